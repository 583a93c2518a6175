//! A fleet in software on a bad network: robots that sleep, go away, and run releases with defects.

use std::collections::BTreeMap;

use crawler_updates::rollout::{
    Busy, Effect, Event, Grant, Happening, Message, PauseReason, Report, RolloutState, Sighting,
    UpdateState,
};

use crate::scene::{NEW, OLD, Scene, build, code, plan, sighting};

const BYTES: u32 = 1_000;

/// A generator of Marsaglia's: xorshift64.
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn percent(&mut self, percent: u64) -> bool {
        self.next() % 100 < percent
    }
}

/// What the new build does on a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Defect {
    None,
    Panics,
    NeverLinks,
}

/// What a robot is at, with the seconds that it has left for it.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Work {
    Idle,
    Preparing(u32),
    Receiving,
    Verifying(u32),
    Staged(u32),
    /// It starts, and cannot be heard: the new build, or the old one after a trial that failed with this code.
    Starting(u32, Option<&'static str>),
    Trial(u32),
}

struct Robot {
    seen: Sighting,
    /// Whether it is never there.
    away: bool,
    defect: Defect,
    work: Work,
    received: u32,
    /// How its last trial failed.
    failed: Option<&'static str>,
    heard: bool,
    /// How often the new build has started.
    trials: u32,
}

impl Robot {
    fn at_work(&self) -> bool {
        self.work != Work::Idle
    }

    /// Takes in a message, and answers.
    fn receive(&mut self, message: Message) -> Option<Report> {
        let before_trial = !matches!(self.work, Work::Trial(_) | Work::Starting(..));
        match (message, &self.work) {
            (Message::Offer, Work::Idle) => {
                if self.seen.build == build(NEW) {
                    return Some(Report::Confirmed(build(NEW)));
                }
                if let Some(failed) = self.failed {
                    return Some(Report::RolledBack(code(failed)));
                }
                if self.seen.busy.is_some() {
                    return Some(Report::Deferred(code("driving")));
                }
                self.work = Work::Preparing(2);
                Some(Report::Preparing)
            }
            (Message::Offer, _) => self.report(),
            (Message::Confirm, Work::Trial(_)) => {
                self.heard = true;
                None
            }
            (Message::Confirm, Work::Idle) if self.seen.build == build(NEW) => {
                Some(Report::Confirmed(build(NEW)))
            }
            (Message::Cancel, _) if before_trial => {
                self.work = Work::Idle;
                Some(Report::Withdrawn)
            }
            (Message::Confirm | Message::Cancel, _) => None,
        }
    }

    fn report(&self) -> Option<Report> {
        Some(match self.work {
            Work::Preparing(_) => Report::Preparing,
            Work::Receiving => Report::Receiving(self.received),
            Work::Verifying(_) => Report::Verifying,
            Work::Staged(_) => Report::Staged,
            Work::Trial(_) => Report::Trial(build(NEW)),
            Work::Idle | Work::Starting(..) => return None,
        })
    }

    fn start(&mut self, new: bool, seconds: u32, failed: Option<&'static str>) {
        self.seen.online = false;
        self.seen.boot += 1;
        self.seen.build = build(if new { NEW } else { OLD });
        self.trials += u32::from(new);
        self.heard = false;
        self.work = Work::Starting(seconds, failed);
    }

