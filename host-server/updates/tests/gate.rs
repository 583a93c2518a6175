//! Reports on releases: what is signed is what is read, and nothing else is.

// The same bodies as under the fuzzer; there they are public.
#[allow(unreachable_pub)]
#[path = "../../../fuzz/src/gate.rs"]
mod targets;

use std::fs;
use std::path::Path;

use crawler_release::image_hash;
use crawler_updates::gate::{
    Bound, DOMAIN, Digest, Estimate, Evaluated, Evaluator, Finding, GATE_FORMAT, GATE_MAX,
    GateFault, GateReport, MAX_ITEMS, PANIC, Parted, Replayed, ReportFault, Threshold, check, open,
    rounded, sign, signer, unverified,
};
use crawler_updates::release::SecretKey;
use proptest::collection::vec;
use proptest::prelude::*;

const RELEASE: &str = "9f2c1ab034d5e6f7";

fn key() -> SecretKey {
    SecretKey::from_pem(include_str!("openssl.pem")).expect("a key")
}

fn threshold(bound: Bound, mean: f64) -> Threshold {
    Threshold {
        metric: "success".to_owned(),
        bound,
        measured: Some(Estimate {
            mean,
            low: 0.0,
            high: 1.0,
            runs: 20,
        }),
    }
}

fn parted(finding: Finding) -> Parted {
    Parted {
        robot: "rover-1".to_owned(),
        output: "duty".to_owned(),
        at_us: 12_345_678,
        finding,
        why: (finding != Finding::Unexpected).then(|| "brakes earlier".to_owned()),
    }
}

fn report() -> GateReport {
    GateReport {
        format: GATE_FORMAT,
        release: RELEASE.to_owned(),
        build: "abc123".to_owned(),
        made: 1_798_761_600,
        evaluator: Evaluator {
            version: "0.1.0".to_owned(),
            protocol: 1,
            program: Digest([7; 32]),
        },
        plan: Digest([0xA5; 32]),
        evaluations: vec![Evaluated {
            scenario: "simple-navigation".to_owned(),
            sha256: Digest([1; 32]),
            robots: 3,
            seed: 1,
            seeds: 20,
            successes: 19,
            thresholds: vec![threshold(Bound::AtLeast(0.9), 0.95)],
        }],
        replays: vec![Replayed {
            recording: "corridor.mcap".to_owned(),
            sha256: Digest([2; 32]),
            robots: 3,
            same: 2,
            differences: vec![parted(Finding::Expected)],
            more: 0,
        }],
        passed: true,
    }
}

/// A file of a body that was signed, whatever it is.
fn signed(body: &[u8]) -> Vec<u8> {
    let key = key();
    let signature = key.sign(&image_hash(&[DOMAIN, body].concat()));
    let parts: [&[u8]; 4] = [b"TCG\x01", &key.public().id().0, &signature, body];
    parts.concat()
}

fn body(report: &GateReport) -> Vec<u8> {
    serde_json::to_vec(report).expect("JSON")
}

#[test]
fn what_is_signed_is_read() {
    let (report, key) = (report(), key());
    let file = sign(&report, &key).expect("signed");
    assert_eq!(file, sign(&report, &key).expect("the same again"));
    assert_eq!(open(&file, &[key.public()]), Ok(report.clone()));
    assert_eq!(check(&file, &[key.public()], RELEASE), Ok(report));
    assert_eq!(signer(&file), Ok(key.public().id()));
    assert_eq!(
        unverified(&file).map(|report| report.release),
        Ok(RELEASE.to_owned())
    );
    assert_eq!(unverified(b"text"), Err(GateFault::NoReport));
    assert!(file.len() < 1_200, "{} bytes", file.len());
}

