//! Learning, as others see it: the same bytes whatever the threads, interruptions that leave no trace, hostile
//! checkpoints, tasks that everybody knows, and worlds over a pipe.

mod client;
mod corpus;
mod environments;
mod exact;
mod hostile;
mod learned;
mod pipe;
mod runs;
mod tasks;
