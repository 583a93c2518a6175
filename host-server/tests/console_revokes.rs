//! A running server takes up what the console revokes, within seconds.

mod support;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use support::{LIMIT, Scratch};

fn program(arguments: &[&str], data: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terracrawler"));
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("TERRACRAWLER_") {
            command.env_remove(name);
        }
    }
    command.args(arguments).arg("--data").arg(data);
    command
}

struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A closed server, and the port of its broker.
fn serve(data: &Path) -> (Running, u16) {
    let any = ["serve", "--http", "127.0.0.1:0", "--mqtt", "127.0.0.1:0"];
    let mut child = program(&any, data)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("starts");
    let mut lines = BufReader::new(child.stdout.take().expect("stdout"));
    let running = Running(child);
    let mut greeting = String::new();
    while !greeting.contains("Ctrl-C") {
        let read = lines.read_line(&mut greeting).expect("reads");
        assert!(read > 0, "ended after {greeting}");
    }
    let port = greeting
        .split("mqtt://127.0.0.1:")
        .nth(1)
        .and_then(|rest| rest.split(' ').next())
        .and_then(|port| port.parse().ok())
        .unwrap_or_else(|| panic!("no broker in {greeting}"));
    (running, port)
}

/// Enrolls a robot and returns its secret.
fn enroll(robot: &str, data: &Path) -> String {
    let output = program(&["robot", "enroll", robot], data)
        .output()
        .expect("runs");
    let url = String::from_utf8(output.stdout).expect("UTF-8");
    let secret = url.split([':', '@']).nth(2);
    secret.unwrap_or_else(|| panic!("{url}")).to_owned()
}

/// Connects as a robot does, by MQTT 5, and returns the reason code of the answer.
fn connect(port: u16, robot: &str, secret: &str) -> (TcpStream, u8) {
    let mut body = vec![0, 4, b'M', b'Q', b'T', b'T', 5, 0xc2, 0, 60, 0];
    for text in [robot, robot, secret] {
        body.extend((text.len() as u16).to_be_bytes());
        body.extend(text.as_bytes());
    }
    let mut packet = vec![0x10, u8::try_from(body.len()).expect("short")];
    packet.extend(body);
    let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("a broker");
    stream.set_read_timeout(Some(LIMIT)).expect("time-out");
    stream.write_all(&packet).expect("sent");
    let mut answer = [0; 4];
    stream.read_exact(&mut answer).expect("an answer");
    assert_eq!(answer[0], 0x20, "CONNACK");
    let mut rest = vec![0; usize::from(answer[1]) - 2];
    stream.read_exact(&mut rest).expect("its properties");
    (stream, answer[3])
}

#[test]
fn a_revoked_robot_is_cut_off_and_stays_out() {
    let scratch = Scratch::new();
    let (_running, port) = serve(&scratch.0);
    // Enrolled beside the running server, and good at once.
    let secret = enroll("rover-1", &scratch.0);
    let other = enroll("rover-2", &scratch.0);
    let (mut rover, code) = connect(port, "rover-1", &secret);
    assert_eq!(code, 0);
    let (mut neighbour, code) = connect(port, "rover-2", &other);
    assert_eq!(code, 0);

    let revoked = program(&["robot", "revoke", "rover-1"], &scratch.0)
        .output()
        .expect("runs");
    assert!(revoked.status.success());
    // The server looks every five seconds.
    let mut rest = Vec::new();
    let ended = rover.read_to_end(&mut rest);
    assert!(ended.is_ok(), "still connected after {LIMIT:?}: {rest:?}");
    let (_, code) = connect(port, "rover-1", &secret);
    assert_ne!(code, 0, "a secret that is void");

    // Nobody else noticed: a ping is answered.
    neighbour.write_all(&[0xc0, 0]).expect("sent");
    let mut pong = [0; 2];
    neighbour.read_exact(&mut pong).expect("an answer");
    assert_eq!(pong, [0xd0, 0]);
}