#[test]
fn a_report_that_is_not_believed_has_a_reason() {
    let (key, other) = (key(), SecretKey::generate().expect("random numbers"));
    let keys = [key.public()];
    let file = sign(&report(), &key).expect("signed");
    let forged = sign(&report(), &other).expect("signed");
    let longer = [&file[..], &vec![b' '; GATE_MAX]].concat();
    let faults = [
        (open(&forged, &keys), "gate_unknown_key"),
        (open(&file, &[other.public()]), "gate_unknown_key"),
        (open(&file, &[]), "gate_no_key"),
        (open(&file[..76], &keys), "gate_bad_signature"),
        (open(&file[..75], &keys), "no_report"),
        (open(b"", &keys), "no_report"),
        (open(&file[1..], &keys), "no_report"),
        (open(&longer, &keys), "gate_too_large"),
        (
            check(&file, &keys, "0000000000000000"),
            "gate_other_release",
        ),
        (open(&signed(b"{}"), &keys), "gate_malformed"),
    ];
    for (result, code) in faults {
        let fault = result.expect_err(code);
        assert_eq!(fault.code(), code, "{fault}");
        assert!(!fault.to_string().is_empty());
    }
    // The key of another in the head of the file does not help.
    let mut relabelled = forged;
    relabelled[4..12].copy_from_slice(&key.public().id().0);
    assert_eq!(open(&relabelled, &keys), Err(GateFault::BadSignature));
    assert_eq!(GateFault::Failed.code(), "gate_failed");
}

#[test]
fn every_bit_counts() {
    let key = key();
    let file = sign(&report(), &key).expect("signed");
    for bit in 0..file.len() * 8 {
        let mut changed = file.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        assert!(open(&changed, &[key.public()]).is_err(), "bit {bit}");
    }
}

/// A signature over a manifest is none over a report, also of the same bytes.
#[test]
fn a_signature_of_something_else_is_none() {
    let key = key();
    let body = body(&report());
    let signature = key.sign(&image_hash(&body));
    let parts: [&[u8]; 4] = [b"TCG\x01", &key.public().id().0, &signature, &body];
    let refused = open(&parts.concat(), &[key.public()]);
    assert_eq!(refused, Err(GateFault::BadSignature));
    // What is signed of a report begins with a text in CBOR, and a manifest is a map.
    assert_eq!(DOMAIN[0] >> 5, 3);
}

#[test]
fn the_outcome_is_that_of_its_parts() {
    assert!(report().outcome());
    let mut missed = report();
    missed.evaluations[0].thresholds[0] = threshold(Bound::AtMost(0.9), 0.95);
    let mut nothing = report();
    nothing.evaluations[0].thresholds[0].measured = None;
    let mut unexpected = report();
    unexpected.replays[0].differences = vec![parted(Finding::Unexpected)];
    let mut missing = report();
    missing.replays[0].differences = vec![parted(Finding::Missing)];
    missing.replays[0].same = 3;
    let mut more = report();
    (more.replays[0].same, more.replays[0].more) = (1, 1);
    for mut failed in [missed, nothing, unexpected, missing, more] {
        assert!(!failed.outcome());
        // Nobody can say otherwise, also with the key.
        let contradiction = GateFault::Contradiction(ReportFault("passed"));
        assert_eq!(sign(&failed, &key()), Err(contradiction.clone()));
        let forged = signed(&body(&failed));
        assert_eq!(open(&forged, &[key().public()]), Err(contradiction));
        failed.passed = false;
        let file = sign(&failed, &key()).expect("signed");
        assert_eq!(open(&file, &[key().public()]), Ok(failed));
    }
}

/// What a case does to a report.
type Change = fn(&mut GateReport);