    /// A second passes; `granted` says whether it may have a part of the image. What it says on its own goes out.
    fn second(&mut self, granted: bool) -> Option<Report> {
        match self.work.clone() {
            Work::Idle => None,
            Work::Preparing(0) => {
                self.work = Work::Receiving;
                self.report()
            }
            Work::Receiving => {
                if !granted {
                    return None;
                }
                self.received = (self.received + 100).min(BYTES);
                if self.received == BYTES {
                    self.work = Work::Verifying(2);
                }
                self.report()
            }
            Work::Verifying(0) => {
                self.work = Work::Staged(1);
                self.report()
            }
            Work::Staged(0) => {
                match self.defect {
                    Defect::NeverLinks => self.start(true, 90, None),
                    Defect::None | Defect::Panics => self.start(true, 3, None),
                }
                None
            }
            Work::Starting(0, None)
                if self.defect == Defect::NeverLinks && self.seen.build == build(NEW) =>
            {
                self.start(false, 3, Some("no_link"));
                None
            }
            Work::Starting(0, failed) => {
                self.seen.online = true;
                self.failed = failed;
                self.work = match failed {
                    None => Work::Trial(30),
                    Some(_) => Work::Idle,
                };
                match failed {
                    None => self.report(),
                    Some(failed) => Some(Report::RolledBack(code(failed))),
                }
            }
            Work::Trial(20) if self.defect == Defect::Panics => {
                self.start(false, 3, Some("panic"));
                None
            }
            Work::Trial(0) if self.heard => {
                self.work = Work::Idle;
                Some(Report::Confirmed(build(NEW)))
            }
            Work::Preparing(left) => self.wait(Work::Preparing(left - 1)),
            Work::Verifying(left) => self.wait(Work::Verifying(left - 1)),
            Work::Staged(left) => self.wait(Work::Staged(left - 1)),
            Work::Starting(left, failed) => self.wait(Work::Starting(left - 1, failed)),
            Work::Trial(left) => self.wait(Work::Trial(left.saturating_sub(1))),
        }
    }

    fn wait(&mut self, work: Work) -> Option<Report> {
        self.work = work;
        None
    }
}

/// Robots, their server, and what lies between.
struct Fleet {
    scene: Scene,
    robots: BTreeMap<String, Robot>,
    chance: Chance,
    /// Share of the messages that get lost; as many come twice, and twice as many late.
    loss: u64,
    /// Share of robots that do something else for a while, each minute.
    restless: u64,
    /// Whether the server is killed now and then.
    kills: bool,
    second: u64,
    up: BTreeMap<(u64, u64), (String, Report)>,
    down: BTreeMap<(u64, u64), Effect>,
    most_at_work: usize,
}

impl Fleet {
    /// One robot in `away` is never there; all are with 0.
    fn new(count: usize, shares: &[u8], parallel: u32, seed: u64, away: usize) -> Self {
        let mut plan = plan(shares);
        plan.limits.parallel = parallel;
        for phase in &mut plan.phases {
            (phase.soak_s, phase.success_percent) = (60, 95);
        }
        let mut seen: Vec<_> = (0..count).map(|n| sighting(&format!("r{n:04}"))).collect();
        if away > 0 {
            for seen in seen.iter_mut().step_by(away) {
                seen.online = false;
            }
        }
        let scene = Scene::start(plan, &seen);
        let robots = seen.into_iter().map(|seen| {
            let robot = Robot {
                away: !seen.online,
                seen,
                defect: Defect::None,
                work: Work::Idle,
                received: 0,
                failed: None,
                heard: false,
                trials: 0,
            };
            (robot.seen.robot.to_string(), robot)
        });
        let robots = robots.collect();
        let mut fleet = Self {
            scene,
            robots,
            chance: Chance(seed * 2 + 1),
            loss: 0,
            restless: 0,
            kills: false,
            second: 0,
            up: BTreeMap::new(),
            down: BTreeMap::new(),
            most_at_work: 0,
        };
        let first = fleet.scene.flush();
        fleet.send(first);
        fleet
    }

    /// When a message arrives: not at all, once, or twice.
    fn arrivals(&mut self) -> Vec<(u64, u64)> {
        let copies = 1 + usize::from(self.chance.percent(self.loss));
        let mut arrivals = Vec::new();
        for _ in 0..copies {
            let late = if self.chance.percent(2 * self.loss) {
                20
            } else {
                1
            };
            let at = self.second + 1 + self.chance.next() % late;
            if !self.chance.percent(self.loss) {
                arrivals.push((at, self.chance.next()));
            }
        }
        arrivals
    }

    fn send(&mut self, effects: Vec<Effect>) {
        for effect in effects {
            for at in self.arrivals() {
                self.down.insert(at, effect.clone());
            }
        }
    }

    fn say(&mut self, robot: &str, report: &Report) {
        for at in self.arrivals() {
            self.up.insert(at, (robot.to_owned(), report.clone()));
        }
    }

    /// The server learns what a robot is like: its retained status is not lost.
    fn show(&mut self, robot: &str) {
        let seen = self.robots[robot].seen.clone();
        let effects = self.scene.event(Event::Seen(seen));
        self.send(effects);
    }

