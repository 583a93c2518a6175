//! Starting is all or nothing: whichever part fails, nothing of the others is left.

use std::collections::BTreeMap;
use std::net::{Ipv4Addr, TcpListener};
use std::num::NonZeroU8;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use crawler_records::RECORDS_FILE;

use super::*;
use crate::addresses::ADDRESSES_FILE;
use crate::config::{Layer, Role, TlsMode};
use crawler_system::data::DataDir;
use crawler_system::data::test_disk::{LIMIT, TestDisk};

/// Threads that end with the process: those of the runtime of the test, and one for all brokers together.
const OTHERS: [&str; 2] = ["own", "futures-timer"];

/// Runs a test on threads that are known. Whatever other runtimes are there belong to a server.
fn run(test: impl Future<Output = ()>) {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.thread_name(OTHERS[0]).enable_all();
    runtime.build().expect("a runtime").block_on(test);
}

/// Threads of this process by their names, but for [`OTHERS`].
fn threads() -> BTreeMap<String, usize> {
    let mut threads = BTreeMap::new();
    for thread in std::fs::read_dir("/proc/self/task").expect("a list") {
        // One that has ended in between has no name any more.
        if let Ok(name) = std::fs::read_to_string(thread.expect("a thread").path().join("comm"))
            && !OTHERS.contains(&name.trim())
        {
            *threads.entry(name.trim().to_owned()).or_default() += 1;
        }
    }
    threads
}

/// Ports that nobody has, nor will have when a server is to start there once more: they are of a loopback address that
/// belongs to this process, while whoever connects or listens elsewhere does so from 127.0.0.1.
fn free_ports<const N: usize>() -> [SocketAddr; N] {
    let [_, high, middle, low] = std::process::id().to_be_bytes();
    let own = Ipv4Addr::new(127, 64 | (high & 63), middle, low);
    let held = [(); N].map(|()| TcpListener::bind((own, 0)).expect("a port"));
    held.each_ref()
        .map(|held| held.local_addr().expect("bound"))
}

/// A place for a server, and what was there before it.
struct Place {
    folder: PathBuf,
    http: SocketAddr,
    mqtt: SocketAddr,
    tasks: usize,
    threads: BTreeMap<String, usize>,
}

