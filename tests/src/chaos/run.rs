//! Processes, the network between them, and what befalls both.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use crawler_sim::net::lockstep::{Cut, LinkModel};
use crawler_sim::net::proxy::{Proxy, ProxyConfig};
use crawler_sim::net::radio::Setup;
use crawler_sim::world::RadioFigures;
use serde_json::Value;
use tempfile::TempDir;

use super::judge::{Kind, judge};
use super::observed::Observations;
use super::people::People;
use super::report::{Fault, Report};
use super::twice::Twice;
use crate::{Mosquitto, ReservedPort, Simulated, Terracrawler, measure, wait_for_with};

/// 5 % of words are sent again, and up to 200 ms more than the shortest way takes.
const BAD_LINK: LinkModel = LinkModel {
    latency_ms: 5.0,
    jitter_ms: 200.0,
    loss: 0.05,
    retransmit_ms: 200.0,
    rssi_dbm: -80,
};
/// Robots without a scenario of their own that would set them going.
const SCENARIO: &str = "name = \"chaos\"\nrobots = 1\n\n[arena]\narea_per_robot = 2.0\n\
                        least_side = 3.0\n\n[spawn]\nclearance = 0.1\n";
/// Commands acknowledged so shortly before the server dies are asked for when it is back.
const RECENT: Duration = Duration::from_secs(3);
/// For the server to bring what it owes to an end: the longest pause between two attempts, and what
/// a busy machine takes on top.
const OWED: Duration = Duration::from_mins(2);
/// After the last command, before anything is asked: longer than motion lives.
const CALM: Duration = Duration::from_secs(5);
const LOOK: Duration = Duration::from_millis(200);

/// Which broker robots and server meet at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Broker {
    /// That of the server, which dies with it.
    Embedded,
    /// Mosquitto.
    Mosquitto,
}

/// What is to happen.
#[derive(Debug, Clone)]
pub struct Options {
    /// Robots.
    pub robots: usize,
    /// Where they meet.
    pub broker: Broker,
    /// When each fault begins, from the moment that all robots are online, and what it is.
    pub faults: Vec<(Duration, Fault)>,
    /// How long a fault lasts.
    pub lasting: Duration,
    /// When commands end, from the same moment.
    pub end: Duration,
    /// For robots to be online, at the beginning and after a fault.
    pub patience: Duration,
    /// Whether what the server has on disk of commands is taken away while it is down: what a server
    /// without a journal would lose.
    pub forget: bool,
    /// Whether commands that go again get a number of their own: what robots would do without
    /// numbers.
    pub forge: bool,
}

/// Everything that runs.
struct Running {
    options: Options,
    server: Terracrawler,
    mosquitto: Option<Mosquitto>,
    broker_port: u16,
    /// The port of Mosquitto, while it is down as well.
    _broker_reserved: Option<ReservedPort>,
    proxy: Option<Proxy>,
    /// That of the proxy, likewise.
    proxy_port: ReservedPort,
    /// When the last fault ended.
    ended: Instant,
}

/// Plays it all, and judges.
///
/// # Panics
/// When something cannot be started, or the robots never get online in the first place.
pub fn run(options: Options) -> Report {
    let folder = tempfile::tempdir().expect("a folder");
    let mut running = Running::set(options);
    let robots = running.options.robots;
    let simulated = running.simulate(&folder);
    running.server.wait_online(robots, running.options.patience);
    let began = Instant::now();
    let twice = Twice::start(running.broker_port, running.options.forge);
    let people = People::start(&running.server.url(), robots);
    let mut report = Report {
        robots,
        ..Report::default()
    };
    for (at, fault) in running.options.faults.clone() {
        std::thread::sleep(at.saturating_sub(began.elapsed()));
        let owed = running.befall(fault, &people);
        report.faults.push((fault, running.wait_back()));
        report.open += running.still_open(&owed);
    }
    std::thread::sleep(running.options.end.saturating_sub(began.elapsed()));
    // On a busy machine it takes longer until there is something to judge.
    let (patience, ended) = (running.options.patience, running.ended);
    let mut seen = (0, BTreeSet::new());
    wait_for_with(
        "commands of all kinds, and twice",
        patience,
        &mut seen,
        |seen| {
            *seen = (twice.sent(), people.acknowledged(ended));
            (seen.0 > 0 && Kind::ALL.iter().all(|kind| seen.1.contains(kind))).then_some(())
        },
    );
    let given = people.stop();
    twice.stop();
    std::thread::sleep(CALM);
    report.open += running.owes();
    simulated.interrupt();
    report.seconds = began.elapsed().as_secs();
    let observed = Observations::read(&folder.path().join("chaos.mcap"));
    judge(&given, &observed, &mut report);
    report
}

impl Running {
    fn set(options: Options) -> Self {
        let (server, mosquitto, broker_port, reserved) = match options.broker {
            Broker::Embedded => {
                let server = Terracrawler::start(&["serve"]);
                let port = server.mqtt();
                (server, None, port, None)
            }
            Broker::Mosquitto => {
                let reserved = ReservedPort::new();
                let port = reserved.number();
                let broker = Mosquitto::start(port);
                let url = format!("mqtt://127.0.0.1:{port}");
                let server = Terracrawler::start(&["serve", "--broker", &url]);
                (server, Some(broker), port, Some(reserved))
            }
        };
        let mut running = Self {
            options,
            server,
            mosquitto,
            broker_port,
            _broker_reserved: reserved,
            proxy: None,
            proxy_port: ReservedPort::new(),
            ended: Instant::now(),
        };
        running.connect();
        running
    }

