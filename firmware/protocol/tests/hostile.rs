//! Nothing that arrives can make a parser panic, or accept what is not JSON.

// The same bodies as under the fuzzer; there they are public.
#[allow(unreachable_pub)]
#[path = "../../../fuzz/src/targets.rs"]
mod targets;

use std::fs;
use std::path::Path;

use crawler_protocol::{
    CellDigest, Command, DecodeError, FaultCommand, MAX_DEPTH, MAX_MESSAGE, PoseFix, Reason,
};
use proptest::prelude::*;
use targets::TARGETS;

const MOVE: &str = r#"{"command": "move", "parameters": {"direction": "forward", "speed": 80, "duration": 2000}, "timestamp": 1648372964000, "seq": 17, "source": "operator:ada"}"#;

fn corpus(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../fuzz/corpus")
        .join(target);
    let mut seeds: Vec<_> = fs::read_dir(&folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .map(|path| (path.display().to_string(), fs::read(&path).unwrap()))
        .collect();
    seeds.sort();
    seeds
}

#[test]
fn every_target_passes_its_corpus() {
    for (name, body) in TARGETS {
        let seeds = corpus(name);
        assert!(seeds.len() >= 2, "{name} has a corpus");
        for (path, data) in seeds {
            println!("{path}");
            body(&data);
        }
    }
}

/// Every target is also built as a fuzzer, and every fuzzer is a target.
#[test]
fn every_target_has_a_fuzzer() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/fuzz_targets");
    let mut fuzzers: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| {
            entry
                .unwrap()
                .path()
                .file_stem()
                .unwrap()
                .to_string_lossy()
                .into_owned()
        })
        .collect();
    // Those of other crates are held to their own lists: by `crawler-access`, `crawler-board`,
    // `crawler-bundle`, `crawler-delta`, `crawler-federated`, `crawler-micromodel`, `crawler-policy`,
    // `crawler-release`, `crawler-sim-protocol`, `crawler-tls` and `crawler-twin`.
    let others = [
        "bundle",
        "model",
        "token",
        "filter",
        "credential",
        "simulator_command",
    ];
    let families = [
        "boot_",
        "delta_",
        "federated_",
        "policy",
        "provision_",
        "release_",
        "tls_",
        "twin_",
    ];
    let elsewhere = |name: &str| {
        others.contains(&name) || families.iter().any(|family| name.starts_with(family))
    };
    fuzzers.retain(|name| !elsewhere(name));
    fuzzers.sort();
    let mut names: Vec<_> = TARGETS.iter().map(|(name, _)| (*name).to_owned()).collect();
    names.sort();
    assert_eq!(fuzzers, names);
}

#[test]
fn truncated_anywhere_no_message_is_read_and_nothing_panics() {
    for (name, body) in TARGETS {
        for (_, data) in corpus(name) {
            for length in 0..data.len() {
                body(&data[..length]);
            }
        }
    }
    for length in 0..MOVE.len() {
        let error = Command::parse(&MOVE.as_bytes()[..length]).expect_err("half a command");
        assert_eq!(error.reason, Reason::Malformed, "at {length}");
        // What is said to be read was whole in the text.
        let seq_at = MOVE.find("17,").unwrap() + 3;
        assert_eq!(error.seq, (length >= seq_at).then_some(17), "at {length}");
        let source_at = MOVE.len() - 1;
        assert_eq!(error.source.is_some(), length >= source_at, "at {length}");
    }
}

#[test]
fn every_single_byte_mutation_of_every_seed_is_survived() {
    for (name, body) in TARGETS {
        for (_, seed) in corpus(name) {
            let mut data = seed.clone();
            for at in 0..seed.len() {
                // Each bit, and the bytes that mean something in JSON.
                for byte in (0..8)
                    .map(|bit| seed[at] ^ 1 << bit)
                    .chain(*b"{}[]\",:\\-0e. \n\x00\xff")
                {
                    data[at] = byte;
                    body(&data);
                }
                data[at] = seed[at];
            }
        }
    }
}

