//! A server, its robots, and releases for them, as people make them.

use std::path::PathBuf;
use std::process::Command;
use std::time::{Duration, Instant};

use crawler_tests::measure::{metrics, sum};
use crawler_tests::{Mosquitto, ReservedPort, Simulated, Terracrawler, agent, binary, wait_for};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Bytes of an image: as many as `release bundle` makes where nobody says how many.
pub(crate) const BYTES: u64 = 608_000;
/// Bytes of a block of it, behind which a robot remembers that it has it.
pub(crate) const BLOCK: u64 = 64 * 1_024;
/// Bytes in front of each chunk.
pub(crate) const CHUNK_HEADER: u64 = 16;
/// The build of every release that is the first of its fleet, and the version of all.
pub(crate) const BUILD: &str = "the-next-one";
const VERSION: &str = "9.9.9";
/// The states in which a robot is at work.
pub(crate) const AT_WORK: [&str; 6] = [
    "offered",
    "preparing",
    "receiving",
    "verifying",
    "staged",
    "trial",
];

/// Robots that nothing sets going.
const SCENARIO: &str = "name = \"updates\"\nrobots = 1\n\n[arena]\narea_per_robot = 2.0\n\
                        least_side = 3.0\n\n[spawn]\nclearance = 0.1\n";
const ONLINE: Duration = Duration::from_mins(5);
/// For a rollout to come to its end.
const PATIENCE: Duration = Duration::from_mins(90);

/// Where the server and robots meet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Meeting {
    /// At the server's own broker.
    Embedded,
    /// At Mosquitto.
    Mosquitto,
}

/// Everything that runs.
pub(crate) struct Fleet {
    pub(crate) server: Terracrawler,
    pub(crate) broker: Option<Mosquitto>,
    /// Of whichever broker.
    pub(crate) port: u16,
    folder: TempDir,
    _reserved: Option<ReservedPort>,
}

impl Fleet {
    /// A server that knows a key.
    pub(crate) fn start(meeting: Meeting) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        release(&["keygen", "--out", &path(&folder, "keys")]);
        let key = path(&folder, "keys/release-public.pem");
        let words = ["serve", "--release-key", &key];
        let (server, broker, port, reserved) = match meeting {
            Meeting::Embedded => {
                let server = Terracrawler::start(&words);
                let port = server.mqtt();
                (server, None, port, None)
            }
            Meeting::Mosquitto => {
                let reserved = ReservedPort::new();
                let port = reserved.number();
                let broker = Mosquitto::start(port);
                let url = format!("mqtt://127.0.0.1:{port}");
                let words = [&words[..], &["--broker", &url]].concat();
                (
                    Terracrawler::start(&words),
                    Some(broker),
                    port,
                    Some(reserved),
                )
            }
        };
        Self {
            server,
            broker,
            port,
            folder,
            _reserved: reserved,
        }
    }

    /// Robots in a process of their own that believe the same key, behind `port`; they stand still, since none is
    /// updated as it drives.
    pub(crate) fn robots(&self, port: u16, robots: usize) -> Simulated {
        let key = path(&self.folder, "keys/release-public.pem");
        let count = robots.to_string();
        let scenario = path(&self.folder, "scenario.toml");
        std::fs::write(&scenario, SCENARIO).expect("a scenario");
        let words = ["--robots", &count, "--seed", "1", "--release-key", &key];
        let words = [&words[..], &["--scenario", &scenario]].concat();
        let simulated = Simulated::start(port, &words);
        self.server.wait_online(robots, ONLINE);
        simulated
    }

    /// Makes a release with these defects, and gives it to the server.
    pub(crate) fn release(&self, defects: &[&str]) -> String {
        let image = self.bundle(BUILD, defects);
        self.add(&image, BUILD, 1)
    }

    /// Makes the image of a program.
    pub(crate) fn bundle(&self, build: &str, defects: &[&str]) -> Vec<u8> {
        let image = path(&self.folder, build);
        let mut words = vec!["bundle", "--out", &image, "--version", VERSION];
        words.extend(["--build", build]);
        for defect in defects {
            words.extend(["--defect", defect]);
        }
        release(&words);
        std::fs::read(PathBuf::from(&image)).expect("an image")
    }

    /// Signs an image, and gives it to the server.
    pub(crate) fn add(&self, image: &[u8], build: &str, sequence: u32) -> String {
        let [from, file] = ["image", "release"].map(|name| path(&self.folder, name));
        std::fs::write(&from, image).expect("room");
        // The command writes over nothing.
        let _ = std::fs::remove_file(&file);
        let (key, sequence) = (
            path(&self.folder, "keys/release-key.pem"),
            sequence.to_string(),
        );
        let mut words = vec!["sign", "--key", &key, "--image", &from, "--out", &file];
        words.extend(["--board", "sim", "--sequence", &sequence]);
        words.extend(["--version", VERSION, "--build", build]);
        release(&words);
        let bytes = std::fs::read(PathBuf::from(&file)).expect("a release");
        let url = format!("{}/api/v1/releases", self.server.url());
        let sent = agent()
            .post(&url)
            .header("content-type", "application/octet-stream")
            .send(&bytes[..]);
        let mut answer = sent.expect("an answer");
        let text = answer.body_mut().read_to_string().expect("a body");
        assert_eq!(answer.status(), 201, "{text}");
        let kept: Value = serde_json::from_str(&text).expect("JSON");
        kept["id"].as_str().expect("an id").to_owned()
    }

    /// Begins a rollout of a release.
    pub(crate) fn begin(&self, release: &str, phases: &Value, parallel: usize) -> String {
        let plan = json!({
            "releases": [{ "release": release }],
            "phases": phases,
            "limits": { "parallel": parallel },
        });
        let (status, begun) = self.server.post("/api/v1/rollouts", &plan);
        assert_eq!(status, 201, "{begun}");
        begun["id"].as_str().expect("an id").to_owned()
    }

    /// How far a rollout is; nothing while the server is away.
    pub(crate) fn look(&self, rollout: &str) -> Option<Progress> {
        let (status, body) = self
            .server
            .try_get(&format!("/api/v1/rollouts/{rollout}"))?;
        (status == 200).then_some(Progress(body))
    }

    /// Waits until a rollout has come as far as this, and says how long that took.
    pub(crate) fn wait(
        &self,
        what: &str,
        rollout: &str,
        mut enough: impl FnMut(&Progress) -> bool,
    ) -> Duration {
        let began = Instant::now();
        wait_for(what, PATIENCE, || {
            self.look(rollout).filter(&mut enough).map(|_| ())
        });
        began.elapsed()
    }

    /// What the server counts of chunks: how many, and their bytes with what is in front of each.
    pub(crate) fn chunks(&self) -> Chunks {
        let text = metrics(&self.server);
        let count = |name| sum(&text, name) as u64;
        Chunks {
            chunks: count("terracrawler_updates_chunks_total"),
            bytes: count("terracrawler_updates_chunk_bytes_total"),
        }
    }

    /// Robots by the build that they run.
    pub(crate) fn running(&self, build: &str) -> usize {
        let (status, body) = self.server.get("/api/v1/robots");
        assert_eq!(status, 200, "{body}");
        let robots = body["robots"].as_array().or_else(|| body.as_array());
        let runs = |robot: &&Value| robot["build"] == build;
        robots
            .expect("a list of robots")
            .iter()
            .filter(runs)
            .count()
    }
}

