//! Updates over the air.
//!
//! [`release`] makes, signs and verifies releases as files, without a server.
//!
//! [`delta`] makes patches from the image of one release to that of another.
//!
//! [`gate`] is what a release was tried on before it goes to robots: a signed report beside it.
//!
//! [`rollout`] decides which robot is offered which release, and when: in phases, within limits, and no
//! further once a release fails. Nothing there does anything: time and events are handed in, and what is to
//! be stored and sent comes back.

pub mod delta;
pub mod gate;
pub mod release;
pub mod rollout;
