//! Sessions: opened, refreshed, stolen, ended; and the live feed's tickets.

mod support;

use std::time::{Duration, Instant};

use futures_util::StreamExt as _;
use hyper::Method;
use serde_json::json;
use support::closed::{ADMIN, Login, OPERATOR, PASSWORD, VIEWER};
use support::{Answer, Fixture, eventually, within};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

#[tokio::test(flavor = "multi_thread")]
async fn a_password_opens_a_session() {
    let fixture = Fixture::closed().await;
    fixture
        .get("/api/v1/session")
        .await
        .is_problem(401, "unauthenticated");
    let answer = fixture.try_login(OPERATOR, PASSWORD).await;
    let cookie = answer.header("set-cookie").to_owned();
    for part in [
        "terracrawler_refresh=",
        "; HttpOnly",
        "; SameSite=Strict",
        "; Path=/api/v1/session",
    ] {
        assert!(cookie.contains(part), "{part} in {cookie}");
    }
    assert!(!cookie.contains("Secure"), "not over TLS");
    assert_eq!(answer.header("cache-control"), "no-store");
    let login = Login::of(&answer);
    assert_eq!(login.answer["expires_in"], 900);
    assert_eq!(login.answer["role"], "operator");
    assert_eq!(
        fixture.get_as(&login.token, "/api/v1/session").await.json(),
        json!({ "open": false, "user": OPERATOR, "role": "operator" })
    );
    for (user, password) in [
        (OPERATOR, "wrong, entirely"),
        ("nobody", PASSWORD),
        ("' or 1=1 --", PASSWORD),
        ("", ""),
        (OPERATOR, &"x".repeat(3_000)),
    ] {
        fixture
            .try_login(user, password)
            .await
            .is_problem(401, "bad_credentials");
    }
    for (body, status, code) in [
        ("", 400, "malformed"),
        ("[]", 422, "invalid_body"),
        (r#"{"user":"ada"}"#, 422, "invalid_body"),
        (
            r#"{"user":"ada","password":"x","role":"admin"}"#,
            422,
            "invalid_body",
        ),
        (
            r#"{"user":"ada","user":"bob","password":"x"}"#,
            422,
            "invalid_body",
        ),
    ] {
        fixture
            .post("/api/v1/session", body)
            .await
            .is_problem(status, code);
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn guessing_takes_longer_and_longer() {
    let fixture = Fixture::closed().await;
    // Where the wait is over before the next attempt, because the machine is that slow, the right
    // password is let in. Then it all begins anew.
    for _ in 0..3 {
        let (wait, begun) = too_many_guesses(&fixture).await;
        let attempt = fixture.try_login(VIEWER, PASSWORD).await;
        if attempt.status == 200 {
            assert!(begun.elapsed() >= wait, "let in before {wait:?}");
            continue;
        }
        attempt.is_problem(429, "too_many_attempts");
        let seconds: u64 = attempt.header("retry-after").parse().expect("seconds");
        assert!((1..=wait.as_secs()).contains(&seconds), "{seconds}");
        // Others at the same address are not locked out with it.
        fixture.login(OPERATOR).await;
        tokio::time::sleep(Duration::from_secs(seconds)).await;
        fixture.login(VIEWER).await;
        assert!(begun.elapsed() >= wait, "let in before {wait:?}");
        fixture.stop().await;
        return;
    }
    panic!("the right password was never refused");
}

/// Guesses until there were too many. Returns for how long nobody is let in then, and when the last
/// guess that counts began, or before.
async fn too_many_guesses(fixture: &Fixture) -> (Duration, Instant) {
    let mut last = Instant::now();
    for guesses in 0..10_u32 {
        let begun = Instant::now();
        let answer = fixture.try_login(VIEWER, "a wrong guess").await;
        if answer.status == 401 {
            answer.is_problem(401, "bad_credentials");
            last = begun;
            continue;
        }
        answer.is_problem(429, "too_many_attempts");
        let beyond = guesses.checked_sub(5).expect("five are free");
        return (Duration::from_secs(2 << beyond), last);
    }
    panic!("nothing holds the guesses up");
}

/// For so long after the first page of a browser has refreshed, another is no thief.
const MOMENT: Duration = Duration::from_secs(2);

#[tokio::test(flavor = "multi_thread")]
async fn a_refresh_token_is_good_once() {
    let fixture = Fixture::closed().await;
    // Where the machine is so slow that the moment is over before the second page asks, the two try
    // again.
    let (login, next, begun) = loop {
        let login = fixture.login(OPERATOR).await;
        let begun = Instant::now();
        let next = Login::of(&fixture.refresh(&login.cookie).await);
        assert_ne!(next.cookie, login.cookie);
        assert_eq!(next.answer["user"], OPERATOR);
        // Two pages of one browser refresh at the same moment: the second gets a token, no cookie.
        let twin = fixture.refresh(&login.cookie).await;
        if twin.status == 200 {
            assert_eq!(twin.header("set-cookie"), "");
            break (login, next, begun);
        }
        twin.is_problem(401, "no_session");
        assert!(begun.elapsed() > MOMENT, "{}", twin.text());
    };
    assert_eq!(
        fixture.get_as(&next.token, "/api/v1/robots").await.status,
        200
    );
    // Later, it can only be a copy. Whoever has it, thief or not, is out.
    let mut stolen = fixture.refresh(&login.cookie).await;
    eventually("a copy", async || {
        stolen = fixture.refresh(&login.cookie).await;
        stolen.status != 200
    })
    .await;
    assert!(begun.elapsed() > MOMENT);
    stolen.is_problem(401, "no_session");
    assert!(stolen.header("set-cookie").contains("Max-Age=0"));
    fixture
        .refresh(&next.cookie)
        .await
        .is_problem(401, "no_session");
    fixture
        .get_as(&next.token, "/api/v1/robots")
        .await
        .is_problem(401, "unauthenticated");

    for cookie in [
        "",
        "terracrawler_refresh=",
        "terracrawler_refresh=x",
        "other=1; terracrawler_refresh=AAAA",
    ] {
        fixture.refresh(cookie).await.is_problem(401, "no_session");
    }
    fixture.stop().await;
}

/// Whether an answer brings the next refresh token.
fn is_next(answer: &Answer) -> bool {
    answer.status == 200 && !answer.header("set-cookie").is_empty()
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_that_refresh_at_once_are_no_thieves() {
    let fixture = Fixture::closed().await;
    let mut cookie = fixture.login(OPERATOR).await.cookie;
    for _ in 0..20 {
        let begun = Instant::now();
        let answers = tokio::join!(fixture.refresh(&cookie), fixture.refresh(&cookie));
        let (next, twin) = match answers {
            (one, other) if !is_next(&one) => (other, one),
            answers => answers,
        };
        // Which of them came first does not matter, and the other gets a token, too.
        if twin.status == 200 {
            assert_eq!(twin.header("set-cookie"), "");
            cookie = Login::of(&next).cookie;
            continue;
        }
        // The machine is so slow that it was too late.
        assert!(begun.elapsed() > MOMENT, "{}", twin.text());
        cookie = fixture.login(OPERATOR).await.cookie;
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_others_cannot_use_the_cookie() {
    let fixture = Fixture::closed().await;
    let login = fixture.login(ADMIN).await;
    for (name, value) in [
        ("origin", "https://evil.example"),
        ("origin", "null"),
        ("sec-fetch-site", "cross-site"),
    ] {
        let headers = [("cookie", login.cookie.as_str()), (name, value)];
        for method in [Method::POST, Method::DELETE] {
            let path = match method {
                Method::POST => "/api/v1/session/refresh",
                _ => "/api/v1/session",
            };
            let answer = fixture.call(method, path, &headers, "").await;
            answer.is_problem(403, "foreign_origin");
            assert_eq!(answer.header("set-cookie"), "");
        }
    }
    // The cookie alone is nobody, except for going on with the session.
    let headers = [("cookie", login.cookie.as_str())];
    fixture
        .call(Method::GET, "/api/v1/users", &headers, "")
        .await
        .is_problem(401, "unauthenticated");
    let own = format!("http://{}", fixture.server.http());
    let headers = [
        ("cookie", login.cookie.as_str()),
        ("origin", own.as_str()),
        ("sec-fetch-site", "same-origin"),
    ];
    let path = "/api/v1/session/refresh";
    let answer = fixture.call(Method::POST, path, &headers, "").await;
    assert_eq!(answer.status, 200);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn logging_out_ends_the_session() {
    let fixture = Fixture::closed().await;
    for by_cookie in [true, false] {
        let login = fixture.login(VIEWER).await;
        let path = "/api/v1/session";
        let out = if by_cookie {
            fixture
                .call_with_cookie(Method::DELETE, path, &login.cookie)
                .await
        } else {
            fixture
                .call_as(&login.token, Method::DELETE, path, "")
                .await
        };
        assert_eq!(out.status, 204);
        assert!(out.header("set-cookie").contains("Max-Age=0"));
        fixture
            .get_as(&login.token, "/api/v1/robots")
            .await
            .is_problem(401, "unauthenticated");
        fixture
            .refresh(&login.cookie)
            .await
            .is_problem(401, "no_session");
    }
    let again = fixture
        .call(Method::DELETE, "/api/v1/session", &[], "")
        .await;
    assert_eq!(again.status, 204, "there is nothing to do");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn another_password_ends_the_other_sessions() {
    let fixture = Fixture::closed().await;
    let here = fixture.login(VIEWER).await;
    let there = fixture.login(VIEWER).await;
    let put = async |old: &str, new: &str| {
        let body = json!({ "old": old, "new": new }).to_string();
        let path = "/api/v1/session/password";
        fixture.call_as(&here.token, Method::PUT, path, &body).await
    };
    put("wrong, entirely", "a better password")
        .await
        .is_problem(401, "bad_credentials");
    put(PASSWORD, "short")
        .await
        .is_problem(422, "weak_password");
    assert_eq!(put(PASSWORD, "a better password").await.status, 204);
    assert_eq!(
        fixture.get_as(&here.token, "/api/v1/robots").await.status,
        200
    );
    fixture
        .get_as(&there.token, "/api/v1/robots")
        .await
        .is_problem(401, "unauthenticated");
    fixture
        .try_login(VIEWER, PASSWORD)
        .await
        .is_problem(401, "bad_credentials");
    Login::of(&fixture.try_login(VIEWER, "a better password").await);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_are_listed_and_ended() {
    let fixture = Fixture::closed().await;
    let admin = fixture.login(ADMIN).await.token;
    let viewer = fixture.login(VIEWER).await.token;
    let other = fixture.login(VIEWER).await.token;
    let list = async |token: &str, path: &str| {
        let answer = fixture.get_as(token, path).await;
        assert_eq!(answer.status, 200, "{}", answer.text());
        answer.json()["sessions"]
            .as_array()
            .expect("sessions")
            .clone()
    };
    let own = list(&viewer, "/api/v1/sessions").await;
    assert_eq!(own.len(), 2);
    assert!(own.iter().all(|session| session["user"] == VIEWER));
    assert!(own.iter().all(|session| session["from"] == "127.0.0.1"));
    let current = own.iter().filter(|session| session["current"] == true);
    assert_eq!(current.count(), 1);
    assert_eq!(list(&admin, "/api/v1/sessions?all=true").await.len(), 3);
    fixture
        .get_as(&viewer, "/api/v1/sessions?all=true")
        .await
        .is_problem(403, "forbidden");

    let of_admin = list(&admin, "/api/v1/sessions").await[0]["id"].clone();
    let end = async |token: &str, id: &str| {
        let path = format!("/api/v1/sessions/{id}");
        fixture.call_as(token, Method::DELETE, &path, "").await
    };
    // Those of others are not even there.
    end(&viewer, of_admin.as_str().expect("id"))
        .await
        .is_problem(404, "unknown_session");
    end(&viewer, "0").await.is_problem(404, "unknown_session");
    end(&viewer, "x").await.is_problem(404, "unknown_session");
    let not_current = own.iter().find(|session| session["current"] == false);
    let not_current = not_current.expect("the other")["id"].as_str().expect("id");
    assert_eq!(end(&viewer, not_current).await.status, 204);
    fixture
        .get_as(&other, "/api/v1/robots")
        .await
        .is_problem(401, "unauthenticated");
    assert_eq!(fixture.get_as(&viewer, "/api/v1/robots").await.status, 200);
    fixture.stop().await;
}

type Socket = WebSocketStream<TcpStream>;

async fn connect(fixture: &Fixture, query: &str, origin: Option<&str>) -> Result<Socket, Error> {
    let address = fixture.server.http();
    let mut request = format!("ws://{address}/api/v1/live{query}")
        .into_client_request()
        .expect("request");
    if let Some(origin) = origin {
        let headers = request.headers_mut();
        headers.insert("origin", origin.parse().expect("origin"));
    }
    let stream = TcpStream::connect(address).await.expect("connect");
    client_async(request, stream)
        .await
        .map(|(socket, _)| socket)
}

#[track_caller]
fn refused(result: Result<Socket, Error>, status: u16) {
    match result {
        Err(Error::Http(response)) => assert_eq!(response.status(), status),
        other => panic!("{other:?}"),
    }
}

async fn ticket(fixture: &Fixture, token: &str) -> String {
    let path = "/api/v1/session/ticket";
    let answer = fixture.call_as(token, Method::POST, path, "").await;
    assert_eq!(answer.status, 200, "{}", answer.text());
    assert_eq!(answer.json()["expires_in"], 30);
    let ticket = answer.json()["ticket"]
        .as_str()
        .expect("a ticket")
        .to_owned();
    format!("?ticket={ticket}")
}

#[tokio::test(flavor = "multi_thread")]
async fn the_live_feed_takes_a_ticket_once() {
    let fixture = Fixture::closed().await;
    let viewer = fixture.login(VIEWER).await.token;
    refused(connect(&fixture, "", None).await, 401);
    refused(connect(&fixture, "?ticket=", None).await, 401);
    refused(connect(&fixture, "?ticket=x", None).await, 401);
    // A token is no ticket: it would end up in logs.
    let token = format!("?ticket={viewer}");
    refused(connect(&fixture, &token, None).await, 401);

    let first = ticket(&fixture, &viewer).await;
    let own = format!("http://{}", fixture.server.http());
    let mut socket = connect(&fixture, &first, Some(&own)).await.expect("in");
    let hello = socket.next().await.expect("open").expect("a frame");
    assert!(matches!(hello, Message::Binary(_)));
    refused(connect(&fixture, &first, None).await, 401);

    let second = ticket(&fixture, &viewer).await;
    let evil = Some("https://evil.example");
    refused(connect(&fixture, &second, evil).await, 403);
    // A ticket ends with its session.
    fixture
        .call_as(&viewer, Method::DELETE, "/api/v1/session", "")
        .await;
    refused(connect(&fixture, &second, None).await, 401);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn readers_are_sent_away_when_their_session_ends() {
    let fixture = Fixture::closed().await;
    let viewer = fixture.login(VIEWER).await.token;
    let admin = fixture.login(ADMIN).await.token;
    let query = ticket(&fixture, &viewer).await;
    let mut socket = connect(&fixture, &query, None).await.expect("in");
    let path = format!("/api/v1/users/{VIEWER}");
    let locked = r#"{"disabled":true}"#;
    let answer = fixture.call_as(&admin, Method::PATCH, &path, locked).await;
    assert_eq!(answer.status, 200);
    let closed = async {
        loop {
            match socket.next().await {
                Some(Ok(Message::Close(Some(close)))) => {
                    return (u16::from(close.code), close.reason.to_string());
                }
                Some(Ok(_)) => {}
                other => panic!("{other:?}"),
            }
        }
    };
    let (code, reason) = within("the reader is sent away", closed).await;
    assert_eq!((code, reason.as_str()), (1008, "the session was ended"));
    fixture.stop().await;
}
