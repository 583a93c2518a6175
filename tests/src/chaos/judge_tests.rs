//! Each count turns red for what it is there for, and for nothing else.

use super::*;
use crate::chaos::{Delivery, Report};

fn given(kind: Kind, mark: u64, id: &str) -> Given {
    Given {
        robot: "r".to_owned(),
        kind,
        mark: kind.mark(mark),
        id: (!id.is_empty()).then(|| id.to_owned()),
        refused: false,
    }
}

fn delivery(at_ms: u64, seq: u64, kind: Kind, mark: u64) -> Delivery {
    Delivery {
        at_us: at_ms * 1_000,
        seq,
        command: kind.name().to_owned(),
        parameters: kind.parameters(mark),
    }
}

fn answer(status: &str, reason: Option<&str>) -> Answer {
    Answer {
        status: status.to_owned(),
        reason: reason.map(str::to_owned),
    }
}

/// A robot that got a set, an identify and a move, and did all of them.
fn good() -> (Vec<Given>, Observed) {
    let kinds = [(Kind::Set, 7), (Kind::Identify, 0), (Kind::Move, 100)];
    let given = kinds.map(|(kind, mark)| given(kind, mark, "an id"));
    let mut observed = Observed {
        carried_out: (3, 1 + 2 + 3),
        boots: 1,
        parameters: json!({ "safe_distance_mm": { "value": 307.0 } }),
        // A move of 300 ms, and its ramp.
        duties: vec![Duty(3_000_000, true), Duty(3_360_000, false)],
        ..Observed::default()
    };
    for (seq, (kind, mark)) in (1..).zip(kinds) {
        observed
            .deliveries
            .push(delivery(seq * 1_000, seq, kind, mark));
        let answers = ["accepted", "completed"].map(|status| answer(status, None));
        observed.answers.insert(seq, answers.into());
    }
    (given.into(), observed)
}

fn judged(given: &[Given], observed: Observed) -> Report {
    let observed = Observations {
        robots: [("r".to_owned(), observed)].into(),
        lost: 0,
        end_us: 60_000_000,
    };
    let mut report = Report::default();
    judge(given, &observed, &mut report);
    report
}

fn red(report: &Report) -> Vec<&'static str> {
    let counts = report.must_be_zero().into_iter();
    counts
        .filter(|(_, count)| *count > 0)
        .map(|(what, _)| what)
        .collect()
}

#[test]
fn what_went_well_is_not_held_against_anybody() {
    let (given, mut observed) = good();
    let report = judged(&given, observed.clone());
    assert_eq!(red(&report), [""; 0], "{report}");
    assert_eq!(report.longest_beyond_ms, 60);
    assert_eq!(report.commands[&Kind::Set].ran, 1);
    // The same number again is what QoS 1 may do.
    observed.deliveries.push(observed.deliveries[0].clone());
    let report = judged(&given, observed);
    assert_eq!(red(&report), [""; 0]);
    assert_eq!(report.deliveries, [4, 1]);
}

#[test]
fn a_setting_that_never_came_is_lost_and_motion_expires() {
    let (mut all, observed) = good();
    all.push(given(Kind::Move, 200, "an id"));
    all.push(given(Kind::Drive, 3, "an id"));
    let report = judged(&all, observed.clone());
    assert_eq!(red(&report), [""; 0]);
    assert_eq!(report.commands[&Kind::Move].expired, 1);
    all.push(given(Kind::Set, 8, "an id"));
    all.push(given(Kind::Identify, 0, "an id"));
    // Nobody said that this one was taken.
    all.push(given(Kind::Set, 9, ""));
    let report = judged(&all, observed);
    assert_eq!(red(&report), ["acknowledged commands lost"]);
    assert_eq!(report.lost, 2);
    assert_eq!(report.commands[&Kind::Set].unknown, 1);
}