impl Place {
    fn new(name: &str) -> Self {
        let name = format!("crawler-server-start-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir(&folder).expect("a folder");
        let [http, mqtt] = free_ports();
        Self {
            folder,
            http,
            mqtt,
            tasks: alive_tasks(),
            threads: threads(),
        }
    }

    fn layer(&self) -> Layer {
        Layer {
            http: Some(self.http),
            mqtt: Some(self.mqtt),
            data: Some(self.folder.clone()),
            open: Some(true),
            robots: Some(2),
            seed: Some(1),
            experiment_threads: NonZeroU8::new(2),
            ..Layer::default()
        }
    }

    /// Asserts that nothing of a server is left: listeners, data directory, tasks, threads.
    async fn is_clean(&self, after: &str) {
        for address in [self.http, self.mqtt] {
            TcpListener::bind(address)
                .unwrap_or_else(|error| panic!("{after}: {address}: {error}"));
        }
        drop(DataDir::open(&self.folder).unwrap_or_else(|error| panic!("{after}: {error}")));
        assert!(!self.folder.join(ADDRESSES_FILE).exists(), "{after}");
        let end = Instant::now() + LIMIT;
        loop {
            let (tasks, now) = (alive_tasks(), threads());
            // Other tests of this program start threads and end them, unless each has a process.
            let alone = std::env::var_os("NEXTEST").is_some();
            if tasks == self.tasks && (now == self.threads || !alone) {
                return;
            }
            assert!(
                Instant::now() < end,
                "{after}: {tasks} tasks instead of {}; threads are {now:?} instead of {:?}",
                self.tasks,
                self.threads
            );
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    fn remove(self) {
        std::fs::remove_dir_all(self.folder).expect("clean up");
    }
}

fn alive_tasks() -> usize {
    tokio::runtime::Handle::current()
        .metrics()
        .num_alive_tasks()
}

async fn stop(server: Server) {
    let stopped = tokio::time::timeout(LIMIT, server.stop()).await;
    stopped.expect("the server stops");
}

fn settings(role: Role, layer: Layer) -> Settings {
    Settings::from_layers(role, &[layer]).expect("settings")
}

#[test]
fn whichever_part_fails_nothing_of_the_others_is_left() {
    run(async {
        let place = Place::new("parts");
        let layer = Layer {
            tls: Some(TlsMode::On),
            ..place.layer()
        };
        let settings = settings(Role::Up, layer);
        let mut failed = 0;
        let server = loop {
            let parts = Parts::failing_after(failed + 1);
            match Server::start_on(&settings, Disk::default(), parts).await {
                Ok(server) => break server,
                Err(StartError::Internal("what a test asked for")) => failed += 1,
                Err(error) => panic!("after {failed} parts: {error}"),
            }
            place.is_clean(&format!("with {failed} parts")).await;
        };
        assert!(failed > 10, "only {failed} parts can fail");
        assert!(place.folder.join(ADDRESSES_FILE).exists());
        stop(server).await;
        place.is_clean("after a stop").await;
        place.remove();
    });
}

#[test]
fn a_server_that_is_dropped_ends_by_itself() {
    run(async {
        let place = Place::new("dropped");
        let settings = settings(Role::Up, place.layer());
        let server = Server::start(&settings).await.expect("started");
        drop(server);
        let end = Instant::now() + LIMIT;
        while let Err(error) = DataDir::open(&place.folder) {
            assert!(Instant::now() < end, "{error}");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        for address in [place.http, place.mqtt] {
            while let Err(error) = TcpListener::bind(address) {
                assert!(Instant::now() < end, "{address}: {error}");
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        }
        place.is_clean("after it was dropped").await;
        stop(Server::start(&settings).await.expect("again")).await;
        place.remove();
    });
}

/// What is in the way of a start, until it is dropped.
enum Obstacle {
    Port {
        _held: TcpListener,
    },
    /// Something else where a file is, and what was there.
    File(PathBuf, Option<Vec<u8>>),
    Full(TestDisk),
    /// The options themselves.
    Options,
}

impl Obstacle {
    fn file(path: PathBuf, put: impl FnOnce(&Path) -> std::io::Result<()>) -> Self {
        let before = std::fs::read(&path).ok();
        if before.is_some() {
            std::fs::remove_file(&path).expect("remove");
        }
        put(&path).expect("put");
        Self::File(path, before)
    }
}

impl Drop for Obstacle {
    fn drop(&mut self) {
        match self {
            Self::Port { .. } | Self::Options => {}
            Self::File(path, before) => {
                if path.is_dir() {
                    std::fs::remove_dir(&path).expect("remove");
                } else {
                    std::fs::remove_file(&path).expect("remove");
                }
                if let Some(before) = before {
                    std::fs::write(path, before).expect("put back");
                }
            }
            Self::Full(disk) => disk.set_full(false),
        }
    }
}

#[test]
fn whatever_is_in_the_way_a_start_leaves_nothing_and_the_next_one_succeeds() {
    run(async {
        let place = Place::new("causes");
        let disk = TestDisk::default();
        let port = |address| Obstacle::Port {
            _held: TcpListener::bind(address).expect("free"),
        };
        let file = |name: &str, text: &str| {
            Obstacle::file(place.folder.join(name), |path| std::fs::write(path, text))
        };
        let folder =
            |name: &str| Obstacle::file(place.folder.join(name), |path| std::fs::create_dir(path));
        let with = |change: fn(&mut Layer)| {
            let mut layer = place.layer();
            change(&mut layer);
            settings(Role::Up, layer)
        };
        let usual = || with(|_| {});
        // Nobody listens there.
        let cases: [(&str, &dyn Fn() -> Obstacle, Settings); 14] = [
            (
                "in use by another program; API",
                &|| port(place.http),
                usual(),
            ),
            (
                "in use by another program; the embedded",
                &|| port(place.mqtt),
                usual(),
            ),
            (
                "in use by another program; the embedded",
                &|| port(place.mqtt),
                with(|layer| {
                    layer.tls = Some(TlsMode::On);
                }),
            ),
            (
                "command-sequence: is not a number",
                &|| file("command-sequence", "x"),
                usual(),
            ),
            (
                "experiments-owner: is not a number",
                &|| file("experiments-owner", "x"),
                usual(),
            ),
            ("commands", &|| folder("commands"), usual()),
            (
                RECORDS_FILE,
                &|| {
                    file(
                        RECORDS_FILE,
                        "no database, but a text that is long enough to be taken for one",
                    )
                },
                usual(),
            ),
            (
                "no storage space",
                &|| {
                    disk.set_full(true);
                    Obstacle::Full(disk.clone())
                },
                usual(),
            ),
            (
                "postgres",
                &|| Obstacle::Options,
                with(|layer| {
                    layer.database = Some(
                        "postgres://nobody@127.0.0.1:1/none"
                            .parse()
                            .expect("an address"),
                    );
                }),
            ),
            (
                "the broker at",
                &|| Obstacle::Options,
                with(|layer| {
                    layer.mqtt = None;
                    layer.broker = Some("mqtt://127.0.0.1:1".parse().expect("an address"));
                }),
            ),
            (
                "the broker at",
                &|| Obstacle::Options,
                with(|layer| {
                    layer.mqtt = None;
                    layer.broker = Some("mqtts://127.0.0.1:1".parse().expect("an address"));
                }),
            ),
            (
                "the other servers cannot be joined",
                &|| Obstacle::Options,
                Settings {
                    // The options ask for an outside broker then, which comes before it.
                    cache: Some("redis://127.0.0.1:1".parse().expect("an address")),
                    ..usual()
                },
            ),
            (
                "simulated robots",
                &|| Obstacle::Options,
                with(|layer| {
                    layer.scenario = Some("nothing-of-this-name".into());
                }),
            ),
            (
                "no-such-file",
                &|| Obstacle::Options,
                with(|layer| {
                    layer.tls_certificate = Some("no-such-file".into());
                    layer.tls_key = Some("no-such-file".into());
                    layer.tls = Some(TlsMode::On);
                }),
            ),
        ];
        for (wanted, obstacle, settings) in cases {
            let obstacle = obstacle();
            let start = Server::start_on(&settings, disk.handle(), Parts::default());
            let started = tokio::time::timeout(LIMIT, start).await.expect("an answer");
            let error = started.err().map(|error| error.to_string());
            let error = error.unwrap_or_else(|| panic!("started in spite of {wanted}"));
            assert!(error.contains(wanted), "{error}");
            drop(obstacle);
            place.is_clean(&error).await;
        }
        let server = Server::start(&usual())
            .await
            .expect("nothing is in the way");
        stop(server).await;
        place.is_clean("after a stop").await;
        place.remove();
    });
}
