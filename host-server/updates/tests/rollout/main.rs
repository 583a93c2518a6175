//! The rollout engine: its rules one by one, by chance, and with a fleet in software.

mod chance;
mod fleet;
mod rules;
mod scene;
