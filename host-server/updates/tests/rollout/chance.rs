//! Anything may happen, in any order: the rules hold, whatever the server was at when it was killed.

use crawler_protocol::RobotId;
use crawler_updates::rollout::{
    Busy, Command, Event, Grant, Plan, ReleaseId, Report, RolloutState, Sighting, UpdateState,
};
use proptest::prelude::*;

use crate::scene::{NEW, OLD, Scene, build, code, plan, sighting};

const ROBOTS: usize = 8;

/// What happens next, to the robot of that number.
#[derive(Debug, Clone)]
enum Happens {
    Seen {
        online: bool,
        busy: Option<Busy>,
        new: bool,
        boots: u32,
    },
    Told(Report),
    Other(Report),
    Pass(u64),
    /// The clock of the machine is set.
    Set(u64),
    Command(Command),
    Take(u32),
    Restart,
}

/// Where the server is killed.
#[derive(Debug, Clone, Copy)]
enum Kill {
    Never,
    BeforeStoring,
    AfterSending(usize),
}

fn report() -> impl Strategy<Value = Report> {
    prop_oneof![
        1 => Just(Report::Deferred(code("driving"))),
        3 => Just(Report::Preparing),
        3 => (0_u32..2_000).prop_map(Report::Receiving),
        3 => Just(Report::Verifying),
        3 => Just(Report::Staged),
        4 => Just(Report::Trial(build(NEW))),
        1 => Just(Report::Trial(build(OLD))),
        6 => Just(Report::Confirmed(build(NEW))),
        1 => Just(Report::Confirmed(build("other"))),
        2 => Just(Report::RolledBack(code("panic"))),
        2 => any::<bool>().prop_map(|lasting| Report::Refused { code: code("no"), lasting }),
        1 => Just(Report::Withdrawn),
    ]
}

fn command(robot: RobotId) -> impl Strategy<Value = Command> {
    prop_oneof![
        2 => Just(Command::Pause),
        6 => Just(Command::Resume),
        1 => Just(Command::Abort),
        3 => Just(Command::Retry(robot.clone())),
        2 => Just(Command::Skip(robot.clone())),
        1 => Just(Command::Supersede(robot)),
    ]
}

fn happens(robot: RobotId) -> impl Strategy<Value = Happens> {
    let busy = prop_oneof![
        4 => Just(None),
        1 => Just(Some(Busy::Asleep)),
        1 => Just(Some(Busy::Driving)),
        1 => Just(Some(Busy::LowBattery)),
    ];
    let seen = (prop::bool::weighted(0.8), busy, any::<bool>(), 0_u32..3);
    prop_oneof![
        8 => seen.prop_map(|(online, busy, new, boots)| Happens::Seen { online, busy, new, boots }),
        20 => report().prop_map(Happens::Told),
        1 => report().prop_map(Happens::Other),
        6 => (0_u64..200).prop_map(Happens::Pass),
        1 => (0_u64..100_000).prop_map(Happens::Pass),
        1 => (0_u64..1 << 45).prop_map(Happens::Set),
        3 => command(robot).prop_map(Happens::Command),
        3 => (0_u32..20_000).prop_map(Happens::Take),
        1 => Just(Happens::Restart),
    ]
}

fn kill() -> impl Strategy<Value = Kill> {
    prop_oneof![
        8 => Just(Kill::Never),
        1 => Just(Kill::BeforeStoring),
        2 => (0_usize..3).prop_map(Kill::AfterSending),
    ]
}

fn name(robot: usize) -> RobotId {
    RobotId::new(&format!("a{robot:04}")).unwrap()
}

fn any_plan() -> impl Strategy<Value = Plan> {
    let shares = prop_oneof![
        Just(vec![100_u8]),
        Just(vec![25, 100]),
        Just(vec![1, 50, 75]),
    ];
    let window = prop::option::of((0_u16..24, 0_u16..24));
    let numbers = (1_u32..5, 0_u32..300, 1_u8..=100, 1_u32..4, 1_u8..4);
    (shares, window, numbers, any::<bool>()).prop_map(|(shares, window, numbers, waits)| {
        let mut plan = plan(&shares);
        let (parallel, soak, success, least, attempts) = numbers;
        plan.limits.parallel = parallel;
        plan.limits.bytes_per_second = Some(20_000);
        plan.limits.wait_s = waits.then_some(3_600);
        plan.retries.attempts = attempts;
        for phase in &mut plan.phases {
            phase.soak_s = soak;
            phase.success_percent = success;
            phase.min_count = least;
        }
        plan.phases[0].stop_min_count = least;
        if let Some((from, to)) = window.filter(|(from, to)| from != to) {
            let window =
                serde_json::json!({"from": format!("{from:02}:00"), "to": format!("{to:02}:00")});
            plan.window = Some(serde_json::from_value(window).unwrap());
        }
        plan
    })
}

/// A rollout, and what is true of its robots.
struct Chance {
    scene: Scene,
    robots: Vec<Sighting>,
    /// What may be sent, and when.
    passed: Vec<(u64, u64)>,
    /// Time that no clock was set in.
    true_ms: u64,
}

impl Chance {
    fn new(plan: Plan) -> Self {
        let robots: Vec<_> = (0..ROBOTS).map(|n| sighting(name(n).as_str())).collect();
        let mut scene = Scene::start(plan, &robots);
        scene.flush();
        Self {
            scene,
            robots,
            passed: Vec::new(),
            true_ms: 0,
        }
    }

