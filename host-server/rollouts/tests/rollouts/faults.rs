//! What cannot be read or written for good is told, and left alone.

use crawler_records::{NewRollout, RolloutStep, Written};
use crawler_rollouts::{Action, RolloutError};
use crawler_updates::rollout::{Document, PauseReason, RolloutState, UpdateState};

use crate::support::{OnDisk, Server, eventually, plan, with_release};

#[tokio::test(flavor = "multi_thread")]
async fn what_can_never_be_stored_is_not_tried_for_ever() {
    let records = with_release().await;
    let server = Server::start("one", &records);
    server
        .rollouts
        .start("ada", plan())
        .await
        .expect("it begins");
    records.close().await;
    assert!(server.running() > 0.0, "nothing was to be stored so far");
    *server.robots.0.lock().expect("a build") = "new";
    eventually("it is given up", async || server.running() == 0.0).await;
    let failures = server.metric("terracrawler_updates_store_failures_total");
    assert!(failures >= 1.0, "{failures}");
    // The server does whatever else it is asked.
    let paused = server.rollouts.act(1, Action::Pause).await;
    assert!(
        matches!(paused, Err(RolloutError::Records(_))),
        "{paused:?}"
    );
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_whose_image_is_damaged_is_carried_out_without_it() {
    let disk = OnDisk::with_release("image").await;
    let server = Server::start("one", &disk.records);
    let id = server.rollouts.start("ada", plan()).await;
    let id = id.expect("it begins");
    server.stop().await;
    disk.tamper("DELETE FROM release_piece").await;
    let server = Server::start("one", &disk.records);
    eventually("it is carried out", async || server.running() > 0.0).await;
    // Its log is stored after it is at work.
    eventually("its log says so", async || {
        server.said(id, "taken_over").await == 1
    })
    .await;
    // It can be ended.
    let ended = server.rollouts.act(id, Action::Abort).await;
    ended.expect("it ends");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_that_cannot_be_read_is_left_alone() {
    let records = with_release().await;
    let damaged = NewRollout {
        id: 1,
        by: "ada".into(),
        owner: "one".into(),
        step: RolloutStep {
            document: Some("{}".into()),
            ..RolloutStep::default()
        },
    };
    records.rollouts().add(damaged).await.expect("kept");
    let epoch = async || {
        let kept = records.rollouts().get(1).await.expect("records");
        kept.expect("a rollout").epoch
    };
    let server = Server::start("one", &records);
    eventually("it is looked at", async || epoch().await == 2).await;
    let id = server.rollouts.start("ada", plan()).await;
    assert_eq!(id.expect("it begins"), 2);
    assert_eq!(epoch().await, 2, "it was taken again, to no end");
    let paused = server.rollouts.act(1, Action::Pause).await;
    assert!(
        matches!(paused, Err(RolloutError::Damaged(_))),
        "{paused:?}"
    );
    // The others are shown, and what is behind it is found.
    let list = async |before, limit| {
        let page = server.rollouts.list(before, limit).await;
        let page = page.expect("a list");
        let ids: Vec<_> = page.rollouts.into_iter().map(|one| one.id).collect();
        (ids, page.next)
    };
    assert_eq!(list(None, 1).await, (vec!["2".to_owned()], Some(2)));
    assert_eq!(list(Some(2), 1).await, (Vec::new(), None));
    assert_eq!(list(None, 2).await, (vec!["2".to_owned()], None));
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_write_that_may_have_failed_the_records_are_right() {
    let disk = OnDisk::with_release("write").await;
    let server = Server::start("one", &disk.records);
    let id = server.rollouts.start("ada", plan()).await;
    let id = id.expect("it begins");
    disk.tamper(
        "CREATE TRIGGER no BEFORE UPDATE OF document ON rollout BEGIN SELECT RAISE(ABORT, 'no'); END",
    )
    .await;
    let paused = server.rollouts.act(id, Action::Pause).await;
    assert!(paused.is_err(), "{paused:?}");
    disk.tamper("DROP TRIGGER no").await;
    // As after an answer that was lost: it was written.
    let kept = disk.records.rollouts().get(id).await.expect("records");
    let kept = kept.expect("a rollout");
    let mut document: Document = serde_json::from_str(&kept.document).expect("a document");
    document.state = RolloutState::Paused(PauseReason::Person);
    let step = RolloutStep {
        document: Some(serde_json::to_string(&document).expect("JSON")),
        ..RolloutStep::default()
    };
    let written = disk.records.rollouts().write(id, kept.epoch, step).await;
    assert_eq!(written.expect("records"), Written::Stored);
    server
        .rollouts
        .act(id, Action::Resume)
        .await
        .expect("it goes on");
    assert_eq!(server.owner(id).await, ("one".into(), "running"));
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_of_an_earlier_rollout_are_taken_once_the_records_let_it() {
    let disk = OnDisk::with_release("earlier").await;
    let (one, two) = (
        Server::start("one", &disk.records),
        Server::start("two", &disk.records),
    );
    let earlier = one.rollouts.start("ada", plan()).await;
    let earlier = earlier.expect("it begins");
    disk.tamper(
        "CREATE TRIGGER no BEFORE UPDATE OF owner ON rollout BEGIN SELECT RAISE(ABORT, 'no'); END",
    )
    .await;
    let newer = two.rollouts.start("eve", plan()).await;
    let newer = newer.expect("it begins all the same");
    let superseded = async || {
        let rows = two.rollouts.robots(earlier, None, None, 9).await;
        let rows = rows.expect("robots");
        let taken = rows
            .iter()
            .filter(|row| row.state == UpdateState::Superseded);
        (taken.count(), rows.len())
    };
    assert_eq!(superseded().await, (0, 3));
    disk.tamper("DROP TRIGGER no").await;
    eventually("they are taken", async || superseded().await == (3, 3)).await;
    assert_eq!(two.owner(earlier).await.0, "two");
    assert_eq!(two.owner(newer).await, ("two".into(), "running"));
    one.stop().await;
    two.stop().await;
}