#[test]
fn every_byte_value_anywhere_in_a_command_is_survived() {
    let mut data = MOVE.as_bytes().to_vec();
    for at in 0..data.len() {
        let before = data[at];
        for byte in 0..=u8::MAX {
            data[at] = byte;
            if let Ok(command) = Command::parse(&data) {
                assert_eq!(command.action.name(), "move");
            }
        }
        data[at] = before;
    }
}

#[test]
fn a_nesting_bomb_is_malformed_and_costs_no_stack() {
    for open in ["[", "{\"a\":", "[{\"a\":"] {
        for whole in [false, true] {
            let mut bomb = String::from(r#"{"seq":17,"source":"a","x":"#);
            while bomb.len() + open.len() <= MAX_MESSAGE / 2 {
                bomb.push_str(open);
            }
            if whole {
                let closing: String = bomb
                    .chars()
                    .rev()
                    .filter_map(|character| match character {
                        '[' => Some(']'),
                        '{' => Some('}'),
                        _ => None,
                    })
                    .collect();
                bomb.push('1');
                bomb.push_str(&closing);
            }
            for (_, body) in TARGETS {
                body(bomb.as_bytes());
            }
            let error = Command::parse(bomb.as_bytes()).unwrap_err();
            assert_eq!((error.reason, error.seq), (Reason::Malformed, Some(17)));
        }
    }
}

#[test]
fn what_is_nested_to_the_limit_is_read_and_no_deeper() {
    // The command itself is the first level, and parameters are the second.
    let inside = usize::from(MAX_DEPTH) - 1;
    let front = r#"{"command":"stop","seq":17,"timestamp":1"#;
    for (field, inside, end, reason) in [
        (r#""x":"#, inside, "", Reason::UnknownField),
        (r#""seq":"#, inside, "", Reason::DuplicateField),
        (r#""source":"#, inside, "", Reason::WrongType),
        (r#""parameters":"#, inside, "", Reason::WrongType),
        (r#""parameters":{"x":"#, inside - 1, "}", Reason::WrongType),
    ] {
        for (levels, reason) in [(inside, reason), (inside + 1, Reason::Malformed)] {
            let (open, close) = ("[".repeat(levels), "]".repeat(levels));
            let json = format!("{front},{field}{open}1{close}{end}}}");
            let error = Command::parse(json.as_bytes()).unwrap_err();
            assert_eq!(error.reason, reason, "{json}");
        }
    }
}

/// What is read in one pass is judged as if its syntax had been proved first.
#[test]
fn a_message_that_is_no_json_is_malformed_whatever_else_is_wrong_with_it() {
    let pose = |text: &str| PoseFix::from_json(text.as_bytes()).unwrap_err();
    for wrong in [
        r#""x":true"#,
        r#""nobody":1"#,
        r#""x":1,"x":2"#,
        r#""x":1e999"#,
        r#""robot":"sim-0001""#,
    ] {
        for (whole, end) in [(true, "}"), (false, ""), (false, "}}"), (false, ",}")] {
            let error = pose(&format!("{{{wrong}{end}"));
            assert_eq!(
                error != DecodeError::Malformed,
                whole,
                "{wrong}{end}: {error}"
            );
        }
    }
}

/// Fields that a fault's name is read without may lie no deeper than others.
#[test]
fn what_is_passed_over_is_no_deeper_than_what_is_read() {
    for (levels, malformed) in [(MAX_DEPTH - 1, false), (MAX_DEPTH, true)] {
        let (open, close) = ("[".repeat(levels.into()), "]".repeat(levels.into()));
        let text = format!(r#"{{"command":"no such","x":{open}{close}}}"#);
        let result = FaultCommand::from_json(text.as_bytes());
        assert_eq!(
            result == Err(DecodeError::Malformed),
            malformed,
            "{levels}: {result:?}"
        );
    }
}

/// The middle between two numbers of 32 bits, or what is next to it in the fifteenth digit.
fn middle() -> impl Strategy<Value = String> {
    (0_u32..(1 << 24), 0_u32..40, -1_i64..=1).prop_map(|(bits, places, off)| {
        let whole = i64::from(bits) * 2 + (1 << 25) + 1;
        if places < 20 {
            // Beyond 24 bits only: the last bit is the half.
            return (whole + off).to_string();
        }
        let value = whole as f64 / f64::from(1_u32 << (places - 20));
        format!("{:.*}", 15 - value.log10().floor() as usize - 1, value)
    })
}

/// A member of a digest: one that belongs there once more, one with a value that may not be, or one that is unknown.
fn member_of_digest() -> impl Strategy<Value = &'static str> {
    proptest::sample::select(vec![
        r#""x":32767"#,
        r#""x":32768"#,
        r#""x":1.0"#,
        r#""\u0078":-7"#,
        r#""y":"1""#,
        r#""y":null"#,
        r#""timestamp":18446744073709551615"#,
        r#""timestamp":-1"#,
        r#""count":65536"#,
        r#""count":true"#,
        r#""robots":[]"#,
        r#""robots":{}"#,
        r#""robots":"none""#,
        r#""robots":[null]"#,
        r#""robots":[{}]"#,
        r#""z":{"x":[1,2,{}]}"#,
        r#""":0"#,
    ])
}

/// The same of a robot in one.
fn member_of_neighbour() -> impl Strategy<Value = &'static str> {
    proptest::sample::select(vec![
        r#""id":"b""#,
        r#""\u0069d":"b""#,
        r#""id":"no name""#,
        r#""x":1e39"#,
        r#""v":"fast""#,
        r#""w":[]"#,
        r#""says":[1,2,3]"#,
        r#""says":[1]"#,
        r#""says":[]"#,
        r#""says":null"#,
        r#""says":[1,2,3,4,5,6,7]"#,
        r#""colour":"red""#,
    ])
}

proptest! {
    /// A number is the nearest one of 32 bits, however it is written: by way of 64 it would be rounded twice, and be
    /// another one close to the middle between two.
    #[test]
    fn numbers_are_read_to_the_last_bit(
        text in proptest::prop_oneof![
            "-?(0|[1-9][0-9]{0,17})(\\.[0-9]{1,17})?([eE][+-]?[0-9]{1,2})?",
            "-?(0|[1-9][0-9]{0,3})(\\.[0-9]{1,12})?",
            middle(),
        ],
    ) {
        let digest = format!(
            r#"{{"x":0,"y":0,"timestamp":1,"count":1,"robots":[{{"id":"a","x":{text},"y":0,"theta":0,"v":0,"w":0}}]}}"#
        );
        let read = CellDigest::from_json(digest.as_bytes()).map(|digest| digest.robots[0].x.to_bits());
        let nearest: f32 = text.parse().expect("a number");
        let nearest = nearest.is_finite().then_some(nearest.to_bits());
        prop_assert_eq!(read, nearest.ok_or(DecodeError::OutOfRange), "{}", text);
    }

    /// Digests put together from members that belong and members that do not: our reader comes to what `serde_json`
    /// makes of the same types, and refuses for the same reason.
    #[test]
    fn digests_are_read_as_serde_json_reads_them(
        members in proptest::collection::vec(member_of_digest(), 0..4),
        robots in proptest::collection::vec(proptest::collection::vec(member_of_neighbour(), 0..3), 0..18),
        place in any::<proptest::sample::Index>(),
    ) {
        let whole = r#""id":"a","x":1.5,"y":-2,"theta":0.25,"v":0,"w":1e-3"#;
        let robots: Vec<_> = robots
            .iter()
            .map(|more| format!("{{{}}}", [whole].into_iter().chain(more.iter().copied()).collect::<Vec<_>>().join(",")))
            .collect();
        let robots = format!(r#""robots":[{}]"#, robots.join(","));
        let mut all: Vec<&str> = vec![r#""x":0"#, r#""y" : -1"#, r#""timestamp":17"#, r#""count":2"#, &robots];
        // One is left out, and others come in its place.
        let at = place.index(all.len() + 1);
        if at < all.len() {
            all.remove(at);
        }
        all.splice(at..at, members);
        let text = format!("{{{}}}", all.join(","));
        let read = CellDigest::from_json(text.as_bytes());
        if text.len() > MAX_MESSAGE {
            prop_assert_eq!(read, Err(DecodeError::TooLarge));
            return Ok(());
        }
        match serde_json::from_str::<CellDigest>(&text) {
            Ok(digest) => prop_assert_eq!(read, Ok(digest), "{}", text),
            Err(error) => {
                let said = error.to_string();
                let reasons = [
                    ("unknown field", DecodeError::UnknownField),
                    ("duplicate field", DecodeError::DuplicateField),
                    ("missing field", DecodeError::MissingField),
                    ("invalid type", DecodeError::WrongType),
                    ("invalid value", DecodeError::OutOfRange),
                    ("invalid length", DecodeError::OutOfRange),
                    ("number out of range", DecodeError::OutOfRange),
                ];
                let reason = reasons.into_iter().find(|(start, _)| said.starts_with(start));
                let (_, reason) = reason.expect(&said);
                prop_assert_eq!(read, Err(reason), "{}: {}", said, text);
            }
        }
    }

    /// Digests with a piece cut out, doubled or overwritten.
    #[test]
    fn damaged_digests(
        robots in 0_u8..4,
        cut in any::<(u16, u8)>(),
        patch in proptest::collection::vec(proptest::sample::select(br#"{}[]":,\0e-.x "#.to_vec()), 0..6),
    ) {
        let one = |i| format!(r#"{{"id":"r{i}","x":1.5,"y":-2,"theta":0.25,"v":0,"w":1e-3}}"#);
        let robots: Vec<_> = (0..robots).map(one).collect();
        let text = format!(
            r#"{{"x":0,"y":-1,"timestamp":17,"count":{},"robots":[{}]}}"#,
            robots.len(),
            robots.join(","),
        );
        prop_assert!(CellDigest::from_json(text.as_bytes()).is_ok());
        let mut data = text.into_bytes();
        let from = usize::from(cut.0) % data.len();
        let to = (from + usize::from(cut.1 % 24)).min(data.len());
        data.splice(from..to, patch);
        let read = CellDigest::from_json(&data);
        if serde_json::from_slice::<serde::de::IgnoredAny>(&data).is_err() {
            prop_assert_eq!(read, Err(DecodeError::Malformed));
        } else if data.iter().filter(|byte| b"{[".contains(byte)).count() < usize::from(MAX_DEPTH) {
            // Half a pair of surrogates is JSON to others; there is none of them here.
            prop_assert_ne!(read, Err(DecodeError::Malformed));
        }
    }

    #[test]
    fn arbitrary_bytes(data in proptest::collection::vec(any::<u8>(), 0..1100)) {
        for (_, body) in TARGETS {
            body(&data);
        }
    }

    /// Texts of the alphabet of JSON get further in than arbitrary bytes do.
    #[test]
    fn arbitrary_tokens(tokens in proptest::collection::vec(proptest::sample::select(vec![
        "{", "}", "[", "]", ":", ",", "\"", "\\", "\\u", "d83e", " ", "-", "0", "17", ".5", "e9",
        "1e999", "true", "false", "null", "\"seq\"", "\"source\"", "\"command\"", "\"parameters\"",
        "\"timestamp\"", "\"robot\"", "\"a\"", "\"stop\"", "\"values\"", "{\"", "\":",
    ]), 0..60)) {
        let text = tokens.concat();
        for (_, body) in TARGETS {
            body(text.as_bytes());
        }
    }

    /// Valid commands with a piece cut out, doubled or overwritten.
    #[test]
    fn damaged_commands(
        command in crate::common::command(),
        cut in any::<(u16, u8)>(),
        patch in proptest::collection::vec(any::<u8>(), 0..6),
    ) {
        let mut buf = [0; MAX_MESSAGE];
        if let Ok(length) = command.to_json(&mut buf) {
            let mut data = buf[..length].to_vec();
            let from = usize::from(cut.0) % length;
            let to = (from + usize::from(cut.1 % 24)).min(length);
            data.splice(from..to, patch);
            for (name, body) in TARGETS {
                if name.starts_with("command") {
                    body(&data);
                }
            }
        }
    }
}
