//! Updates of the emulated board, on machine code: boot stage, flash, program and broker are real; the server's part
//! is played by the test.

use std::time::Duration;

use crawler_hil::emulator::{self, Options};
use crawler_tests::{Mosquitto, ReservedPort};
use crawler_updates::release::SecretKey;
use serde_json::Value;

use super::board::Board;
use super::machine;
use super::update_server::{News, Release, UpdateServer, point};

/// For a whole update with its trial of half a minute, and for a start after a power cut.
const UPDATES: Duration = Duration::from_mins(5);
const STARTS: Duration = Duration::from_mins(2);
/// How often the power is cut during one update, unless the variable says otherwise.
const CUTS: u32 = 20;
const CUTS_VARIABLE: &str = "CRAWLER_POWER_CUTS";

/// A robot that takes releases, a server that makes them, and a broker between.
struct Fleet {
    _broker: Mosquitto,
    _port: ReservedPort,
    server: UpdateServer,
    key: SecretKey,
    options: Options,
}

impl Fleet {
    fn new(arguments: &[&str]) -> Self {
        let port = ReservedPort::new();
        let number = port.number();
        let broker = Mosquitto::start(number);
        let key = SecretKey::generate().expect("a key");
        let robot = "virt-01".parse().expect("an id");
        let image = emulator::image().unwrap_or_else(|error| panic!("{error}"));
        let mut options = Options::new(image, robot, crawler_hil::BrokerUrl::loopback(number));
        options.arguments = arguments.iter().map(|word| (*word).to_owned()).collect();
        options.release_keys = vec![point(&key)];
        Self {
            _broker: broker,
            _port: port,
            server: UpdateServer::start("virt-01", number),
            key,
            options,
        }
    }

    /// The board, with the program that it is flashed with.
    fn board(&self) -> Board {
        Board::start_with(self.options.clone())
    }

    /// The program that it is flashed with, as a release.
    fn flashed(&self) -> Release {
        Release::sign(&self.options.program().expect("a program"), 1, &self.key)
    }

    /// The build of that.
    fn build(&self) -> String {
        self.flashed().build
    }

    /// Another build of the same program: it has a second key.
    fn update(&self, sequence: u32) -> Release {
        let mut options = self.options.clone();
        let next = SecretKey::generate().expect("a key");
        options.release_keys.push(point(&next));
        let image = options.program().expect("a program");
        let release = Release::sign(&image, sequence, &self.key);
        assert_ne!(release.build, self.build());
        release
    }
}

/// What the robot says when an update came to its end.
fn outcome(news: &News, release: &Release) -> Option<Value> {
    match news {
        News::Report(report)
            if report["update"] == "outcome" && report["release"] == release.id.as_str() =>
        {
            Some(report.clone())
        }
        _ => None,
    }
}

/// The build that the robot says it has.
fn build(news: &News) -> Option<String> {
    match news {
        News::Report(report) if report["update"] == "have" => {
            Some(report["build"].as_str()?.to_owned())
        }
        _ => None,
    }
}

#[test]
fn an_update_is_proven_by_the_program_that_runs_it() {
    let _machine = machine();
    let fleet = Fleet::new(&[]);
    let release = fleet.update(2);
    let board = fleet.board();
    fleet.server.hand_out(&release, None);
    let mut stages = Vec::new();
    let outcome = fleet
        .server
        .pursue("the outcome", &release, UPDATES, |news| {
            if let News::Report(report) = news
                && let Some(stage) = report["state"].as_str()
                && stages.last().is_none_or(|last| last != stage)
            {
                stages.push(stage.to_owned());
            }
            outcome(news, &release)
        });
    assert_eq!(outcome["outcome"], "confirmed", "{outcome}");
    // A report that still waits when the next one comes is not sent: checking may be done before.
    let way = ["preparing", "receiving", "staged"];
    let mut told = stages.iter();
    assert!(
        way.iter().all(|stage| told.any(|told| told == stage)),
        "{stages:?}"
    );
    // The program that says so is the new one, from the other slot.
    assert!(
        board
            .wait_line(&format!("build {}", release.build), STARTS)
            .is_some()
    );
    assert!(board.wait_line("slot 1, on trial", STARTS).is_some());
    // And it is the one that starts from now on.
    let mut board = board;
    board.power_cycle().expect("it starts again");
    assert!(board.wait_line("slot 1, proven", STARTS).is_some());
    let runs = fleet.server.pursue("what it has", &release, STARTS, build);
    assert_eq!(runs, release.build);
}

/// Not one chunk of the image is sent.
#[test]
fn an_update_comes_as_a_patch_of_the_program_that_runs() {
    let _machine = machine();
    let fleet = Fleet::new(&[]);
    let release = fleet.update(2).after(&fleet.flashed());
    let board = fleet.board();
    fleet.server.hand_out(&release, Some(0));
    let outcome = fleet
        .server
        .pursue("the outcome", &release, UPDATES, |news| {
            outcome(news, &release)
        });
    assert_eq!(outcome["outcome"], "confirmed", "{outcome}");
    assert!(
        board
            .wait_line(&format!("build {}", release.build), STARTS)
            .is_some()
    );
}