    /// Opens the way from the robots to their broker.
    fn connect(&mut self) {
        let config = ProxyConfig {
            listen: ([127, 0, 0, 1], self.proxy_port.number()).into(),
            broker: vec![([127, 0, 0, 1], self.broker_port).into()],
            setup: Setup {
                link: BAD_LINK,
                radio: None,
                figures: RadioFigures::default(),
                seed: 1,
            },
            // Those of robots that gave up and of robots that try again.
            most_connections: 4 * self.options.robots + 16,
        };
        self.proxy = Some(Proxy::start(&config).expect("a proxy"));
    }

    fn simulate(&self, folder: &TempDir) -> Simulated {
        let scenario = folder.path().join("chaos.toml");
        std::fs::write(&scenario, SCENARIO).expect("a scenario");
        let record = folder.path().join("chaos.mcap");
        let robots = self.options.robots.to_string();
        let paths = [&scenario, &record].map(|path| path.to_str().expect("a plain path"));
        let [scenario, record] = paths;
        Simulated::start(
            self.proxy_port.number(),
            &[
                "--robots",
                &robots,
                "--seed",
                "1",
                "--scenario",
                scenario,
                "--record",
                record,
            ],
        )
    }

    fn cut(&self, share_in_ten: usize, cut: Cut) {
        let proxy = self.proxy.as_ref().expect("a proxy");
        for robot in 0..self.options.robots {
            // Three of every ten are never cut off together with their neighbours.
            if robot * 7 % 10 < share_in_ten {
                proxy.cut(&format!("sim-{:04}", robot + 1), cut);
            }
        }
    }

    /// Lets a fault come and go. Where the server dies by it, tells what it owed then.
    fn befall(&mut self, fault: Fault, people: &People) -> Vec<String> {
        let mut owed = Vec::new();
        match fault {
            Fault::ServerKilled => {
                owed = people.owed(RECENT);
                self.server.kill();
            }
            Fault::KilledInPartition => {
                self.cut(4, Cut::Silent);
                std::thread::sleep(self.options.lasting);
                owed = people.owed(self.options.lasting);
                self.server.kill();
            }
            Fault::BrokerKilled => self.kill_broker(),
            Fault::BothKilled => {
                owed = people.owed(RECENT);
                self.kill_broker();
                self.server.kill();
            }
            Fault::Partition => self.cut(4, Cut::Silent),
            Fault::Stall => self.cut(10, Cut::Silent),
            Fault::Cut => {
                if let Some(proxy) = self.proxy.take() {
                    proxy.stop(Duration::ZERO).expect("the proxy ends");
                }
            }
        }
        std::thread::sleep(self.options.lasting);
        self.ended = Instant::now();
        match fault {
            Fault::ServerKilled => self.revive(),
            Fault::KilledInPartition => {
                self.revive();
                self.ended = Instant::now();
                self.cut(10, Cut::None);
            }
            Fault::BrokerKilled => self.mosquitto = Some(Mosquitto::start(self.broker_port)),
            Fault::BothKilled => {
                self.mosquitto = Some(Mosquitto::start(self.broker_port));
                self.revive();
            }
            Fault::Partition | Fault::Stall => self.cut(10, Cut::None),
            Fault::Cut => self.connect(),
        }
        owed
    }

    /// How long after the end of the fault all robots were online, milliseconds.
    fn wait_back(&self) -> Option<u64> {
        while self.ended.elapsed() < self.options.patience {
            if self.online() == self.options.robots {
                return Some(self.ended.elapsed().as_millis() as u64);
            }
            std::thread::sleep(LOOK);
        }
        None
    }

    fn kill_broker(&mut self) {
        let broker = self.mosquitto.take();
        broker.expect("an outside broker to kill").kill();
    }

    fn revive(&mut self) {
        if self.options.forget {
            let journal = self.server.data().join("commands");
            std::fs::remove_file(journal).expect("a journal");
        }
        self.server.restart();
        self.server.wait_ready();
    }

    fn online(&self) -> usize {
        let Some((200, body)) = self.server.try_get("/api/v1/robots") else {
            return 0;
        };
        let robots = body["robots"].as_array().or_else(|| body.as_array());
        robots.map_or(0, |robots| {
            let online = |robot: &&Value| robot["presence"] == "online";
            robots.iter().filter(online).count()
        })
    }

    /// Of these commands those that the server still calls open when it has had its time. One that
    /// it does not know any more had come to an end before; the recording tells to which.
    fn still_open(&self, ids: &[String]) -> u64 {
        let end = Instant::now() + OWED;
        let mut left: Vec<&String> = ids.iter().collect();
        loop {
            left.retain(|id| {
                let answer = self.server.try_get(&format!("/api/v1/commands/{id}"));
                let status = answer.map(|(_, view)| view["status"].clone());
                status.is_some_and(|status| status == "pending" || status == "accepted")
            });
            if left.is_empty() || Instant::now() > end {
                return left.len() as u64;
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Commands that are open when nobody has given any for a while.
    fn owes(&self) -> u64 {
        let end = Instant::now() + OWED;
        loop {
            let open = measure::sum(
                &measure::metrics(&self.server),
                "terracrawler_commands_open",
            );
            if open == 0.0 || Instant::now() > end {
                return open as u64;
            }
            std::thread::sleep(LOOK);
        }
    }
}
