//! Requests and what is answered, one by one.

use std::format;
use std::string::String;

use super::super::*;
use super::harness::{ALL, Board, GOOD, good_but, portal, post};
use crate::settings::testing::settings;
use crate::settings::{Passphrase, RangerMode};

#[test]
fn good_settings_are_stored_and_what_happens_next_is_told() {
    let mut board = Board::told(settings());
    let label = board.kept().access_point;
    let changes = [("id", "crawler-09"), ("wifi_password", "battery staple")];
    let (outcome, reply) = board.post(&good_but(&changes));
    assert_eq!(reply.status, 200, "{}", reply.body);
    let Outcome::Saved(stored) = outcome else {
        panic!("{outcome:?}");
    };
    assert_eq!(stored.id.as_str(), "crawler-09");
    let phrase = stored
        .wifi
        .as_ref()
        .and_then(|wifi| wifi.passphrase.clone());
    assert_eq!(phrase, Passphrase::new("battery staple").ok());
    assert_eq!(board.kept().settings, Some(stored));
    assert_eq!(board.kept().access_point, label, "the label stays true");
    assert!(reply.body.contains("Robot crawler-09 restarts"));
    assert!(reply.body.contains("Werkstatt &lt;2&gt;"));
    assert!(!reply.body.contains("battery") && !reply.body.contains("hunter2"));
}

#[test]
fn everything_wrong_is_said_beside_its_field_and_nothing_is_stored() {
    let mut board = Board::new();
    let (outcome, reply) = board.post(&[
        ("ssid", "a network with a name that is far too long for one"),
        ("wifi_password", "short"),
        ("broker", "mqtt://broker"),
        ("id", "Crawler 7"),
        ("username", "robot"),
        ("password", ""),
        ("ranger", "laser"),
    ]);
    assert_eq!((outcome, reply.status), (Outcome::Answered, 422));
    assert_eq!(board.kept().settings, None);
    for (field, words) in [
        ("ssid", "too long"),
        ("broker", "port must be"),
        ("id", "not allowed"),
        ("fleet", "fill this in"),
        ("password", "enter the password"),
        ("ranger", "choose one"),
    ] {
        let place = format!("<p class=\"flaw\" id=\"{field}-flaw\">");
        let (_, rest) = reply.body.split_once(&place).expect(field);
        let (said, _) = rest.split_once("</p>").expect(field);
        assert!(said.contains(words), "{field}: {said}");
        let input = format!(" aria-invalid=\"true\" aria-describedby=\"{field}-flaw\"");
        assert!(reply.body.contains(&input), "{field}");
    }
    assert!(
        reply.body.contains("value=\"Crawler 7\""),
        "kept for correction"
    );
    assert!(!reply.body.contains("short"), "passwords are never shown");
    // The name was too long, so its password was not looked at: one thing at a time.
    let (_, reply) = board.post(&good_but(&[("wifi_password", "short")]));
    assert!(
        reply.body.contains("at least 8 characters"),
        "{}",
        reply.body
    );
}

#[test]
fn the_page_shows_what_is_stored_except_passwords() {
    let mut board = Board::told(settings());
    let page = board.get("/");
    assert_eq!(page.status, 200);
    for shown in [
        "value=\"Werkstatt &lt;2&gt;\"",
        "value=\"broker.local:1884\"",
        "value=\"crawler-07\"",
        "value=\"robot\"",
        "<option value=\"pulse\" selected>",
        "Set up robot crawler-07",
        board.portal.token.as_str(),
    ] {
        assert!(page.body.contains(shown), "{shown}");
    }
    for secret in ["correct horse", "hunter2"] {
        assert!(!page.body.contains(secret), "{secret}");
    }
    assert_eq!(page.body.matches("Stored, and not shown").count(), 2);
    assert!(!page.body.contains("{{"));
    let fresh = Board::new().get("/").body;
    assert!(fresh.contains("Set up robot crawler-4f2a") && !fresh.contains("Stored, and not"));
    assert!(
        fresh.contains("name=\"broker\" value=\"\""),
        "no broker is suggested"
    );
}

