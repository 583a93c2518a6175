//! What somebody does first: the console's words lead where they say.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, Stdio};

use crate::LIMIT;
use crate::console::{PASSWORD, Place, done, row};

/// A server at ports that the console is not told.
pub(crate) struct Running {
    child: Child,
    /// What it says once it runs.
    pub(crate) greeting: String,
}

impl Running {
    pub(crate) fn start(place: &Place, options: &[&str], log: Stdio) -> Self {
        let any = ["serve", "--http", "127.0.0.1:0", "--mqtt", "127.0.0.1:0"];
        let mut child = place
            .command(&any)
            .args(options)
            .stderr(log)
            .spawn()
            .expect("starts");
        let mut lines = BufReader::new(child.stdout.take().expect("stdout"));
        let mut running = Self {
            child,
            greeting: String::new(),
        };
        while !running.greeting.contains("Ctrl-C") {
            let read = lines.read_line(&mut running.greeting).expect("reads");
            assert!(read > 0, "ended after {}", running.greeting);
        }
        running
    }

    /// The address that follows `before` in its greeting.
    pub(crate) fn address(&self, before: &str) -> &str {
        let rest = self.greeting.split(before).nth(1);
        rest.and_then(|rest| rest.split(['/', ' ', '\n']).next())
            .unwrap_or_else(|| panic!("no {before} in {}", self.greeting))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sends a request and returns status and body of the answer.
pub(crate) fn ask(address: &str, head: &str, body: &str) -> (u16, String) {
    let mut stream =
        TcpStream::connect(address).unwrap_or_else(|error| panic!("{address}: {error}"));
    stream.set_read_timeout(Some(LIMIT)).expect("time-out");
    let length = body.len();
    let request = format!(
        "{head} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\
         content-type: application/json\r\ncontent-length: {length}\r\n\r\n{body}"
    );
    stream.write_all(request.as_bytes()).expect("sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("an answer");
    let status = answer.split(' ').nth(1).and_then(|code| code.parse().ok());
    (status.unwrap_or_else(|| panic!("{answer}")), answer)
}

/// Opens a link as the control room does: what it asks of the server, and what comes of it.
fn open(link: &str, name: Option<&str>) -> (u16, String) {
    let (page, code) = link.trim().split_once("/#invite=").expect("a link");
    let address = page.strip_prefix("http://").expect("a page");
    let (status, _) = ask(address, "GET /", "");
    assert_eq!(status, 200, "there is a page at {page}");
    let (code, named) = match code.split_once("&name=") {
        Some((code, named)) => (code, Some(named)),
        None => (code, None),
    };
    // The page asks for a name where the link has none.
    let body = serde_json::json!({
        "code": code,
        "name": named.or(name).expect("a name"),
        "password": PASSWORD,
    });
    ask(address, "POST /api/v1/invitations", &body.to_string())
}

#[test]
fn an_invitation_leads_to_an_account() {
    let place = Place::new();
    let running = Running::start(&place, &[], Stdio::null());
    // Somebody new, by name.
    let link = place.ok(&["user", "invite", "newname", "--role", "operator"]);
    assert!(
        link.contains(running.address("control room  http://")),
        "{link}"
    );
    let list = place.ok(&["user", "list"]);
    assert!(row(&list, "newname").contains("invited"), "{list}");
    let (status, answer) = open(&link, None);
    assert_eq!(status, 200, "{answer}");
    assert!(answer.contains(r#""user":"newname""#), "{answer}");
    let list = place.ok(&["user", "list"]);
    assert!(row(&list, "newname").contains("operator"), "{list}");
    assert!(row(&list, "newname").contains("active"), "{list}");
    // Once.
    assert_eq!(open(&link, None).0, 401);

    // Somebody who chooses a name, and somebody known who has lost the password.
    let link = place.ok(&["user", "invite", "--role", "admin"]);
    assert_eq!(open(&link, Some("ada")).0, 200);
    let link = place.ok(&["user", "invite", "newname"]);
    assert_eq!(open(&link, None).0, 200);
    let list = place.ok(&["user", "list"]);
    assert!(row(&list, "newname").contains("operator"), "{list}");

    // A link that would not work is none.
    let told = place.refused(&["user", "invite", "newname", "--role", "admin"]);
    assert!(told.contains("user role newname admin"), "{told}");
    place.ok(&["user", "disable", "newname"]);
    let told = place.refused(&["user", "invite", "newname"]);
    assert!(told.contains("user enable newname"), "{told}");
    // Who is gone is gone with the invitation.
    place.ok(&["user", "invite", "guest"]);
    place.ok(&["user", "remove", "guest"]);
    assert!(!place.ok(&["user", "list"]).contains("guest"));
}

#[test]
fn a_robot_is_told_where_the_broker_is() {
    let place = Place::new();
    let running = Running::start(&place, &[], Stdio::null());
    let broker = running.address("MQTT broker   mqtt://").to_owned();
    let output = place.run(&["robot", "enroll", "rover-1"]);
    let url = done(&output);
    assert!(url.trim().ends_with(&format!("@{broker}")), "{url}");
    let advice = String::from_utf8_lossy(&output.stderr);
    assert!(advice.contains(&format!(" {broker}\n")), "{advice}");
    let url = place.ok(&["robot", "enroll", "--simulator", "lab"]);
    assert!(url.trim().ends_with(&format!("@{broker}")), "{url}");
    // What is asked for is what is told, and without a server there are the options.
    let url = place.ok(&[
        "robot",
        "enroll",
        "rover-2",
        "--address",
        "robots.example:1900",
    ]);
    assert!(url.trim().ends_with("@robots.example:1900"), "{url}");
}