    fn event(&mut self, event: Event, kill: Kill) {
        match kill {
            Kill::Never => {
                self.scene.event(event);
            }
            Kill::BeforeStoring => self.scene.lose(event),
            Kill::AfterSending(sent) => self.scene.cut(event, sent),
        }
    }

    fn happen(&mut self, at: usize, what: Happens, kill: Kill) {
        let before: Vec<_> = self.scene.rollout.rows().cloned().collect();
        let release = self.scene.rollout.document().plan.releases[0]
            .release
            .clone();
        let robot = name(at);
        let mut can_undo = false;
        match what {
            Happens::Seen {
                online,
                busy,
                new,
                boots,
            } => {
                let seen = &mut self.robots[at];
                (seen.online, seen.busy) = (online, busy);
                seen.build = build(if new { NEW } else { OLD });
                seen.boot += boots;
                let seen = seen.clone();
                can_undo = true;
                self.event(Event::Seen(seen), kill);
            }
            Happens::Told(report) => self.event(
                Event::Told {
                    robot,
                    release,
                    report,
                },
                kill,
            ),
            Happens::Other(report) => {
                let release = ReleaseId::new("other").unwrap();
                self.scene.event(Event::Told {
                    robot,
                    release,
                    report,
                });
                assert!(
                    self.scene.rollout.rows().eq(&before),
                    "about another release"
                );
            }
            Happens::Pass(seconds) => {
                self.true_ms += seconds * 1_000;
                self.scene.now.unix_ms = self.scene.now.unix_ms.saturating_add(seconds * 1_000);
                self.scene.now.monotonic_ms += seconds * 1_000;
                self.event(Event::Tick, kill);
            }
            Happens::Set(unix_ms) => self.scene.now.unix_ms = unix_ms,
            Happens::Command(command) => {
                can_undo = true;
                let _ = self.scene.command(&command);
            }
            Happens::Take(bytes) => {
                let may = self.scene.rollout.row(&robot).unwrap().state.may_receive();
                let grant = self
                    .scene
                    .rollout
                    .take(&robot, &release, bytes, self.scene.now);
                assert!(may || grant == Grant::No);
                if grant == Grant::Now {
                    self.passed.push((self.true_ms, bytes.into()));
                }
            }
            Happens::Restart => {
                can_undo = true;
                self.restart();
            }
        }
        // What is proven stays, but for a person's word and a robot that shows otherwise.
        for row in before.iter().filter(|_| !can_undo) {
            let after = self.scene.rollout.row(&row.robot).unwrap();
            let proven = [UpdateState::Confirmed, UpdateState::RolledBack];
            if proven.contains(&row.state) {
                assert_eq!(after.state, row.state, "{row:?}");
            }
        }
    }

    /// The server is killed and comes back, and hears of every robot.
    fn restart(&mut self) {
        self.scene.restart();
        for seen in self.robots.clone() {
            self.scene.event(Event::Seen(seen));
        }
    }

    /// From now on all goes well, and nothing is lost: the rollout comes to its end.
    fn end(&mut self) {
        for round in 0.. {
            assert!(round < 3_000, "{:#?}", self.scene.rollout);
            if self.scene.state().is_over() {
                break;
            }
            let _ = self.scene.command(&Command::Resume);
            for at in 0..ROBOTS {
                let seen = &mut self.robots[at];
                (seen.online, seen.busy) = (true, None);
                let seen = seen.clone();
                self.scene.event(Event::Seen(seen));
            }
            let work = self
                .scene
                .rollout
                .rows()
                .filter(|row| row.state.is_in_flight());
            for robot in work.map(|row| row.robot.clone()).collect::<Vec<_>>() {
                self.scene
                    .told(robot.as_str(), Report::Confirmed(build(NEW)));
            }
            self.scene.pass_s(120);
        }
        assert!(self.scene.rollout.rows().all(|row| row.state.is_over()));
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(300))]

    #[test]
    fn whatever_happens_the_rules_hold(
        plan in any_plan(),
        course in proptest::collection::vec(
            (0..ROBOTS).prop_flat_map(|at| (Just(at), happens(name(at)), kill())), 1..120,
        ),
    ) {
        let mut chance = Chance::new(plan);
        let mut aborted = false;
        for (at, what, kill) in course {
            let sent = chance.scene.sent.len();
            chance.happen(at, what, kill);
            let offers = Scene::offered(&chance.scene.sent[sent..]);
            prop_assert!(!aborted || offers.is_empty(), "offered after an abort");
            let state = chance.scene.state();
            aborted |= matches!(state, RolloutState::Aborting | RolloutState::Aborted);
        }
        for (at, &(from, _)) in chance.passed.iter().enumerate() {
            let mut sum = 0;
            for &(until, bytes) in &chance.passed[at..] {
                sum += bytes;
                prop_assert!(sum <= 20 * (until - from + 1_000), "{sum} bytes");
            }
        }
        chance.end();
    }

    /// All that a rollout goes by is stored, or heard again: a restart alone changes nothing.
    #[test]
    fn a_restart_changes_nothing(
        plan in any_plan(),
        reports in proptest::collection::vec((0..ROBOTS, report(), 0_u64..100), 1..60),
    ) {
        let mut chance = Chance::new(plan);
        for (at, report, seconds) in reports {
            chance.scene.told(name(at).as_str(), report);
            chance.scene.pass_s(seconds);
            let rows: Vec<_> = chance.scene.rollout.rows().cloned().collect();
            let document = chance.scene.rollout.document().clone();
            chance.restart();
            prop_assert!(chance.scene.rollout.rows().eq(&rows));
            prop_assert_eq!(chance.scene.rollout.document(), &document);
        }
    }
}
