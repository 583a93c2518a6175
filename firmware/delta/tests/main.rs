//! Patches that detools made, patches that mean no good, and no patches at all.

mod corpus;
mod golden;
mod hostile;
mod support;
