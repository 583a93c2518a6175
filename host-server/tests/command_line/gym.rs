//! `terracrawler gym`: worlds for another program over pipes, as that program meets them.

use std::io::Write as _;
use std::process::{Child, ChildStdin, ChildStdout, Command, Output, Stdio};

// The same as in the tests of the protocol.
#[path = "../../../models/policy/tests/client.rs"]
#[allow(dead_code, reason = "those use more of it")]
mod client;

use client::{Client, Order, frame, hello};

fn start(words: &[&str]) -> (Child, ChildStdin, ChildStdout) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_terracrawler"))
        .arg("gym")
        .args(words)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it runs");
    let input = child.stdin.take().expect("a pipe");
    let output = child.stdout.take().expect("a pipe");
    (child, input, output)
}

/// What it says of what it was asked.
fn said(words: &[&str], asked: &[u8]) -> Output {
    let (mut child, mut input, output) = start(words);
    // It may have ended before.
    let _ = input.write_all(asked);
    drop(input);
    child.stdout = Some(output);
    child.wait_with_output().expect("it ends")
}

#[test]
fn two_programs_with_the_same_seeds_see_the_same() {
    let session = |threads: &str| {
        let (mut child, input, output) = start(&["--worlds", "16", "--threads", threads]);
        let mut client = Client::new(output, input, true);
        assert_eq!(client.hello.name, "spread");
        assert_eq!((client.hello.worlds, client.hello.agents), (16, 3));
        assert_eq!((client.hello.observation, client.hello.actions), (48, 7));
        let begin = (0..16).map(|world| Order::Train(3, world, 0));
        let mut all = vec![client.advance(&begin.collect::<Vec<_>>())];
        for step in 0..8_u8 {
            let act = Order::Act(vec![step % 7, 1, 2]);
            all.push(client.advance(&vec![act; 16]));
        }
        drop(client);
        assert!(child.wait().expect("it ends").success());
        all
    };
    let all = session("1");
    assert!(all == session("2"));
    assert!(all[1].rewards.iter().any(|reward| *reward != 0.0));
    assert_eq!(all[0].states.len(), 16 * 3 * 56);
}

#[test]
fn one_robot_of_each_world_may_learn_alone() {
    let (mut child, input, output) = start(&["--teammates", "spread", "--randomisation", "wild"]);
    let mut client = Client::new(output, input, false);
    assert_eq!((client.hello.worlds, client.hello.agents), (1, 1));
    let begun = client.advance(&[Order::Evaluate(5)]);
    assert_eq!((begun.observations.len(), begun.rewards.len()), (48, 1));
    client.advance(&[Order::Act(vec![0])]);
    drop(client);
    assert!(child.wait().expect("it ends").success());
}

#[test]
fn what_cannot_be_is_said_in_one_line() {
    let old = hello(0, 0);
    for (words, asked, why) in [
        (&[][..], &old[..], "version 0 of the protocol"),
        (&[], b"GET / HTTP/1.1\r\n\r\n", "a frame of"),
        (&[], &frame(3, &[]), "the first frame is no hello"),
        (&[], &hello(1, 0)[..9], "the input ended within a frame"),
        (&["--teammates", "nobody"], &[], "--teammates nobody: "),
        (
            &["--teammates", "Cargo.toml"],
            &[],
            "--teammates Cargo.toml: ",
        ),
    ] {
        let output = said(words, asked);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        assert!(text.contains(why), "{text}");
    }
    let output = said(&[], &[]);
    assert!(output.status.success() && output.stdout.is_empty());
}
