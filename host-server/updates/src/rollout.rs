//! The pure part of a rollout: which robot is offered which release, and when.
//!
//! A [`Plan`] says which releases go to whom, in which phases and within which limits. [`Rollout::start`] takes one
//! up for a fleet; from then on every [`Event`] and every [`Command`] gives a [`Step`]: what to store, what to tell
//! people, and what to send. Time is handed in. Nothing else decides what comes of it: the same calls give the
//! same steps.
//!
//! # Killed at any moment
//! The caller stores document, rows and notes of a step in one transaction, and sends its effects only then.
//! Whatever it was at when it was killed, [`Rollout::load`] goes on from what is stored: an event that was not stored
//! is told again by the robot or noticed by a time-out, and effects that were not sent come again. All effects may be
//! carried out any number of times. What may not, the notes, is stored with the rest, under numbers.
//!
//! # Rules
//! * A robot is confirmed when it says so of the build of its release, or ran that before it was offered anything.
//! * A place of [`Limits::parallel`] is taken from the offer to the end of the trial. The rollout never offers beyond
//!   that; a robot that is at work all the same gets a place if there is one, and is told to give up if not. One that
//!   already runs the new program is counted, whatever the limit.
//! * A robot that is offline, asleep, driving or low takes no place. It does not hold up its phase; when that has
//!   passed it belongs to the next one. See [`Phase`] for when that is.
//! * A robot that goes offline on the way gives its place back and goes on later where it was; that is no failure.
//! * A roll-back, or a confirmation of another build, is final unless a person retries the robot. Time-outs and
//!   refusals that need not last are retried after a pause, [`Retries::attempts`] times.
//! * The rollout pauses by itself at [`Phase::most_failures`] failures among the robots of the phase, or when all
//!   that can be reached are done and too few are confirmed. A pause, also by a person, recalls who has not started
//!   the new program.
//! * Each robot belongs to one place in an order by chance that follows from its id and the rollout's.
//!
//! # Where to read on
//! [`plan`] and what is wrong with one, `check`; `assign`, who belongs to which phase; [`robot`], where a robot stands;
//! [`event`], what goes in and comes out; `transition`, what a report means; `engine`, and its parts `reports`,
//! `phases` and `commands`; `judge`, when a phase has passed.
//!
//! # Example
//! ```
//! use crawler_protocol::{Kind, RobotId};
//! use crawler_updates::rollout::{
//!     BoardName, BuildId, Event, Message, Now, Owner, Plan, Report, RolloutId, RolloutState, Rollout, ServerId,
//!     Sighting,
//! };
//!
//! let plan: Plan = serde_json::from_str(r#"{
//!     "releases": [{"release": "sim-4", "board": "sim", "build": "b4", "version": "0.4.0", "sequence": 4,
//!                   "bytes": 600000}],
//!     "phases": [{"select": {"share": 100}, "soak_s": 0}]}"#)?;
//! let robot = RobotId::new("sim-0001")?;
//! let seen = Sighting {
//!     robot: robot.clone(),
//!     board: BoardName::new("sim")?,
//!     kind: Kind::Simulated,
//!     vision: false,
//!     policies: false,
//!     build: BuildId::new("b3")?,
//!     boot: 1,
//!     online: true,
//!     busy: None,
//! };
//! let owner = Owner { server: ServerId::new("a")?, epoch: 1 };
//! let now = Now { unix_ms: 1_700_000_000_000, monotonic_ms: 0 };
//!
//! let (mut rollout, step) = Rollout::start(RolloutId::new("spring")?, plan, owner, &[seen], now)?;
//! // Here the caller stores `step.document`, `step.rows` and `step.notes`, and then sends:
//! assert_eq!((&step.effects[0].robot, step.effects[0].message), (&robot, Message::Offer));
//!
//! let report = Report::Confirmed(BuildId::new("b4")?);
//! let release = step.effects[0].release.clone();
//! let step = rollout.handle(Event::Told { robot, release, report }, now);
//! assert_eq!(rollout.document().state, RolloutState::Done);
//!
//! let (again, _) = Rollout::load(step.document.expect("it has changed"), step.rows, now)?;
//! assert_eq!(again.document(), rollout.document());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod assign;
mod bucket;
mod check;
mod commands;
mod counts;
mod document;
mod engine;
pub mod event;
mod judge;
mod names;
mod phases;
pub mod plan;
mod progress;
mod rank;
mod reports;
pub mod robot;
mod roster;
mod sequence;
mod transition;
mod window;

pub use check::{
    LEAST_BYTES_PER_SECOND, MOST_BYTES, MOST_PHASES, MOST_RELEASES, MOST_ROBOTS, PlanError,
};
pub use commands::CommandError;
pub use counts::{Counts, PhaseCounts};
pub use document::{Anchor, DOCUMENT_VERSION, Document, LoadError, Owner};
pub use engine::{Grant, RESTART_GRACE_MS, Rollout, StaleEpoch, StartError};
pub use event::{
    Busy, Command, Effect, Event, Happening, Message, Note, Now, OWN_MODEL, Report, Sighting, Step,
};
pub use judge::LEAST_FAILURES;
pub use names::{BoardName, BuildId, Code, NameError, ReleaseId, RolloutId, ServerId, Version};
pub use plan::{
    GateOverride, Limits, Phase, Plan, PlannedRelease, Replaced, Retries, Selection, Timeouts,
};
pub use progress::{PauseReason, PhaseState, RolloutState};
pub use reports::RESEND_AFTER_MS;
pub use robot::{Reason, RobotRow, UpdateState};
pub use window::{MOST_OFFSET_MINUTES, NoTimeOfDay, TimeOfDay, Window};
