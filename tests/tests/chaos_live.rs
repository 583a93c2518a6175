//! Nothing that was acknowledged is lost and nothing runs twice when a server is killed and its robots
//! are cut off, with real processes over real sockets. `cargo xtask bench chaos` is the long version.

use std::time::Duration;

use crawler_tests::chaos::{Broker, Fault, Options, run};

#[test]
fn a_killed_server_and_a_partition_lose_nothing_and_repeat_nothing() {
    let report = run(Options {
        robots: 20,
        broker: Broker::Embedded,
        faults: vec![
            (Duration::from_secs(4), Fault::KilledInPartition),
            (Duration::from_secs(18), Fault::Partition),
        ],
        lasting: Duration::from_secs(4),
        end: Duration::from_secs(28),
        patience: Duration::from_mins(1),
        forget: false,
        forge: false,
    });
    println!("{report}");
    for (what, count) in report.must_be_zero() {
        assert_eq!(count, 0, "{what}\n{report}");
    }
    for (fault, took) in &report.faults {
        assert!(
            took.is_some(),
            "not all came back after {fault:?}\n{report}"
        );
    }
    // It has to have been about something.
    for (kind, counts) in &report.commands {
        assert!(counts.ran > 0, "no {} ran\n{report}", kind.name());
    }
    assert!(report.deliveries[1] > 0, "nothing came twice\n{report}");
}