    fn run(&mut self, seconds: u64) {
        for _ in 0..seconds {
            if self.scene.state() != RolloutState::Running && !self.at_work() {
                return;
            }
            self.step();
        }
    }

    fn at_work(&self) -> bool {
        self.robots.values().any(Robot::at_work)
    }

    fn step(&mut self) {
        self.second += 1;
        let effects = self.scene.pass_s(1);
        self.send(effects);
        let later = self.up.split_off(&(self.second + 1, 0));
        for (robot, report) in std::mem::replace(&mut self.up, later).into_values() {
            let effects = self.scene.told(&robot, report);
            self.send(effects);
        }
        let later = self.down.split_off(&(self.second + 1, 0));
        for effect in std::mem::replace(&mut self.down, later).into_values() {
            let name = effect.robot.to_string();
            let robot = self.robots.get_mut(&name).unwrap();
            let answer = robot
                .seen
                .online
                .then(|| robot.receive(effect.message))
                .flatten();
            if let Some(report) = answer {
                self.say(&name, &report);
            }
        }
        let names: Vec<String> = self.robots.keys().cloned().collect();
        for name in &names {
            self.robot(name);
        }
        let at_work = self.robots.values().filter(|robot| robot.at_work()).count();
        self.most_at_work = self.most_at_work.max(at_work);
        if self.kills && self.second.is_multiple_of(41) {
            self.scene.restart();
            let effects = self.scene.flush();
            self.send(effects);
            for name in &names {
                self.show(name);
            }
        }
    }

    fn robot(&mut self, name: &str) {
        let release = self.scene.rollout.document().plan.releases[0]
            .release
            .clone();
        let robot = self.robots.get_mut(name).unwrap();
        let before = robot.seen.clone();
        let asks = robot.seen.online && robot.work == Work::Receiving;
        let id = robot.seen.robot.clone();
        let granted =
            asks && self.scene.rollout.take(&id, &release, 100, self.scene.now) == Grant::Now;
        let said = robot.second(granted);
        let starting = matches!(robot.work, Work::Starting(..));
        if !starting
            && !robot.away
            && self.second.is_multiple_of(60)
            && self.chance.percent(self.restless)
        {
            if matches!(robot.work, Work::Idle) && self.chance.percent(50) {
                robot.seen.busy = match robot.seen.busy {
                    None => Some(Busy::Driving),
                    Some(_) => None,
                };
            } else {
                robot.seen.online = !robot.seen.online;
            }
        }
        let robot = &self.robots[name];
        if robot.seen != before {
            self.show(name);
        }
        if let (Some(report), true) = (said, self.robots[name].seen.online) {
            self.say(name, &report);
        }
    }
}

#[test]
fn a_good_release_reaches_everyone_on_a_good_network() {
    let mut fleet = Fleet::new(200, &[1, 10, 100], 25, 1, 0);
    fleet.run(5_000);
    assert_eq!(fleet.scene.state(), RolloutState::Done);
    for robot in fleet.robots.values() {
        assert_eq!((robot.seen.build.as_str(), robot.trials), (NEW, 1));
    }
    assert_eq!(fleet.most_at_work, 25);
    // Nobody was asked twice.
    assert_eq!(Scene::offered(&fleet.scene.sent).len(), 200);
}

