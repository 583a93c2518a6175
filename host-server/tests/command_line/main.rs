//! The program `terracrawler` as a person calls it.

#[path = "../server/support/port.rs"]
#[allow(
    dead_code,
    unreachable_pub,
    reason = "public to the tests of the server, which use more of it"
)]
mod port;
#[path = "../server/support/scratch.rs"]
#[allow(unreachable_pub, reason = "public to the tests of the server")]
mod scratch;

/// How long a test waits for something that is to happen, however slow the machine is.
const LIMIT: std::time::Duration = std::time::Duration::from_mins(1);

mod backups;
mod console;
mod console_revokes;
mod crowds;
mod doctor;
mod evaluate;
mod folder;
mod guesses;
mod gym;
mod hostile_names;
mod newcomer;
mod program;
mod release;
mod replay;
mod train;
mod twin;
mod twin_gap;
mod twin_live;
