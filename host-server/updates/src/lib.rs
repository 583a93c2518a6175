//! Updates over the air.
//!
//! [`rollout`] decides which robot is offered which release, and when: in phases, within limits, and no
//! further once a release fails. Nothing here does anything: time and events are handed in, and what is to
//! be stored and sent comes back.

pub mod rollout;
