//! `docs/faults.md` says what the program does.

use std::collections::{BTreeMap, BTreeSet};
use std::format;
use std::path::Path;
use std::string::String;
use std::vec::Vec;

use crawler_drivers::lamp::Pattern;
use crawler_hal::Instant;
use crawler_protocol::Level;

use crate::state::Fault;
use crate::testing::robot;
use crate::trouble::{KEPT_EVENTS, LinkTrouble};

const PAGE: &str = include_str!("../../../docs/faults.md");

/// Rows of the table whose first heading is `heading`, cell by cell.
fn rows(heading: &str) -> Vec<Vec<&'static str>> {
    let start = format!("| {heading} |");
    let mut lines = PAGE.lines().skip_while(|line| !line.starts_with(&start));
    lines.next().expect(heading);
    lines
        .skip(1)
        .take_while(|line| line.starts_with('|'))
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
        .collect()
}

/// What stands in backticks.
fn named(cell: &'static str) -> Vec<&'static str> {
    cell.split('`').skip(1).step_by(2).collect()
}

#[test]
fn every_kept_event_is_on_the_page_and_every_event_of_the_page_is_kept() {
    let told: BTreeSet<&str> = rows("fault").iter().flat_map(|row| named(row[4])).collect();
    assert_eq!(told, KEPT_EVENTS.into_iter().collect());
}

#[test]
fn patterns_of_the_page_are_those_the_lamp_shows() {
    let known: BTreeSet<String> = Pattern::ALL.iter().map(|p| format!("{p:?}")).collect();
    let mut of_event: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for row in rows("fault") {
        for pattern in named(row[3]) {
            assert!(known.contains(pattern), "there is no pattern {pattern}");
            // The first event is the one of its own.
            of_event
                .entry(named(row[4])[0])
                .or_default()
                .insert(pattern);
        }
    }
    for trouble in LinkTrouble::ALL {
        let pattern = format!("{:?}", trouble.pattern());
        let told = &of_event[trouble.event()];
        assert!(told.contains(pattern.as_str()), "{trouble:?}: {told:?}");
        assert_eq!(told.len(), 1, "{trouble:?}");
    }
    for fault in [Fault::Motor, Fault::Battery, Fault::Ranger] {
        let pattern = format!("{:?}", fault.pattern());
        let told = &of_event[fault.name()];
        assert!(told.contains(pattern.as_str()), "{fault:?}: {told:?}");
    }
}

#[test]
fn flashes_of_the_page_are_those_of_the_patterns() {
    let legend = rows("pattern");
    let told: BTreeMap<&str, &str> = legend
        .iter()
        .map(|row| (named(row[0])[0], named(row[1])[0]))
        .collect();
    for pattern in Pattern::ALL {
        let lit = pattern.table_ms().iter().step_by(2);
        let flashes: String = lit.map(|&ms| if ms >= 400 { '-' } else { '.' }).collect();
        if let Some(told) = told.get(format!("{pattern:?}").as_str()) {
            assert_eq!(*told, flashes, "{pattern:?}");
        }
    }
    // Whatever the other table names is explained in this one.
    for row in rows("fault") {
        for pattern in named(row[3]) {
            assert!(told.contains_key(pattern), "{pattern}");
        }
    }
}

#[test]
fn the_tests_that_the_page_names_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    for row in rows("fault") {
        let (file, test) = (
            named(row[5])[0],
            row[5].split(' ').next_back().expect("a name"),
        );
        let text = std::fs::read_to_string(root.join(file)).expect(file);
        let head = format!("#[test]\nfn {test}()");
        assert!(text.contains(&head), "{file} has no test {test}");
    }
}

#[test]
fn a_board_can_listen_to_what_is_logged() {
    // A plain function has no memory of its own: it speaks by panicking.
    fn echo(level: Level, event: &str, text: core::fmt::Arguments<'_>) {
        panic!("{} {event} {text}", level.name());
    }
    let mut robot = robot("sim-0001");
    robot.set_echo(echo);
    let logging = std::panic::AssertUnwindSafe(|| {
        robot.log(Level::Error, "ranger", format_args!("dead"), Instant::BOOT);
    });
    let said = std::panic::catch_unwind(logging).expect_err("the echo was called");
    let said = said.downcast_ref::<String>().expect("a text");
    assert_eq!(said, "error ranger dead");
}