#[test]
fn an_empty_password_keeps_the_stored_one_for_the_same_counterpart_only() {
    let empty = [("wifi_password", ""), ("password", "")];
    let submit = |changes: &[(&'static str, &'static str)]| {
        let mut board = Board::told(settings());
        let mut all = empty.to_vec();
        all.extend_from_slice(changes);
        let (outcome, reply) = board.post(&good_but(&all));
        (outcome, reply.body)
    };
    assert_eq!(submit(&[]).0, Outcome::Saved(settings()));
    let renamed = submit(&[("id", "other"), ("ranger", "uart")]).0;
    let Outcome::Saved(renamed) = renamed else {
        panic!("{renamed:?}");
    };
    assert_eq!(renamed.credentials, settings().credentials);
    assert_eq!(
        (renamed.wifi, renamed.ranger),
        (settings().wifi, RangerMode::Uart)
    );
    // Another network must not get the old one's password, nor another broker the user's.
    for change in [
        ("ssid", "evil"),
        ("broker", "evil.example"),
        ("broker", "broker.local:1885"),
        ("username", "mallory"),
    ] {
        let (outcome, body) = submit(&[change]);
        assert_eq!(outcome, Outcome::Answered, "{change:?}");
        assert_eq!(
            body.matches("Please enter the password").count(),
            1,
            "{change:?}"
        );
    }
    // No name: no account. A password without a name is a mistake.
    let Outcome::Saved(none) = submit(&[("username", "")]).0 else {
        panic!("an account is not needed");
    };
    assert_eq!(none.credentials, None);
    assert!(
        submit(&[("username", ""), ("password", "x")])
            .1
            .contains("needs a user name")
    );
    // An open network is said to be one.
    let Outcome::Saved(open) = submit(&[("ssid", "café"), ("wifi_open", "1")]).0 else {
        panic!("open networks are fine");
    };
    assert_eq!(open.wifi.map(|wifi| wifi.passphrase), Some(None));
    let both = submit(&[("wifi_open", "1"), ("wifi_password", "12345678")]);
    assert!(both.1.contains("either enter a password or tick"));
}

#[test]
fn a_board_with_a_cable_is_not_asked_for_wifi() {
    let mut board = Board::told(settings());
    board.portal = portal(Features {
        wifi: false,
        scan: true,
        ranger: false,
    });
    let page = board.get("/").body;
    for absent in [
        "ssid",
        "wifi_password",
        "networks",
        "<script",
        "US-100",
        "access point",
    ] {
        assert!(
            !page.contains(&format!("\"{absent}\"")) || absent == "<script",
            "{absent}"
        );
    }
    assert!(!page.contains("<script") && !page.contains("US-100"));
    assert_eq!(board.get("/networks").status, 404);
    let fields = [
        ("broker", "10.0.2.2"),
        ("id", "virt-01"),
        ("fleet", "swarm"),
    ];
    let Outcome::Saved(stored) = board.post(&fields).0 else {
        panic!("nothing more is needed");
    };
    // What is not asked for stays as it is.
    assert_eq!(
        (stored.wifi, stored.ranger),
        (settings().wifi, RangerMode::Pulse)
    );
    assert_eq!(stored.id.as_str(), "virt-01");
}

