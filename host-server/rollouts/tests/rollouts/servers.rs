//! A rollout is carried out by one server at a time.

use std::time::Duration;

use crawler_records::{RolloutRobot, RolloutStep, Written};
use crawler_rollouts::{Action, RolloutError};
use crawler_updates::rollout::{Busy, CommandError, Reason, UpdateState};

use crate::support::{RELEASE, Server, eventually, plan, with_release, withdraw};

#[tokio::test(flavor = "multi_thread")]
async fn whoever_is_asked_carries_it_out() {
    let records = with_release().await;
    let (one, two) = (
        Server::start("one", &records),
        Server::start("two", &records),
    );
    let id = one.rollouts.start("ada", plan()).await.expect("it begins");
    assert_eq!(one.owner(id).await, ("one".into(), "running"));
    two.rollouts
        .act(id, Action::Pause)
        .await
        .expect("it pauses");
    assert_eq!(one.owner(id).await, ("two".into(), "paused"));
    // The former owner, which may not know that it is, takes it back when it is asked.
    one.rollouts
        .act(id, Action::Resume)
        .await
        .expect("it goes on");
    assert_eq!(two.owner(id).await, ("one".into(), "running"));
    two.rollouts.act(id, Action::Abort).await.expect("it ends");
    assert_eq!(one.owner(id).await, ("two".into(), "aborted"));
    let over = one.rollouts.act(id, Action::Resume).await;
    assert!(
        matches!(over, Err(RolloutError::Command(CommandError::Over))),
        "{over:?}"
    );
    let rows = one
        .rollouts
        .robots(id, None, None, 9)
        .await
        .expect("robots");
    assert!(
        rows.iter().all(|row| row.state == UpdateState::Skipped),
        "{rows:?}"
    );
    let unknown = one.rollouts.act(99, Action::Pause).await;
    assert!(matches!(unknown, Err(RolloutError::Unknown)), "{unknown:?}");
    let log = one
        .rollouts
        .one(id)
        .await
        .expect("a rollout")
        .log
        .expect("a log");
    let count = |what: &str| log.iter().filter(|line| line.what == what).count();
    assert_eq!(
        (count("started"), count("taken_over"), count("aborted")),
        (1, 3, 1),
        "{log:?}"
    );
    records
        .audit()
        .verify()
        .await
        .expect("the audit log is whole");
    one.stop().await;
    two.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn rollouts_that_begin_at_once_have_numbers_of_their_own() {
    let records = with_release().await;
    let (one, two) = (
        Server::start("one", &records),
        Server::start("two", &records),
    );
    for round in 0..4 {
        let (first, second) = tokio::join!(
            one.rollouts.start("ada", plan()),
            two.rollouts.start("eve", plan())
        );
        let mut ids = [first.expect("it begins"), second.expect("it begins")];
        ids.sort_unstable();
        assert_eq!(ids, [2 * round + 1, 2 * round + 2]);
        for id in ids {
            let ended = one.rollouts.act(id, Action::Abort).await;
            // The other one may have taken all robots of the first.
            assert!(
                matches!(
                    ended,
                    Ok(()) | Err(RolloutError::Command(CommandError::Over))
                ),
                "{ended:?}"
            );
        }
    }
    one.stop().await;
    two.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn another_server_takes_over_from_one_that_is_gone() {
    let records = with_release().await;
    let (one, two) = (
        Server::start("one", &records),
        Server::start("two", &records),
    );
    let id = one.rollouts.start("ada", plan()).await.expect("it begins");
    let told = one.told.lock().expect("a list").clone();
    assert!(
        told.contains(&format!("rollout {id} has begun")),
        "{told:?}"
    );
    one.stop().await;
    // For the second one it is not gone yet, for the third it is.
    let three = Server::with_lease("three", &records, Duration::ZERO);
    eventually("it is taken over", async || {
        two.owner(id).await.0 == "three"
    })
    .await;
    let rows = two
        .rollouts
        .robots(id, None, Some(UpdateState::Offered), 9)
        .await;
    assert_eq!(
        rows.expect("robots").len(),
        3,
        "all three are still to answer"
    );
    // One that comes back under its name leaves it where it is, and finds what is its own.
    let one = Server::start("one", &records);
    three.stop().await;
    let three = Server::start("three", &records);
    eventually("it is back", async || one.said(id, "taken_over").await == 2).await;
    assert_eq!(one.owner(id).await, ("three".into(), "running"));
    one.stop().await;
    two.stop().await;
    three.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_release_that_cannot_go_out_is_refused() {
    let records = with_release().await;
    let server = Server::start("one", &records);
    let mut other = plan();
    other.releases[0].release = "0000000000000000".parse().expect("an id");
    let unknown = server.rollouts.start("ada", other).await;
    assert!(
        matches!(unknown, Err(RolloutError::UnknownRelease(_))),
        "{unknown:?}"
    );
    withdraw(&records).await;
    let withdrawn = server.rollouts.start("ada", plan()).await;
    assert!(
        matches!(withdrawn, Err(RolloutError::Release(..))),
        "{withdrawn:?}"
    );
    assert!(
        server
            .rollouts
            .list(None, 9)
            .await
            .expect("a list")
            .rollouts
            .is_empty()
    );
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_withdrawn_goes_no_further_whoever_withdrew_it() {
    let records = with_release().await;
    let server = Server::start("one", &records);
    let id = server.rollouts.start("ada", plan()).await;
    let id = id.expect("it begins");
    // Nobody tells this server.
    withdraw(&records).await;
    eventually("it stands", async || server.owner(id).await.1 == "paused").await;
    let robot = "a".parse().expect("a robot");
    for action in [Action::Resume, Action::Retry(robot)] {
        let refused = server.rollouts.act(id, action).await;
        assert!(
            matches!(refused, Err(RolloutError::Release(..))),
            "{refused:?}"
        );
    }
    assert_eq!(server.owner(id).await.1, "paused");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_that_cannot_be_paused_is_told_and_the_others_are() {
    let records = with_release().await;
    let one = Server::start("one", &records);
    let damaged = one.rollouts.start("ada", plan()).await;
    let damaged = damaged.expect("it begins");
    one.stop().await;
    let kept = records.rollouts().get(damaged).await.expect("records");
    let step = RolloutStep {
        robots: vec![RolloutRobot {
            robot: "a".parse().expect("a robot"),
            state: "offered".into(),
            entry: "{}".into(),
        }],
        ..RolloutStep::default()
    };
    let epoch = kept.expect("a rollout").epoch;
    let written = records.rollouts().write(damaged, epoch, step).await;
    assert_eq!(written.expect("records"), Written::Stored);
    let two = Server::start("two", &records);
    let good = two.rollouts.start("ada", plan()).await;
    let good = good.expect("it begins");
    let before = two.rollouts.running_with(RELEASE).await.expect("rollouts");
    assert_eq!(before, [damaged, good]);
    withdraw(&records).await;
    let (paused, all) = two.rollouts.pause_all_of(RELEASE, before).await;
    assert_eq!(paused, [good]);
    assert!(matches!(all, Err(RolloutError::Damaged(_))), "{all:?}");
    assert_eq!(two.owner(good).await, ("two".into(), "paused"));
    two.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_that_wait_say_why() {
    let records = with_release().await;
    let server = Server::start("one", &records);
    *server.robots.1.lock().expect("a reason") = Some(Busy::Driving);
    let id = server.rollouts.start("ada", plan()).await;
    let id = id.expect("it begins");
    let reasons = async || {
        let rows = server.rollouts.robots(id, None, None, 9).await;
        let rows = rows.expect("robots").into_iter();
        rows.map(|row| (row.state, row.reason)).collect::<Vec<_>>()
    };
    let told = |code: &str| Some(Reason::Told(code.parse().expect("a code")));
    assert_eq!(
        reasons().await,
        vec![(UpdateState::Waiting, told("driving")); 3]
    );
    let b = "b".parse().expect("a robot");
    let one = server.rollouts.robot(id, &b).await.expect("a robot");
    assert_eq!(one.robot.reason, told("driving"));
    *server.robots.1.lock().expect("a reason") = Some(Busy::LowBattery);
    assert_eq!(reasons().await[0].1, told("low_battery"));
    *server.robots.1.lock().expect("a reason") = None;
    eventually("they are offered the release", async || {
        let offered = (UpdateState::Offered, None);
        reasons().await.iter().all(|reason| *reason == offered)
    })
    .await;
    server.stop().await;
}
