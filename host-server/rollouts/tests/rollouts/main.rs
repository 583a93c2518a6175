//! Several servers with one set of records.

mod servers;
mod support;