/// What `GET /api/v1/rollouts/{id}` says.
pub(crate) struct Progress(Value);

impl Progress {
    /// Robots in a state.
    pub(crate) fn count(&self, state: &str) -> usize {
        self.0["counts"]["robots"][state].as_u64().unwrap_or(0) as usize
    }

    /// Robots that are at work.
    pub(crate) fn at_work(&self) -> usize {
        AT_WORK.map(|state| self.count(state)).iter().sum()
    }

    /// Bytes of images that robots have.
    pub(crate) fn bytes(&self) -> u64 {
        self.0["counts"]["bytes"].as_u64().unwrap_or(0)
    }

    /// Failures of the first phase.
    pub(crate) fn failures(&self) -> u64 {
        self.0["counts"]["phases"][0]["failures"]
            .as_u64()
            .unwrap_or(0)
    }

    /// Where the rollout itself stands.
    pub(crate) fn state(&self) -> &str {
        self.0["state"].as_str().unwrap_or_default()
    }
}

/// Chunks that were sent.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Chunks {
    pub(crate) chunks: u64,
    /// With what is in front of each.
    pub(crate) bytes: u64,
}

impl Chunks {
    pub(crate) const fn and(self, other: Self) -> Self {
        Self {
            chunks: self.chunks + other.chunks,
            bytes: self.bytes + other.bytes,
        }
    }

    /// Bytes of images and manifests.
    pub(crate) const fn payload(self) -> u64 {
        self.bytes - CHUNK_HEADER * self.chunks
    }

    /// Blocks that each of so many robots was sent more than the image has, on average. Manifests are among them.
    pub(crate) fn again(self, robots: usize) -> f64 {
        let more = self.payload() as f64 - (BYTES * robots as u64) as f64;
        more / BLOCK as f64 / robots as f64
    }
}

fn path(folder: &TempDir, name: &str) -> String {
    let path = folder.path().join(name);
    path.to_str().expect("a plain path").to_owned()
}

/// `terracrawler release`.
fn release(words: &[&str]) {
    let done = Command::new(binary()).arg("release").args(words).output();
    let done = done.expect("terracrawler");
    assert!(done.status.success(), "release {words:?}: {done:?}");
}
