//! The rollout engine: its rules one by one, by chance, and with a fleet in software.

mod chance;
mod commands;
mod fleet;
mod phases;
mod robots;
mod scene;
mod server;
