//! Learning, as others see it: the same bytes whatever the threads, interruptions that leave no trace, hostile
//! checkpoints, and tasks that everybody knows.

mod corpus;
mod environments;
mod exact;
mod hostile;
mod learned;
mod runs;
mod tasks;
