//! Rollouts are written step by step, each by the one server that has it.

use crate::support::{Folder, memory, open, robot, rollout, rollout_step};
use crawler_records::{
    Lease, MAX_ROLLOUT_ENTRY, MAX_ROLLOUTS, MAX_ROLLOUTS_AT_WORK, Records, RecordsError,
    RolloutStep, Taken, Written,
};

async fn begin(records: &Records) -> i64 {
    let id = records.rollouts().next_id().await.unwrap();
    records.rollouts().add(rollout(id)).await.unwrap();
    id
}

async fn write(records: &Records, id: i64, epoch: u64, step: RolloutStep) -> Written {
    records.rollouts().write(id, epoch, step).await.unwrap()
}

async fn take(records: &Records, id: i64, epoch: u64, owner: &str) -> Option<Taken> {
    records.rollouts().take(id, epoch, owner).await.unwrap()
}

#[tokio::test]
async fn what_was_written_outlives_the_process() {
    let folder = Folder::new();
    let records = open(&folder).await;
    assert_eq!(records.rollouts().get(1).await.unwrap(), None);
    assert_eq!(begin(&records).await, 1);
    assert_eq!(begin(&records).await, 2);
    for n in 1..4 {
        let document = (n == 3).then_some("[3]");
        let step = rollout_step(n, document);
        assert_eq!(write(&records, 1, 1, step).await, Written::Stored);
    }
    records.close().await;

    let records = open(&folder).await;
    let (kept, robots) = records.rollouts().whole(1).await.unwrap().unwrap();
    assert_eq!((kept.document.as_str(), kept.ended), ("[3]", None));
    assert_eq!((kept.by.as_str(), kept.made, kept.epoch), ("ada", 1_000, 1));
    assert_eq!(robots, ["entry 0", "entry 1", "entry 2", "entry 3"]);
    let (_, of_the_other) = records.rollouts().whole(2).await.unwrap().unwrap();
    assert_eq!(of_the_other, ["entry 0"]);
    let listed = records.rollouts().page(None, 9).await.unwrap();
    let ids: Vec<_> = listed.iter().map(|rollout| rollout.id).collect();
    assert_eq!(ids, [2, 1]);
    assert_eq!(records.rollouts().page(Some(2), 9).await.unwrap(), [kept]);
    // Page by page, and by state.
    let page = |after, state| {
        let records = &records;
        async move { records.rollouts().robots(1, after, state, 2).await.unwrap() }
    };
    assert_eq!(page(None, None).await, ["entry 0", "entry 1"]);
    let (second, last) = (robot(1), robot(3));
    assert_eq!(
        page(Some(second.as_str()), None).await,
        ["entry 2", "entry 3"]
    );
    assert_eq!(page(None, Some("offered")).await, ["entry 1", "entry 3"]);
    assert!(page(Some(last.as_str()), None).await.is_empty());
    let one = async |id| records.rollouts().robot(id, second.as_str()).await;
    assert_eq!(one(1).await.unwrap(), Some("entry 1".into()));
    assert_eq!(one(2).await.unwrap(), None);
    let notes = records.rollouts().notes(1, None, 2).await.unwrap();
    assert_eq!(notes, [(1_002, "step 2".into()), (1_003, "step 3".into())]);
    let notes = records.rollouts().notes(1, Some(second.as_str()), 9).await;
    assert_eq!(notes.unwrap(), [(1_001, "note 1".into())]);
    assert!(records.audit().verify().await.is_ok());
}

