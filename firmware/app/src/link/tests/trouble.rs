//! What keeps a robot from its broker has a name, and the broker hears of it afterwards.

use std::string::String;
use std::vec::Vec;

use crawler_hal::{Duration, Instant, NetError};
use crawler_protocol::Level;

use super::harness::{Broker, config, robot, run, run_as};
use super::peer::Peer;
use super::wire::field;
use crate::link::{JOINED_WITHIN, REFUSED, SESSION_EXPIRY};
use crate::trouble::LinkTrouble;
use crate::{Config, Credentials, Robot};

const SECOND: Duration = Duration::from_secs(1);

fn with_credentials() -> Config {
    Config {
        credentials: Some(Credentials {
            username: "rover".try_into().expect("short"),
            password: "open sesame".try_into().expect("short"),
        }),
        ..config()
    }
}

/// Accepts the robot and collects the records it has kept, as event and text.
async fn records(peer: &mut Peer) -> Vec<(String, String)> {
    peer.accept(false).await;
    let published = peer.publishes_for(SECOND * 3).await;
    let logs = published
        .iter()
        .filter(|p| p.topic.starts_with("swarm/logs/"));
    logs.map(|p| (field(&p.json(), "event"), field(&p.json(), "text")))
        .collect()
}

#[test]
fn name_and_password_travel_in_connect_and_nowhere_else() {
    assert!(!std::format!("{:?}", with_credentials()).contains("sesame"));
    run_as(Robot::new(with_credentials()), async |broker| {
        let mut peer = broker.peer().await;
        let (connect, _) = peer.accept(false).await;
        assert_eq!(connect.username.as_deref(), Some("rover"));
        assert_eq!(connect.password.as_deref(), Some(&b"open sesame"[..]));
        for publish in peer.publishes_for(SECOND * 5).await {
            let text = String::from_utf8_lossy(&publish.payload).into_owned();
            assert!(!text.contains("sesame"), "{text}");
        }
    });
}

#[test]
fn without_credentials_none_are_sent() {
    run(async |broker| {
        let (connect, _) = broker.peer().await.accept(false).await;
        assert_eq!((connect.username, connect.password), (None, None));
    });
}

#[test]
fn a_broker_that_refuses_the_credentials_is_a_trouble_of_its_own() {
    // Bad user name or password, not authorised, bad authentication method.
    for reason in [0x86, 0x87, 0x8c] {
        run_as(Robot::new(with_credentials()), async |broker| {
            let peer = broker.peer().await;
            peer.connect().await;
            peer.send(&[0x20, 3, 0, reason, 0]);
            peer.dropped().await;
            let start = broker.now();
            broker.sleep(SECOND).await;
            assert_eq!(broker.robot.link_trouble(), Some(LinkTrouble::Credentials));
            let mut peer = broker.peer().await;
            let waited = broker.now() - start;
            assert!(waited * 2 >= REFUSED, "no hammering: {waited:?}");
            let told = records(&mut peer).await;
            let refusal = std::format!("(0x{reason:02x})");
            assert!(
                told.iter().any(|(event, text)| {
                    event == "broker-credentials" && text.contains(&refusal)
                }),
                "{told:?}"
            );
            assert!(!std::format!("{told:?}").contains("sesame"));
            assert_eq!(broker.robot.link_trouble(), None);
        });
    }
}

#[test]
fn credentials_that_mqtt_cannot_carry_are_told_and_not_sent() {
    let mut config = with_credentials();
    if let Some(credentials) = &mut config.credentials {
        credentials.username = "a\0b".try_into().expect("short");
    }
    run_as(Robot::new(config), async |broker| {
        broker.sleep(SECOND).await;
        assert_eq!(broker.robot.link_trouble(), Some(LinkTrouble::Credentials));
    });
}

#[test]
fn every_way_of_not_joining_has_its_name() {
    let cases = [
        (NetError::NotJoined, LinkTrouble::NoNetwork, "no network"),
        (NetError::BadCredentials, LinkTrouble::Password, "password"),
        (NetError::NoAddress, LinkTrouble::NoAddress, "no address"),
        // Never answers.
        (
            NetError::TimedOut,
            LinkTrouble::NoNetwork,
            "does not answer",
        ),
    ];
    for (error, trouble, words) in cases {
        run(async |broker| {
            broker.fail_joining(Some(error));
            broker.peer().await.close();
            let before = broker.attempts().len();
            broker.sleep(JOINED_WITHIN + SECOND * 2).await;
            assert_eq!(broker.robot.link_trouble(), Some(trouble), "{error:?}");
            assert_eq!(
                broker.attempts().len(),
                before,
                "a stream without a network"
            );
            broker.fail_joining(None);
            let mut peer = broker.peer().await;
            let told = records(&mut peer).await;
            let known =
                |(event, text): &(String, String)| event == trouble.event() && text.contains(words);
            assert!(told.iter().any(known), "{error:?}: {told:?}");
            assert_eq!(broker.robot.link_trouble(), None);
        });
    }
}

