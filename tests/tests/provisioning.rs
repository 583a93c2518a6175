//! A person sets up an emulated board from a browser: the page of the real boards, over a real
//! network, with hostile requests before the good one.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use crawler_hil::BrokerUrl;
use crawler_hil::emulator::{self, Emulator, Options};
use crawler_protocol::RobotId;
use crawler_tests::{ReservedPort, Terracrawler, wait_for, wait_for_with};
use serde_json::json;

/// To boot and get an address.
const BOOTS: Duration = Duration::from_mins(2);
/// Longest that a request may take on a busy machine; a hostile one is given up after 5 s.
const PATIENCE: Duration = Duration::from_mins(2);

/// An emulator that shows its log when its test fails.
struct Board {
    emulator: Emulator,
    page: ReservedPort,
}

impl Board {
    /// A board without settings, whose broker by command line does not exist.
    fn unprovisioned() -> Self {
        let page = ReservedPort::new();
        let robot = RobotId::new("unset").expect("an id");
        let started = emulator::image().and_then(|image| {
            Emulator::start(Options {
                arguments: vec!["provision=1".to_owned()],
                forwards: vec![(page.number(), 80)],
                ..Options::new(image, robot, BrokerUrl::loopback(1))
            })
        });
        let emulator = started.unwrap_or_else(|error| panic!("{error}"));
        let line = emulator.wait_line("provisioning: page", BOOTS);
        assert!(line.is_some(), "no page: {:?}", emulator.lines());
        Self { emulator, page }
    }

    /// Sends bytes and reads until the board closes.
    fn ask(&self, request: &[u8]) -> String {
        let mut stream =
            TcpStream::connect(("127.0.0.1", self.page.number())).expect("a connection");
        stream.set_read_timeout(Some(PATIENCE)).expect("a limit");
        // The board may refuse before it has read all.
        let _ = stream.write_all(request);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8(answer).expect("UTF-8")
    }

    fn status(&self, request: &str) -> u16 {
        let answer = self.ask(request.as_bytes());
        let code = answer
            .strip_prefix("HTTP/1.1 ")
            .and_then(|rest| rest.get(..3));
        code.and_then(|code| code.parse().ok())
            .unwrap_or_else(|| panic!("{request} was answered: {answer}"))
    }

    fn host(&self) -> String {
        format!("127.0.0.1:{}", self.page.number())
    }

    fn get(&self) -> String {
        self.ask(format!("GET / HTTP/1.1\r\nHost: {}\r\n\r\n", self.host()).as_bytes())
    }

    /// A form as the browser sends it.
    fn form(&self, origin: &str, body: &str) -> String {
        format!(
            "POST /settings HTTP/1.1\r\nHost: {}\r\nOrigin: {origin}\r\n\
             Content-Type: application/x-www-form-urlencoded\r\nContent-Length: {}\r\n\r\n{body}",
            self.host(),
            body.len()
        )
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        if std::thread::panicking() {
            for line in self.emulator.lines() {
                eprintln!("{line}");
            }
        }
    }
}

fn between<'a>(text: &'a str, open: &str, close: &str) -> &'a str {
    let found = text
        .split_once(open)
        .and_then(|(_, rest)| rest.split_once(close));
    found.unwrap_or_else(|| panic!("no {open} in {text}")).0
}

#[test]
fn a_person_sets_up_a_robot_from_a_browser() {
    let server = Terracrawler::start(&["serve"]);
    let mut board = Board::unprovisioned();
    let page = board.get();
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n"), "{page}");
    assert!(page.contains("Set up robot unset"), "{page}");
    assert!(page.trim_end().ends_with("</html>"), "{page}");
    let token = between(&page, "name=\"token\" value=\"", "\"").to_owned();

    // What others send.
    let host = board.host();
    let own = format!("http://{host}");
    let good = format!(
        "token={token}&broker=10.0.2.2%3A{}&id=provisioned-1&fleet=swarm",
        server.mqtt()
    );
    let wrong_token = good.replace(&token, &"0".repeat(32));
    for (request, status) in [
        (board.form("http://evil.example", &good), 403),
        (board.form(&own, &wrong_token), 403),
        (
            board
                .form(&own, &good)
                .replace(&format!("Host: {host}"), "Host: robot.local"),
            421,
        ),
        (
            board.form(&own, &good.replace("id=provisioned-1", "id=Not+A+Name")),
            422,
        ),
        (board.form(&own, &format!("{good}&admin=1")), 400),
        (
            format!("GET /../../etc/passwd HTTP/1.1\r\nHost: {host}\r\n\r\n"),
            404,
        ),
        (
            format!(
                "GET / HTTP/1.1\r\nHost: {host}\r\nX: {}\r\n\r\n",
                "x".repeat(5_000)
            ),
            431,
        ),
        (board.form(&own, &"a".repeat(20_000)), 413),
        ("\u{16}\u{3}\u{1}\r\n\r\n".to_owned(), 400),
    ] {
        assert_eq!(board.status(&request), status, "{request}");
    }
    // Connections that say nothing, or not enough, cost nobody else more than some seconds.
    let mut silent: Vec<TcpStream> = (0..2)
        .map(|_| TcpStream::connect(("127.0.0.1", board.page.number())).expect("a connection"))
        .collect();
    silent[1].write_all(b"GET / HT").expect("some bytes");
    let page = wait_for("the page in spite of them", PATIENCE, || {
        let page = board.get();
        page.starts_with("HTTP/1.1 200").then_some(page)
    });
    assert!(page.contains(&token), "the same boot: nothing was saved");
    drop(silent);

    // A board whose connections are all busy resets a new one, and a person tries again.
    let answer = wait_for("an answer to the good form", PATIENCE, || {
        let answer = board.ask(board.form(&own, &good).as_bytes());
        (!answer.is_empty()).then_some(answer)
    });
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    assert!(answer.contains("Robot provisioned-1 restarts"), "{answer}");

    // The robot itself, with the new name, at the new broker.
    server.wait_online(1, BOOTS);
    let (status, robot) = server.get("/api/v1/robots/provisioned-1");
    assert_eq!(status, 200, "{robot}");
    assert_eq!(robot["boot"]["cause"], json!("software"));
    // It needs no page any more.
    assert!(!board.get().starts_with("HTTP/1.1 200"));

    // And again after a power cut.
    board.emulator.power_cycle().expect("power");
    let mut last = json!(null);
    wait_for_with("it is back with its settings", BOOTS, &mut last, |robot| {
        *robot = server.get("/api/v1/robots/provisioned-1").1;
        (robot["boot"]["cause"] == json!("power-on") && robot["presence"] == json!("online"))
            .then_some(())
    });
}
