//! A rollout and its store: every step is stored as text before anything is sent, and read back from there.

use std::collections::{BTreeMap, BTreeSet};

use crawler_protocol::{Kind, RobotId};
use crawler_updates::rollout::{
    BoardName, BuildId, Code, Command, CommandError, Counts, Document, Effect, Event, Happening,
    Message, Note, Now, Owner, PhaseState, Plan, PlannedRelease, Reason, ReleaseId, Report,
    RobotRow, Rollout, RolloutId, RolloutState, Selection, ServerId, Sighting, Step, UpdateState,
};

pub(crate) const OLD: &str = "old";
pub(crate) const NEW: &str = "new";

pub(crate) fn id(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

pub(crate) fn build(name: &str) -> BuildId {
    BuildId::new(name).unwrap()
}

pub(crate) fn code(name: &str) -> Code {
    Code::new(name).unwrap()
}

/// A plan for boards `sim`, with phases of these shares, without a soak.
pub(crate) fn plan(shares: &[u8]) -> Plan {
    let phases: Vec<_> = shares
        .iter()
        .map(|share| serde_json::json!({"select": {"share": share}, "soak_s": 0, "success_percent": 90}))
        .collect();
    let plan = serde_json::json!({
        "releases": [{"release": "sim-4", "board": "sim", "build": NEW, "version": "0.4.0", "sequence": 4,
                      "bytes": 1_000}],
        "phases": phases,
    });
    serde_json::from_value(plan).unwrap()
}

/// A robot that runs the old build, and is at hand.
pub(crate) fn sighting(name: &str) -> Sighting {
    Sighting {
        robot: id(name),
        board: BoardName::new("sim").unwrap(),
        kind: Kind::Simulated,
        vision: false,
        policies: false,
        build: build(OLD),
        boot: 1,
        online: true,
        busy: None,
    }
}

/// What a database has of a rollout.
#[derive(Debug, Clone, Default)]
pub(crate) struct Store {
    document: String,
    rows: BTreeMap<RobotId, String>,
    notes: BTreeSet<(Option<RobotId>, u32)>,
}

impl Store {
    /// Writes a step, and holds it against what is there.
    fn write(&mut self, step: &Step) {
        if let Some(document) = &step.document {
            self.document = serde_json::to_string(document).unwrap();
        }
        for row in &step.rows {
            let text = serde_json::to_string(row).unwrap();
            self.rows.insert(row.robot.clone(), text);
        }
        for note in &step.notes {
            let name = (about(note), note.revision);
            assert!(self.notes.insert(name), "told twice: {note:?}");
        }
    }

    pub(crate) fn read(&self) -> (Document, Vec<RobotRow>) {
        let rows = self
            .rows
            .values()
            .map(|row| serde_json::from_str(row).unwrap());
        (
            serde_json::from_str(&self.document).unwrap(),
            rows.collect(),
        )
    }
}

fn about(note: &Note) -> Option<RobotId> {
    match &note.what {
        Happening::Robot { robot, .. } => Some(robot.clone()),
        _ => None,
    }
}

/// A rollout at work, checked after every step.
#[derive(Debug, Clone)]
pub(crate) struct Scene {
    pub(crate) rollout: Rollout,
    pub(crate) store: Store,
    pub(crate) now: Now,
    pub(crate) notes: Vec<Note>,
    /// What was sent, in order.
    pub(crate) sent: Vec<Effect>,
    /// Effects that were decided and not sent yet.
    pub(crate) waiting: Vec<Effect>,
    /// How often each robot was offered the release.
    offers: BTreeMap<RobotId, u32>,
}

impl Scene {
    pub(crate) fn start(plan: Plan, fleet: &[Sighting]) -> Self {
        let now = Now {
            unix_ms: 1_700_000_000_000,
            monotonic_ms: 77,
        };
        let owner = Owner {
            server: ServerId::new("a").unwrap(),
            epoch: 1,
        };
        let rollout = RolloutId::new("spring").unwrap();
        let (rollout, step) = Rollout::start(rollout, plan, owner, fleet, now).unwrap();
        let mut scene = Self {
            rollout,
            store: Store::default(),
            now,
            notes: Vec::new(),
            sent: Vec::new(),
            waiting: Vec::new(),
            offers: BTreeMap::new(),
        };
        scene.take(step);
        scene
    }

    /// `count` robots, `a0000` and on.
    pub(crate) fn of(plan: Plan, count: usize) -> Self {
        let fleet: Vec<_> = (0..count).map(|n| sighting(&format!("a{n:04}"))).collect();
        Self::start(plan, &fleet)
    }

    /// Stores a step; its effects wait to be sent.
    fn take(&mut self, step: Step) {
        self.check_effects(&step);
        self.store.write(&step);
        self.notes.extend(step.notes);
        self.waiting.extend(step.effects);
        self.check();
    }

    /// Sends what waits, and returns it.
    pub(crate) fn flush(&mut self) -> Vec<Effect> {
        let effects = std::mem::take(&mut self.waiting);
        self.sent.extend(effects.clone());
        effects
    }

    pub(crate) fn event(&mut self, event: Event) -> Vec<Effect> {
        let step = self.rollout.handle(event, self.now);
        self.take(step);
        self.flush()
    }

    pub(crate) fn command(&mut self, command: &Command) -> Result<Vec<Effect>, CommandError> {
        let before = self.rollout.document().clone();
        match self.rollout.command(command, self.now) {
            Ok(step) => {
                self.take(step);
                Ok(self.flush())
            }
            Err(error) => {
                assert_eq!(*self.rollout.document(), before);
                Err(error)
            }
        }
    }

    pub(crate) fn told(&mut self, robot: &str, report: Report) -> Vec<Effect> {
        let release = self.rollout.document().plan.releases[0].release.clone();
        let robot = id(robot);
        self.event(Event::Told {
            robot,
            release,
            report,
        })
    }

    /// Takes every robot that is at work, or comes to be, to its end; returns how many those were.
    pub(crate) fn confirm_all(&mut self) -> usize {
        let mut count = 0;
        loop {
            let rows = self.rollout.rows().filter(|row| row.state.is_in_flight());
            let names: Vec<String> = rows.map(|row| row.robot.to_string()).collect();
            if names.is_empty() {
                return count;
            }
            for name in names {
                self.told(&name, Report::Confirmed(build(NEW)));
                count += 1;
            }
        }
    }

    pub(crate) fn pass_s(&mut self, seconds: u64) -> Vec<Effect> {
        self.now.unix_ms += seconds * 1_000;
        self.now.monotonic_ms += seconds * 1_000;
        self.event(Event::Tick)
    }

    /// The server is killed before it has stored what comes of an event, and comes back.
    pub(crate) fn lose(&mut self, event: Event) {
        let _ = self.rollout.handle(event, self.now);
        self.reload();
    }

    /// The server is killed once it has stored what comes of an event, and has sent a part of it.
    pub(crate) fn cut(&mut self, event: Event, sent: usize) {
        let step = self.rollout.handle(event, self.now);
        self.take(step);
        self.waiting.truncate(sent);
        self.flush();
        self.restart();
    }

    /// The server is killed, with what was not sent, and comes back: all that it knows is what was stored.
    pub(crate) fn restart(&mut self) {
        let before: Vec<RobotRow> = self.rollout.rows().cloned().collect();
        let (document, rows) = self.store.read();
        assert_eq!(rows, before, "rows are stored with every step");
        assert_eq!(document, *self.rollout.document());
        self.reload();
    }

    fn reload(&mut self) {
        self.waiting.clear();
        self.now.monotonic_ms = 5;
        let (document, rows) = self.store.read();
        let (rollout, step) = Rollout::load(document, rows, self.now).unwrap();
        self.rollout = rollout;
        self.take(step);
    }

    pub(crate) fn state(&self) -> RolloutState {
        self.rollout.document().state
    }

    pub(crate) fn robot(&self, robot: &str) -> (UpdateState, Option<Reason>) {
        let row = self.rollout.row(&id(robot)).unwrap();
        (row.state, row.reason.clone())
    }

    pub(crate) fn counts(&self) -> Counts {
        self.rollout.counts(self.now)
    }

    /// Robots that were sent the offer, in order.
    pub(crate) fn offered(effects: &[Effect]) -> Vec<String> {
        let offers = effects.iter().filter(|one| one.message == Message::Offer);
        offers.map(|one| one.robot.as_str().to_owned()).collect()
    }

    /// What must hold of every effect that is decided.
    fn check_effects(&mut self, step: &Step) {
        let document = self.rollout.document();
        let mut first = false;
        for effect in &step.effects {
            assert_eq!(effect.epoch, document.owner.epoch);
            let row = self.rollout.row(&effect.robot).unwrap();
            let release = &document.plan.releases[usize::from(row.release.unwrap())];
            assert_eq!(release.release, effect.release);
            if effect.message != Message::Offer {
                continue;
            }
            assert_eq!(
                document.state,
                RolloutState::Running,
                "offered by one that does not run"
            );
            let before = self.offers.insert(effect.robot.clone(), row.offers);
            if before == Some(row.offers) {
                continue; // It goes again, to a robot at work.
            }
            first = true;
            assert_eq!(row.phase, Some(document.phase), "offered out of turn");
            let window = document.plan.window;
            let open = window.is_none_or(|window| window.is_open(self.now.unix_ms));
            assert!(open, "offered while the window is closed");
        }
        let in_flight = self.rollout.rows().filter(|row| row.state.is_in_flight());
        let in_flight = in_flight.count();
        let most = document.plan.limits.parallel as usize;
        assert!(!first || in_flight <= most, "{in_flight} at work");
    }

    /// What must hold at any time.
    fn check(&self) {
        let document = self.rollout.document();
        let counts = self.counts();
        let counted: u32 = counts.robots.values().sum();
        assert_eq!(counted as usize, self.rollout.rows().count());
        for state in UpdateState::ALL {
            let rows = self.rollout.rows().filter(|row| row.state == state).count();
            let counted = counts.robots.get(&state).copied().unwrap_or(0);
            assert_eq!(counted as usize, rows, "{state}");
        }
        for (at, state) in document.phases.iter().enumerate() {
            let passed = matches!(state, PhaseState::Passed { .. });
            let pending = matches!(state, PhaseState::Pending);
            let phase = usize::from(document.phase);
            assert!(passed || at >= phase, "phase {at} has not passed");
            assert!(pending || at <= phase, "phase {at} has begun");
        }
        for row in self.rollout.rows() {
            if document.state.is_over() {
                assert!(row.state.is_over(), "{row:?} in a rollout that is over");
            }
            if row.state.is_in_flight() {
                assert!(row.due_ms.is_some(), "{row:?} has time for ever");
                assert!(row.offers > 0, "{row:?} was never offered it");
            }
        }
        let current = usize::from(document.phase);
        if document.state == RolloutState::Running
            && document.plan.phases[current].stop_min_count == 1
        {
            let phase = &counts.phases[current];
            assert!(
                phase.failures < phase.most_failures,
                "goes on after {phase:?}"
            );
        }
        // Whoever only ticks when told to never sleeps for good while something is due.
        let wake = self.rollout.wake_in_ms(self.now);
        assert!(wake.is_none_or(|wake| wake > 0), "wakes at once, for ever");
    }
}

/// A release for another board.
pub(crate) fn release_for(board: &str) -> PlannedRelease {
    let mut release = plan(&[100]).releases[0].clone();
    release.board = BoardName::new(board).unwrap();
    release.release = ReleaseId::new(board).unwrap();
    release
}

/// The phase of a plan as a group.
pub(crate) fn group(robots: &[&str]) -> Selection {
    Selection::Group(robots.iter().map(|name| id(name)).collect())
}
