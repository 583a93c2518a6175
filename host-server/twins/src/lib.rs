//! Twins of the robots of a fleet while they drive.
//!
//! Whoever hears a robot or a tracker hands on what it says, and never waits for it: [`Twins::telemetry`] and
//! [`Twins::fix`] put it into a bounded inbox. A thread of its own ([`Worker::run`]) takes it out, steps the twin of
//! each robot, looks for certificates, and tells when something is wrong with a robot, or no longer. Whoever asks
//! ([`Twins::state`], [`Twins::forecast`], [`Twins::certificate`]) waits for one twin at most; who asks for the
//! [`Twins::gap`] of all waits for each of them in turn.
//!
//! Evidence is what robots say of their duties, and what a tracker says of where they are; where robots believe to be
//! is made of that tracker's word as well, and is not looked at. A robot has a twin from its first fix on. Nothing
//! here changes a robot.
//!
//! Reading order: `inbox`, what was heard and waits; [`folder`], certificates and why one is refused; `recording`, evidence that
//! somebody keeps; `twin`, that of one robot; [`notice`], what people are told; `gap`, how far bodies and
//! robots are apart; `twins`, all of them.

pub mod folder;
mod gap;
mod inbox;
pub mod notice;
mod recording;
mod twin;
mod twins;

#[cfg(test)]
mod tests;

pub use crawler_twin::around::{Room, Solid};
pub use crawler_twin::body::{Parameters, Pose, wrap};
pub use crawler_twin::certificate::{Certificate, Validation, Value};
pub use crawler_twin::detect::{Fault, FaultName};
pub use crawler_twin::drift::Drift;
pub use crawler_twin::gap as measures;
pub use crawler_twin::shadow::{Estimate, Forecast, Residual, View};
pub use gap::{FleetGap, RobotGap};
pub use recording::Recording;
pub use twins::{Ahead, Fleet, Found, Full, MOST, NoTwin, State, Twins, Worker};
