//! Accounts over HTTP: how they come to be, change and go.

#[path = "support/mqtt.rs"]
mod mqtt;
mod support;

use crawler_server::config::Role;
use hyper::Method;
use mqtt::Closed;
use serde_json::{Value, json};
use support::closed::{ADMIN, Login, OPERATOR, PASSWORD, VIEWER};
use support::{Fixture, Scratch};

/// The code of an invitation's address.
#[track_caller]
fn code(link: &str) -> &str {
    let (page, code) = link.split_once("/#invite=").expect("an invitation");
    assert!(page.starts_with("http://"), "{link}");
    code
}

fn accept(code: &str, name: Option<&str>, password: &str) -> String {
    match name {
        Some(name) => json!({ "code": code, "name": name, "password": password }),
        None => json!({ "code": code, "password": password }),
    }
    .to_string()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_first_administrator_is_invited_by_the_server() {
    let fixture = Fixture::closed_at(Scratch::new(), Role::Serve, |_| {}).await;
    let link = fixture
        .server
        .invitation()
        .expect("nobody is there yet")
        .to_owned();
    assert!(link.contains(&fixture.server.http().to_string()), "{link}");
    let take = async |name, password| {
        let body = accept(code(&link), name, password);
        fixture.post("/api/v1/invitations", &body).await
    };
    take(None, PASSWORD).await.is_problem(422, "bad_name");
    take(Some("Ada Lovelace"), PASSWORD)
        .await
        .is_problem(422, "bad_name");
    take(Some("ada"), "short")
        .await
        .is_problem(422, "weak_password");
    // None of that has cost the invitation.
    let answer = take(Some("ada"), PASSWORD).await;
    let login = Login::of(&answer);
    assert_eq!(login.answer["role"], "admin");
    assert_eq!(login.answer["user"], "ada");
    assert_eq!(
        fixture.get_as(&login.token, "/api/v1/users").await.status,
        200
    );
    take(Some("eve"), PASSWORD)
        .await
        .is_problem(401, "bad_invitation");

    let scratch = fixture.leave().await;
    let again = Fixture::closed_at(scratch, Role::Serve, |_| {}).await;
    assert_eq!(again.server.invitation(), None, "there is an administrator");
    // The session outlives the server, and so does the token.
    assert_eq!(
        again.get_as(&login.token, "/api/v1/users").await.status,
        200
    );
    again.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invitation_nobody_took_is_worth_nothing_after_a_restart() {
    let first = Fixture::closed_at(Scratch::new(), Role::Serve, |_| {}).await;
    let link = first.server.invitation().expect("an invitation").to_owned();
    let scratch = first.leave().await;
    let second = Fixture::closed_at(scratch, Role::Serve, |_| {}).await;
    assert_ne!(second.server.invitation(), Some(link.as_str()));
    let body = accept(code(&link), Some("eve"), PASSWORD);
    second
        .post("/api/v1/invitations", &body)
        .await
        .is_problem(401, "bad_invitation");
    second.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_administrator_makes_changes_and_deletes_accounts() {
    let fixture = Fixture::closed().await;
    let admin = fixture.login(ADMIN).await.token;
    let call = async |method, path: &str, body: Value| {
        fixture
            .call_as(&admin, method, path, &body.to_string())
            .await
    };

    let made = call(
        Method::POST,
        "/api/v1/users",
        json!({ "name": "bob", "role": "viewer", "password": "a long password" }),
    )
    .await;
    assert_eq!(made.status, 201, "{}", made.text());
    assert_eq!(made.json()["user"]["name"], "bob");
    assert!(made.json()["invitation"].is_null());
    assert!(!made.text().contains("argon2"), "{}", made.text());
    let users = fixture.get_as(&admin, "/api/v1/users").await.json();
    let names: Vec<_> = users["users"]
        .as_array()
        .expect("users")
        .iter()
        .map(|user| user["name"].as_str().expect("name"))
        .collect();
    assert_eq!(names, [ADMIN, "bob", OPERATOR, VIEWER]);

    for (body, status, problem) in [
        (
            json!({ "name": "bob", "role": "viewer" }),
            409,
            "user_exists",
        ),
        (json!({ "name": "B", "role": "viewer" }), 422, "bad_name"),
        (
            json!({ "name": "carl", "role": "king" }),
            422,
            "invalid_body",
        ),
        (json!({ "name": "carl" }), 422, "invalid_body"),
        (
            json!({ "name": "carl", "role": "viewer", "root": true }),
            422,
            "invalid_body",
        ),
        (
            json!({ "name": "carl", "role": "viewer", "password": "short" }),
            422,
            "weak_password",
        ),
    ] {
        call(Method::POST, "/api/v1/users", body)
            .await
            .is_problem(status, problem);
    }

    let bob = Login::of(&fixture.try_login("bob", "a long password").await);
    let changed = call(
        Method::PATCH,
        "/api/v1/users/bob",
        json!({ "role": "operator" }),
    )
    .await;
    assert_eq!(changed.status, 200, "{}", changed.text());
    assert_eq!(changed.json()["role"], "operator");
    // What his token said is no longer true.
    fixture
        .get_as(&bob.token, "/api/v1/robots")
        .await
        .is_problem(401, "unauthenticated");
    let bob = Login::of(&fixture.try_login("bob", "a long password").await);
    assert_eq!(bob.answer["role"], "operator");

    let locked = json!({ "disabled": true });
    call(Method::PATCH, "/api/v1/users/bob", locked).await;
    fixture
        .get_as(&bob.token, "/api/v1/robots")
        .await
        .is_problem(401, "unauthenticated");
    fixture
        .refresh(&bob.cookie)
        .await
        .is_problem(401, "no_session");
    fixture
        .try_login("bob", "a long password")
        .await
        .is_problem(401, "bad_credentials");
    let unlocked = json!({ "disabled": false, "password": "another password" });
    call(Method::PATCH, "/api/v1/users/bob", unlocked).await;
    fixture
        .try_login("bob", "a long password")
        .await
        .is_problem(401, "bad_credentials");
    let bob = Login::of(&fixture.try_login("bob", "another password").await);

    let gone = fixture
        .call_as(&admin, Method::DELETE, "/api/v1/users/bob", "")
        .await;
    assert_eq!(gone.status, 204);
    fixture
        .get_as(&bob.token, "/api/v1/robots")
        .await
        .is_problem(401, "unauthenticated");
    for name in ["bob", "Bob!", "%00"] {
        fixture
            .call_as(&admin, Method::DELETE, &format!("/api/v1/users/{name}"), "")
            .await
            .is_problem(404, "unknown_user");
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn somebody_must_be_left_to_administer() {
    let fixture = Fixture::closed().await;
    let admin = fixture.login(ADMIN).await.token;
    let own = format!("/api/v1/users/{ADMIN}");
    for body in [r#"{"role":"viewer"}"#, r#"{"disabled":true}"#] {
        fixture
            .call_as(&admin, Method::PATCH, &own, body)
            .await
            .is_problem(409, "last_admin");
    }
    fixture
        .call_as(&admin, Method::DELETE, &own, "")
        .await
        .is_problem(409, "last_admin");
    // One who has not come yet does not count.
    let invited = r#"{"name":"later","role":"admin"}"#;
    let invited = fixture
        .call_as(&admin, Method::POST, "/api/v1/users", invited)
        .await;
    fixture
        .call_as(&admin, Method::DELETE, &own, "")
        .await
        .is_problem(409, "last_admin");
    let link = invited.json()["invitation"]
        .as_str()
        .expect("a link")
        .to_owned();
    let body = accept(code(&link), None, PASSWORD);
    Login::of(&fixture.post("/api/v1/invitations", &body).await);
    let gone = fixture.call_as(&admin, Method::DELETE, &own, "").await;
    assert_eq!(gone.status, 204, "{}", gone.text());
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invitation_is_good_once_and_for_one() {
    let fixture = Fixture::closed().await;
    let admin = fixture.login(ADMIN).await.token;
    let body = r#"{"name":"carl","role":"operator"}"#;
    let made = fixture
        .call_as(&admin, Method::POST, "/api/v1/users", body)
        .await;
    assert_eq!(made.status, 201);
    assert_eq!(made.json()["user"]["invited"], true);
    let link = made.json()["invitation"]
        .as_str()
        .expect("a link")
        .to_owned();
    // Nobody gets in without the invitation.
    fixture
        .try_login("carl", "")
        .await
        .is_problem(401, "bad_credentials");
    let take = async |name, password| {
        let body = accept(code(&link), name, password);
        fixture.post("/api/v1/invitations", &body).await
    };
    take(Some("eve"), PASSWORD)
        .await
        .is_problem(422, "bad_name");
    take(None, "short").await.is_problem(422, "weak_password");
    let login = Login::of(&take(None, PASSWORD).await);
    assert_eq!(login.answer["user"], "carl");
    assert_eq!(login.answer["role"], "operator");
    take(None, PASSWORD).await.is_problem(401, "bad_invitation");
    let other = accept(&"A".repeat(43), None, PASSWORD);
    fixture
        .post("/api/v1/invitations", &other)
        .await
        .is_problem(401, "bad_invitation");
    Login::of(&fixture.try_login("carl", PASSWORD).await);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn credentials_are_made_shown_once_and_revoked() {
    let fixture = Fixture::closed().await;
    let admin = fixture.login(ADMIN).await.token;
    let path = "/api/v1/robots/rover-1/credential";
    let made = fixture.call_as(&admin, Method::POST, path, "").await;
    assert_eq!(made.status, 201, "{}", made.text());
    let secret = made.json()["secret"].as_str().expect("a secret").to_owned();
    assert_eq!(secret.len(), 43);
    let url = made.json()["url"].as_str().expect("a URL").to_owned();
    let port = fixture.server.mqtt().port;
    assert_eq!(url, format!("mqtt://rover-1:{secret}@127.0.0.1:{port}"));
    let listed = fixture.get_as(&admin, "/api/v1/credentials").await;
    assert!(!listed.text().contains(&secret));
    assert_eq!(listed.json()["credentials"][0]["robot"], "rover-1");
    assert_eq!(listed.json()["credentials"][0]["by"], ADMIN);
    assert!(listed.json()["credentials"][0]["revoked"].is_null());
    let again = fixture.call_as(&admin, Method::POST, path, "").await;
    assert_ne!(again.json()["secret"], secret.as_str());

    let gone = fixture.call_as(&admin, Method::DELETE, path, "").await;
    assert_eq!(gone.status, 204);
    let listed = fixture.get_as(&admin, "/api/v1/credentials").await;
    assert!(listed.json()["credentials"][0]["revoked"].is_number());
    fixture
        .call_as(&admin, Method::DELETE, path, "")
        .await
        .is_problem(404, "unknown_credential");
    fixture
        .call_as(&admin, Method::POST, "/api/v1/robots/NO/credential", "")
        .await
        .is_problem(422, "bad_name");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_open_server_has_no_accounts() {
    let fixture = Fixture::start().await;
    assert_eq!(fixture.server.invitation(), None);
    assert_eq!(
        fixture.get("/api/v1/session").await.json(),
        json!({ "open": true, "user": null, "role": "admin" })
    );
    fixture
        .try_login(ADMIN, PASSWORD)
        .await
        .is_problem(409, "open_server");
    let code = accept(&"A".repeat(43), Some("eve"), PASSWORD);
    fixture
        .post("/api/v1/invitations", &code)
        .await
        .is_problem(409, "open_server");
    let ticket = fixture.post("/api/v1/session/ticket", "").await;
    ticket.is_problem(409, "open_server");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_whose_secret_is_taken_away_is_gone_at_once() {
    let fixture = Fixture::closed().await;
    let admin = fixture.login(ADMIN).await.token;
    let closed = Closed::around(fixture).await;
    let path = "/api/v1/robots/rover-1/credential";
    let enrol = async || {
        let made = closed.fixture.call_as(&admin, Method::POST, path, "").await;
        made.json()["secret"].as_str().expect("a secret").to_owned()
    };
    let first = enrol().await;
    let mut rover = closed.connect("rover-1", "rover-1", &first).await;
    // Another secret sends the robot with the old one away.
    let second = enrol().await;
    rover.ended().await;
    closed.refusal("rover-1", "rover-1", &first).await;
    let mut rover = closed.connect("rover-1", "rover-1", &second).await;
    closed
        .fixture
        .call_as(&admin, Method::DELETE, path, "")
        .await;
    rover.ended().await;
    closed.refusal("rover-1", "rover-1", &second).await;

    // So does another role, with a person.
    let mut olga = closed.connect("laptop", OPERATOR, PASSWORD).await;
    let user = format!("/api/v1/users/{OPERATOR}");
    let role = r#"{"role":"viewer"}"#;
    closed
        .fixture
        .call_as(&admin, Method::PATCH, &user, role)
        .await;
    olga.ended().await;
    closed.stop().await;
}
