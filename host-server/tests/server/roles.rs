//! Who may call what, call by call: the OpenAPI document says what there is, and each of it is tried
//! by nobody, by people whose role is too low, and by the lowest role that may.

use crate::support::Fixture;
use crate::support::closed::{ADMIN, OPERATOR, VIEWER};
use hyper::Method;
use serde_json::Value;

/// Calls that anybody may make.
const ANYBODY: &[&str] = &[
    "get /api/v1/schema/{message}",
    "post /api/v1/session",
    "post /api/v1/session/refresh",
    "delete /api/v1/session",
    "post /api/v1/invitations",
];
/// Calls of operators. Every other call that changes something is the administrator's, or about
/// one's own session.
const OPERATORS: &[&str] = &[
    "post /api/v1/counterfactuals",
    "delete /api/v1/counterfactuals/{id}",
    "post /api/v1/fences",
    "put /api/v1/fences/{id}",
    "delete /api/v1/fences/{id}",
    "post /api/v1/robots/{id}/commands",
    "post /api/v1/robots/{id}/faults",
    "delete /api/v1/robots/{id}/faults",
    "put /api/v1/robots/{id}/parameters",
    "post /api/v1/robots/{id}/twin/calibrations",
    "delete /api/v1/robots/{id}/twin/calibrations/{number}",
    "post /api/v1/simulator/commands",
    "post /api/v1/experiments",
    "delete /api/v1/experiments/{id}",
    "post /api/v1/experiments/{id}/start",
    "post /api/v1/experiments/{id}/pause",
    "post /api/v1/experiments/{id}/resume",
    "post /api/v1/experiments/{id}/stop",
    "post /api/v1/policies/{name}/shadow",
    "post /api/v1/swarm/commands",
];
/// Calls of administrators.
const ADMINISTRATORS: &[&str] = &[
    "get /api/v1/audit",
    "get /api/v1/audit/verify",
    "get /api/v1/credentials",
    "post /api/v1/releases",
    "post /api/v1/releases/{id}/gate",
    "post /api/v1/releases/{id}/withdraw",
    "post /api/v1/robots/{id}/credential",
    "delete /api/v1/robots/{id}/credential",
    "post /api/v1/policies/{name}/deploy",
    "post /api/v1/rollouts",
    "post /api/v1/rollouts/{id}/pause",
    "post /api/v1/rollouts/{id}/resume",
    "post /api/v1/rollouts/{id}/abort",
    "post /api/v1/rollouts/{id}/robots/{robot}/retry",
    "post /api/v1/rollouts/{id}/robots/{robot}/skip",
    "get /api/v1/users",
    "post /api/v1/users",
    "patch /api/v1/users/{name}",
    "delete /api/v1/users/{name}",
];

/// Every call of the document.
async fn calls(fixture: &Fixture) -> Vec<(Method, String)> {
    let document = fixture.get("/api/v1/openapi.json").await.json();
    let paths = document["paths"].as_object().expect("paths");
    let methods = |item: &Value| -> Vec<String> {
        item.as_object().expect("methods").keys().cloned().collect()
    };
    paths
        .iter()
        .flat_map(|(path, item)| {
            let each = move |method: String| {
                let method = method.to_uppercase().parse().expect("a method");
                (method, path.clone())
            };
            methods(item).into_iter().map(each)
        })
        .collect()
}

/// Whether the answer came from behind the check.
fn let_in(status: u16) -> bool {
    status != 401 && status != 403
}

