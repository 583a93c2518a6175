//! When a command goes to a robot, when it goes again, and when it is given up.
//!
//! Nothing here does anything: time is handed in, and what is to be sent is handed to a [`DeliverySink`].
//! The server and the chaos runs of the simulator use the same [`Delivery`].
//!
//! # What makes sure that nothing is lost and nothing runs twice
//! A robot remembers the newest command of each source with its answer. The same number again is
//! answered from memory; a lower one is `stale`. So a command may be sent again under its number
//! for as long as nothing newer went to the same robot. Hence:
//!
//! * A command waits until all before it to the same robot are answered or given up. Two exceptions:
//!   halts go at once, and motion follows motion at once, since the newer replaces the older.
//! * Without an answer it is sent again, first after [`RESEND_AFTER_MS`], then ever less often,
//!   and at once when the robot, or the connection to the broker, has come back.
//! * Settings go under a source of their own, [`SETTINGS`]: no halt overtakes one, so one that goes
//!   again is either answered from memory or runs for the first time.
//! * A command that waited gets its number, and its time, when it first goes.
//! * A robot that has started anew has forgotten. What went to the program before is not sent
//!   again, but for settings, which may be set twice, and halts, which only make things safer.
//! * A halt is not repeated once something newer went to the robot: it would end that.
//! * Nothing goes later than its [`Class::life_ms`].
//!
//! What a halt or a command to the whole swarm has overtaken may come back `stale`; that is its outcome
//! then.

mod queue;

use std::collections::BTreeMap;

use crawler_protocol::{Action, RobotId};

use queue::{PendingCommand, RobotQueue};

/// Milliseconds since any moment that is the same for all calls.
pub type Ms = u64;

/// How long after a command went without an answer it goes again for the first time.
pub const RESEND_AFTER_MS: Ms = 1_000;
/// The longest pause between two attempts.
pub const LONGEST_PAUSE_MS: Ms = 30_000;
/// Commands that may wait for one robot.
pub const MOST_PER_ROBOT: usize = 64;
/// Commands that may wait for robots that are away, all together.
pub const MOST: usize = 50_000;
/// The source that settings go under, whoever gave them: robots compare numbers per source.
pub const SETTINGS: &str = "settings";
/// Times a setting gets a new number, because the robot has started anew, before it is given up.
const MOST_NUMBERS: u8 = 4;

/// How a command is treated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Class {
    /// `stop` and `estop`: go at once, whatever else waits.
    Halt,
    /// Moves the robot: worthless when late.
    Motion,
    /// Everything else.
    Plain,
    /// `set`: waits for a robot that is away.
    Setting,
}

impl Class {
    /// The class of an action.
    #[must_use]
    pub const fn of(action: &Action) -> Self {
        match action {
            Action::Stop | Action::Estop => Self::Halt,
            Action::Set(_) => Self::Setting,
            action if action.is_motion() => Self::Motion,
            _ => Self::Plain,
        }
    }

    /// How long after it was given a command may still be sent. Robots refuse motion of that age
    /// themselves.
    #[must_use]
    pub const fn life_ms(self) -> Ms {
        match self {
            Self::Motion => 2_000,
            Self::Halt | Self::Plain => 60_000,
            Self::Setting => 55 * 60_000,
        }
    }
}

/// One command on its way to one robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sending<'a> {
    /// Whose command it is, as told to [`Delivery::submit`].
    pub id: u64,
    /// For whom.
    pub robot: &'a RobotId,
    /// Under which number.
    pub seq: u64,
    /// Whether it has gone under this number before.
    pub again: bool,
    /// For how long it may still reach the robot; at least 1.
    pub life_ms: Ms,
    /// How often the robot has started, if it told.
    pub boot: Option<u32>,
}

/// How a delivery ended without an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum End {
    /// It never went: the robot did not come back in time.
    Expired,
    /// It went, and nobody can tell what came of it.
    Unanswered,
}

/// Who carries things out.
pub trait DeliverySink {
    /// The number that the command `id` is about to go to a robot under: above `above`, and above all
    /// that were given before. What could not go under its number may get the same one again.
    fn number(&mut self, id: u64, robot: &RobotId, above: u64) -> u64;
    /// Whether commands of this class may go at all at the moment. Halts always may.
    fn may_go(&self, _class: Class) -> bool {
        true
    }
    /// Sends a command; false when it cannot go now. Nothing that came after it goes before it then, but
    /// for halts.
    fn send(&mut self, sending: &Sending<'_>) -> bool;
    /// The command will not be sent any more.
    fn over(&mut self, id: u64, robot: &RobotId, end: End);
}

/// There is no room for another command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Full;

impl std::fmt::Display for Full {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("too many commands wait to be delivered")
    }
}

impl std::error::Error for Full {}

/// All commands under way to all robots.
#[derive(Debug, Default)]
pub struct Delivery {
    queues: BTreeMap<RobotId, RobotQueue>,
    /// Whether there is no connection to the broker.
    down: bool,
    /// The newest number that went to all robots.
    broadcast: u64,
    /// Commands under way.
    pending: usize,
}

