//! The audit log on a disk that takes nothing of it for a while: nothing is lost, and what would be is not
//! done.

use crate::support::closed::{ADMIN, OPERATOR};
use crate::support::{Fixture, eventually};
use hyper::Method;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{Connection as _, Executor as _};

const SWARM: &str = "/api/v1/swarm/commands";
const STOP: &str = r#"{"command":"stop"}"#;
const USER: &str = r#"{"name":"bob","role":"viewer","password":"a secret of bob"}"#;

/// Has the log of a server refuse lines from here on, or take them again.
async fn set_full(fixture: &Fixture, full: bool) {
    let file = fixture.settings.data.join(crawler_records::RECORDS_FILE);
    let options = SqliteConnectOptions::new().filename(file);
    let mut connection = SqliteConnection::connect_with(&options)
        .await
        .expect("a connection");
    let change = if full {
        "CREATE TRIGGER disk_full BEFORE INSERT ON audit
         BEGIN SELECT RAISE(ABORT, 'database or disk is full'); END"
    } else {
        "DROP TRIGGER disk_full"
    };
    connection.execute(change).await.expect("changed");
    connection.close().await.expect("closed");
}

async fn metric(fixture: &Fixture, name: &str) -> String {
    let text = fixture.get("/metrics").await;
    let lines = text.text().lines();
    let mut found = lines.filter_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    found.next().expect("there").to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn halts_go_while_the_log_takes_nothing_and_are_in_it_afterwards() {
    let fixture = Fixture::closed().await;
    let admin = fixture.login(ADMIN).await.token;
    let operator = fixture.login(OPERATOR).await.token;
    let call = async |token: &str, method, path: &str, body: &str| {
        fixture.call_as(token, method, path, body).await
    };
    set_full(&fixture, true).await;
    let mut ids = Vec::new();
    for _ in 0..7 {
        let sent = call(&operator, Method::POST, SWARM, STOP).await;
        assert_eq!(sent.status, 202, "{}", sent.text());
        ids.push(sent.json()["id"].clone());
    }
    eventually("the server is not ready", async || {
        let ready = fixture.get("/readyz").await;
        ready.status == 503 && ready.json()["audit"] == false
    })
    .await;
    assert_eq!(metric(&fixture, "terracrawler_audit_log_up").await, "0");

    // What has to be in the log is not done.
    let refused = call(&admin, Method::POST, "/api/v1/users", USER).await;
    refused.is_problem(503, "not_audited");
    let set = r#"{"command":"set","parameters":{"safe_distance_mm":420}}"#;
    let refused = call(&operator, Method::POST, SWARM, set).await;
    refused.is_problem(503, "not_audited");
    let path = "/api/v1/robots/rover-1/credential";
    let refused = call(&admin, Method::POST, path, "").await;
    refused.is_problem(503, "not_audited");
    // Looking changes nothing.
    let users = call(&admin, Method::GET, "/api/v1/users", "").await;
    assert_eq!(users.status, 200, "{}", users.text());
    assert!(!users.text().contains("bob"), "{}", users.text());

    set_full(&fixture, false).await;
    eventually("the server is ready again", async || {
        let ready = fixture.get("/readyz").await;
        ready.status == 200 && ready.json()["audit"].is_null()
    })
    .await;
    let mut stops = Vec::new();
    for entry in fixture.audit(&admin).await.iter().rev() {
        if entry["detail"]["request"]["command"] == "stop" {
            assert_eq!(entry["outcome"], "ok", "{entry}");
            stops.push(entry["detail"]["id"].clone());
        }
    }
    assert_eq!(stops, ids, "each of them, in their order");
    let verdict = call(&admin, Method::GET, "/api/v1/audit/verify", "")
        .await
        .json();
    assert_eq!(verdict["intact"], true, "{verdict}");
    assert_eq!(verdict["lost"], 0, "{verdict}");
    assert_eq!(metric(&fixture, "terracrawler_audit_log_up").await, "1");
    assert_eq!(
        metric(&fixture, "terracrawler_audit_log_waiting").await,
        "0"
    );
    let added = call(&admin, Method::POST, "/api/v1/users", USER).await;
    assert!(added.status.is_success(), "{}", added.text());
    fixture.stop().await;
}