#[test]
fn a_good_release_reaches_everyone_on_a_bad_network_with_a_server_that_is_killed() {
    for seed in 0..4 {
        let mut fleet = Fleet::new(60, &[5, 100], 12, seed, 20);
        (fleet.loss, fleet.restless, fleet.kills) = (20, 10, seed % 2 == 0);
        for _ in 0..40 {
            fleet.run(600);
            let rows = fleet.scene.rollout.rows();
            let open = rows
                .filter(|row| row.state != UpdateState::Confirmed)
                .count();
            if open == fleet.robots.values().filter(|robot| robot.away).count() {
                break;
            }
            // Nobody stays away for good but those.
            for name in fleet.robots.keys().cloned().collect::<Vec<_>>() {
                let robot = fleet.robots.get_mut(&name).unwrap();
                if !robot.away && !matches!(robot.work, Work::Starting(..)) {
                    (robot.seen.online, robot.seen.busy) = (true, None);
                }
                fleet.show(&name);
            }
            if matches!(fleet.scene.state(), RolloutState::Paused(_)) {
                // The network has cost too many attempts; a person goes on.
                let failed = fleet
                    .scene
                    .rollout
                    .rows()
                    .filter(|row| row.state.is_failure());
                let failed: Vec<_> = failed.map(|row| row.robot.clone()).collect();
                for robot in failed {
                    let retry = crawler_updates::rollout::Command::Retry(robot);
                    fleet.scene.command(&retry).unwrap();
                }
                let effects = fleet
                    .scene
                    .command(&crawler_updates::rollout::Command::Resume);
                fleet.send(effects.unwrap());
            }
        }
        for (name, robot) in &fleet.robots {
            let row = fleet.scene.rollout.row(&robot.seen.robot).unwrap();
            let want = if robot.away {
                UpdateState::Waiting
            } else {
                UpdateState::Confirmed
            };
            assert_eq!(row.state, want, "seed {seed}: {row:?}, {:?}", robot.work);
            assert_eq!(
                robot.seen.build == build(NEW),
                want == UpdateState::Confirmed
            );
            assert!(
                robot.trials <= 1,
                "{name} was started {} times",
                robot.trials
            );
        }
        assert_eq!(
            fleet.scene.state(),
            RolloutState::Running,
            "it waits for those"
        );
    }
}

#[test]
fn a_bad_release_stops_in_the_first_phase_that_shows_it() {
    let mut stopped = [0, 0];
    for seed in 0..12 {
        let mut fleet = Fleet::new(200, &[1, 10, 100], 50, seed, 0);
        let order: Vec<String> = fleet.robots.keys().cloned().collect();
        let mut bad = 0;
        while bad < 40 {
            let name = &order[fleet.chance.next() as usize % order.len()];
            let robot = fleet.robots.get_mut(name).unwrap();
            if robot.defect == Defect::None {
                robot.defect = if bad % 2 == 0 {
                    Defect::Panics
                } else {
                    Defect::NeverLinks
                };
                bad += 1;
            }
        }
        let phase = |fleet: &Fleet, name: &str| {
            fleet
                .scene
                .rollout
                .row(&fleet.robots[name].seen.robot)
                .unwrap()
                .phase
        };
        let shown = order
            .iter()
            .filter(|name| fleet.robots[*name].defect != Defect::None);
        let first = shown.filter_map(|name| phase(&fleet, name)).min().unwrap();
        assert!(
            first < 2,
            "seed {seed}: no bad robot among the first twenty"
        );
        while fleet.scene.state() == RolloutState::Running {
            fleet.step();
            assert!(fleet.second < 5_000);
        }
        assert_eq!(fleet.scene.counts().phase, first, "seed {seed}");
        let whats = fleet.scene.notes.iter().map(|note| &note.what);
        let before = whats.take_while(|what| !matches!(what, Happening::Paused(_)));
        let failures = before
            .filter(|what| matches!(what, Happening::Robot { state, .. } if state.is_failure()));
        assert!((1..=2).contains(&failures.count()), "seed {seed}");
        stopped[usize::from(first)] += 1;
        // Whoever was on the way comes to its end, its last word arrives, and nobody else begins.
        fleet.run(1_000);
        for _ in 0..5 {
            fleet.step();
        }
        let reason = fleet.scene.state();
        let own = [PauseReason::Failures, PauseReason::Threshold].map(RolloutState::Paused);
        assert!(own.contains(&reason), "{reason:?}");
        for robot in fleet.robots.values() {
            let row = fleet.scene.rollout.row(&robot.seen.robot).unwrap();
            let bad = robot.defect != Defect::None;
            assert!(
                !bad || robot.seen.build == build(OLD),
                "back on the old build"
            );
            assert!(!row.state.is_in_flight(), "{row:?}");
            assert!(robot.trials == 0 || row.phase <= Some(first));
            assert_eq!(
                bad && robot.trials > 0,
                row.state == UpdateState::RolledBack,
                "{row:?}"
            );
        }
    }
    assert!(stopped.iter().all(|count| *count > 0), "{stopped:?}");
}
