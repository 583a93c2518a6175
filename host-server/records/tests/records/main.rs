//! The records in `SQLite`, what moves between engines, and what takes an engine of its own.

mod support;

mod accounts;
mod audit;
mod events;
mod experiments;
mod faults;
mod fences;
mod frames;
mod history;
mod killed;
mod moves;
mod parts;
mod postgres;
mod releases;
mod rollouts;
