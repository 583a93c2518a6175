//! The control step: everything between what the robot knows and what its wheels get.
//!
//! [`Controller::step`] is synchronous and does no I/O; the control activity calls it every
//! [`PERIOD`], and so do the tests of the safety rules. One call does, in this order: odometry and
//! its correction, faults, failsafes, the end of the goal, halts, one order, a look ahead, wanted motion, ramps.
//!
//! What goes by others is reckoned in turns: in one step where they are, in the next one what the behaviour wants for it,
//! which holds for both. So neither is added to the other, and no step takes longer than a board has for it
//! (docs/counts.md). View, failsafes and ramps count in every step.
//!
//! # How motion ends
//! | cause | duties |
//! |---|---|
//! | `stop`, `estop`, fault, lost link, no fresh view, blocked way | zero within the same step |
//! | duration over, arrival, `behave manual`, new order | down the ramp |
//! | failsafe of continuous driving | down the ramp, or as much faster as it takes to stand in time |
//!
//! Continuous driving is over [`FAILSAFE`] after its last word, and the wheels stand then: they begin to
//! slow down before, as late as the ramp permits, but not while the word is younger than [`HOLD`].
//!
//! # When the link is lost
//! Manual driving ends at once. So do behaviours by default: a robot nobody can stop should not
//! drive. Where that is safe, `link_grace_ms` lets a behaviour go on for a while, so that a hiccup
//! of the network does not scatter an experiment; when it has passed, the behaviour ends. A robot that
//! never had a link (a simulation without a network) has none to lose.
//!
//! # What is taken up again
//! A behaviour (not `goto`, whose sender was told that it failed) that the ranger or the link has ended
//! goes on when both are well again, if that was within `resume_within_ms` and nobody has said otherwise
//! meanwhile; so does one that `reboot` has ended. Nothing else resumes by itself.

mod ahead;
mod aside;
mod ends;
mod guided;
mod orders;
mod resume;
mod tuning;

use crawler_drivers::l298n::Trim;
use crawler_hal::{Duration, Instant, Millivolts};
use crawler_protocol::{BehaviourName, Pose, Reason, ResponseStatus, Says};
use heapless::Vec;
use rand_core::Rng;

use crate::behaviour::{Detour, Leeway, MissionNews, Progress, Scan, ScanResult, Underway};
use crate::goal::Goal;
use crate::motion::{Correction, Odometry, Ramp, Twist};
use crate::navigation::Guide;
use crate::neighbours::Neighbour;
use crate::order::{HALT_ANSWERS, Halt, Order, Sender, UpdateWish};
use crate::perception::{Charge, LinkHealth, Reading, SensorHealth};
use crate::policy::{Decision, Pilot, Policies};
use crate::state::{Event, Fault, Side, State};
use crate::tracking::{Fix, TOLD_EVERY};
use crate::vision::{InTheWay, View};

use guided::Guided;
pub use resume::CALM;
use resume::Resumption;
pub use tuning::Tuning;

/// Time between two control steps.
pub const PERIOD: Duration = Duration::from_millis(20);
/// The wheels stand this long after the last word of whoever drives continuously, however slow the ramp.
pub const FAILSAFE: Duration = Duration::from_millis(500);
/// A word of continuous driving holds in full for this long, however slow the ramp: a controller sends
/// one every 100 to 200 ms, and one that is late by half of that must not be felt. What is left of
/// [`FAILSAFE`] stops a wheel from full duty at a tenth of it a period, which is half as steep as the
/// steepest ramp there is.
pub const HOLD: Duration = Duration::from_millis(300);
/// Longest a bounded `move` may last.
pub const LONGEST_MOVE: Duration = Duration::from_millis(10_000);
/// How long the start waits for the flash and the ranger before it goes on without them.
pub const START_PATIENCE: Duration = Duration::from_millis(2_000);
/// A scan takes four to nine seconds; one that takes longer is held up.
pub const SCAN_TIMEOUT: Duration = Duration::from_secs(30);

