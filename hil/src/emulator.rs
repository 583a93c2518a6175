//! The emulated board as a device on the bench.
