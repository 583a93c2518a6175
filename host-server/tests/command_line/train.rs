//! `terracrawler train`, and robots that drive by what comes of it.

use std::fs;
use std::process::{Command, Output};

use serde_json::Value;

use crate::folder::Folder;

fn terracrawler(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_terracrawler"))
        .args(words)
        .output()
        .expect("it runs")
}

fn said(output: &Output) -> String {
    let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
    text(&output.stdout) + &text(&output.stderr)
}

#[test]
fn a_policy_is_trained_and_robots_drive_by_it() {
    let folder = Folder::new();
    let out = folder.file("trained");
    let few = ["--steps", "1", "--worlds", "1", "--units", "4"];
    let output = terracrawler(&[&["train", "--out", &out], &few[..]].concat());
    let text = said(&output);
    assert!(output.status.success(), "{text}");
    assert!(text.contains("policy.tcpo: "), "{text}");

    let (policy, json) = (
        folder.file("trained/policy.tcpo"),
        folder.file("result.json"),
    );
    let words = [
        "evaluate",
        "--scenario",
        "spread",
        "--seeds",
        "1",
        "--json",
        &json,
    ];
    let evaluated = |options: &[&str]| {
        let output = terracrawler(&[&words, options].concat());
        // One that has learned next to nothing may well fail.
        assert!(
            matches!(output.status.code(), Some(0 | 1)),
            "{}",
            said(&output)
        );
        let text = fs::read_to_string(&json).expect("it was written");
        serde_json::from_str::<Value>(&text).expect("JSON")
    };
    let (driven, again) = (
        evaluated(&["--policy", &policy]),
        evaluated(&["--policy", &policy]),
    );
    assert_eq!(driven["trials"], again["trials"], "the same every time");
    assert!(driven["provenance"]["policy"].is_string(), "{driven}");
    let without = evaluated(&[]);
    assert_ne!(
        driven["trials"], without["trials"],
        "it makes no difference"
    );

    // For robots that are there it is signed, under a name.
    let (keys, release) = (folder.file("keys"), folder.file("few.release"));
    let output = terracrawler(&["release", "keygen", "--out", &keys]);
    assert!(output.status.success(), "{}", said(&output));
    let (private, public) = (
        folder.file("keys/release-key.pem"),
        folder.file("keys/release-public.pem"),
    );
    let sign = |name: &str| {
        let words = [
            "release",
            "sign",
            "--key",
            &private,
            "--image",
            &policy,
            "--kind",
            "policy",
            "--name",
            name,
            "--board",
            "sim",
            "--version",
            "1",
            "--sequence",
            "1",
            "--out",
            &release,
        ];
        terracrawler(&words)
    };
    let output = sign("eyes");
    assert_eq!(output.status.code(), Some(1));
    assert!(
        said(&output).contains("name of a detector"),
        "{}",
        said(&output)
    );
    let output = sign("few");
    assert!(output.status.success(), "{}", said(&output));
    assert!(said(&output).contains("policy few"), "{}", said(&output));
    let output = terracrawler(&["release", "verify", &release, "--public", &public]);
    assert!(output.status.success(), "{}", said(&output));
    fs::remove_file(&release).expect("it is there");

    let mut damaged = fs::read(&policy).expect("a policy");
    *damaged.last_mut().expect("bytes") ^= 1;
    fs::write(&policy, damaged).expect("a file");
    let output = terracrawler(&[&words[..], &["--policy", &policy]].concat());
    let text = said(&output);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("the policy is damaged"), "{text}");
    let output = sign("few");
    assert_eq!(output.status.code(), Some(1));
    assert!(
        said(&output).contains("the policy is damaged"),
        "{}",
        said(&output)
    );
    assert!(
        !fs::exists(&release).expect("a folder"),
        "nothing was signed"
    );
}