#[tokio::test(flavor = "multi_thread")]
async fn every_call_refuses_whoever_may_not_make_it() {
    let fixture = Fixture::closed().await;
    let admin = fixture.login(ADMIN).await.token;
    let operator = fixture.login(OPERATOR).await.token;
    let viewer = fixture.login(VIEWER).await.token;
    let calls = calls(&fixture).await;
    assert!(calls.len() > 30, "the document is there");
    for named in [ANYBODY, OPERATORS, ADMINISTRATORS].concat() {
        let there = |(method, path): &(Method, String)| {
            named == format!("{} {path}", method.as_str().to_lowercase())
        };
        assert!(calls.iter().any(there), "{named} is not in the document");
    }
    for (method, template) in calls {
        let call = format!("{} {template}", method.as_str().to_lowercase());
        // Names that nothing has: what is let in finds nothing to change.
        let path = template
            .replace("{id}", "0")
            .replace("{name}", "nobody")
            .replace("{message}", "telemetry");
        let anonymous = fixture.call(method.clone(), &path, &[], "").await;
        if ANYBODY.contains(&call.as_str()) {
            let status = anonymous.status.as_u16();
            let refreshes = call == "post /api/v1/session/refresh";
            assert!(let_in(status) || refreshes, "{call}: {}", anonymous.text());
            continue;
        }
        anonymous.is_problem(401, "unauthenticated");
        assert_eq!(anonymous.header("www-authenticate"), "Bearer", "{call}");
        let forged = "eyJhbGciOiJub25lIiwidHlwIjoiSldUIn0.eyJzdWIiOiJhZGEifQ.";
        for token in ["", "x", forged, &format!("{viewer}x")] {
            let answer = fixture.call_as(token, method.clone(), &path, "").await;
            answer.is_problem(401, "unauthenticated");
        }
        let (least, below): (_, &[&String]) = if ADMINISTRATORS.contains(&call.as_str()) {
            (&admin, &[&viewer, &operator])
        } else if OPERATORS.contains(&call.as_str()) {
            (&operator, &[&viewer])
        } else {
            (&viewer, &[])
        };
        for low in below {
            let answer = fixture.call_as(low, method.clone(), &path, "").await;
            answer.is_problem(403, "forbidden");
            assert!(
                answer.text().contains("needs the role"),
                "{}",
                answer.text()
            );
        }
        let answer = fixture.call_as(least, method.clone(), &path, "").await;
        assert!(let_in(answer.status.as_u16()), "{call}: {}", answer.text());
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_everybody_may_see_stays_visible() {
    let fixture = Fixture::closed().await;
    for path in [
        "/",
        "/healthz",
        "/readyz",
        "/api/v1/openapi.json",
        "/api/v1/schema/telemetry",
    ] {
        assert_eq!(fixture.get(path).await.status, 200, "{path}");
    }
    // Prometheus on this machine needs no account; one elsewhere does, proxy or not.
    assert_eq!(fixture.get("/metrics").await.status, 200);
    let elsewhere = [("x-forwarded-for", "192.0.2.1")];
    fixture
        .call(Method::GET, "/metrics", &elsewhere, "")
        .await
        .is_problem(401, "unauthenticated");
    let viewer = fixture.login(VIEWER).await.token;
    let bearer = format!("Bearer {viewer}");
    let known = [
        ("x-forwarded-for", "192.0.2.1"),
        ("authorization", bearer.as_str()),
    ];
    let metrics = fixture.call(Method::GET, "/metrics", &known, "").await;
    assert_eq!(metrics.status, 200);
    // Methods that a path does not have are told to nobody who may not administer.
    fixture
        .call(Method::DELETE, "/api/v1/robots", &[], "")
        .await
        .is_problem(401, "unauthenticated");
    fixture
        .get("/api/v1/nope")
        .await
        .is_problem(404, "not_found");
    // A proxy in front may have looked at the other name.
    let host = fixture.server.http().to_string();
    let twice = [("host", host.as_str()), ("host", host.as_str())];
    fixture
        .call(Method::GET, "/healthz", &twice, "")
        .await
        .is_problem(400, "bad_host");
    // Of what everybody may call there is nothing to hide.
    for path in ["/healthz", "/readyz"] {
        fixture
            .call(Method::DELETE, path, &[], "")
            .await
            .is_problem(405, "method_not_allowed");
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_bears_the_name_of_whoever_gave_it() {
    let fixture = Fixture::closed().await;
    let operator = fixture.login(OPERATOR).await.token;
    let stop = r#"{"command":"stop"}"#;
    let sent = fixture
        .call_as(&operator, Method::POST, "/api/v1/swarm/commands", stop)
        .await;
    assert_eq!(sent.status, 202, "{}", sent.text());
    assert_eq!(sent.json()["source"], format!("operator:{OPERATOR}"));
    let viewer = fixture.login(VIEWER).await.token;
    fixture
        .call_as(&viewer, Method::POST, "/api/v1/swarm/commands", stop)
        .await
        .is_problem(403, "forbidden");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_asks_too_often_is_told_to_wait() {
    let fixture = Fixture::closed().await;
    let viewer = fixture.login(VIEWER).await.token;
    let mut refused = None;
    for _ in 0..2_000 {
        let answer = fixture.get_as(&viewer, "/api/v1/session").await;
        if answer.status != 200 {
            refused = Some(answer);
            break;
        }
    }
    let refused = refused.expect("refused at last");
    refused.is_problem(429, "rate_limited");
    assert_eq!(refused.header("retry-after"), "1");
    assert_eq!(refused.json()["retry_after"], 1);
    // Others are not slowed down by it.
    let admin = fixture.login(ADMIN).await.token;
    assert_eq!(fixture.get_as(&admin, "/api/v1/users").await.status, 200);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_answer_has_its_number_and_its_headers() {
    let fixture = Fixture::closed().await;
    let first = fixture.get("/api/v1/robots").await;
    let second = fixture.get("/api/v1/robots").await;
    assert_ne!(first.header("x-request-id"), "");
    assert_ne!(first.header("x-request-id"), second.header("x-request-id"));
    assert_eq!(first.json()["request"], first.header("x-request-id"));
    for path in ["/", "/healthz", "/api/v1/robots", "/nope"] {
        let answer = fixture.get(path).await;
        let policy = answer.header("content-security-policy");
        assert!(policy.contains("frame-ancestors 'none'"), "{path}");
        assert!(!policy.contains("unsafe"), "{path}");
        assert_eq!(answer.header("x-content-type-options"), "nosniff");
        assert_eq!(answer.header("referrer-policy"), "no-referrer");
        assert_eq!(answer.header("x-frame-options"), "DENY");
        // Over a connection that is not encrypted, it would be ignored or do harm.
        assert_eq!(answer.header("strict-transport-security"), "");
    }
    fixture.stop().await;
}
