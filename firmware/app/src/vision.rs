//! What the camera shows: from frames to things, and where they are.
//!
//! ```text
//! frame → rows of 96 × 96 pixels → detector → cells → things → bearings
//!         Picture                  Finder     spots    View     Lens
//! ```
//!
//! The camera activity looks ([`camera`](crate::camera())), at most once per `vision_period_ms`,
//! and only while somebody wants to know: a scan is under way, the robot wanders, or
//! `vision_always` is on. What it saw goes to control, and to `vision/{id}` when it is news:
//! something came, went or moved, or it is there still after two seconds.
//!
//! Where the detector runs is the business of [`Eyes`].

mod cells;
mod class;
#[cfg(test)]
mod driving_tests;
mod eyes;
pub(crate) mod lens;
mod picture;
#[cfg(test)]
mod tests;
mod view;

pub use cells::{LEAST_MARGIN, MAX_CELLS, MAX_SPOTS, Spot, Spots, spots};
pub use class::{Class, Classes};
pub use crawler_micromodel::{ModelError, arena_bytes};
pub use eyes::{Detector, DetectorError, Eyes, Finder, Look, NoEyes, NoLook, OwnEyes, OwnLook};
pub use lens::Lens;
pub use picture::{LARGEST, Picture, PictureError, frame_bytes};
pub(crate) use view::Sights;
pub use view::{InTheWay, Seen, View};
