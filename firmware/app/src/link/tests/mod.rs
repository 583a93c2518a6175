//! The link against a scripted broker, in virtual time.

mod harness;
mod loss;
mod peer;
mod traffic;
mod wire;
