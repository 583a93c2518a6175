//! What intake hands to whoever carries it out, once a command has been found valid, fresh and new.

use core::cell::{Cell, RefCell};

use crawler_hal::Instant;
use crawler_protocol::{Action, BehaviourSpec, Direction, Reason, Source};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::signal::Signal;
use heapless::Vec;

use crate::goal::{Mission, Swarm};
use crate::neighbours::name_of;
use crate::parameters::Changes;
use crate::policy::decisions::named;

/// What an update wants of control.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UpdateWish {
    /// Nothing.
    #[default]
    None,
    /// That the robot stands, and takes no orders to move.
    Stand,
    /// That it restarts, once its answers are out.
    Restart,
}

/// Most halts of one control period that can be answered one by one.
pub const HALT_ANSWERS: usize = 4;

/// Who gave a command, and under which number: where its answers go.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Sender {
    /// Who sent the command.
    pub source: Source,
    /// Its sequence number.
    pub seq: u64,
}

/// The part of a command that control carries out.
///
/// `stop` and `estop` travel as [`Halt`], `set` goes to the store, `capture` to the camera, `report_map` to
/// whoever keeps the map, `shadow` to whoever decides: what cannot be carried out here cannot be written here.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Task {
    /// Open-loop motion in one direction.
    Move {
        /// Where to.
        direction: Direction,
        /// Share of the permitted speed, 0 to 100.
        speed: u8,
        /// How long, in milliseconds; 0 is until told otherwise, under the failsafe.
        duration_ms: u32,
    },
    /// Continuous driving.
    Drive {
        /// Forward speed in metres per second.
        v: f32,
        /// Turning rate in radians per second, counter-clockwise positive.
        w: f32,
    },
    /// One turn in place, collecting ranges.
    Scan,
    /// Wander about, avoiding obstacles.
    Wander {
        /// Share of the permitted speed, 0 to 100.
        speed: u8,
    },
    /// Move by where others are.
    Swarm(Swarm),
    /// Do what takes a memory.
    Mission(Mission),
    /// Drive by a policy that was learned.
    Policy {
        /// Stands for its name.
        name: u32,
    },
    /// Go to a place in the odometry frame.
    Goto {
        /// Metres along the axis the robot faced at boot.
        x: f32,
        /// Metres to the left of it.
        y: f32,
    },
    /// End any behaviour and wait for manual commands.
    Manual,
    /// Release the latch of an emergency stop.
    Reset,
    /// Blink.
    Identify,
    /// Restart the program.
    Reboot,
}

impl Task {
    /// The task in `action`; `None` where it is not control that carries it out, or nobody can.
    // Known actions are named one by one although the last arm would catch them too.
    #[allow(clippy::match_same_arms)]
    pub fn from_action(action: &Action) -> Option<Self> {
        Some(match action {
            Action::Move {
                direction,
                speed,
                duration_ms,
            } => Self::Move {
                direction: *direction,
                speed: *speed,
                duration_ms: *duration_ms,
            },
            Action::Drive { v, w } => Self::Drive { v: *v, w: *w },
            Action::Scan => Self::Scan,
            Action::Goto { x, y } | Action::Behave(BehaviourSpec::Goto { x, y }) => {
                Self::Goto { x: *x, y: *y }
            }
            Action::Behave(BehaviourSpec::Manual) => Self::Manual,
            Action::Behave(BehaviourSpec::Wander { speed }) => Self::Wander { speed: *speed },
            Action::Behave(BehaviourSpec::Disperse) => Self::Swarm(Swarm::Disperse),
            Action::Behave(BehaviourSpec::Gather { x, y }) => {
                Self::Swarm(Swarm::Gather { x: *x, y: *y })
            }
            Action::Behave(BehaviourSpec::Flock) => Self::Swarm(Swarm::Flock),
            Action::Behave(BehaviourSpec::Formation) => Self::Swarm(Swarm::Formation),
            Action::Behave(BehaviourSpec::Follow { leader, distance }) => {
                Self::Mission(Mission::Follow {
                    leader: name_of(leader),
                    distance: *distance,
                })
            }
            Action::Behave(BehaviourSpec::Patrol { waypoints, laps }) => {
                Self::Mission(Mission::Patrol {
                    waypoints: *waypoints,
                    laps: *laps,
                })
            }
            Action::Behave(BehaviourSpec::Consensus { measure, f }) => {
                Self::Mission(Mission::Consensus {
                    measure: *measure,
                    f: *f,
                })
            }
            Action::Behave(BehaviourSpec::Allocate { tasks }) => {
                Self::Mission(Mission::Allocate { tasks: *tasks })
            }
            Action::Behave(BehaviourSpec::Shaped(formation)) => {
                Self::Mission(Mission::Shaped(*formation))
            }
            Action::Behave(BehaviourSpec::Cover { area }) => {
                Self::Mission(Mission::Cover { area: *area })
            }
            Action::Behave(BehaviourSpec::Policy { policy }) => Self::Policy {
                name: named(policy.as_str()),
            },
            Action::Capture
            | Action::ReportMap
            | Action::Stop
            | Action::Estop
            | Action::Set(_)
            | Action::Shadow { .. } => {
                return None;
            }
            Action::Reset => Self::Reset,
            Action::Identify => Self::Identify,
            Action::Reboot => Self::Reboot,
            // An action this program does not know yet is one it cannot do.
            _ => return None,
        })
    }

