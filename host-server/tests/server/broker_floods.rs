//! Clients that guess passwords, come in crowds, or send more than they may.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use crate::support::mqtt;
use crate::support::mqtt::{Client, Closed, PASSWORD};
use crate::support::{eventually, mqtt_options, within};
use crawler_access::Role;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{ConnectReturnCode, PubAckReason};

#[tokio::test(flavor = "multi_thread")]
async fn guessing_passwords_gets_slower_and_locks_no_robot_out() {
    let closed = Closed::start().await;
    closed.person("ada", Role::Admin).await;
    closed.person("bob", Role::Admin).await;
    let secret = closed.enroll("rover-1").await;
    // Where the wait is over before the right password comes, because the machine is that slow, it
    // all begins anew.
    let mut refused = 0;
    for _ in 0..3 {
        let before = closed.refusals("attempts").await;
        let (wait, begun) = too_many_guesses(&closed).await;
        refused = right_password(&closed).await;
        assert!(begun.elapsed() >= wait, "let in before {wait:?}");
        let counted = closed.refusals("attempts").await - before;
        assert_eq!(counted, f64::from(refused + 1));
        if refused > 0 {
            break;
        }
    }
    assert!(refused > 0, "the right password was never refused");
    for _ in 0..100 {
        let wrong = "A".repeat(43);
        let code = closed.refusal("rover-1", "rover-1", &wrong).await;
        assert_eq!(code, ConnectReturnCode::BadUserNamePassword);
    }
    closed.connect("rover-1", "rover-1", &secret).await;
    closed.stop().await;
}

/// Guesses at the password of `ada` until there were too many. Returns for how long nobody is let in
/// under her name then, and when the last guess that counts began, or before.
async fn too_many_guesses(closed: &Closed) -> (Duration, Instant) {
    let before = closed.refusals("attempts").await;
    let mut last = Instant::now();
    for guesses in 0..10_u32 {
        let begun = Instant::now();
        let good = if matches!(guesses, 3 | 4) {
            // Those over HTTP count as well: five in all are free.
            let body = r#"{"user": "ada", "password": "correct mule of the API"}"#;
            let answer = closed.fixture.post("/api/v1/session", body).await;
            assert_eq!(answer.status, 401, "{}", answer.text());
            true
        } else {
            let password = format!("correct mule {guesses}");
            let code = closed.refusal("x", "ada", &password).await;
            if code != ConnectReturnCode::BadUserNamePassword {
                assert_eq!(code, ConnectReturnCode::NotAuthorized);
            }
            code == ConnectReturnCode::BadUserNamePassword
        };
        if !good {
            assert_eq!(closed.refusals("attempts").await, before + 1.0);
            let beyond = guesses.checked_sub(5).expect("five are free");
            return (Duration::from_secs(2 << beyond), last);
        }
        last = begun;
    }
    panic!("nothing holds the guesses up");
}

/// Tries the right password of `ada` until she is let in. Returns how often she was sent away, each
/// time because she came too often.
async fn right_password(closed: &Closed) -> u32 {
    let mut refused = 0;
    eventually("ada is let in", async || {
        match Client::connect(closed.options("x", "ada", PASSWORD)).await {
            Ok(_) => true,
            Err(code) => {
                assert_eq!(code, ConnectReturnCode::NotAuthorized);
                refused += 1;
                if refused == 1 {
                    // Others at the same address are not locked out with her.
                    closed.connect("desk", "bob", PASSWORD).await;
                }
                false
            }
        }
    })
    .await;
    refused
}

#[tokio::test(flavor = "multi_thread")]
async fn a_crowd_of_strangers_keeps_no_robot_out() {
    let closed = Closed::start().await;
    let secret = closed.enroll("rover-1").await;
    let port = closed.fixture.server.mqtt().port;
    let over = Arc::new(AtomicBool::new(false));
    let knocked = Arc::new(AtomicU32::new(0));
    let strangers: Vec<_> = (0..40)
        .map(|number| {
            let (over, knocked) = (Arc::clone(&over), Arc::clone(&knocked));
            tokio::spawn(async move {
                let name = format!("stranger{number}");
                while !over.load(Ordering::SeqCst) {
                    let mut options = mqtt_options(&name, port);
                    options.set_credentials(&name, "long enough to hash");
                    let code = mqtt::refused(options).await;
                    assert!(
                        matches!(
                            code,
                            ConnectReturnCode::BadUserNamePassword
                                | ConnectReturnCode::NotAuthorized
                        ),
                        "{code:?}"
                    );
                    knocked.fetch_add(1, Ordering::SeqCst);
                }
            })
        })
        .collect();
    // It comes while all of them knock, and they go on.
    eventually("all of them knock", async || {
        knocked.load(Ordering::SeqCst) >= 40
    })
    .await;
    closed.connect("rover-1", "rover-1", &secret).await;
    over.store(true, Ordering::SeqCst);
    for stranger in strangers {
        within("the stranger goes", stranger)
            .await
            .expect("no panic");
    }
    closed.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_is_throttled_then_cut_off_then_locked_out() {
    let closed = Closed::start().await;
    let mut robot = closed.robot("rover-1").await;
    let secret = closed.enroll("eve").await;
    let mut eve = closed.connect("eve", "eve", &secret).await;
    let sender = eve.sender.clone();
    let start = Instant::now();
    let flood = tokio::spawn(async move {
        let flood = || sender.publish("swarm/telemetry/eve", QoS::AtMostOnce, false, "{}");
        while flood().await.is_ok() {}
    });
    eventually("throttled", async || {
        closed.metric("delayed_total").await > 10.0
    })
    .await;
    eve.ended().await;
    flood.abort();
    // Not before it was told to slow down for so long. On a slow machine it takes longer.
    let took = start.elapsed();
    assert!(took > Duration::from_secs(10), "{took:?}");
    assert_eq!(closed.metric("cut_off_total").await, 1.0);
    // For a minute.
    assert_eq!(
        closed.refusal("eve", "eve", &secret).await,
        ConnectReturnCode::NotAuthorized
    );
    assert_eq!(closed.refusals("cut_off").await, 1.0);
    eventually("in the audit log", async || {
        let page = closed.records.audit().page(None, 100, None).await;
        let mut lines = page.expect("the audit log").into_iter();
        lines.any(|line| line.entry.action == "broker.cut_off" && line.entry.target == "eve")
    })
    .await;
    assert_eq!(
        robot.publish("swarm/heartbeat/rover-1", "well").await,
        PubAckReason::Success
    );
    closed.stop().await;
}
