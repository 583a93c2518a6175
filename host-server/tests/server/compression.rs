//! What goes in gzip, what does not, and which wishes of a reader count.

use std::io::Read as _;

use crate::support::Fixture;
use crate::support::closed::ADMIN;
use hyper::Method;
use serde_json::Value;

const TAKES_GZIP: [(&str, &str); 1] = [("accept-encoding", "br;q=0.5, gzip, deflate")];

fn unzipped(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut reader = flate2::read::GzDecoder::new(bytes);
    reader.read_to_end(&mut out).expect("gzip");
    out
}

#[tokio::test(flavor = "multi_thread")]
async fn long_text_goes_in_gzip_to_who_takes_it() {
    let fixture = Fixture::start().await;
    for number in 0..20 {
        let robot = fixture.robot(&format!("r-{number}")).await;
        robot.introduce().await;
        fixture
            .wait_presence(&format!("r-{number}"), "online")
            .await;
    }
    for path in [
        "/api/v1/openapi.json",
        "/api/v1/schema/command",
        "/api/v1/robots",
        "/metrics",
    ] {
        let plain = fixture.get(path).await;
        assert_eq!(plain.header("content-encoding"), "", "{path}");
        assert_eq!(plain.header("vary"), "accept-encoding", "{path}");
        let zipped = fixture.call(Method::GET, path, &TAKES_GZIP, "").await;
        assert_eq!(zipped.status, 200, "{path}");
        assert_eq!(zipped.header("content-encoding"), "gzip", "{path}");
        assert_eq!(zipped.header("vary"), "accept-encoding", "{path}");
        assert_eq!(zipped.header("content-type"), plain.header("content-type"));
        let (short, long) = (zipped.body.len(), plain.body.len());
        assert!(short * 2 < long, "{path}: {short} of {long} bytes");
        let text = unzipped(&zipped.body);
        if path == "/api/v1/openapi.json" {
            assert_eq!(text, plain.body, "{path}");
        } else if path != "/metrics" {
            assert!(serde_json::from_slice::<Value>(&text).is_ok(), "{path}");
        }
        // Who takes it only if there is nothing else, and who takes nothing.
        let unwanted = [("accept-encoding", "gzip;q=0")];
        let unwanted = fixture.call(Method::GET, path, &unwanted, "").await;
        assert_eq!(unwanted.header("content-encoding"), "", "{path}");
        let neither = [("accept-encoding", "gzip;q=0, identity;q=0")];
        let neither = fixture.call(Method::GET, path, &neither, "").await;
        neither.is_problem(406, "not_acceptable");
    }
    // Short ones, errors and whatever is not read go as they are.
    for path in ["/healthz", "/api/v1/history", "/api/v1/robots/nobody"] {
        let answer = fixture.call(Method::GET, path, &TAKES_GZIP, "").await;
        assert_eq!(answer.header("content-encoding"), "", "{path}");
    }
    let head = fixture
        .call(Method::HEAD, "/api/v1/openapi.json", &TAKES_GZIP, "")
        .await;
    assert_eq!(head.header("content-encoding"), "");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_halt_is_obeyed_and_answered_whatever_encoding_is_asked_for() {
    let fixture = Fixture::start().await;
    let robot = fixture.robot("a").await;
    robot.introduce().await;
    fixture.wait_presence("a", "online").await;
    let headers = [
        ("content-type", "application/json"),
        ("accept-encoding", "identity;q=0"),
    ];
    let path = "/api/v1/robots/a/commands";
    let stop = r#"{"command": "stop"}"#;
    let answer = fixture.call(Method::POST, path, &headers, stop).await;
    assert_eq!(answer.status, 202, "{}", answer.text());
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_said_of_secrets_goes_as_it_is() {
    let fixture = Fixture::closed().await;
    let admin = fixture.login(ADMIN).await;
    let bearer = format!("Bearer {}", admin.token);
    let headers = [
        ("authorization", bearer.as_str()),
        ("accept-encoding", "gzip"),
    ];
    // Long enough in the end.
    let path = "/api/v1/sessions?all=true";
    loop {
        let answer = fixture.call(Method::GET, path, &headers, "").await;
        assert_eq!(answer.status, 200, "{}", answer.text());
        assert_eq!(answer.header("content-encoding"), "");
        if answer.body.len() > 4_096 {
            break;
        }
        fixture.login(ADMIN).await;
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_of_the_control_room_is_known_again_in_either_encoding() {
    let fixture = Fixture::start().await;
    let plain = fixture.get("/").await;
    let tag = plain.header("etag").to_owned();
    // Without the control room there is a page of help, which has no tag.
    if !tag.is_empty() {
        assert!(tag.starts_with("W/\""), "{tag}");
        assert_eq!(plain.header("vary"), "accept-encoding");
        let zipped = fixture.call(Method::GET, "/", &TAKES_GZIP, "").await;
        assert_eq!(zipped.header("content-encoding"), "gzip");
        assert_eq!(zipped.header("etag"), tag);
        assert_eq!(unzipped(&zipped.body), plain.body);
        for encoding in ["gzip", "identity"] {
            let headers = [
                ("if-none-match", tag.as_str()),
                ("accept-encoding", encoding),
            ];
            let same = fixture.call(Method::GET, "/", &headers, "").await;
            assert_eq!((same.status.as_u16(), same.body.len()), (304, 0));
            assert_eq!(same.header("etag"), tag);
            assert_eq!(same.header("vary"), "accept-encoding");
        }
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn there_is_one_form_of_everything_whatever_a_reader_accepts() {
    let fixture = Fixture::start().await;
    for wanted in ["application/xml", "text/html;q=0.9, */*;q=0", "none of it"] {
        let headers = [("accept", wanted)];
        let list = fixture
            .call(Method::GET, "/api/v1/robots", &headers, "")
            .await;
        assert_eq!(list.status, 200, "{wanted}");
        assert_eq!(list.header("content-type"), "application/json", "{wanted}");
        let none = fixture
            .call(Method::GET, "/api/v1/robots/no", &headers, "")
            .await;
        none.is_problem(404, "unknown_robot");
    }
    fixture.stop().await;
}