#[test]
fn a_command_under_two_numbers_ran_twice() {
    for (kind, mark) in [(Kind::Set, 7), (Kind::Identify, 0), (Kind::Move, 100)] {
        let (given, mut observed) = good();
        observed.deliveries.push(delivery(2_900, 4, kind, mark));
        observed.answers.insert(4, vec![answer("completed", None)]);
        observed.carried_out = (4, 10);
        let report = judged(&given, observed);
        assert_eq!(report.twice, 1, "{kind:?}: {report}");
    }
    // Under one number, as only the robot's own count tells.
    let (given, mut observed) = good();
    observed.carried_out = (4, 7);
    assert_eq!(red(&judged(&given, observed)), ["commands run twice"]);
}

#[test]
fn what_is_rejected_at_the_door_was_not_taken_up() {
    let (mut all, mut observed) = good();
    for (seq, reason) in [(4, "blocked"), (5, "busy")] {
        observed
            .deliveries
            .push(delivery(9_000, seq, Kind::Drive, seq));
        observed
            .answers
            .insert(seq, vec![answer("rejected", Some(reason))]);
        all.push(given(Kind::Drive, seq, "an id"));
    }
    observed.carried_out = (4, 10);
    let report = judged(&all, observed);
    assert_eq!(red(&report), [""; 0], "{report}");
    let drives = report.commands[&Kind::Drive];
    assert_eq!((drives.ran, drives.refused), (1, 1));
}

#[test]
fn a_robot_that_says_what_it_did_not_do_is_found_out() {
    let what = "commands said to have run that did not";
    let (given, mut observed) = good();
    observed.carried_out = (2, 3);
    assert_eq!(red(&judged(&given, observed.clone())), [what]);
    observed.carried_out = (3, 7);
    assert_eq!(red(&judged(&given, observed.clone())), [what]);
    observed.carried_out = (3, 6);
    observed.parameters = json!({ "safe_distance_mm": { "value": 600.0 } });
    let what = "robots with another setting than the last";
    assert_eq!(red(&judged(&given, observed)), [what]);
}

#[test]
fn wheels_need_a_word() {
    let what = "times driven without a controller";
    let (given, good) = good();
    for (duties, beyond) in [
        // Longer than the move and its ramp.
        (vec![Duty(3_000_000, true), Duty(3_421_000, false)], 121),
        // Before any word.
        (vec![Duty(1_000_000, true), Duty(1_200_000, false)], 200),
        // To the end.
        (vec![Duty(3_000_000, true)], 56_700),
    ] {
        let observed = Observed {
            duties,
            ..good.clone()
        };
        let report = judged(&given, observed);
        assert_eq!(red(&report), [what]);
        assert_eq!(report.longest_beyond_ms, beyond);
    }
    // What comes again is no word.
    let mut observed = good.clone();
    observed
        .deliveries
        .push(delivery(3_200, 3, Kind::Move, 100));
    observed.duties[1] = Duty(3_500_000, false);
    assert_eq!(red(&judged(&given, observed)), [what]);
    // A word that was refused is none.
    let mut observed = good.clone();
    observed.answers.insert(3, vec![answer("expired", None)]);
    observed.carried_out = (2, 3);
    assert_eq!(red(&judged(&given, observed)), [what]);
    // A robot that is steered drives on from word to word.
    let mut observed = good;
    for seq in 4..9 {
        let mark = seq;
        observed
            .deliveries
            .push(delivery(3_200 + (seq - 4) * 400, seq, Kind::Drive, mark));
        observed.answers.insert(seq, vec![answer("accepted", None)]);
    }
    observed.carried_out = (8, 36);
    observed.duties[1] = Duty(4_800_000 + 500_000, false);
    let mut given = given;
    given.extend((4..9).map(|mark| super::tests::given(Kind::Drive, mark, "an id")));
    let report = judged(&given, observed.clone());
    assert_eq!(red(&report), [""; 0], "{report}");
    assert_eq!(report.longest_beyond_ms, 0);
    // And stands half a second after the last one, ramp and all.
    observed.duties[1] = Duty(4_800_000 + 501_000, false);
    assert_eq!(red(&judged(&given, observed)), [what]);
}

#[test]
fn a_robot_that_is_not_there_has_lost_everything() {
    let mut report = Report::default();
    judge(&good().0, &Observations::default(), &mut report);
    assert_eq!(report.lost, 2);
    assert_eq!(red(&report), ["acknowledged commands lost"]);
}
