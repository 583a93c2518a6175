//! Twins against a reference reality: bodies whose parameters they cannot read, and effects that their
//! model does not have.

mod certificates;
mod corpus;
mod courses;
mod gaps;
mod hostile;
mod reference;
mod shadows;
