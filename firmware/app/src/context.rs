//! The one value that the activities of a robot share, and who may write which part of it.

pub(crate) mod handles;
#[cfg(test)]
mod tests;

use core::cell::{Cell, RefCell};

use crawler_hal::{Instant, PANIC_TEXT, ResetCause};
use crawler_protocol::{
    Action, BehaviourName, Command, Level, ParameterValues, PolicyName, Pose, Reason,
    ResponseStatus, RobotState, Says, Shadow, Source,
};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::signal::Signal;
use heapless::String;

use crate::behaviour::Leeway;
use crate::config::Config;
use crate::goal::Goal;
use crate::injected::Injected;
use crate::ledger::{Answer, SourceNumber};
use crate::map_report::MapReports;
use crate::memory::CommandMemory;
use crate::navigation::{Destination, Guide};
use crate::neighbours::Neighbours;
use crate::order::{Captures, Halts, Order, Sender, SetRequest, Task, UpdateWish};
use crate::outbox::{Outbox, Outgoing};
use crate::parameters::{Changes, Parameters};
use crate::perception::{Battery, LinkHealth, Reading};
use crate::policy::Policies;
use crate::policy::decisions::{Decisions, named};
use crate::policy::shadow::Shadows;
use crate::state::Fault;
use crate::timesync::TimeSync;
use crate::tracking::Tracking;
use crate::trouble::LinkTrouble;
use crate::vision::Sights;

/// What telemetry and the lamp need to know of control, copied once per period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Snapshot {
    /// State as reported.
    pub state: RobotState,
    /// Behaviour in force.
    pub behaviour: BehaviourName,
    /// Why the robot stands, when its state is `ERROR`.
    pub fault: Option<Fault>,
    /// Where odometry and outside references put the robot.
    pub pose: Pose,
    /// Duty of the left and right wheel, −1 to 1.
    pub wheels: [f32; 2],
    /// What it says to its neighbours.
    pub says: Option<Says>,
    /// Newest reading of the ranger.
    pub reading: Reading,
    /// Newest word on the battery.
    pub battery: Battery,
}

impl Default for Snapshot {
    fn default() -> Self {
        Self {
            state: RobotState::Initializing,
            behaviour: BehaviourName::Manual,
            fault: None,
            pose: Pose::default(),
            wheels: [0.0; 2],
            says: None,
            reading: Reading::default(),
            battery: Battery::default(),
        }
    }
}

/// What is known of this boot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BootRecord {
    /// Boots so far, this one included. 0 until the flash was read, and for good when it
    /// cannot be.
    pub count: u32,
    /// Why the program started.
    pub cause: ResetCause,
    /// Whether the body kept where and why the program panicked before.
    pub panicked: bool,
}

impl BootRecord {
    /// Whether the program restarted because it was told to.
    pub(crate) fn was_asked_for(self) -> bool {
        self.cause == ResetCause::Software && !self.panicked
    }
}