#[test]
fn a_program_that_panics_on_trial_is_given_up() {
    let _machine = machine();
    let fleet = Fleet::new(&["fault=trial-panic@3"]);
    let release = fleet.update(2);
    let board = fleet.board();
    fleet.server.hand_out(&release, None);
    let outcome = fleet
        .server
        .pursue("the outcome", &release, UPDATES, |news| {
            outcome(news, &release)
        });
    assert_eq!(outcome["outcome"], "rolled_back", "{outcome}");
    assert_eq!(outcome["reason"], "panic", "{outcome}");
    assert!(
        board
            .wait_line("slot 1 is given up: panic", STARTS)
            .is_some()
    );
    let runs = fleet.server.pursue("what it has", &release, STARTS, build);
    assert_eq!(runs, fleet.build());
}

#[test]
fn an_image_that_is_no_program_is_passed_over() {
    let _machine = machine();
    let fleet = Fleet::new(&[]);
    // Signed, whole, and nothing that runs.
    let release = Release::sign(&vec![0x13; 100_000], 2, &fleet.key);
    let board = fleet.board();
    fleet.server.hand_out(&release, None);
    let outcome = fleet
        .server
        .pursue("the outcome", &release, UPDATES, |news| {
            outcome(news, &release)
        });
    assert_eq!(outcome["outcome"], "rolled_back", "{outcome}");
    assert_eq!(outcome["reason"], "bad_image", "{outcome}");
    let passed_over = "slot 0: the other one does not start: bad_image";
    assert!(board.wait_line(passed_over, STARTS).is_some());
}

/// Where the power goes.
enum Cut {
    /// When so many chunks of the image were sent since the start.
    Sent(u32),
    /// When the robot says that it is there, or further.
    At(Stage),
    /// When the new program has said what it has: on trial.
    Trial,
}

/// How far a robot is that has not started the new program.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    Preparing,
    Receiving,
    Verifying,
    Staged,
}

impl Stage {
    fn of(news: &News) -> Option<Self> {
        let News::Report(report) = news else {
            return None;
        };
        match report["state"].as_str()? {
            "preparing" => Some(Self::Preparing),
            "receiving" => Some(Self::Receiving),
            "verifying" => Some(Self::Verifying),
            "staged" => Some(Self::Staged),
            _ => None,
        }
    }
}

impl Cut {
    /// Whether now is the moment; if so, whether the image was whole before the power goes, and the robot may start
    /// it on its own meanwhile.
    fn is_now(&self, news: &News, new: &str) -> Option<bool> {
        let stage = Stage::of(news);
        let runs_new = build(news).is_some_and(|build| build == new);
        let whole = runs_new || stage >= Some(Stage::Verifying);
        match self {
            Self::Sent(_) => (whole || matches!(news, News::Sent)).then_some(whole),
            Self::At(at) => (runs_new || stage >= Some(*at)).then_some(whole),
            Self::Trial => runs_new.then_some(true),
        }
    }
}

/// The power is cut again and again while an update comes in, while it is tried, and after: the robot always comes
/// back, with the program before until the new one has proven itself, and goes on where it was.
#[test]
fn power_cuts_at_any_point_brick_no_robot() {
    let _machine = machine();
    let fleet = Fleet::new(&[]);
    let release = fleet.update(2);
    let old = fleet.build();
    let mut board = fleet.board();
    let cuts = std::env::var(CUTS_VARIABLE).ok();
    let cuts = cuts.map_or(CUTS, |text| text.parse().expect("a number"));
    for cut in plan(cuts, &release) {
        let chunks = match cut {
            Cut::Sent(chunks) => Some(chunks),
            Cut::At(_) | Cut::Trial => None,
        };
        fleet.server.hand_out(&release, chunks);
        let whole = fleet
            .server
            .pursue("a moment to cut the power", &release, UPDATES, |news| {
                cut.is_now(news, &release.build)
            });
        board.power_cycle().expect("it starts again");
        // Whatever it was at: it is there, with one of the two programs.
        let runs = fleet.server.pursue("it is back", &release, STARTS, build);
        assert!(runs == old || runs == release.build, "{runs}");
        if !whole {
            assert_eq!(runs, old, "nothing unproven was started");
        }
    }
    fleet.server.hand_out(&release, None);
    let outcome = fleet
        .server
        .pursue("the outcome", &release, UPDATES, |news| {
            outcome(news, &release)
        });
    assert_eq!(outcome["outcome"], "confirmed", "{outcome}");
    board.power_cycle().expect("it starts again");
    let runs = fleet.server.pursue("what it has", &release, STARTS, build);
    assert_eq!(runs, release.build);
}

/// So many cuts: most while the image comes in, spread over different places of blocks; some as the slot is prepared,
/// as it is verified and as it is started, and one on trial. The image may be started before the power goes from the
/// moment that it is verified: with the fourth time that it is switched on, a program on trial is given up.
fn plan(cuts: u32, release: &Release) -> Vec<Cut> {
    let chunks = release.image.len() as u32 / 1_024;
    let others = [
        Cut::At(Stage::Preparing),
        Cut::At(Stage::Verifying),
        Cut::At(Stage::Staged),
        Cut::Trial,
    ];
    let receiving = cuts.saturating_sub(others.len() as u32);
    // Whole blocks of 64 chunks stay, so all of them together come to the end; a step of 7 meets any place in them.
    let rest =
        (0..receiving).map(|cut| Cut::Sent((1 + cut * 7) % 64 + 1 + chunks / (2 * receiving)));
    let [preparing, others @ ..] = others;
    std::iter::once(preparing)
        .chain(rest)
        .chain(others)
        .collect()
}
