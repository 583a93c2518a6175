//! Crowds of connections at a program that may open few files.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};

use crate::LIMIT;
use crate::scratch::Scratch;

/// Descriptors of the program.
const FEW: u32 = 512;
/// More connections than those, each.
const CROWD: usize = 600;

struct Server {
    child: Child,
    _scratch: Scratch,
    http: String,
    mqtt: String,
}

/// The program, which may open few files.
fn limited(scratch: &Scratch, arguments: &[&str]) -> Command {
    // The hard limit as well: the program raises the other.
    let limited = format!("ulimit -n {FEW}; exec \"$0\" \"$@\"");
    let mut command = Command::new("sh");
    command
        .args(["-c", &limited, env!("CARGO_BIN_EXE_terracrawler")])
        .args(arguments)
        .args(["--http", "127.0.0.1:0", "--mqtt", "127.0.0.1:0"])
        .arg("--data")
        .arg(&scratch.0);
    command
}

impl Server {
    fn start() -> Self {
        let scratch = Scratch::new();
        let mut child = limited(&scratch, &["serve", "--open", "--log", "off"])
            .stdout(Stdio::piped())
            .spawn()
            .expect("starts");
        let mut lines = BufReader::new(child.stdout.take().expect("stdout"));
        let mut greeting = String::new();
        while !greeting.contains("Ctrl-C") {
            let read = lines.read_line(&mut greeting).expect("reads");
            assert!(read > 0, "ended after {greeting}");
        }
        let behind = |scheme: &str| {
            let (_, rest) = greeting.split_once(scheme).expect("an address");
            let end = rest.find(['/', ' ']).expect("an end");
            rest.get(..end).expect("an address").to_owned()
        };
        Self {
            http: behind("http://"),
            mqtt: behind("mqtt://"),
            child,
            _scratch: scratch,
        }
    }

    /// What the server answers over a connection of its own.
    fn ask(&self, request: &str, body: &str) -> String {
        let mut stream = connect(&self.http);
        let length = body.len();
        let request = format!(
            "{request} HTTP/1.1\r\nhost: {}\r\nconnection: close\r\n\
             content-type: application/json\r\ncontent-length: {length}\r\n\r\n{body}",
            self.http
        );
        stream.write_all(request.as_bytes()).expect("sent");
        let mut answer = String::new();
        let read = stream.read_to_string(&mut answer);
        assert!(read.is_ok(), "{read:?} after {answer}");
        answer
    }

    /// A session of a robot over a new connection.
    fn session(&self) -> TcpStream {
        let mut stream = connect(&self.mqtt);
        let packet = b"\x10\x13\0\x04MQTT\x05\x02\0\x3c\0\0\x06wheely";
        stream.write_all(packet).expect("sent");
        let mut answer = [0; 4];
        stream.read_exact(&mut answer).expect("a CONNACK");
        assert_eq!((answer[0], answer[3]), (0x20, 0), "{answer:?}");
        stream
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Already ended is fine.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn connect(address: &str) -> TcpStream {
    let stream = TcpStream::connect(address).expect("connect");
    stream.set_read_timeout(Some(LIMIT)).expect("a limit");
    stream
}

#[test]
fn with_few_descriptors_no_crowd_keeps_out_a_robot_or_a_stop() {
    // Both ends of a connection are not ours, but these are.
    rlimit::increase_nofile_limit(4_096).expect("a limit");
    let server = Server::start();
    let http = server.http.clone();
    let mqtt = server.mqtt.clone();
    let mut crowds = Vec::new();
    for (address, said) in [
        (&mqtt, &b""[..]),
        (&mqtt, b"\x10\x13\0\x04MQ"),
        (&http, b""),
        (&http, b"POST /api/v1/swarm/commands HTTP/1.1\r\nx-slow: "),
    ] {
        for _ in 0..CROWD {
            let mut stream = connect(address);
            // Who was crowded out already is no longer listened to.
            let _ = stream.write_all(said);
            crowds.push(stream);
        }
        let _robot = server.session();
        let body = r#"{"command":"estop"}"#;
        let answer = server.ask("POST /api/v1/swarm/commands", body);
        assert!(answer.starts_with("HTTP/1.1 202 "), "{answer}");
    }
    let metrics = server.ask("GET /metrics", "");
    let name = "terracrawler_embedded_broker_refusals_total{reason=\"crowded\"} ";
    let line = metrics.lines().find_map(|line| line.strip_prefix(name));
    let crowded: f64 = line.expect("counted").parse().expect("a number");
    assert!(crowded >= CROWD as f64, "{crowded}");
}

#[test]
fn a_fleet_that_takes_more_files_than_are_allowed_does_not_begin() {
    let scratch = Scratch::new();
    let ended = limited(&scratch, &["up", "--open", "--robots", "200"])
        .stdin(Stdio::null())
        .output()
        .expect("starts");
    let said = String::from_utf8_lossy(&ended.stderr);
    assert!(!ended.status.success(), "{said}");
    // Each robot, its broker's end, and everything else.
    assert!(
        said.contains("656 open files are needed and 512 allowed"),
        "{said}"
    );
}