/// Takes the level, the event and the text of a log record.
pub type Echo = fn(Level, &str, core::fmt::Arguments<'_>);

/// As much of `text` as fits, cut at a character boundary.
pub(crate) fn cut<const N: usize>(text: &str) -> String<N> {
    let mut out = String::new();
    for character in text.chars() {
        if out.push(character).is_err() {
            break;
        }
    }
    out
}

/// One robot: everything its activities share, and nothing else they could share.
///
/// Every field has one writer: the activity whose handle can change it. All others read
/// copies, through the methods here. What everyone writes to (answers and log records in the outbox,
/// the memory of commands) guards itself. Nothing here is held across an await.
pub struct Robot<M: RawMutex> {
    pub(crate) config: Config,
    /// Where log records are told as well, at once.
    echo: Option<Echo>,
    /// What intake remembers of commands and their answers.
    pub(crate) commands: CommandMemory<M>,
    /// Everyone → link: answers and log records.
    pub(crate) outbox: Outbox<M>,
    /// Link → everyone: Unix time.
    pub(crate) time: TimeSync<M>,
    /// Intake → control.
    orders: Channel<M, Order, 4>,
    /// Intake → control, merged rather than queued: never refused.
    halt: Halts<M>,
    /// Intake → store.
    set_requests: Channel<M, SetRequest, 2>,
    /// Control → store: the behaviour that a restart is about to interrupt.
    behaviour_to_keep: Signal<M, Goal>,
    /// Store → control: the behaviour that the restart before this boot interrupted.
    behaviour_before_restart: Signal<M, Goal>,
    /// Intake → camera.
    captures: Captures<M>,
    /// Intake → sense, and sense ↔ link: the map for whoever asked for it.
    map_reports: MapReports<M>,
    /// Control and update → camera, and camera → control and link.
    sights: Sights<M>,
    /// Sense → control.
    reading: Mutex<M, Cell<Reading>>,
    /// Power → control, store.
    battery: Mutex<M, Cell<Battery>>,
    /// Power → store: the battery was measured.
    battery_measured: Signal<M, ()>,
    /// Link → control.
    link_health: Mutex<M, Cell<LinkHealth>>,
    /// Link → lamp: what keeps the robot from its broker.
    link_trouble: Mutex<M, Cell<Option<LinkTrouble>>>,
    /// Link → control: the newest outside position reference.
    tracking: Tracking<M>,
    /// Link → control: who is near.
    neighbours: Neighbours<M>,
    /// Control → sense: where the robot is to go.
    going: Mutex<M, Cell<Option<Destination>>>,
    /// Sense → control: which way.
    guide: Mutex<M, Cell<Option<Guide>>>,
    /// Sense → control: what others leave of its speed to a robot on its way.
    leeway: Mutex<M, Cell<Leeway>>,
    /// Control → link, lamp, sense.
    snapshot: Mutex<M, Cell<Snapshot>>,
    /// Store → everyone.
    parameters: Mutex<M, RefCell<Parameters>>,
    /// Store → link: the retained parameters message is out of date.
    parameters_changed: Signal<M, ()>,
    /// Store and control → link.
    boot: Mutex<M, Cell<BootRecord>>,
    /// Control → link: how the program panicked before this start, or nothing.
    panic: Mutex<M, RefCell<String<PANIC_TEXT>>>,
    /// Store → control: the flash has been read, or has been given up.
    loaded: Mutex<M, Cell<bool>>,
    /// Link → control, sense, link: what is broken on purpose.
    pub(crate) injected: Injected<M>,
    /// Control ↔ policy: observations, and what was decided for them.
    decisions: Decisions<M>,
    /// Intake, update and policy → link: how a policy that does not drive compares.
    shadows: Shadows<M>,
    /// Update → control.
    update_wish: Mutex<M, Cell<UpdateWish>>,
    /// Control → update: periods that were missed since the start.
    missed: Mutex<M, Cell<u32>>,
    /// Control and link → lamp: the pattern may have changed.
    lamp_changed: Signal<M, ()>,
    /// Control → lamp: until when to blink for `identify`.
    identify_until: Mutex<M, Cell<Instant>>,
}

impl<M: RawMutex> Robot<M> {
    /// A robot that has not started yet.
    pub fn new(config: Config) -> Self {
        Self {
            config,
            echo: None,
            commands: CommandMemory::new(),
            outbox: Outbox::new(),
            time: TimeSync::new(),
            orders: Channel::new(),
            halt: Halts::new(),
            set_requests: Channel::new(),
            behaviour_to_keep: Signal::new(),
            behaviour_before_restart: Signal::new(),
            captures: Captures::new(),
            map_reports: MapReports::new(),
            sights: Sights::new(),
            reading: Mutex::new(Cell::new(Reading::default())),
            battery: Mutex::new(Cell::new(Battery::default())),
            battery_measured: Signal::new(),
            link_health: Mutex::new(Cell::new(LinkHealth::default())),
            link_trouble: Mutex::new(Cell::new(None)),
            tracking: Tracking::new(),
            neighbours: Neighbours::new(),
            going: Mutex::new(Cell::new(None)),
            guide: Mutex::new(Cell::new(None)),
            leeway: Mutex::new(Cell::new(Leeway::ALL)),
            snapshot: Mutex::new(Cell::new(Snapshot::default())),
            parameters: Mutex::new(RefCell::new(Parameters::default())),
            parameters_changed: Signal::new(),
            boot: Mutex::new(Cell::new(BootRecord {
                count: 0,
                cause: ResetCause::External,
                panicked: false,
            })),
            panic: Mutex::new(RefCell::new(String::new())),
            loaded: Mutex::new(Cell::new(false)),
            injected: Injected::new(),
            decisions: Decisions::new(),
            shadows: Shadows::new(),
            update_wish: Mutex::new(Cell::new(UpdateWish::None)),
            missed: Mutex::new(Cell::new(0)),
            lamp_changed: Signal::new(),
            identify_until: Mutex::new(Cell::new(Instant::BOOT)),
        }
    }

    /// Has `echo` told of every log record as it is written, link or no link: a board's debug
    /// line then says what the broker is told. The function must not wait. Set in place, since a
    /// context is too large to pass through the stack.
    pub fn set_echo(&mut self, echo: Echo) {
        self.echo = Some(echo);
    }

    /// Identity and shape of the robot.
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// What control last reported.
    pub fn snapshot(&self) -> Snapshot {
        self.snapshot.lock(Cell::get)
    }

    /// What is known of this boot.
    pub fn boot(&self) -> BootRecord {
        self.boot.lock(Cell::get)
    }

    /// Where and why the program panicked before this start, when the body has kept it.
    pub fn last_panic(&self) -> Option<String<PANIC_TEXT>> {
        self.panic.lock(|text| {
            let text = text.borrow();
            (!text.is_empty()).then(|| text.clone())
        })
    }

    /// Reads the parameters.
    pub fn with_parameters<T>(&self, read: impl FnOnce(&Parameters) -> T) -> T {
        self.parameters
            .lock(|parameters| read(&parameters.borrow()))
    }

    /// Whether the flash has been read, or given up.
    pub fn is_loaded(&self) -> bool {
        self.loaded.lock(Cell::get)
    }

    /// Puts `values` over the parameters, and keeps nothing of it in flash: for whoever runs a
    /// program with others than it has stored.
    ///
    /// # Errors
    /// The reason for which a `set` command would be refused; nothing has changed then.
    pub fn adjust(&self, values: &ParameterValues) -> Result<(), Reason> {
        let next = self.with_parameters(|present| present.with(values))?;
        self.replace_parameters(next);
        self.parameters_changed.signal(());
        Ok(())
    }

    fn replace_parameters(&self, next: Parameters) {
        self.parameters
            .lock(|cell| cell.borrow_mut().replace_with(next));
    }

    /// Newest reading of the ranger.
    pub(crate) fn reading(&self) -> Reading {
        self.reading.lock(Cell::get)
    }

    /// Where the robot is to go, if it is to go anywhere.
    pub(crate) fn going(&self) -> Option<Destination> {
        self.going.lock(Cell::get)
    }

    /// The newest plan.
    pub(crate) fn guide(&self) -> Option<Guide> {
        self.guide.lock(Cell::get)
    }

    /// What others leave of its speed to a robot on its way to a place.
    pub(crate) fn leeway(&self) -> Leeway {
        self.leeway.lock(Cell::get)
    }

    /// Newest word on the battery.
    pub(crate) fn battery(&self) -> Battery {
        self.battery.lock(Cell::get)
    }

    /// How the session with the broker is.
    pub fn link_health(&self) -> LinkHealth {
        self.link_health.lock(Cell::get)
    }

    /// What an update wants of control.
    pub(crate) fn update_wish(&self) -> UpdateWish {
        self.update_wish.lock(Cell::get)
    }

    /// What there is to drive by.
    pub fn policies(&self) -> Policies {
        self.decisions.installed()
    }

    /// How a policy that does not drive compares, while somebody wants to know.
    pub fn shadow(&self) -> Option<Shadow> {
        self.shadows.told()
    }

    /// Periods of control that were missed since the start.
    pub(crate) fn missed_periods(&self) -> u32 {
        self.missed.lock(Cell::get)
    }

    /// Orders that wait for control.
    #[cfg(test)]
    pub(crate) fn orders_waiting(&self) -> usize {
        self.orders.len()
    }

    /// What control waits for a decision on.
    #[cfg(test)]
    pub(crate) fn policy_asked(&self) -> Option<crate::policy::Asked> {
        self.decisions.waiting()
    }

    /// Outside position references refused so far.
    pub fn refused_fixes(&self) -> u32 {
        self.tracking.refused()
    }

    /// Whether there is something seen that the link has not told.
    pub(crate) fn has_news(&self) -> bool {
        self.sights.has_news()
    }

    /// Whether a part of the map waits to be sent.
    pub(crate) fn map_waits(&self) -> bool {
        self.map_reports.waits()
    }

    /// Tells control how the session with the broker is. A loss is acted upon within one
    /// control period.
    pub fn set_link_health(&self, health: LinkHealth) {
        self.link_health.lock(|cell| cell.set(health));
    }

    /// What keeps the robot from its broker, as far as the link knows.
    pub fn link_trouble(&self) -> Option<LinkTrouble> {
        self.link_trouble.lock(Cell::get)
    }

    /// Answers a command: notes what it came to, and queues the answer for delivery.
    pub fn respond(
        &self,
        source: &Source,
        seq: u64,
        status: ResponseStatus,
        reason: Option<Reason>,
        now: Instant,
    ) {
        let answer = Answer { status, reason };
        let number = self.commands.with(|memory| {
            memory.ledger.answer(source, seq, answer);
            memory.ledger.number(source)
        });
        self.outbox
            .answer(source, self.outgoing(number, seq, answer, now));
    }

    /// Moves the robot's clock by so many milliseconds: a fault, which the server's time messages
    /// set right. Does nothing to a clock that was never set.
    pub fn step_clock(&self, ms: i64) {
        self.time.jump(ms);
    }

    /// Unix time in milliseconds, while the robot's clock is synchronised.
    pub fn unix_ms(&self, now: Instant) -> Option<u64> {
        self.time.unix_ms(now)
    }

    /// Writes a log record, to be sent when there is a session. Long text is cut.
    pub fn log(
        &self,
        level: Level,
        event: &'static str,
        text: core::fmt::Arguments<'_>,
        now: Instant,
    ) {
        if let Some(echo) = self.echo {
            echo(level, event, text);
        }
        let timestamp = self.unix_ms(now).unwrap_or(0);
        self.outbox.log(level, event, text, timestamp);
    }

    /// The source of this number, while it is remembered.
    pub(crate) fn source(&self, number: SourceNumber) -> Option<Source> {
        self.commands
            .with(|memory| memory.ledger.source(number).cloned())
    }

    pub(crate) fn outgoing(
        &self,
        source: SourceNumber,
        seq: u64,
        answer: Answer,
        now: Instant,
    ) -> Outgoing {
        Outgoing {
            source,
            seq,
            status: answer.status,
            reason: answer.reason,
            timestamp: self.unix_ms(now).unwrap_or(0),
        }
    }

    /// Hands a valid, fresh and new command to whoever carries it out, who then answers it.
    ///
    /// `stop` and `estop` always get through. The second value of the answer names an order
    /// taken back by them, which the caller answers `failed` with [`Reason::Interrupted`].
    ///
    /// # Errors
    /// The reason to answer `rejected` with; the robot keeps doing what it did.
    /// [`Reason::Unsupported`] for what this program does not do, [`Reason::Busy`] when too many
    /// commands wait.
    pub fn route(
        &self,
        command: &Command,
        now: Instant,
        mut taken_back: impl FnMut(&Sender),
    ) -> Result<Routed, Reason> {
        let sender = Sender {
            source: command.source.clone(),
            seq: command.seq,
        };
        match &command.action {
            Action::Stop => Ok(self.request_halt(false, sender, &mut taken_back)),
            Action::Estop => Ok(self.request_halt(true, sender, &mut taken_back)),
            Action::Set(values) => self.request_set(values, sender),
            Action::Capture if self.config.camera => {
                self.captures.request(sender).map(|()| Routed::Waiting)
            }
            Action::ReportMap => self.map_reports.request(sender).map(|()| Routed::Waiting),
            Action::Shadow { policy } => self.compare(policy.as_ref()),
            action => {
                let task = Task::from_action(action).ok_or(Reason::Unsupported)?;
                let order = Order {
                    task,
                    sender,
                    arrived: now,
                };
                match self.orders.try_send(order) {
                    Ok(()) => Ok(Routed::Waiting),
                    Err(_) => Err(Reason::Busy),
                }
            }
        }
    }

    /// Has a policy decide beside the one that drives, or none.
    fn compare(&self, policy: Option<&PolicyName>) -> Result<Routed, Reason> {
        if let Some(policy) = policy {
            self.policies().check(named(policy.as_str()))?;
        }
        self.shadows.begin(policy);
        Ok(Routed::Done)
    }

    #[inline(never)]
    fn request_set(&self, values: &ParameterValues, sender: Sender) -> Result<Routed, Reason> {
        let changes = Changes::new(values);
        let looks = changes.as_ref().is_ok_and(Changes::wants_eyes);
        if looks && self.config.eyes.is_none() {
            return Err(Reason::Unsupported);
        }
        match self.set_requests.try_send(SetRequest { changes, sender }) {
            Ok(()) => Ok(Routed::Waiting),
            Err(_) => Err(Reason::Busy),
        }
    }

    /// Takes back what waits and would undo the halt, then asks control to halt.
    ///
    /// Control may run between any two lines of this on a board, where it lives in an interrupt:
    /// it then sees the orders as they arrived, and the halt a moment later.
    fn request_halt(
        &self,
        emergency: bool,
        sender: Sender,
        taken_back: &mut impl FnMut(&Sender),
    ) -> Routed {
        for _ in 0..self.orders.len() {
            let Ok(order) = self.orders.try_receive() else {
                break;
            };
            if order.task.yields_to_halt() {
                taken_back(&order.sender);
            } else if let Err(full) = self.orders.try_send(order) {
                // Only when intake were re-entered, which it is not; answered all the same.
                let embassy_sync::channel::TrySendError::Full(order) = full;
                taken_back(&order.sender);
            }
        }
        if self.halt.request(emergency, sender) {
            Routed::Waiting
        } else {
            Routed::Unattended
        }
    }
}

/// What became of a routed command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Routed {
    /// Whoever carries it out will answer it.
    Waiting,
    /// It is carried out: the caller answers `completed`.
    Done,
    /// A halt that is obeyed, but one too many in this control period to be answered from
    /// there: the caller answers `accepted`.
    Unattended,
}