/// Everything but the page of this boot, asked by address, is refused.
#[test]
fn forms_of_others_are_refused() {
    let mut board = Board::new();
    let token = String::from(board.portal.token.as_str());
    let mut fields = std::vec![("token", token.as_str())];
    fields.extend_from_slice(&GOOD);
    let whole = String::from_utf8(post(&fields)).unwrap();
    let own = "Origin: http://192.168.4.1\r\n";
    let host = "Host: 192.168.4.1\r\n";
    assert!(whole.contains(own) && whole.contains(host));
    for (what, request, status) in [
        (
            "another page",
            whole.replace(own, "Origin: http://evil.example\r\n"),
            403,
        ),
        (
            "a sandboxed page",
            whole.replace(own, "Origin: null\r\n"),
            403,
        ),
        (
            "the page over TLS",
            whole.replace(own, "Origin: https://192.168.4.1\r\n"),
            403,
        ),
        (
            "the page of another port",
            whole.replace(own, "Origin: http://192.168.4.1:81\r\n"),
            403,
        ),
        (
            "two origins",
            whole.replace(own, &format!("{own}{own}")),
            400,
        ),
        (
            "a name that points here",
            whole
                .replace(own, "Origin: http://evil.example\r\n")
                .replace(host, "Host: evil.example\r\n"),
            421,
        ),
        (
            "no token",
            whole.replace(&format!("token={token}&"), ""),
            403,
        ),
        (
            "half a token",
            whole.replace(&token, &format!("{:032}", 0)),
            403,
        ),
        (
            "no token and no origin",
            whole
                .replace(own, "")
                .replace(&token, "ffffffffffffffffffffffffffffffff"),
            403,
        ),
        (
            "plain text",
            whole.replace("x-www-form-urlencoded", "json"),
            415,
        ),
    ] {
        // The length is still right where only the head was changed; else it is set right.
        let (head, body) = request.split_once("\r\n\r\n").unwrap();
        let head: String = head
            .lines()
            .map(|line| match line.strip_prefix("Content-Length: ") {
                Some(_) => format!("Content-Length: {}\r\n", body.len()),
                None => format!("{line}\r\n"),
            })
            .collect();
        let (outcome, reply) = board.ask(format!("{head}\r\n{body}").as_bytes());
        assert_eq!(reply.status, status, "{what}");
        assert_eq!(outcome, Outcome::Answered, "{what}");
        assert_eq!(board.kept().settings, None, "{what}");
        let own_page = reply.body.contains("has restarted meanwhile");
        assert_eq!(own_page, what.ends_with("token"), "{what}: {}", reply.body);
    }
    // Without an origin, the token alone proves that the page was read.
    let (outcome, _) = board.ask(whole.replace(own, "").as_bytes());
    assert!(matches!(outcome, Outcome::Saved(_)));
}

#[test]
fn phones_that_look_for_the_internet_are_sent_to_the_page() {
    let mut board = Board::new();
    board.portal.captive = Some(core::net::Ipv4Addr::new(192, 168, 4, 1));
    for (host, path) in [
        ("captive.apple.com", "/hotspot-detect.html"),
        ("connectivitycheck.gstatic.com", "/generate_204"),
        ("www.msftconnecttest.com", "/connecttest.txt"),
        ("[2001:db8::1]", "/"),
        ("a_b.example:8080", "/"),
    ] {
        let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n");
        let (outcome, reply) = board.ask(request.as_bytes());
        assert_eq!((outcome, reply.status), (Outcome::Answered, 302), "{host}");
        assert_eq!(reply.header("Location"), Some("http://192.168.4.1/"));
    }
    let request = b"POST /settings HTTP/1.1\r\nHost: a.b\r\nContent-Length: 0\r\n\r\n";
    assert_eq!(board.ask(request).1.status, 421);
    board.portal.captive = None;
    let request = b"GET / HTTP/1.1\r\nHost: a.b\r\n\r\n";
    assert_eq!(board.ask(request).1.status, 421);
}

