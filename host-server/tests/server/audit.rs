//! The audit log: everything that somebody does is in it, and nothing of it can be taken out.

use crate::support::closed::{ADMIN, OPERATOR, PASSWORD, VIEWER};
use crate::support::{Fixture, eventually};
use hyper::Method;
use serde_json::{Value, json};

#[tokio::test(flavor = "multi_thread")]
async fn whatever_somebody_does_is_written_down() {
    let fixture = Fixture::closed().await;
    let admin = fixture.login(ADMIN).await.token;
    let check = async |action: &str, who: &str, target: &str, outcome: &str| {
        let mut entry = Value::Null;
        // Of halts and motion it is written a moment later.
        eventually(&format!("{action} by {who}: {outcome}"), async || {
            let entries = fixture.audit(&admin).await;
            let of_action = entries.iter().find(|entry| entry["action"] == action);
            entry = of_action.cloned().unwrap_or_default();
            (&entry["who"], &entry["target"], &entry["outcome"])
                == (&json!(who), &json!(target), &json!(outcome))
        })
        .await;
        assert_eq!(entry["from"], "127.0.0.1", "{entry}");
        assert!(entry["at"].as_i64() > Some(1_600_000_000_000), "{entry}");
        assert_eq!(entry["hash"].as_str().map(str::len), Some(64), "{entry}");
        entry
    };
    check("login", ADMIN, ADMIN, "ok").await;
    fixture.try_login(VIEWER, "wrong, entirely").await;
    check("login", "anonymous", VIEWER, "bad_credentials").await;
    // Some type the password where the name belongs.
    fixture.try_login(PASSWORD, "").await;
    check("login", "anonymous", "(no name)", "bad_credentials").await;

    let call = async |token: &str, method, path: &str, body: &str| {
        fixture.call_as(token, method, path, body).await
    };
    let operator = fixture.login(OPERATOR).await.token;
    let stop = r#"{"command":"stop"}"#;
    let sent = call(&operator, Method::POST, "/api/v1/swarm/commands", stop).await;
    let entry = check("command.send", OPERATOR, "swarm", "ok").await;
    assert_eq!(entry["detail"]["id"], sent.json()["id"]);
    assert_eq!(entry["detail"]["request"]["command"], "stop");
    let path = "/api/v1/robots/a/commands";
    call(&operator, Method::POST, path, stop).await;
    check("command.send", OPERATOR, "a", "unknown_robot").await;
    let path = "/api/v1/robots/a/parameters";
    call(&operator, Method::PUT, path, r#"{"safe_distance_mm":600}"#).await;
    let entry = check("command.send", OPERATOR, "a", "unknown_robot").await;
    assert_eq!(entry["detail"]["request"]["command"], "set");
    let path = "/api/v1/robots/a/faults";
    let fault = r#"{"fault":{"fault":"ranger-dead"}}"#;
    call(&operator, Method::POST, path, fault).await;
    check("fault.inject", OPERATOR, "a", "unknown_robot").await;
    call(&operator, Method::DELETE, path, "").await;
    check("fault.heal", OPERATOR, "a", "unknown_robot").await;

    let user = r#"{"name":"bob","role":"viewer","password":"a secret of bob"}"#;
    call(&admin, Method::POST, "/api/v1/users", user).await;
    check("user.add", ADMIN, "bob", "ok").await;
    call(&admin, Method::POST, "/api/v1/users", user).await;
    check("user.add", ADMIN, "bob", "user_exists").await;
    let path = "/api/v1/users/bob";
    call(&admin, Method::PATCH, path, r#"{"role":"operator"}"#).await;
    let entry = check("user.change", ADMIN, "bob", "ok").await;
    assert_eq!(entry["detail"]["role"], "operator");
    call(&admin, Method::DELETE, path, "").await;
    check("user.delete", ADMIN, "bob", "ok").await;
    let path = "/api/v1/robots/rover-1/credential";
    call(&admin, Method::POST, path, "").await;
    check("credential.enrol", ADMIN, "rover-1", "ok").await;
    call(&admin, Method::DELETE, path, "").await;
    check("credential.revoke", ADMIN, "rover-1", "ok").await;
    call(&admin, Method::DELETE, path, "").await;
    check("credential.revoke", ADMIN, "rover-1", "unknown_credential").await;
    let body = json!({ "old": PASSWORD, "new": "another of olga" }).to_string();
    call(&operator, Method::PUT, "/api/v1/session/password", &body).await;
    check("password.change", OPERATOR, OPERATOR, "ok").await;
    call(&operator, Method::DELETE, "/api/v1/session", "").await;
    check("logout", OPERATOR, OPERATOR, "ok").await;

    // What the command came to follows by itself, under the name of whoever gave it.
    eventually("the end of the command", async || {
        let entries = fixture.audit(&admin).await;
        entries.iter().any(|entry| {
            entry["action"] == "command.end"
                && entry["who"] == OPERATOR
                && entry["detail"]["id"] == sent.json()["id"]
        })
    })
    .await;

    // Nobody reads a secret there.
    let text = fixture.get_as(&admin, "/api/v1/audit?limit=1000").await;
    for secret in [
        PASSWORD,
        "wrong, entirely",
        "a secret of bob",
        "another of olga",
        "argon2",
    ] {
        assert!(!text.text().contains(secret), "{secret}");
    }
    assert_eq!(
        fixture.get_as(&admin, "/api/v1/audit/verify").await.json()["intact"],
        true
    );
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_log_is_read_page_by_page() {
    let fixture = Fixture::closed().await;
    let admin = fixture.login(ADMIN).await.token;
    let stop = r#"{"command":"stop"}"#;
    for _ in 0..5 {
        let path = "/api/v1/robots/a/commands";
        fixture.call_as(&admin, Method::POST, path, stop).await;
    }
    eventually("all is written down", async || {
        fixture.audit(&admin).await.len() == 6
    })
    .await;
    let mut numbers = Vec::new();
    let mut path = "/api/v1/audit?limit=2".to_owned();
    loop {
        let page = fixture.get_as(&admin, &path).await.json();
        let entries = page["entries"].as_array().expect("entries");
        assert!(entries.len() <= 2);
        numbers.extend(entries.iter().map(|entry| entry["seq"].as_u64()));
        let Some(next) = page["next"].as_u64() else {
            break;
        };
        path = format!("/api/v1/audit?limit=2&before={next}");
    }
    let all: Vec<_> = (1..=6).rev().map(Some).collect();
    assert_eq!(numbers, all);
    let none = fixture
        .get_as(&admin, "/api/v1/audit?who=olga")
        .await
        .json();
    assert_eq!(none, json!({ "entries": [], "next": null }));
    let own = format!("/api/v1/audit?who={ADMIN}");
    let own = fixture.get_as(&admin, &own).await.json();
    assert_eq!(own["entries"].as_array().map(Vec::len), Some(6));
    for query in ["limit=0", "limit=1001", "limit=x", "before=-1", "since=1"] {
        fixture
            .get_as(&admin, &format!("/api/v1/audit?{query}"))
            .await
            .is_problem(400, "bad_query");
    }
    let verdict = fixture.get_as(&admin, "/api/v1/audit/verify").await;
    assert_eq!(
        verdict.json(),
        json!({ "entries": 6, "intact": true, "broken_at": null, "lost": 0 })
    );
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_open_server_writes_it_down_too() {
    let fixture = Fixture::start().await;
    let stop = r#"{"command":"stop"}"#;
    fixture.post("/api/v1/swarm/commands", stop).await;
    let mut entry = Value::Null;
    eventually("written down", async || {
        let page = fixture.get("/api/v1/audit").await.json();
        let entries = page["entries"].as_array().expect("entries").iter();
        let mut of_action = entries.filter(|entry| entry["action"] == "command.send");
        entry = of_action.next().cloned().unwrap_or_default();
        !entry.is_null()
    })
    .await;
    assert_eq!(entry["who"], "anonymous");
    assert_eq!(entry["from"], "127.0.0.1");
    fixture.stop().await;
}