/// Most answers of one step: every halt, the goal that ended, the order, and that order's own
/// goal if it ends at once.
const ANSWERS: usize = HALT_ANSWERS + 4;
/// Most notes of one step.
const NOTES: usize = 6;

/// What the controller is told at each step.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// Newest word of the ranger.
    pub reading: Reading,
    /// How much the battery allows.
    pub charge: Charge,
    /// What the battery delivers, when it is known: wheels turn faster for it.
    pub voltage: Option<Millivolts>,
    /// An outside position reference that has not been taken in yet.
    pub fix: Option<Fix>,
    /// What the camera has shown and has not been taken in yet.
    pub view: Option<&'a View>,
    /// Who is near, while that is needed: see [`Controller::wants_neighbours`].
    pub near: &'a [Neighbour],
    /// The robot itself, as [`Neighbour::who`].
    pub own: u32,
    /// The newest plan; see [`Controller::going`].
    pub guide: Option<Guide>,
    /// What others leave of its speed to a robot on its way to a place, who is not told of them otherwise.
    pub leeway: Leeway,
    /// Whether the session with the broker holds.
    pub link: LinkHealth,
    /// Whether the parameters are loaded, or given up.
    pub loaded: bool,
    /// Whether the motor driver refused the last duties.
    pub motor_fault: bool,
    /// A halt, when one was requested.
    pub halt: Option<&'a Halt>,
    /// The next order, when one waits.
    pub order: Option<&'a Order>,
    /// What an update wants.
    pub update: UpdateWish,
    /// What there is to drive by.
    pub policies: Policies,
    /// What was decided since the last step, while a policy drives.
    pub decision: Option<Decision>,
}

/// An answer to a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answer {
    /// Whose command.
    pub sender: Sender,
    /// What it came to.
    pub status: ResponseStatus,
    /// Why.
    pub reason: Option<Reason>,
}

/// Something worth a log record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Note {
    /// A fault came up.
    Raised(Fault),
    /// A fault is gone.
    Cleared(Fault),
    /// Motion ended before its time.
    Ended(Reason),
    /// A behaviour that had been interrupted goes on.
    Resumed(BehaviourName),
    /// Turning aside has failed this many times in a row.
    HemmedIn(u8),
    /// An outside position reference was adopted: the estimate has jumped.
    Relocated(Pose),
    /// What came up on a mission.
    Mission(MissionNews),
    /// A scan is done.
    Scanned(ScanResult),
}

/// What follows from a step.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outputs {
    /// Duty of the left and right wheel, −1 to 1, before trim.
    pub duties: [f32; 2],
    /// Answers to give.
    pub answers: Vec<Answer, ANSWERS>,
    /// Log records to write.
    pub notes: Vec<Note, NOTES>,
    /// Whether to blink for whoever looks for the robot.
    pub identify: bool,
    /// Whether to restart, once the answers are out.
    pub reboot: bool,
    /// The behaviour that the restart interrupts.
    pub unfinished: Option<Goal>,
}

impl Outputs {
    fn answer(&mut self, sender: Sender, status: ResponseStatus, reason: Option<Reason>) {
        let answer = Answer {
            sender,
            status,
            reason,
        };
        let room = self.answers.push(answer).is_ok();
        debug_assert!(room, "ANSWERS counts every answer of a step");
    }

    fn note(&mut self, note: Note) {
        // Of more notes in one step than that, the first ones tell the story.
        let _ = self.notes.push(note);
    }
}