    /// Whether the task sets the robot in motion.
    pub const fn is_motion(&self) -> bool {
        match self {
            Self::Move { .. }
            | Self::Drive { .. }
            | Self::Scan
            | Self::Wander { .. }
            | Self::Swarm(_)
            | Self::Mission(_)
            | Self::Policy { .. }
            | Self::Goto { .. } => true,
            Self::Manual | Self::Reset | Self::Identify | Self::Reboot => false,
        }
    }

    /// Whether the task says what the robot is to do from now on: to move, or to stand.
    pub const fn decides_motion(&self) -> bool {
        self.is_motion() || matches!(self, Self::Manual | Self::Reboot)
    }

    /// Whether a later `stop` or `estop` takes the task back while it still waits.
    ///
    /// Motion, because it would undo the halt; `reset`, because it would release an emergency
    /// stop that came after it.
    pub const fn yields_to_halt(&self) -> bool {
        self.is_motion() || matches!(self, Self::Reset)
    }
}

/// A task with its sender and the moment it arrived.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Order {
    /// What to do.
    pub task: Task,
    /// Who asked.
    pub sender: Sender,
    /// When the command arrived: continuous driving ends 500 ms after this.
    pub arrived: Instant,
}

/// A `set` on its way to the store, and what its values came to when they were looked at.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SetRequest {
    pub(crate) changes: Result<Changes, Reason>,
    pub(crate) sender: Sender,
}

/// A request to stand still. Several that arrive before control looks become one.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Halt {
    /// Whether one of them was an emergency stop.
    pub emergency: bool,
    /// Who is to be told when the robot has stopped.
    pub senders: Vec<Sender, HALT_ANSWERS>,
}

/// Intake → control: the halt that waits, merged rather than queued, and never refused.
///
/// A signal with the halt in it would move its quarter of a kilobyte about whenever control looks,
/// which is fifty times a second, and almost always there is none.
pub(crate) struct Halts<M: RawMutex> {
    waiting: Mutex<M, RefCell<Option<Halt>>>,
    /// Something may wait.
    asked: Signal<M, ()>,
}

impl<M: RawMutex> Halts<M> {
    pub(crate) const fn new() -> Self {
        Self {
            waiting: Mutex::new(RefCell::new(None)),
            asked: Signal::new(),
        }
    }

    /// Adds a request to what waits. False when there is no place to remember its sender, who
    /// is then not answered by control.
    pub(crate) fn request(&self, emergency: bool, sender: Sender) -> bool {
        let remembered = self.waiting.lock(|waiting| {
            let mut waiting = waiting.borrow_mut();
            let halt = waiting.get_or_insert_default();
            halt.emergency |= emergency;
            halt.senders.push(sender).is_ok()
        });
        self.asked.signal(());
        remembered
    }

    /// Whether there is one to take.
    pub(crate) fn waits(&self) -> bool {
        self.waiting.lock(|waiting| waiting.borrow().is_some())
    }

    /// Takes what waits.
    pub(crate) fn try_take(&self) -> Option<Halt> {
        self.waiting.lock(|waiting| {
            if waiting.borrow().is_none() {
                return None;
            }
            waiting.borrow_mut().take()
        })
    }

    /// Returns when something may have been requested since the last return.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) async fn asked(&self) {
        self.asked.wait().await;
    }
}

/// Intake → camera: at most one capture at a time.
pub(crate) struct Captures<M: RawMutex> {
    /// From the request to its final answer.
    open: Mutex<M, Cell<bool>>,
    requests: Channel<M, Sender, 1>,
}

impl<M: RawMutex> Captures<M> {
    pub(crate) const fn new() -> Self {
        Self {
            open: Mutex::new(Cell::new(false)),
            requests: Channel::new(),
        }
    }

    /// Asks for a still.
    ///
    /// # Errors
    /// [`Reason::Busy`] while another capture is open.
    pub(crate) fn request(&self, sender: Sender) -> Result<(), Reason> {
        if self.open.lock(|open| open.replace(true)) {
            return Err(Reason::Busy);
        }
        // There is room: only an open capture could be in it.
        self.requests.try_send(sender).map_err(|_| Reason::Busy)
    }

    /// Waits for a still that was asked for.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) async fn next(&self) -> Sender {
        self.requests.receive().await
    }

    /// Ends the capture: another one may be asked for.
    pub(crate) fn close(&self) {
        self.open.lock(|open| open.set(false));
    }
}