#[test]
fn requests_that_are_not_understood_are_refused_by_name() {
    let host = "Host: 192.168.4.1\r\n";
    let long = "x".repeat(3_100);
    let many = "A: b\r\n".repeat(40);
    let form = "Content-Type: application/x-www-form-urlencoded\r\n";
    for (request, status) in [
        (format!("GET /nothing HTTP/1.1\r\n{host}\r\n"), 404),
        (format!("GET /settings HTTP/1.1\r\n{host}\r\n"), 405),
        (format!("POST / HTTP/1.1\r\n{host}\r\n"), 405),
        (format!("POST /networks HTTP/1.1\r\n{host}\r\n"), 405),
        (format!("DELETE / HTTP/1.1\r\n{host}\r\n"), 405),
        (format!("OPTIONS * HTTP/1.1\r\n{host}\r\n"), 400),
        (
            format!("GET http://192.168.4.1/ HTTP/1.1\r\n{host}\r\n"),
            400,
        ),
        ("GET / HTTP/1.1\r\n\r\n".into(), 400),
        (format!("GET / HTTP/1.1\r\n{host}{host}\r\n"), 400),
        ("GET / HTTP/1.1\r\nHost: \r\n\r\n".into(), 400),
        ("GET / HTTP/1.1\r\nHost: a b\r\n\r\n".into(), 400),
        (format!("GET / HTTP/2.0\r\n{host}\r\n"), 505),
        (format!("GET / HTTP/1.1\r\n{host} folded: x\r\n\r\n"), 400),
        (format!("GET / HTTP/1.1\r\n{host}X: {long}\r\n\r\n"), 431),
        (format!("GET / HTTP/1.1\r\n{host}{many}\r\n"), 431),
        ("\x16\x03\x01\x02\x00\x01".into(), 400),
        ("hello\r\n".into(), 400),
        (format!("POST /settings HTTP/1.1\r\n{host}{form}\r\n"), 411),
        (
            format!("POST /settings HTTP/1.1\r\n{host}{form}Content-Length: 9999\r\n\r\n"),
            413,
        ),
        (
            format!(
                "POST /settings HTTP/1.1\r\n{host}{form}Content-Length: 99999999999999999999999\r\n\r\n"
            ),
            413,
        ),
        (
            format!("POST /settings HTTP/1.1\r\n{host}{form}Content-Length: +1\r\n\r\n"),
            400,
        ),
        (
            format!("POST /settings HTTP/1.1\r\n{host}{form}Content-Length: 1, 1\r\n\r\n"),
            400,
        ),
        (
            format!(
                "POST /settings HTTP/1.1\r\n{host}{form}Content-Length: 1\r\nContent-Length: 1\r\n\r\n"
            ),
            400,
        ),
        (
            format!("POST /settings HTTP/1.1\r\n{host}{form}Transfer-Encoding: chunked\r\n\r\n"),
            501,
        ),
        (
            format!("POST /settings HTTP/1.1\r\n{host}{form}Expect: 100-continue\r\n\r\n"),
            417,
        ),
        (
            format!("POST /settings HTTP/1.1\r\n{host}{form}Content-Length: 3\r\n\r\na=b"),
            400,
        ),
        (
            format!("POST /settings HTTP/1.1\r\n{host}{form}Content-Length: 0\r\n\r\n"),
            403,
        ),
    ] {
        let (outcome, reply) = Board::new().ask(request.as_bytes());
        assert_eq!(reply.status, status, "{request}");
        assert_eq!(outcome, Outcome::Answered, "{request}");
        assert_eq!(reply.header("Allow").is_some(), status == 405);
    }
}

#[test]
fn head_is_get_without_a_body() {
    let mut board = Board::new();
    let (_, reply) = board.ask(b"HEAD / HTTP/1.1\r\nHost: 10.0.0.1\r\n\r\n");
    assert_eq!((reply.status, reply.body.len()), (200, 0));
    assert_ne!(reply.header("Content-Length"), Some("0"));
}

#[test]
fn networks_are_told_strongest_first_and_a_failing_radio_is_said() {
    let mut board = Board::new();
    let reply = board.get("/networks");
    assert_eq!(reply.header("Content-Type"), Some("application/json"));
    let found: serde_json::Value = serde_json::from_str(&reply.body).expect("JSON");
    assert_eq!(found[0]["ssid"], "</script>");
    assert_eq!(found[0]["open"], true);
    assert_eq!(found[1]["ssid"], "weak \"one\"");
    assert_eq!(found[1]["rssi_dbm"], -80);
    board.radio.fails = true;
    let reply = board.get("/networks");
    assert_eq!(
        (reply.status, reply.header("Retry-After")),
        (503, Some("3"))
    );
}

#[test]
fn only_people_count_as_users_of_the_page() {
    let board = Board::new();
    assert_eq!(board.portal.features, ALL);
    let mut board = board;
    let mut used = |request: &[u8]| {
        let mut peer = board.peer(std::vec![(0, request.to_vec())]);
        let server = super::harness::TestServer::new(
            board.portal.clone(),
            crate::settings::Vault::new(&mut board.flash),
            &mut board.radio,
            board.clock.clone(),
        );
        let mut buffer = [0; BUFFER];
        board
            .clock
            .clone()
            .run(server.converse(&mut peer, &mut buffer));
        server.last_used().is_some()
    };
    assert!(used(b"GET / HTTP/1.1\r\nHost: 192.168.4.1\r\n\r\n"));
    assert!(!used(b"GET / HTTP/1.1\r\nHost: captive.apple.com\r\n\r\n"));
    assert!(!used(
        b"GET /favicon.ico HTTP/1.1\r\nHost: 192.168.4.1\r\n\r\n"
    ));
    assert!(!used(b"rubbish"));
}
