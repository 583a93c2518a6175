//! Names that clients give themselves do not write lines into the log, nor steer the terminal of whoever
//! reads it.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::time::Instant;

use crate::LIMIT;
use crate::console::Place;
use crate::newcomer::Running;
use crate::scratch::Scratch;

/// Connects by MQTT 5 and waits until the broker has answered, or ended the connection.
fn connect(broker: &str, client: &str, user: &str) {
    let mut body = vec![0, 4, b'M', b'Q', b'T', b'T', 5, 0xc2, 0, 60, 0];
    for text in [client, user, "secret"] {
        body.extend(u16::try_from(text.len()).expect("short").to_be_bytes());
        body.extend(text.as_bytes());
    }
    let mut packet = vec![0x10];
    let mut length = body.len();
    while length >= 0x80 {
        packet.push((length % 0x80) as u8 | 0x80);
        length /= 0x80;
    }
    packet.push(length as u8);
    packet.extend(body);
    let mut stream = TcpStream::connect(broker).expect("a broker");
    stream.set_read_timeout(Some(LIMIT)).expect("time-out");
    stream.write_all(&packet).expect("sent");
    // Refused or not, and however it is told.
    let _ = stream.read(&mut [0; 4]);
}

/// Waits until `log` has `word`, and tries again meanwhile: refusals are not all logged.
fn until(log: &Path, word: &str, again: impl Fn()) -> String {
    let end = Instant::now() + LIMIT;
    loop {
        again();
        let bytes = std::fs::read(log).expect("the log");
        // Half of a letter may be on its way.
        let text = String::from_utf8(bytes);
        if let Ok(text) = &text
            && text.contains(word)
        {
            return text.clone();
        }
        assert!(Instant::now() < end, "no {word} in {text:?}");
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
}

#[test]
fn no_name_writes_a_line_of_the_log() {
    let place = Place::new();
    let scratch = Scratch::new();
    std::fs::create_dir_all(&scratch.0).expect("directory");
    let path = scratch.0.join("log");
    let log = File::create(&path).expect("file");
    let running = Running::start(&place, &["--log", "debug"], log.into());
    let broker = running.address("MQTT broker   mqtt://").to_owned();
    let names = [
        "one\n2026-01-01T00:00:00Z  INFO forged: a line of its own",
        "two\r\x1b[2J\x1b]0;title\x07\x08\x7f",
        "three\u{85}\u{9b}31m\u{2028}\u{202e}",
    ];
    for name in names {
        let (word, _) = name.split_at(3);
        // Once as the id of the client, and once as the name of its user.
        until(&path, &format!("client={word}"), || {
            connect(&broker, name, "eve");
        });
        until(&path, &format!("user={word}"), || {
            connect(&broker, "eve", name);
        });
    }
    let long = format!("four{}", "x".repeat(60_000));
    until(&path, "user=four", || connect(&broker, "eve", &long));
    drop(running);
    let text = std::fs::read_to_string(&path).expect("UTF-8");
    for line in text.lines() {
        let dated = line.get(..3) == Some("202") && line.get(10..11) == Some("T");
        assert!(
            dated && !line.starts_with("2026-01-01T00:00:00Z"),
            "{line:?}"
        );
        let steers = |c: char| c.is_control() || matches!(c, '\u{2028}' | '\u{202e}');
        assert!(!line.contains(steers), "{line:?}");
        assert!(line.len() < 1_024, "{} bytes: {}", line.len(), &line[..200]);
    }
}
