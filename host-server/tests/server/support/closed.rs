//! A closed server with people in it, and what they do.

use std::sync::OnceLock;

use crawler_access::{Role as Rank, UserName, password};
use crawler_records::{Records, User};
use crawler_server::config::{Layer, Role, Settings};
use crawler_server::server::Server;
use hyper::Method;
use serde_json::{Value, json};

use super::{Answer, Fixture, Scratch, quiet};

/// An administrator, an operator and a viewer.
pub const ADMIN: &str = "ada";
pub const OPERATOR: &str = "olga";
pub const VIEWER: &str = "vera";
/// The password of all of them.
pub const PASSWORD: &str = "open sesame, please";

/// What somebody has who is logged in.
pub struct Login {
    pub token: String,
    /// `name=value`, as a browser sends it back.
    pub cookie: String,
    pub answer: Value,
}

impl Login {
    #[track_caller]
    pub fn of(answer: &Answer) -> Self {
        assert_eq!(answer.status, 200, "{}", answer.text());
        let cookie = answer.header("set-cookie");
        let cookie = cookie.split(';').next().unwrap_or_default().to_owned();
        let answer = answer.json();
        Self {
            token: answer["token"].as_str().expect("a token").to_owned(),
            cookie,
            answer,
        }
    }
}

/// Takes half a second, so once for all tests of a file.
fn hash() -> String {
    static HASH: OnceLock<String> = OnceLock::new();
    let hash = HASH.get_or_init(|| password::Memory::new().hash(PASSWORD).expect("a hash"));
    hash.clone()
}

pub fn name(text: &str) -> UserName {
    text.parse().expect("a name")
}

/// Puts the three people into the records of a server that does not run.
pub async fn people(scratch: &Scratch) {
    let records = Records::open(&scratch.0).await.expect("records");
    for (user, role) in [
        (ADMIN, Rank::Admin),
        (OPERATOR, Rank::Operator),
        (VIEWER, Rank::Viewer),
    ] {
        let user = User {
            name: name(user),
            role,
            password: Some(hash()),
            created: 1,
            disabled: false,
        };
        records.users().add(&user).await.expect("a user");
    }
    records.close().await;
}

impl Fixture {
    /// A closed server with an administrator, an operator and a viewer.
    pub async fn closed() -> Self {
        Self::closed_with(Role::Serve, |_| {}).await
    }

    /// The same with other options.
    pub async fn closed_with(role: Role, change: impl FnOnce(&mut Layer)) -> Self {
        let scratch = Scratch::new();
        people(&scratch).await;
        Self::closed_at(scratch, role, change).await
    }

    /// A closed server on records that are there or not.
    pub async fn closed_at(scratch: Scratch, role: Role, change: impl FnOnce(&mut Layer)) -> Self {
        let mut layer = Layer {
            open: Some(false),
            ..quiet(&scratch)
        };
        change(&mut layer);
        let settings = Settings::from_layers(role, &[layer]).expect("settings");
        let server = Server::start(&settings).await.expect("the server starts");
        Self {
            server,
            settings,
            scratch,
        }
    }

    /// Stops the server and hands its data directory on.
    pub async fn leave(self) -> Scratch {
        self.server.stop().await;
        self.scratch
    }

    /// Tries to log in.
    pub async fn try_login(&self, user: &str, password: &str) -> Answer {
        let body = json!({ "user": user, "password": password }).to_string();
        self.post("/api/v1/session", &body).await
    }

    /// Logs one of the three in.
    pub async fn login(&self, user: &str) -> Login {
        Login::of(&self.try_login(user, PASSWORD).await)
    }

    /// A call with a token.
    pub async fn call_as(&self, token: &str, method: Method, path: &str, body: &str) -> Answer {
        let bearer = format!("Bearer {token}");
        let headers = [
            ("authorization", bearer.as_str()),
            ("content-type", "application/json"),
        ];
        let headers = if body.is_empty() {
            &headers[..1]
        } else {
            &headers[..]
        };
        self.call(method, path, headers, body).await
    }

    /// A GET with a token.
    pub async fn get_as(&self, token: &str, path: &str) -> Answer {
        self.call_as(token, Method::GET, path, "").await
    }

    /// A call with the refresh cookie.
    pub async fn call_with_cookie(&self, method: Method, path: &str, cookie: &str) -> Answer {
        self.call(method, path, &[("cookie", cookie)], "").await
    }

    /// Refreshes a session.
    pub async fn refresh(&self, cookie: &str) -> Answer {
        self.call_with_cookie(Method::POST, "/api/v1/session/refresh", cookie)
            .await
    }

    /// The newest entries of the audit log, as an administrator sees them.
    pub async fn audit(&self, token: &str) -> Vec<Value> {
        let page = self.get_as(token, "/api/v1/audit?limit=1000").await;
        assert_eq!(page.status, 200, "{}", page.text());
        page.json()["entries"].as_array().expect("entries").clone()
    }
}
