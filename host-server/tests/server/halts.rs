//! Halts have a budget of their own: whatever else is asked for, and by whom, a stop goes through.

use crate::support::closed::{OPERATOR, VIEWER};
use crate::support::{Answer, Fixture};
use hyper::Method;

const SWARM: &str = "/api/v1/swarm/commands";
const STOP: &str = r#"{"command":"stop"}"#;
const ESTOP: &str = r#"{"command":"estop"}"#;
const SCAN: &str = r#"{"command":"scan"}"#;
/// Requests after which an address has none left, however slow the machine is.
const FLOOD: usize = 20_000;
/// Requests at the same time: one after the other they come no faster than budgets fill up.
const TOGETHER: usize = 64;

/// Asks until the answer is that it was too often.
async fn until_refused(what: &str, ask: impl AsyncFn() -> Answer) {
    let mut last = String::new();
    for _ in 0..FLOOD / TOGETHER {
        let asked = (0..TOGETHER).map(|_| ask());
        for answer in futures_util::future::join_all(asked).await {
            if answer.status == 429 {
                answer.is_problem(429, "rate_limited");
                return;
            }
            last = format!("{} {}", answer.status, answer.text());
        }
    }
    panic!("{FLOOD} times {what} and never refused; the last answer was {last}");
}

/// Stops the fleet thirty times, while `ask` uses up everything else.
async fn stops_go_through(
    fixture: &Fixture,
    what: &str,
    ask: impl AsyncFn() -> Answer,
    halt: impl AsyncFn(&'static str) -> Answer,
) {
    for (number, body) in [STOP, ESTOP].into_iter().cycle().take(30).enumerate() {
        // Otherwise the budget fills up again meanwhile.
        until_refused(what, &ask).await;
        let answer = halt(body).await;
        assert_eq!(
            answer.status,
            202,
            "{what}, halt {number}: {}",
            answer.text()
        );
    }
    assert_eq!(fixture.get("/healthz").await.status, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_at_the_same_address_uses_up_a_stop() {
    let fixture = Fixture::closed().await;
    let operator = fixture.login(OPERATOR).await.token;
    // Strangers ask for the very call.
    let ask = async || fixture.post(SWARM, STOP).await;
    let halt =
        async |body: &'static str| fixture.call_as(&operator, Method::POST, SWARM, body).await;
    stops_go_through(&fixture, "a stop without a token", ask, halt).await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_else_of_an_account_uses_up_its_stops() {
    let fixture = Fixture::closed().await;
    let operator = fixture.login(OPERATOR).await.token;
    let polling = async || fixture.get_as(&operator, "/api/v1/robots").await;
    let halt =
        async |body: &'static str| fixture.call_as(&operator, Method::POST, SWARM, body).await;
    stops_go_through(&fixture, "polling", polling, halt).await;
    // Other commands are no halts.
    let scanning = async || fixture.call_as(&operator, Method::POST, SWARM, SCAN).await;
    stops_go_through(&fixture, "a scan", scanning, halt).await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn on_an_open_server_a_stop_goes_through_as_well() {
    let fixture = Fixture::start().await;
    let polling = async || fixture.get("/api/v1/robots").await;
    let halt = async |body: &'static str| fixture.post(SWARM, body).await;
    stops_go_through(&fixture, "polling", polling, halt).await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_stops_is_bounded_and_takes_nothing_from_others() {
    let fixture = Fixture::closed().await;
    let operator = fixture.login(OPERATOR).await.token;
    let halt = async || fixture.call_as(&operator, Method::POST, SWARM, STOP).await;
    until_refused("a stop", halt).await;
    // What is left of the account, and of the address.
    let robots = fixture.get_as(&operator, "/api/v1/robots").await;
    assert_eq!(robots.status, 200, "{}", robots.text());
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn probes_take_nothing_from_people() {
    let fixture = Fixture::closed().await;
    let viewer = fixture.login(VIEWER).await.token;
    for path in ["/healthz", "/readyz", "/metrics"] {
        until_refused(path, async || fixture.get(path).await).await;
        let robots = fixture.get_as(&viewer, "/api/v1/robots").await;
        assert_eq!(robots.status, 200, "{path}: {}", robots.text());
    }
    fixture.stop().await;
}