impl Delivery {
    /// Nothing under way, and connected.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes in a command for one robot. It goes with the next [`Delivery::poll`].
    ///
    /// `id` rises from call to call, and is the command's number if it is the newest of all that
    /// went to the robot by then.
    ///
    /// # Errors
    /// [`Full`] when too many wait; never for a halt.
    pub fn submit(&mut self, id: u64, robot: &RobotId, class: Class, now: Ms) -> Result<(), Full> {
        let room = self.pending < MOST;
        let queue = self.queues.entry(robot.clone()).or_default();
        if class != Class::Halt && !(room && queue.len() < MOST_PER_ROBOT) {
            return Err(Full);
        }
        queue.push(PendingCommand::new(id, class, now + class.life_ms()));
        self.pending += 1;
        Ok(())
    }

    /// Takes in a command that has just gone to the whole swarm under the number `id`: robots
    /// that do not answer get it again, each for itself.
    pub fn broadcast(
        &mut self,
        id: u64,
        robots: impl IntoIterator<Item = RobotId>,
        class: Class,
        now: Ms,
    ) {
        self.broadcast = self.broadcast.max(id);
        for robot in robots {
            let queue = self.queues.entry(robot).or_default();
            if self.pending < MOST && queue.len() < MOST_PER_ROBOT {
                queue.push_sent(PendingCommand::new(id, class, now + class.life_ms()), now);
                self.pending += 1;
            }
        }
    }

    /// Takes up a command again after a restart: it may or may not have gone under `seq`, to the
    /// program of that `boot` if that is known, and lives until `expires`.
    pub fn resume(
        &mut self,
        id: u64,
        robot: &RobotId,
        class: Class,
        (seq, boot): (u64, Option<u32>),
        (now, expires): (Ms, Ms),
    ) {
        let queue = self.queues.entry(robot.clone()).or_default();
        queue.push_sent(PendingCommand::new(id, class, expires), now);
        queue.took_off(id, seq, boot, now);
        self.pending += 1;
    }

    /// Takes a command back. Nothing is said of it any more.
    pub fn withdraw(&mut self, id: u64, robot: &RobotId) {
        if let Some(queue) = self.queues.get_mut(robot) {
            self.pending -= queue.remove(|pending| pending.id() == id);
        }
    }

    /// The connection to the broker is there, or lost. Once it is back everything without an
    /// answer goes again at once: a broker that has started anew has forgotten it.
    pub fn connection(&mut self, up: bool, now: Ms) {
        if up && self.down {
            for queue in self.queues.values_mut() {
                queue.rouse(now);
            }
        }
        self.down = !up;
    }

    /// A robot has told its status, or its broker has told that it is gone.
    pub fn status(&mut self, robot: &RobotId, online: bool, boot: u32, now: Ms) {
        let queue = self.queues.entry(robot.clone()).or_default();
        queue.status(online, boot, now);
    }

    /// A robot has spoken, whatever its status says: a last will can come late.
    pub fn heard(&mut self, robot: &RobotId, now: Ms) {
        if let Some(queue) = self.queues.get_mut(robot) {
            queue.heard(now);
        }
    }

    /// Whether commands for this robot go at once, as far as is known.
    #[must_use]
    pub fn is_online(&self, robot: &RobotId) -> bool {
        !self.down && self.queues.get(robot).is_none_or(RobotQueue::is_online)
    }

    /// How often the robot had started when it last told its status.
    #[must_use]
    pub fn boot(&self, robot: &RobotId) -> Option<u32> {
        self.queues.get(robot)?.boot()
    }

    /// The robot has answered the number `seq`: nothing is sent any more. Returns whose command it
    /// was, if it was still under way.
    pub fn answered(&mut self, robot: &RobotId, seq: u64) -> Option<u64> {
        let id = self.queues.get_mut(robot)?.answered(seq)?;
        self.pending -= 1;
        Some(id)
    }

    /// Sends what is due, and gives up what is too old.
    pub fn poll(&mut self, now: Ms, sink: &mut dyn DeliverySink) {
        for (robot, queue) in &mut self.queues {
            if queue.len() == 0 {
                continue;
            }
            let before = queue.len();
            queue.poll(robot, self.broadcast, !self.down, now, sink);
            self.pending -= before - queue.len();
        }
    }

    /// As [`Delivery::poll`], for one robot.
    pub fn poll_one(&mut self, robot: &RobotId, now: Ms, sink: &mut dyn DeliverySink) {
        if let Some(queue) = self.queues.get_mut(robot) {
            let before = queue.len();
            queue.poll(robot, self.broadcast, !self.down, now, sink);
            self.pending -= before - queue.len();
        }
    }

    /// Commands under way, counted per robot.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.pending
    }

    /// Whether nothing is under way.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.pending == 0
    }
}
