//! Several servers with one set of records.

mod faults;
mod servers;
mod support;