/// The controller of one robot: a value, and all of its memory.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Controller {
    // Of the parameters, which whoever restores a controller sets again.
    #[cfg_attr(feature = "serde", serde(skip))]
    tuning: Tuning,
    state: State,
    odometry: Odometry,
    ramps: [Ramp; 2],
    last_step: Instant,
    /// Who waits for the end of the goal or scan.
    pending: Option<Sender>,
    scan: Option<Scan>,
    progress: Progress,
    link_lost_since: Option<Instant>,
    /// The last way round an obstacle, and when it was left: turning back and forth in a corner
    /// leads nowhere.
    last_escape: Option<(Side, Instant)>,
    detour: Option<Detour>,
    guided: Guided,
    mission: Underway,
    pilot: Pilot,
    /// When it was noted last that the leader is lost.
    told_lost: Option<Instant>,
    resumption: Resumption,
    rebooting: bool,
    /// The update that wants the robot has had it: it does not get it back after a fault.
    #[cfg_attr(feature = "serde", serde(skip))]
    update_begun: bool,
    /// When a jump of the estimate was noted last.
    told_jump: Option<Instant>,
    /// By the newest view of the camera.
    in_the_way: Option<InTheWay>,
    /// Whether this step is one in which a rule that goes by others is asked.
    rules: bool,
    /// What that wanted last.
    wanted: Option<Twist>,
    /// How fast others let it go on, when that was asked last.
    leeway: Leeway,
    /// For how many steps on its way to a place that has been next to nothing.
    held: u8,
}

impl Controller {
    /// A controller at rest, in [`State::Initializing`].
    pub fn new(tuning: Tuning) -> Self {
        Self {
            tuning,
            state: State::Initializing,
            odometry: Odometry::default(),
            ramps: [Ramp::default(); 2],
            last_step: Instant::BOOT,
            pending: None,
            scan: None,
            progress: Progress::default(),
            link_lost_since: None,
            last_escape: None,
            detour: None,
            guided: Guided::default(),
            mission: Underway::None,
            pilot: Pilot::new(),
            told_lost: None,
            resumption: Resumption::default(),
            rebooting: false,
            update_begun: false,
            told_jump: None,
            in_the_way: None,
            rules: false,
            wanted: None,
            leeway: Leeway::ALL,
            held: 0,
        }
    }

    /// Takes other parameters, from the next step on.
    pub fn set_tuning(&mut self, tuning: Tuning) {
        self.tuning = tuning;
    }

    /// Trims of the left and right wheel, for the motor driver.
    pub fn trims(&self) -> [Trim; 2] {
        self.tuning.trims()
    }

    /// The state.
    pub const fn state(&self) -> &State {
        &self.state
    }

    /// The behaviour in force.
    pub fn behaviour(&self) -> BehaviourName {
        match self.state.goal() {
            Some(goal) => goal.behaviour(),
            None => BehaviourName::Manual,
        }
    }

    /// What the robot says to its neighbours.
    pub fn says(&self) -> Option<Says> {
        match self.state.goal() {
            Some(Goal::Mission { .. }) => self.mission.says(),
            Some(_) | None => None,
        }
    }

    /// Where the robot should be.
    pub const fn pose(&self) -> Pose {
        self.odometry.pose()
    }

    /// The duties in force.
    pub fn duties(&self) -> [f32; 2] {
        let [left, right] = &self.ramps;
        [left.duty(), right.duty()]
    }

    /// Takes one step at `now`.
    ///
    /// Steps may come late, or early when a halt does not wait for the next period: duties change
    /// by no more than the ramp allows for the time since the last step, nor for more than one
    /// period.
    pub fn step<R: Rng>(&mut self, inputs: &Inputs<'_>, rng: &mut R, now: Instant) -> Outputs {
        let mut out = Outputs::default();
        self.step_into(inputs, rng, now, &mut out);
        out
    }

