//! The corpus of the fuzz targets is replayed.

// The same bodies as under the fuzzer; there they are public.
#[allow(unreachable_pub)]
#[path = "../../../../fuzz/src/twins.rs"]
mod twins;

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use crawler_twin::certificate::{About, certify};

use crate::reference::{Hidden, Random, Rates, Story, anyhow, baseline, drive};

#[test]
fn the_corpus_is_replayed() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for (name, body) in twins::TARGETS {
        let mut replayed = 0;
        for entry in fs::read_dir(corpus.join(name)).expect("a corpus") {
            body(&fs::read(entry.expect("an entry").path()).expect("readable"));
            replayed += 1;
        }
        assert!(replayed > 4, "{name} has a corpus of {replayed}");
    }
}

/// A table of a drive, a row for each thing that was said.
fn text(story: &Story) -> String {
    let mut text = String::from("t,duty_left,duty_right,voltage,x,y,theta\n");
    for row in &story.duties {
        let [left, right] = row.duty;
        let _ = writeln!(text, "{:.3},{left:.3},{right:.3},,,,", row.at_s);
    }
    for row in &story.supply {
        let _ = writeln!(text, "{:.3},,,{:.3},,,", row.at_s, row.volts);
    }
    for row in &story.fixes {
        let _ = writeln!(
            text,
            "{:.3},,,,{:.3},{:.3},{:.3}",
            row.at_s, row.x, row.y, row.theta
        );
    }
    text
}

#[test]
#[ignore = "writes the seeds of the corpus"]
fn seeds_are_written() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    let keep = |target: &str, name: String, text: &str| {
        fs::create_dir_all(corpus.join(target)).expect("a folder");
        fs::write(corpus.join(target).join(name), text).expect("written");
    };
    for seed in 0..4 {
        let hidden = Hidden::draw(seed, 0.0);
        let mut script = baseline();
        script.extend(anyhow(42.0, &mut Random::new(seed)));
        let rates = Rates {
            telemetry: 10,
            fixes: 5,
        };
        let story = drive(&hidden, &script, rates);
        if seed == 0 {
            keep("twin_table", "drive".to_owned(), &text(&story));
        }
        let made = certify(&story.evidence(), About::default(), None).expect("a certificate");
        let whole = made.write();
        keep("twin_certificate", format!("whole-{seed}"), &whole);
        let half: String = whole.chars().take(whole.len() / 2).collect();
        keep("twin_certificate", format!("cut-{seed}"), &half);
    }
    let head = "t,duty_left,duty_right,voltage,x,y,theta\n";
    for (name, rows) in [
        ("head", ""),
        ("empty-cells", "0,,,,,,\n1,,,,,,\n"),
        ("no-numbers", "0,NaN,inf,-inf,1e999,0,0\n"),
        ("backwards", "9,0,0,7.4,0,0,0\n1,0,0,7.4,0,0,0\n"),
        ("comments", "# nothing\n\n0,1,-1,7.4,0.5,0.5,3\n"),
    ] {
        keep("twin_table", name.to_owned(), &format!("{head}{rows}"));
    }
    let volts = "t,volts_left,volts_right,voltage,x,y,theta,sigma\n0,3,-3,7.4,0,0,0,0.02\n";
    keep("twin_table", "volts".to_owned(), volts);
}
