//! A byte stream in virtual time.

use core::fmt::Write as _;
use std::collections::VecDeque;
use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

use embedded_io_async::{ErrorKind, ErrorType, Read, Write};

use super::super::*;
use crate::clock::testing::TestClock;
use crate::settings::testing::{TestFlash, TestRng, settings};
use crate::settings::{Kept, Settings, Vault};

/// The other end of a connection.
#[derive(Debug)]
pub(super) struct Peer {
    clock: TestClock,
    /// What it sends, and when.
    script: VecDeque<(u64, Vec<u8>)>,
    /// Whether it closes after its last byte, rather than waiting.
    closes: bool,
    /// How many bytes it takes; then it stalls.
    takes: usize,
    pub(super) heard: Vec<u8>,
}

/// The connection is broken.
#[derive(Debug, Clone, Copy)]
pub(super) struct Broken;

impl core::fmt::Display for Broken {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("broken")
    }
}

impl core::error::Error for Broken {}

impl embedded_io_async::Error for Broken {
    fn kind(&self) -> ErrorKind {
        ErrorKind::ConnectionReset
    }
}

impl ErrorType for Peer {
    type Error = Broken;
}

impl Read for Peer {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Broken> {
        assert!(!buffer.is_empty(), "a read without room");
        let Some((at, _)) = self.script.front() else {
            if self.closes {
                return Ok(0);
            }
            self.clock.wait_for(u64::MAX - 1).await;
            return Err(Broken);
        };
        let at = *at;
        self.clock.wait_for(at).await;
        let (_, bytes) = self.script.front_mut().expect("looked at above");
        let count = buffer.len().min(bytes.len());
        buffer[..count].copy_from_slice(&bytes[..count]);
        bytes.drain(..count);
        if bytes.is_empty() {
            self.script.pop_front();
        }
        Ok(count)
    }
}

impl Write for Peer {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Broken> {
        if self.takes == 0 {
            self.clock.wait_for(u64::MAX - 1).await;
        }
        let count = bytes.len().min(self.takes).min(100);
        self.takes -= count;
        self.heard.extend_from_slice(&bytes[..count]);
        Ok(count)
    }

    async fn flush(&mut self) -> Result<(), Broken> {
        Ok(())
    }
}

/// A radio that finds two networks, or fails.
#[derive(Debug, Default)]
pub(super) struct Radio {
    pub(super) scans: usize,
    pub(super) fails: bool,
}

impl Scanner for Radio {
    async fn scan(&mut self, networks: &mut Networks) -> Result<(), ScanFailed> {
        self.scans += 1;
        if self.fails {
            return Err(ScanFailed);
        }
        for (ssid, rssi_dbm, open) in [("weak \"one\"", -80, false), ("</script>", -40, true)] {
            networks.add(Nearby {
                ssid: heapless::String::try_from(ssid).unwrap(),
                rssi_dbm,
                open,
            });
        }
        Ok(())
    }
}

pub(super) type TestServer<'a> = Server<&'a mut TestFlash, &'a mut Radio, TestClock>;

/// A board with its page.
#[derive(Debug)]
pub(super) struct Board {
    pub(super) clock: TestClock,
    pub(super) portal: Portal,
    pub(super) flash: TestFlash,
    pub(super) radio: Radio,
}

pub(super) const ALL: Features = Features {
    wifi: true,
    scan: true,
    ranger: true,
};

pub(super) fn portal(features: Features) -> Portal {
    Portal {
        features,
        token: Token::draw(&mut TestRng(1)),
        captive: None,
        suggestion: Settings {
            wifi: None,
            id: crawler_protocol::RobotId::new("crawler-4f2a").unwrap(),
            credentials: None,
            ..settings()
        },
    }
}

impl Board {
    pub(super) fn new() -> Self {
        Self {
            clock: TestClock::default(),
            portal: portal(ALL),
            flash: TestFlash::blank(),
            radio: Radio::default(),
        }
    }

    /// A board that has been told before.
    pub(super) fn told(settings: Settings) -> Self {
        let mut board = Self::new();
        let kept = Kept {
            settings: Some(settings),
            access_point: Some(crate::settings::AccessPointPassword::draw(&mut TestRng(9))),
        };
        embassy_futures::block_on(Vault::new(&mut board.flash).store(&kept)).unwrap();
        board
    }

    pub(super) fn kept(&mut self) -> Kept {
        embassy_futures::block_on(Vault::new(&mut self.flash).load()).unwrap()
    }

    pub(super) fn peer(&self, script: Vec<(u64, Vec<u8>)>) -> Peer {
        peer(&self.clock, script)
    }