#[test]
fn a_broker_that_is_not_trusted_is_told_with_the_reason() {
    run(async |broker| {
        broker.fail_joining(Some(NetError::Insecure("expired")));
        broker.peer().await.close();
        broker.sleep(SECOND * 40).await;
        let trouble = broker.robot.link_trouble();
        assert_eq!(trouble, Some(LinkTrouble::Untrusted));
        broker.fail_joining(None);
        let mut peer = broker.peer().await;
        let told = records(&mut peer).await;
        let known = |(event, text): &(String, String)| {
            event == "broker-untrusted" && text.contains("not trusted (expired)")
        };
        assert!(told.iter().any(known), "{told:?}");
    });
}

#[test]
fn troubles_of_one_outage_are_all_told_however_long_it_lasts() {
    run(async |broker| {
        broker.fail_joining(Some(NetError::BadCredentials));
        broker.sleep(SECOND * 60).await;
        broker.fail_joining(Some(NetError::NoAddress));
        broker.sleep(SECOND * 60).await;
        // Meanwhile much else happens.
        for number in 0..100 {
            let text = format_args!("{number}");
            broker.robot.log(Level::Info, "scan", text, Instant::BOOT);
        }
        broker.fail_joining(None);
        broker.refuse_connections(true);
        broker.sleep(SECOND * 60).await;
        broker.refuse_connections(false);
        let mut peer = broker.peer().await;
        let told = records(&mut peer).await;
        for event in [
            "network-password",
            "no-address",
            "link-failed",
            "outbox-full",
        ] {
            assert!(
                told.iter().any(|(known, _)| known == event),
                "{event}: {told:?}"
            );
        }
    });
}

/// What is logged while a dead connection is not known to be dead, and lost with it.
async fn logged_into_the_void(broker: &Broker) -> Vec<(String, String)> {
    let peer = broker.connected().await;
    peer.publish("swarm/parameters/").await;
    peer.publishes_for(SECOND * 2).await;
    // From here on nobody reads: bytes are taken and never answered.
    let now = broker.now();
    broker
        .robot
        .log(Level::Error, "ranger", format_args!("dead"), now);
    broker.sleep(SECOND * 12).await;
    drop(peer);
    let mut peer = broker.peer().await;
    records(&mut peer).await
}

#[test]
fn a_fault_written_to_a_dead_connection_is_sent_again() {
    let told = run(async |broker| logged_into_the_void(&broker).await);
    let dead = (String::from("ranger"), String::from("dead"));
    assert!(told.contains(&dead), "{told:?}");
}

#[test]
fn a_fault_is_sent_once_when_it_arrives() {
    run(async |broker| {
        let mut peer = broker.connected().await;
        peer.publish("swarm/parameters/").await;
        let now = broker.now();
        broker
            .robot
            .log(Level::Error, "ranger", format_args!("dead"), now);
        let told = peer.publishes_for(SECOND * 4).await;
        let ranger = told.iter().filter(|p| p.topic.starts_with("swarm/logs/"));
        assert_eq!(ranger.count(), 1);
        peer.close();
        peer = broker.peer().await;
        let told = records(&mut peer).await;
        assert!(told.iter().all(|(event, _)| event != "ranger"), "{told:?}");
    });
}

#[test]
fn a_panic_is_told_in_the_status_and_once_in_a_record() {
    let robot = robot();
    let text = "src/wheel.rs:12: a wheel fell off";
    robot.control_handle().set_boot_cause(
        crawler_hal::ResetCause::Panic,
        Some(text),
        Instant::BOOT,
    );
    run_as(robot, async |broker| {
        let peer = broker.connected().await;
        let published = peer.publishes_for(SECOND * 4).await;
        let on = |topic| {
            let mut all = published.iter();
            all.find(|p| p.topic.starts_with(topic))
                .expect(topic)
                .json()
        };
        let status = on("swarm/status/");
        assert_eq!(field(&status["boot"], "panic"), text);
        assert_eq!(field(&status["boot"], "cause"), "panic");
        let record = on("swarm/logs/");
        assert_eq!(field(&record, "event"), "panic");
        assert_eq!(field(&record, "text"), text);
        assert_eq!(field(&record, "level"), "error");
        peer.close();
        broker.sleep(SESSION_EXPIRY).await;
        let mut peer = broker.peer().await;
        let told = records(&mut peer).await;
        assert!(told.iter().all(|(event, _)| event != "panic"), "{told:?}");
    });
}

proptest::proptest! {
    #[test]
    fn any_text_of_a_panic_survives_or_is_cut_between_characters(text in ".{0,120}") {
        let robot = robot();
        robot.control_handle().set_boot_cause(crawler_hal::ResetCause::Panic, Some(&text), Instant::BOOT);
        let kept = robot.last_panic().unwrap_or_default();
        proptest::prop_assert!(text.starts_with(kept.as_str()));
        let limit = crawler_hal::PANIC_TEXT;
        let next = text[kept.len()..].chars().next().map_or(0, char::len_utf8);
        proptest::prop_assert!(next == 0 || kept.len() + next > limit, "cut too early");
        let record = robot.outbox.next_log(0, Instant::BOOT).map(|record| record.text);
        proptest::prop_assert_eq!(record, robot.last_panic());
    }
}
