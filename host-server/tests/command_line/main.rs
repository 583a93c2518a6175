//! The program `terracrawler` as a person calls it.

#[path = "../server/support/scratch.rs"]
#[allow(unreachable_pub, reason = "public to the tests of the server")]
mod scratch;

mod console;
mod console_revokes;
mod doctor;
mod evaluate;
mod program;
mod replay;