    /// One connection.
    pub(super) fn converse(&mut self, peer: &mut Peer) -> Outcome {
        let server = TestServer::new(
            self.portal.clone(),
            Vault::new(&mut self.flash),
            &mut self.radio,
            self.clock.clone(),
        );
        let mut buffer = [0; BUFFER];
        self.clock.clone().run(server.converse(peer, &mut buffer))
    }

    /// Sends a request at once, and returns the answer.
    pub(super) fn ask(&mut self, request: &[u8]) -> (Outcome, Reply) {
        let mut peer = self.peer(std::vec![(0, request.to_vec())]);
        let outcome = self.converse(&mut peer);
        (outcome, Reply::parse(&peer.heard))
    }

    pub(super) fn get(&mut self, path: &str) -> Reply {
        let request = format!("GET {path} HTTP/1.1\r\nHost: 192.168.4.1\r\n\r\n");
        self.ask(request.as_bytes()).1
    }

    /// Sends a form as the page does.
    pub(super) fn post(&mut self, fields: &[(&str, &str)]) -> (Outcome, Reply) {
        let token = self.portal.token.as_str().to_string();
        let mut all = std::vec![("token", token.as_str())];
        all.extend_from_slice(fields);
        self.ask(&post(&all))
    }
}

/// Someone who sends what `script` says, takes everything, and closes.
pub(super) fn peer(clock: &TestClock, script: Vec<(u64, Vec<u8>)>) -> Peer {
    Peer {
        clock: clock.clone(),
        script: script.into(),
        closes: true,
        takes: usize::MAX,
        heard: Vec::new(),
    }
}

impl Peer {
    pub(super) const fn stays(mut self) -> Self {
        self.closes = false;
        self
    }

    pub(super) const fn takes(mut self, bytes: usize) -> Self {
        self.takes = bytes;
        self
    }
}

/// Encodes a form as the standard of the web says, without a look at our decoder.
pub(super) fn encode(fields: &[(&str, &str)]) -> String {
    let mut body = String::new();
    for (name, value) in fields {
        if !body.is_empty() {
            body.push('&');
        }
        body.push_str(name);
        body.push('=');
        for byte in value.bytes() {
            match byte {
                b' ' => body.push('+'),
                b'*' | b'-' | b'.' | b'_' | b'0'..=b'9' | b'A'..=b'Z' | b'a'..=b'z' => {
                    body.push(char::from(byte));
                }
                other => write!(body, "%{other:02X}").expect("a string takes everything"),
            }
        }
    }
    body
}

/// A form in a request, as a browser sends it.
pub(super) fn post(fields: &[(&str, &str)]) -> Vec<u8> {
    let body = encode(fields);
    format!(
        "POST /settings HTTP/1.1\r\nHost: 192.168.4.1\r\nOrigin: http://192.168.4.1\r\n\
         Content-Type: application/x-www-form-urlencoded\r\nContent-Length: {}\r\n\r\n{body}",
        body.len()
    )
    .into_bytes()
}

/// A response, taken apart.
#[derive(Debug)]
pub(super) struct Reply {
    pub(super) status: u16,
    pub(super) head: String,
    pub(super) body: String,
}

impl Reply {
    fn parse(bytes: &[u8]) -> Self {
        let text = core::str::from_utf8(bytes).expect("UTF-8");
        let (head, body) = text.split_once("\r\n\r\n").expect("a head");
        let status = head["HTTP/1.1 ".len()..][..3].parse().expect("a status");
        let reply = Self {
            status,
            head: head.to_string(),
            body: body.to_string(),
        };
        let length: usize = reply
            .header("Content-Length")
            .expect("it")
            .parse()
            .expect("a number");
        assert!(body.is_empty() || body.len() == length, "{head}");
        assert_eq!(reply.header("Connection"), Some("close"));
        reply
    }

    pub(super) fn header(&self, name: &str) -> Option<&str> {
        self.head
            .lines()
            .find_map(|line| line.strip_prefix(name)?.strip_prefix(": "))
    }
}

/// What a person enters.
pub(super) const GOOD: [(&str, &str); 8] = [
    ("ssid", "Werkstatt <2>"),
    ("wifi_password", "correct horse"),
    ("broker", "broker.local:1884"),
    ("id", "crawler-07"),
    ("fleet", "swarm"),
    ("username", "robot"),
    ("password", "hunter2&="),
    ("ranger", "pulse"),
];

/// [`GOOD`] with some values replaced.
pub(super) fn good_but<'a>(changes: &[(&'a str, &'a str)]) -> Vec<(&'a str, &'a str)> {
    let mut fields: Vec<(&str, &str)> = GOOD.to_vec();
    for (name, value) in changes {
        match fields.iter_mut().find(|(known, _)| known == name) {
            Some(field) => field.1 = value,
            None => fields.push((name, value)),
        }
    }
    fields
}
