//! What the devices of one robot said, and what its program made of it.
//!
//! Every device of a robot has a `tap` that tells the `EventLog` what passes through it; `played`
//! devices say once more what is on one. A recording is a file of them.

mod event;
pub(crate) mod life;
mod mqtt;
pub(crate) mod playback;
pub(crate) mod played;
pub(crate) mod tap;

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;

use crawler_hal::{Clock, LinkState, Millivolts, ResetCause};
use crawler_protocol::{BehaviourName, RobotState};

use crate::run::journal::Payload;
use crate::run::machine::SimRobot;
use crate::sched::SimClock;
pub use event::{Event, Flash, Lens, Net, Output, What, Writer};
use life::Life;
use mqtt::{Packets, Publish};

/// Events of one robot that wait to be taken, at most. A robot has a few hundred in a second and
/// they are taken ten times in one.
const MAX_WAITING: usize = 65_536;

/// The event log of one robot, shared by its devices. A new one for each boot.
pub(crate) struct EventLog {
    clock: SimClock,
    begun: u64,
    ended: Cell<Option<u64>>,
    contents: RefCell<LogContents>,
}

#[derive(Default)]
struct LogContents {
    events: Vec<Event>,
    lost: u64,
    robot: Option<Rc<SimRobot>>,
    state: Option<(RobotState, BehaviourName)>,
    outputs: BTreeMap<Output, u8>,
    link: Option<LinkState>,
    up: Packets,
    down: Packets,
    flash_operations: u64,
}

impl std::fmt::Debug for EventLog {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("EventLog")
            .field("begun", &self.begun)
            .field("ended", &self.ended)
            .finish_non_exhaustive()
    }
}

impl EventLog {
    pub(crate) fn new(clock: &SimClock) -> Self {
        let clock = clock.world();
        Self {
            begun: clock.now().as_micros(),
            ended: Cell::new(None),
            contents: RefCell::default(),
            clock,
        }
    }

    /// The program whose state is told.
    pub(crate) fn watch(&self, robot: &Rc<SimRobot>) {
        self.contents.borrow_mut().robot = Some(Rc::clone(robot));
    }

    /// When the program started.
    pub(crate) const fn begun(&self) -> u64 {
        self.begun
    }

    /// When it was stopped, once it is.
    pub(crate) fn ended(&self) -> Option<u64> {
        self.ended.get()
    }

    /// The program was stopped: a reset, a power cut, or its robot's removal.
    pub(crate) fn end(&self) {
        self.ended.set(Some(self.now()));
        self.contents.borrow_mut().robot = None;
    }

    pub(crate) fn now(&self) -> u64 {
        self.clock.now().as_micros()
    }

    pub(crate) fn note(&self, what: What) {
        self.note_at(self.now(), what);
    }

    pub(crate) fn note_at(&self, at: u64, what: What) {
        self.contents.borrow_mut().note(at, what);
    }

    /// When something that was asked for at `begun` is done, if that is later.
    pub(crate) fn done(&self, begun: u64) -> Option<u64> {
        let now = self.now();
        (now > begun).then_some(now)
    }

    pub(crate) fn set(&self, output: Output, value: u8) {
        let now = self.now();
        let contents = &mut *self.contents.borrow_mut();
        if contents.outputs.insert(output, value) != Some(value) {
            contents.note(now, What::Set(output, value));
        }
    }

    pub(crate) fn link(&self, state: LinkState) {
        let now = self.now();
        let contents = &mut *self.contents.borrow_mut();
        if contents.link.replace(state) != Some(state) {
            let link = match state {
                LinkState::Down => None,
                LinkState::Up { address, rssi_dbm } => Some((address, rssi_dbm)),
            };
            contents.note(now, What::Link(link));
        }
    }

    /// Called once in each control period.
    pub(crate) fn look(&self) {
        let now = self.now();
        let contents = &mut *self.contents.borrow_mut();
        let Some(robot) = &contents.robot else { return };
        let snapshot = robot.snapshot();
        let state = (snapshot.state, snapshot.behaviour);
        if contents.state.replace(state) != Some(state) {
            contents.note(now, What::State(state.0, state.1));
        }
    }

    /// Numbers an operation of the flash.
    pub(crate) fn flash_operation(&self) -> u64 {
        let contents = &mut *self.contents.borrow_mut();
        contents.flash_operations += 1;
        contents.flash_operations - 1
    }

