//! Whatever comes, nothing panics, and a table is read as it was written.

use std::fmt::Write as _;

use crawler_twin::certificate::{About, Certificate, certify};
use crawler_twin::evidence::{Duty, Evidence, Fix, Refusal, Supply};
use crawler_twin::table::{self, TableError};
use proptest::prelude::*;

use crate::reference::{Hidden, Rates, baseline, drive};

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -2.0..2.0,
        2 => any::<f64>(),
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
    ]
}

fn stamp() -> impl Strategy<Value = f64> {
    prop_oneof![8 => 0.0..60.0, 1 => any::<f64>(), 1 => Just(f64::NAN)]
}

proptest! {
    #![proptest_config(crawler_properties::cases(48))]

    #[test]
    fn any_rows_come_to_an_end(
        duties in prop::collection::vec((stamp(), prop::option::of(stamp()), number(), number()), 0..300),
        fixes in prop::collection::vec((stamp(), prop::option::of(stamp()), number(), number(), number()), 0..300),
        volts in prop::collection::vec((stamp(), 0.0..12.0), 0..20),
    ) {
        let mut evidence = Evidence::default();
        let (mut taken, mut refused) = (0, 0);
        let mut count = |result: Result<(), Refusal>| match result {
            Ok(()) => taken += 1,
            Err(_) => refused += 1,
        };
        for (at_s, arrived_s, left, right) in duties {
            count(evidence.duty(Duty { at_s, arrived_s, duty: [left, right] }));
        }
        for (at_s, arrived_s, x, y, theta) in fixes {
            count(evidence.fix(Fix { at_s, arrived_s, x, y, theta, sigma_m: 0.01 }));
        }
        for (at_s, volts) in volts {
            count(evidence.supply(Supply { at_s, arrived_s: None, volts }));
        }
        let rows = evidence.duties().len() + evidence.fixes().len() + evidence.volts().len();
        prop_assert_eq!(rows, taken);
        let counts = evidence.counts();
        let counted = counts.absurd + counts.doubled + counts.late + counts.clock_jumps + counts.beyond;
        prop_assert_eq!(counted, refused);
        // Noise is nobody's drive.
        prop_assert!(certify(&evidence, About::default(), None).is_err());
    }

    #[test]
    fn any_text_is_a_table_or_is_not(text in ".{0,400}", cells in "(t|x|y|theta|voltage|duty_left|duty_right|,|\n|[0-9.eNa-]){0,200}") {
        let _ = table::read(&text);
        let _ = table::read(&cells);
        let _ = Certificate::read(text.as_bytes());
    }
}

#[test]
fn a_table_says_what_was_written_into_it() {
    let hidden = Hidden::draw(3_001, 0.0);
    let story = drive(
        &hidden,
        &baseline(),
        Rates {
            telemetry: 20,
            fixes: 10,
        },
    );
    let mut text =
        String::from("# a drive\nt, duty_left, duty_right, voltage, x, y, theta, of no interest\n");
    for row in &story.duties {
        let _ = writeln!(text, "{}, {}, {},,,,", row.at_s, row.duty[0], row.duty[1]);
    }
    for row in &story.supply {
        let _ = writeln!(text, "{},,, {},,,", row.at_s, row.volts);
    }
    for row in &story.fixes {
        let _ = writeln!(text, "{},,,, {}, {}, {}", row.at_s, row.x, row.y, row.theta);
    }
    let read = table::read(&text).expect("a table");
    assert_eq!(read.duties().len(), story.duties.len());
    assert_eq!(read.volts().len(), story.supply.len());
    assert_eq!(read.fixes().len(), story.fixes.len());
    for (row, there) in read.duties().iter().zip(&story.duties) {
        assert_eq!((row.at_s, row.duty), (there.at_s, there.duty));
    }
    let wrong = |text: &str| table::read(text).expect_err("no table");
    assert_eq!(wrong("t,x,y,theta\n"), TableError::Missing("voltage"));
    assert_eq!(
        wrong("t,x,y,theta,voltage\n"),
        TableError::Missing("duty_left")
    );
    let head = "t,x,y,theta,voltage,duty_left,duty_right";
    assert_eq!(
        wrong(&format!("{head},t\n")),
        TableError::Twice("t".to_owned())
    );
    let line = format!("{head}\n1,2,x,,,,\n");
    assert_eq!(wrong(&line), TableError::NoNumber(2, "y".to_owned()));
    assert_eq!(
        wrong(&format!("{head}\n1,,,,,,,\n")),
        TableError::TooLong(2)
    );
}

#[test]
fn a_certificate_of_another_format_or_of_no_robot_is_refused() {
    let story = {
        let mut script = baseline();
        script.extend(baseline());
        drive(
            &Hidden::draw(3_002, 0.0),
            &script,
            Rates {
                telemetry: 20,
                fixes: 10,
            },
        )
    };
    let made = certify(&story.evidence(), About::default(), None).expect("a certificate");
    let text = made.write();
    let told = |text: String| {
        Certificate::read(text.as_bytes())
            .expect_err("refused")
            .to_string()
    };
    let other = text.replacen("\"format\": 1", "\"format\": 2", 1);
    assert!(told(other).contains("format 2"));
    let absurd = text.replacen("\"track_m\": 0.1", "\"track_m\": 9.1", 1);
    assert!(told(absurd).contains("no robot"));
    let more = text.replacen('{', "{\"more\": 1,", 1);
    assert!(told(more).contains("unknown field"));
}
