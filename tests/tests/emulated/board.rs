//! An emulated board in a test, and the bench it lies on.

use std::ops::{Deref, DerefMut};

use crawler_hil::BrokerUrl;
use crawler_hil::emulator::{self, Emulator, Options};
use crawler_hil::suite::{self, Bench, BenchError, Failure, Outcome, Target};
use crawler_protocol::{Fleet, RobotId};

/// An emulator that shows its log when its test fails.
pub(crate) struct Board(Emulator);

impl Board {
    /// A board whose broker is on this machine.
    pub(crate) fn start(id: &str, port: u16, arguments: &[&str]) -> Self {
        Self::start_at(id, BrokerUrl::loopback(port), arguments)
    }

    pub(crate) fn start_at(id: &str, broker: BrokerUrl, arguments: &[&str]) -> Self {
        let robot = RobotId::new(id).expect("an id");
        // In one line, with its remedy.
        let image = emulator::image().unwrap_or_else(|error| panic!("{error}"));
        Self::start_with(Options {
            arguments: arguments.iter().map(|word| (*word).to_owned()).collect(),
            ..Options::new(image, robot, broker)
        })
    }

    pub(crate) fn start_with(options: Options) -> Self {
        Self(Emulator::start(options).unwrap_or_else(|error| panic!("{error}")))
    }
}

impl Deref for Board {
    type Target = Emulator;

    fn deref(&self) -> &Emulator {
        &self.0
    }
}

impl DerefMut for Board {
    fn deref_mut(&mut self) -> &mut Emulator {
        &mut self.0
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("--- log of {} ---", self.0.robot());
            for line in self.0.lines() {
                eprintln!("{line}");
            }
        }
    }
}

fn target(id: &str, broker: BrokerUrl) -> Target {
    Target {
        broker,
        fleet: Fleet::default(),
        robot: RobotId::new(id).expect("an id"),
    }
}

fn block_on<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime")
        .block_on(work)
}

/// Runs the suite, all of it when `only` is empty; `may_skip` need not be possible here.
pub(crate) fn suite_on(id: &str, port: u16, only: &[&str], may_skip: &[&str]) {
    let options = suite::Options {
        no_motion: false,
        only: only.iter().map(|name| (*name).to_owned()).collect(),
    };
    let target = target(id, BrokerUrl::loopback(port));
    let report = block_on(suite::run(&target, &options, |_| {}));
    let report = report.unwrap_or_else(|error| panic!("{error}"));
    for case in &report.cases {
        let fine = match case.outcome {
            Outcome::Passed => true,
            Outcome::Skipped(_) => may_skip.contains(&case.name),
            Outcome::Failed(_) => false,
        };
        assert!(fine, "{id}: {case}\n{report}");
    }
}

/// Does `work` with a session that hears the robot.
pub(crate) fn listen(
    id: &str,
    port: u16,
    work: impl AsyncFnOnce(&mut Bench) -> Result<(), Failure>,
) {
    listen_at(id, BrokerUrl::loopback(port), work);
}

pub(crate) fn listen_at(
    id: &str,
    broker: BrokerUrl,
    work: impl AsyncFnOnce(&mut Bench) -> Result<(), Failure>,
) {
    block_on(async {
        let opened = Bench::open(target(id, broker)).await;
        let mut bench = opened.unwrap_or_else(|error| panic!("{error}"));
        work(&mut bench)
            .await
            .unwrap_or_else(|error| panic!("{error}"));
        bench.close().await;
    });
}

/// Checks that nobody gets in with these credentials.
pub(crate) fn refused_at(broker: BrokerUrl) {
    let refused = block_on(Bench::open(target("nobody", broker)));
    assert!(matches!(refused.err(), Some(BenchError::Refused(..))));
}