    /// A new connection: what the old one left unfinished is gone.
    pub(crate) fn connected(&self) {
        let contents = &mut *self.contents.borrow_mut();
        contents.up = Packets::default();
        contents.down = Packets::default();
    }

    /// Bytes that went out to the network. Only messages are kept: a connection also begins with
    /// name and password.
    pub(crate) fn sent(&self, at: u64, bytes: &[u8]) {
        let contents = &mut *self.contents.borrow_mut();
        let mut packets = std::mem::take(&mut contents.up);
        packets.feed(bytes, |publish| {
            let Publish {
                topic,
                payload,
                qos,
                retain,
                ..
            } = publish;
            let payload = Payload::new(&payload);
            contents.note(
                at,
                What::Published {
                    topic,
                    payload,
                    qos,
                    retain,
                },
            );
        });
        contents.up = packets;
    }

    /// Bytes that came from the network.
    pub(crate) fn received(&self, at: u64, bytes: &[u8]) {
        let contents = &mut *self.contents.borrow_mut();
        let mut packets = std::mem::take(&mut contents.down);
        packets.feed(bytes, |publish| {
            let payload = Payload::new(&publish.payload);
            let topic = publish.topic;
            contents.note(at, What::Delivered { topic, payload });
        });
        contents.down = packets;
    }

    /// Takes the events so far, and how many there was no room for.
    pub(crate) fn take(&self) -> (Vec<Event>, u64) {
        let contents = &mut *self.contents.borrow_mut();
        (
            std::mem::take(&mut contents.events),
            std::mem::take(&mut contents.lost),
        )
    }
}

impl LogContents {
    fn note(&mut self, at: u64, what: What) {
        if self.events.len() < MAX_WAITING {
            self.events.push(Event(at, what));
        } else {
            self.lost += 1;
        }
    }
}

/// The event logs of all robots of a simulation. A handle.
#[derive(Debug, Clone, Default)]
pub struct EventLogs(Rc<RefCell<Vec<Track>>>);

/// One boot of a robot in the event log.
#[derive(Debug, Clone)]
pub(crate) struct Track {
    pub(crate) robot: usize,
    pub(crate) life: Life,
    pub(crate) event_log: Rc<EventLog>,
    /// Whether its beginning was taken.
    pub(crate) told: bool,
}

impl EventLogs {
    /// Puts in an event log for a robot that boots.
    pub(crate) fn insert(&self, robot: usize, life: Life, clock: &SimClock) -> Rc<EventLog> {
        let event_log = Rc::new(EventLog::new(clock));
        self.0.borrow_mut().push(Track {
            robot,
            life,
            event_log: Rc::clone(&event_log),
            told: false,
        });
        event_log
    }

    /// Hands out every track that is new, has something on it, or has ended, and forgets those
    /// that have.
    pub(crate) fn drain(&self, mut take: impl FnMut(&Track, Vec<Event>, u64)) {
        let tracks = &mut *self.0.borrow_mut();
        for track in tracks.iter_mut() {
            let (events, lost) = track.event_log.take();
            if !track.told || !events.is_empty() || lost > 0 || track.event_log.ended().is_some() {
                take(track, events, lost);
            }
            track.told = true;
        }
        tracks.retain(|track| track.event_log.ended().is_none());
    }
}

/// Names of causes in files.
pub(crate) const fn cause_name(cause: ResetCause) -> &'static str {
    match cause {
        ResetCause::PowerOn => "power_on",
        ResetCause::Software => "software",
        ResetCause::Watchdog => "watchdog",
        ResetCause::BrownOut => "brown_out",
        ResetCause::Panic => "panic",
        _ => "external",
    }
}

/// The other way.
pub(crate) fn cause_named(name: &str) -> ResetCause {
    let known = [
        ResetCause::PowerOn,
        ResetCause::Software,
        ResetCause::Watchdog,
        ResetCause::BrownOut,
        ResetCause::Panic,
    ];
    let found = known.into_iter().find(|&cause| cause_name(cause) == name);
    found.unwrap_or(ResetCause::External)
}

/// What an ADC gave, for the event log.
pub(crate) fn millivolts<E>(result: &Result<Millivolts, E>) -> Option<u16> {
    result.as_ref().ok().map(|voltage| voltage.0)
}