#[tokio::test]
async fn a_former_owner_writes_nothing() {
    let records = memory().await;
    let id = begin(&records).await;
    assert_eq!(take(&records, id, 2, "two").await, None, "it has epoch 1");
    let taken = take(&records, id, 1, "two").await.expect("it is to be had");
    assert_eq!(
        (taken.rollout.epoch, taken.rollout.owner.as_str()),
        (2, "two")
    );
    assert_eq!(taken.robots, ["entry 0"]);
    assert_eq!(
        take(&records, id, 1, "three").await,
        None,
        "somebody was faster"
    );

    let before = records.rollouts().whole(id).await.unwrap();
    let lines = records.audit().verify().await;
    let late = rollout_step(1, Some("late"));
    for epoch in [0, 1, 3] {
        assert_eq!(
            write(&records, id, epoch, late.clone()).await,
            Written::Lost
        );
    }
    assert_eq!(write(&records, id + 1, 1, late).await, Written::Lost);
    assert_eq!(records.rollouts().whole(id).await.unwrap(), before);
    assert_eq!(records.audit().verify().await, lines);
    assert_eq!(
        records
            .rollouts()
            .renew(vec![(id, 1), (99, 1)])
            .await
            .unwrap(),
        [id, 99]
    );
    let lost = records.rollouts().renew(vec![(id, 2)]).await.unwrap();
    assert!(lost.is_empty(), "{lost:?}");
    let lease = |beat| Lease {
        id,
        owner: "two".into(),
        epoch: 2,
        beat,
    };
    assert_eq!(records.rollouts().leases().await.unwrap(), [lease(1)]);

    let mut end = rollout_step(1, Some("end"));
    end.over = true;
    assert_eq!(write(&records, id, 2, end).await, Written::Stored);
    assert_eq!(records.rollouts().leases().await.unwrap(), []);
    assert_eq!(take(&records, id, 2, "three").await, None, "it is over");
    assert_eq!(
        records.rollouts().get(id).await.unwrap().unwrap().ended,
        Some(1_001)
    );
}

#[tokio::test]
async fn a_step_that_is_written_again_tells_nothing_twice() {
    let records = memory().await;
    let id = begin(&records).await;
    let before = records.audit().verify().await.unwrap();
    for _ in 0..3 {
        let step = rollout_step(1, Some("[1]"));
        assert_eq!(write(&records, id, 1, step).await, Written::Stored);
    }
    assert_eq!(records.audit().verify().await, Ok(before + 1));
    let notes = records.rollouts().notes(id, None, 9).await.unwrap();
    assert_eq!(notes.len(), 2, "{notes:?}");
}

#[tokio::test]
async fn a_step_is_written_as_a_whole_or_not_at_all() {
    let records = memory().await;
    let id = begin(&records).await;
    let before = records.rollouts().whole(id).await.unwrap();
    // The second robot is one that the tables refuse.
    let mut step = rollout_step(1, Some("[1]"));
    let mut second = step.robots[0].clone();
    (second.robot, second.state) = (robot(2), String::new());
    step.robots.push(second);
    let refused = records.rollouts().write(id, 1, step).await;
    assert!(refused.is_err(), "{refused:?}");
    assert_eq!(records.rollouts().whole(id).await.unwrap(), before);
    assert!(
        records
            .rollouts()
            .notes(id, Some("sim-00001"), 9)
            .await
            .unwrap()
            .is_empty()
    );
    let mut long = rollout_step(1, None);
    long.robots[0].entry = "x".repeat(MAX_ROLLOUT_ENTRY + 1);
    let refused = records.rollouts().write(id, 1, long).await;
    assert!(
        matches!(refused, Err(RecordsError::Invalid(_))),
        "{refused:?}"
    );
}

#[tokio::test]
async fn there_are_so_many_and_the_oldest_that_are_over_make_room() {
    let records = memory().await;
    for _ in 0..MAX_ROLLOUTS_AT_WORK {
        begin(&records).await;
    }
    let next = records.rollouts().next_id().await.unwrap();
    let refused = records.rollouts().add(rollout(next)).await;
    assert!(
        matches!(refused, Err(RecordsError::TooMany(_))),
        "{refused:?}"
    );
    let mut end = rollout_step(1, Some("end"));
    end.over = true;
    // All but the first come to their end.
    for id in 2..=MAX_ROLLOUTS_AT_WORK {
        write(&records, id, 1, end.clone()).await;
    }
    let refused = records.rollouts().add(rollout(MAX_ROLLOUTS_AT_WORK)).await;
    assert!(matches!(refused, Err(RecordsError::Exists)), "{refused:?}");
    for id in next..=MAX_ROLLOUTS + 1 {
        let mut new = rollout(id);
        new.step.over = true;
        records.rollouts().add(new).await.unwrap();
    }
    let kept = records.rollouts().page(None, 1_000).await.unwrap();
    assert_eq!(kept.len() as i64, MAX_ROLLOUTS);
    assert!(
        records.rollouts().get(1).await.unwrap().is_some(),
        "it is at work"
    );
    assert_eq!(records.rollouts().get(2).await.unwrap(), None);
    assert!(
        records
            .rollouts()
            .robots(2, None, None, 9)
            .await
            .unwrap()
            .is_empty()
    );
    assert!(
        records
            .rollouts()
            .notes(2, None, 9)
            .await
            .unwrap()
            .is_empty()
    );
}