    /// As [`Self::step`], adding to `out`, which is empty.
    pub fn step_into<R: Rng>(
        &mut self,
        inputs: &Inputs<'_>,
        rng: &mut R,
        now: Instant,
        out: &mut Outputs,
    ) {
        let elapsed = now - self.last_step;
        self.last_step = now;
        self.rules = !self.rules;
        let duties = self.duties();
        self.tuning.set_voltage(inputs.voltage);
        self.odometry
            .advance(duties, elapsed, &self.tuning.geometry);
        if let Some(fix) = inputs.fix {
            self.correct(fix, out, now);
        }
        if let Some(view) = inputs.view {
            self.see(view);
        }

        self.start(inputs, now);
        let mut cut = self.check_faults(inputs, out, now);
        cut |= self.check_link(inputs.link, out, now);
        cut |= self.check_time(out, now);
        if let Some(halt) = inputs.halt {
            self.halt(halt, out, now);
            cut = true;
        }
        if let Some(order) = inputs.order {
            self.take_order(order, inputs, out, now);
            // A short move may have been over before its turn came.
            cut |= self.check_time(out, now);
            // `reset` may have uncovered what the emergency stop hid.
            cut |= self.check_faults(inputs, out, now);
        }
        self.resume(inputs, out, now);
        self.follow_update(inputs, out, now);
        aside::look_aside(self, inputs, now);
        cut |= self.look_ahead(inputs, rng, out, now);
        self.follow_policy(inputs, now);
        let twist = self.wanted(inputs, out, now);
        cut |= !self.permits_motion(inputs, now);
        if !cut {
            self.drive(twist, elapsed, now);
            cut = !self.permits_duties(inputs, now);
        }
        if cut {
            for ramp in &mut self.ramps {
                ramp.cut(now);
            }
        }
        out.duties = self.duties();
    }

    /// Improves the estimate, and touches nothing else.
    fn correct(&mut self, fix: Fix, out: &mut Outputs, now: Instant) {
        let age = now - fix.seen;
        match self.odometry.correct(fix.pose, age, &self.tuning.geometry) {
            Correction::Adopted if self.told_jump.is_none_or(|at| now - at >= TOLD_EVERY) => {
                self.told_jump = Some(now);
                out.note(Note::Relocated(self.pose()));
            }
            Correction::Adopted
            | Correction::Weighed
            | Correction::Doubted
            | Correction::Refused => {}
        }
    }

    fn start(&mut self, inputs: &Inputs<'_>, now: Instant) {
        if self.state == State::Initializing {
            let heard = inputs.loaded && inputs.reading.health != SensorHealth::Unproven;
            if heard || now - Instant::BOOT >= START_PATIENCE {
                self.state = self.state.step(Event::Ready, now);
            }
        }
    }

    /// Stands or restarts for an update, and goes back to work when it wants nothing any more.
    fn follow_update(&mut self, inputs: &Inputs<'_>, out: &mut Outputs, now: Instant) {
        if inputs.update == UpdateWish::None {
            if self.state == State::Updating {
                self.state = self.state.step(Event::EndUpdate, now);
            }
            self.update_begun = false;
        } else if inputs.update == UpdateWish::Restart {
            if !self.rebooting {
                self.restart(out, now);
            }
        } else if !self.update_begun
            && self.state == State::Idle
            && self.duties() == [0.0; 2]
            && inputs.charge == Charge::Good
            && !self.rebooting
            && !self.resumption.is_waiting()
        {
            self.update_begun = true;
            self.state = self.state.step(Event::BeginUpdate, now);
        }
    }

    /// Closes the book of what is under way: answers whoever waits for it, and notes an end
    /// before its time. The caller moves the state on.
    fn finish(&mut self, result: Result<(), Reason>, out: &mut Outputs) {
        if let Err(reason) = result
            && self.is_under_way()
        {
            out.note(Note::Ended(reason));
        }
        if let Some(sender) = self.pending.take() {
            match result {
                Ok(()) => out.answer(sender, ResponseStatus::Completed, None),
                Err(reason) => out.answer(sender, ResponseStatus::Failed, Some(reason)),
            }
        }
        self.scan = None;
        self.detour = None;
        self.progress.reset();
    }

    /// Whether the robot is about something, moving or not.
    fn is_under_way(&self) -> bool {
        match self.state {
            State::Moving(_) | State::Caution(_) | State::Avoiding(..) | State::Scanning { .. } => {
                true
            }
            State::Initializing | State::Idle | State::Error(_) | State::Updating => false,
        }
    }

    /// Whether what is under way, or rolling out, needs a fresh view of the way ahead.
    fn needs_view(&self) -> bool {
        self.tuning.avoidance
            || match self.state {
                State::Moving(goal) | State::Caution(goal) | State::Avoiding(goal, _) => {
                    goal.is_autonomous()
                }
                State::Scanning { .. } => true,
                State::Initializing | State::Idle | State::Error(_) | State::Updating => false,
            }
    }
}
