//! A model of each robot that is held against what it does.
//!
//! Evidence goes in, results come out; nothing here reads a clock, a file or a socket. A twin sees what a
//! robot publishes and what its tracker says, and nothing else.
//!
//! Reading order: [`body`], the model; [`evidence`], what is known of a drive, and what of it is refused; [`drive`],
//! duties between samples, and where a body goes by them; [`identify`], parameters from a drive, by the small
//! systems of `linear`; [`predict`], predictions against what happened; [`certificate`], a body with the proof
//! of what it is worth, and [`belief`], one with what is left open of it; [`shadow`], a body that follows a robot, [`around`],
//! what that may touch, [`detect`], what is wrong with it, [`gap`], how far body and robot are apart, and [`drift`], whether a
//! certificate still holds. Beside them: [`script`], the drive to calibrate on as a scenario, and [`course`], the same for a
//! robot where it stands, with [`rehearsal`], which floor it takes; [`table`], drives of other robots.

pub mod around;
pub mod belief;
pub mod body;
pub mod certificate;
pub mod course;
pub mod detect;
pub mod drift;
pub mod drive;
pub mod evidence;
pub mod gap;
pub mod identify;
pub mod predict;
pub mod rehearsal;
pub mod script;
pub mod shadow;
pub mod table;

mod linear;