#[test]
fn what_no_report_can_say_is_refused() {
    let cases: [(&str, Change); 24] = [
        ("format", |report| report.format = 2),
        ("release", |report| report.release.push('0')),
        ("release", |report| report.release.make_ascii_uppercase()),
        ("build", |report| report.build.clear()),
        ("made", |report| report.made = u64::MAX),
        ("version", |report| report.evaluator.version = "1\n".into()),
        ("evaluations", |report| report.evaluations.clear()),
        ("evaluations", |report| {
            let one = report.evaluations[0].clone();
            report.evaluations = vec![one; MAX_ITEMS + 1];
        }),
        ("scenario", |report| {
            report.evaluations[0].scenario = "x".repeat(65);
        }),
        ("robots", |report| report.evaluations[0].robots = 0),
        ("seeds", |report| report.evaluations[0].seeds = 0),
        ("seed", |report| report.evaluations[0].seed = u64::MAX),
        ("successes", |report| report.evaluations[0].successes = 21),
        ("thresholds", |report| {
            report.evaluations[0].thresholds.clear();
        }),
        ("metric", |report| {
            report.evaluations[0].thresholds[0].metric.clear();
        }),
        ("bound", |report| {
            report.evaluations[0].thresholds[0].bound = Bound::AtLeast(f64::NAN);
        }),
        ("bound", |report| {
            report.evaluations[0].thresholds[0].bound = Bound::AtMost(0.123_456_7);
        }),
        ("measured", |report| {
            report.evaluations[0].thresholds[0] = threshold(Bound::AtLeast(0.9), 1.5);
        }),
        ("recording", |report| report.replays[0].recording.clear()),
        ("same", |report| report.replays[0].same = 3),
        ("differences", |report| {
            report.replays[0].differences = vec![parted(Finding::Missing); MAX_ITEMS + 1];
        }),
        ("why", |report| report.replays[0].differences[0].why = None),
        ("why", |report| {
            report.replays[0].differences[0].finding = Finding::Unexpected;
        }),
        ("finding", |report| {
            report.replays[0].differences[0].output = PANIC.to_owned();
        }),
    ];
    for (field, change) in cases {
        let mut report = report();
        change(&mut report);
        assert_eq!(report.validate(), Err(ReportFault(field)), "{field}");
        let refused = sign(&report, &key());
        assert_eq!(refused, Err(GateFault::Contradiction(ReportFault(field))));
        let fault = open(&signed(&body(&report)), &[key().public()]).expect_err(field);
        assert_eq!(fault.code(), "gate_malformed", "{fault}");
    }
}

#[test]
fn a_report_has_one_spelling() {
    let text = String::from_utf8(body(&report())).expect("text");
    let cases = [
        text.replace(",\"made\"", ", \"made\""),
        format!("{text}\n"),
        text.replace("\"made\":1798761600", "\"made\":1798761600.0"),
        text.replace("0.9}", "0.90}"),
        text.replace("\"more\":0", "\"more\":0,\"more\":0"),
        text.replace("\"more\":0", "\"more\":0,\"mood\":1"),
        text.replace("a5a5", "A5a5"),
        text.replace("duty", "d\\u0075ty"),
        text.replace("\"passed\":true", "\"passed\":null"),
        text.replace("expected", "hoped_for"),
    ];
    for case in cases {
        assert_ne!(case, text);
        let fault = open(&signed(case.as_bytes()), &[key().public()]).expect_err("refused");
        assert_eq!(fault.code(), "gate_malformed", "{case}");
    }
}

#[test]
fn a_report_that_is_too_long_is_not_signed() {
    let mut report = report();
    let one = Parted {
        why: Some("x".repeat(160)),
        ..parted(Finding::Expected)
    };
    report.replays[0].differences = vec![one; MAX_ITEMS];
    (report.replays[0].robots, report.replays[0].same) = (32, 0);
    let one = report.replays[0].clone();
    report.replays = vec![one; MAX_ITEMS];
    assert_eq!(report.validate(), Ok(()));
    assert_eq!(sign(&report, &key()), Err(GateFault::Oversize));
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![(-1e9..1e9), (-1.0..1.0), Just(0.0), Just(1e9), Just(1e-6)].prop_map(rounded)
}

fn any_threshold() -> impl Strategy<Value = Threshold> {
    let bound = (any::<bool>(), number()).prop_map(|(least, number)| {
        if least {
            Bound::AtLeast(number)
        } else {
            Bound::AtMost(number)
        }
    });
    let measured = (vec(number(), 3), 1..=5_u32).prop_map(|(mut numbers, runs)| {
        numbers.sort_by(f64::total_cmp);
        Estimate {
            low: numbers[0],
            mean: numbers[1],
            high: numbers[2],
            runs,
        }
    });
    ("[a-z_]{1,64}", bound, prop::option::of(measured)).prop_map(|(metric, bound, measured)| {
        Threshold {
            metric,
            bound,
            measured,
        }
    })
}

