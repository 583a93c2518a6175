//! Commands, numbered and written.

use crawler_protocol::{Action, Command, MAX_MESSAGE, Source};

/// Who gives the commands of a simulation.
const SOURCE: &str = "simulator";
/// Who gives the commands of the scenario. Each robot gets them when it is ready; numbers shared
/// among robots would depend on when the others are.
const SCENARIO: &str = "scenario";
/// Number of the initial command; those of others follow it.
const FIRST_SEQ: u64 = 1;
/// Later commands of the scenario are numbered from here, for each robot apart, and far from the
/// commands of others.
const LATER_SEQ: u64 = 1 << 40;

/// Numbers the commands that come from outside. No number is given twice.
#[derive(Debug)]
pub(super) struct CommandNumbers {
    newest: u64,
}

impl CommandNumbers {
    pub(super) const fn new() -> Self {
        Self { newest: FIRST_SEQ }
    }

    /// The next number.
    pub(super) const fn next(&mut self) -> u64 {
        self.newest += 1;
        self.newest
    }

    /// A command from outside with its number, at this Unix time.
    pub(super) fn write(&mut self, action: Action, timestamp: u64) -> (u64, Vec<u8>) {
        let seq = self.next();
        (seq, write(SOURCE, seq, action, timestamp))
    }
}

/// A command of the scenario with its number, at this Unix time: one for a robot that had so many of them `before`.
pub(super) fn of_scenario(before: u64, action: Action, timestamp: u64) -> (u64, Vec<u8>) {
    let seq = match before {
        0 => FIRST_SEQ,
        later => LATER_SEQ + later,
    };
    (seq, write(SCENARIO, seq, action, timestamp))
}

fn write(source: &str, seq: u64, action: Action, timestamp: u64) -> Vec<u8> {
    let command = Command {
        action,
        timestamp,
        seq,
        source: Source::new(source).unwrap_or_else(|_| unreachable!("{source} is valid")),
    };
    let mut buffer = [0; MAX_MESSAGE];
    // Only a command with numbers that are not finite cannot be written. Robots refuse an
    // empty message, as they would refuse such a command.
    let len = command.to_json(&mut buffer).unwrap_or(0);
    buffer[..len].to_vec()
}
