//! Everything between server and robots goes wrong, and no command is lost or runs twice.

use crate::common::chaos::Chaos;
use crawler_app::parameters::{Definition, Domain};
use crawler_delivery::Class;

#[test]
fn no_command_is_lost_and_none_runs_twice_whatever_breaks() {
    let report = Chaos::new(24, 11, false).run(8 * 60_000);
    println!("{report}");
    for (what, count) in report.must_be_zero() {
        assert_eq!(count, 0, "{what}\n{report}");
    }
    assert!(report.again > 0, "nothing was ever sent again");
    assert!(report.faults.len() == 6, "not every fault struck");
    let set = report.commands["set"];
    assert_eq!(set[0], set[1], "a setting did not arrive");
    assert!(set[0] > 100);
}

/// The measure of the one above: a server that sends once and trusts its broker fails it.
#[test]
fn a_server_that_sends_once_loses_commands() {
    let report = Chaos::new(12, 11, true).run(5 * 60_000);
    assert!(report.lost > 0, "{report}");
}

/// Else a robot would take up what somebody has stopped while it was away.
#[test]
fn a_stop_waits_for_as_long_as_a_robot_may_take_something_up_again() {
    let resume = Definition::by_name("resume_within_ms").map(|definition| definition.domain);
    let Some(Domain::Number { max, .. }) = resume else {
        panic!("{resume:?}");
    };
    assert!(Class::Halt.life_ms() as f32 >= max, "{max} ms");
}