fn any_evaluated() -> impl Strategy<Value = Evaluated> {
    (
        "[ -~äµ]{1,20}",
        any::<[u8; 32]>(),
        (1..100_u32, 0..(1_u64 << 52), 5..1_000_u32, 0..=5_u32),
        vec(any_threshold(), 1..4),
    )
        .prop_map(
            |(scenario, sha256, (robots, seed, seeds, successes), thresholds)| Evaluated {
                scenario,
                sha256: Digest(sha256),
                robots,
                seed,
                seeds,
                successes,
                thresholds,
            },
        )
}

fn any_replayed() -> impl Strategy<Value = Replayed> {
    let finding = prop_oneof![
        Just(Finding::Expected),
        Just(Finding::Unexpected),
        Just(Finding::Missing)
    ];
    let one = ("[a-z0-9-]{1,32}", 0..(1_u64 << 53), finding, "[ -~]{1,160}");
    let one = one.prop_map(|(robot, at_us, finding, why)| Parted {
        robot,
        at_us,
        why: Some(why).filter(|_| finding != Finding::Unexpected),
        ..parted(finding)
    });
    (
        "[a-z.]{1,64}",
        any::<[u8; 32]>(),
        1..9_u32,
        vec(one, 0..5),
        0..3_u32,
    )
        .prop_map(|(recording, sha256, same, differences, more)| {
            let found = differences
                .iter()
                .filter(|one| one.finding != Finding::Missing);
            Replayed {
                recording,
                sha256: Digest(sha256),
                robots: same + found.count() as u32 + more,
                same,
                differences,
                more,
            }
        })
}

fn any_report() -> impl Strategy<Value = GateReport> {
    (
        any::<u64>(),
        "[ -~]{1,40}",
        0..(1_u64 << 53),
        any::<u8>(),
        vec(any_evaluated(), 1..4),
        vec(any_replayed(), 0..4),
    )
        .prop_map(|(release, build, made, protocol, evaluations, replays)| {
            let mut any = GateReport {
                release: format!("{release:016x}"),
                build,
                made,
                evaluations,
                replays,
                ..report()
            };
            any.evaluator.protocol = protocol;
            any.passed = any.outcome();
            any
        })
}

proptest! {
    #[test]
    fn whatever_can_be_said_is_read_as_it_was_said(any in any_report()) {
        prop_assert_eq!(any.validate(), Ok(()));
        let key = key();
        let file = sign(&any, &key).expect("signed");
        prop_assert_eq!(open(&file, &[key.public()]), Ok(any));
    }

    #[test]
    fn whatever_comes_in_does_no_harm(
        any in any_report(),
        at in any::<prop::sample::Index>(),
        byte in any::<u8>(),
    ) {
        let mut text = body(&any);
        let at = at.index(text.len());
        text[at] = byte;
        targets::TARGETS[0].1(&text);
        targets::TARGETS[0].1(&text[..at]);
    }
}

#[test]
fn the_corpus_is_replayed() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for (name, body) in targets::TARGETS {
        let mut replayed = 0;
        for entry in fs::read_dir(folder.join(name)).expect("a corpus") {
            body(&fs::read(entry.expect("an entry").path()).expect("readable"));
            replayed += 1;
        }
        assert!(replayed > 10, "{name} has a corpus of {replayed}");
    }
}

/// What the corpus begins with, so that it is kept up with the format.
#[test]
fn the_corpus_has_reports_that_are_read() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus/release_gate");
    for name in ["plain", "failed", "evaluation-alone", "everything"] {
        let body = fs::read(folder.join(name)).expect(name);
        let report = open(&signed(&body), &[key().public()]).expect(name);
        assert_eq!(report.passed, name != "failed", "{name}");
    }
}
