use crate::Entry as Record;
use proptest::prelude::*;
use serde_json::json;

use super::queue::MOST;
use super::*;

fn record(at: i64) -> Record {
    Record {
        at,
        who: "ada".into(),
        from: "127.0.0.1".into(),
        action: "test".into(),
        target: String::new(),
        detail: Value::Null,
        outcome: "ok".into(),
    }
}

fn entry(n: usize) -> Entry {
    Entry {
        who: "ada".into(),
        from: "127.0.0.1".into(),
        action: "test",
        target: n.to_string(),
        detail: Value::Null,
        outcome: "ok".into(),
    }
}

fn audit(records: &Records) -> (AuditLog, AuditWriter) {
    AuditLog::new(records.clone(), Arc::new(Metrics::new()))
}

/// Lets `writer` write all that waits.
async fn finish(writer: AuditWriter) {
    let stop = CancellationToken::new();
    stop.cancel();
    writer.run(stop).await;
}

#[tokio::test]
async fn what_there_was_no_room_for_is_a_gap_in_the_log() {
    let records = Records::in_memory().await.expect("records");
    let (audit, writer) = audit(&records);
    for n in 0..MOST + 10 {
        audit.note(entry(n));
    }
    assert!(!audit.has_room());
    finish(writer).await;
    let newest = records.audit().page(None, 2, None).await.expect("a page");
    assert_eq!(newest[0].entry.action, "audit.gap");
    assert_eq!(newest[0].entry.detail["entries"], 10);
    assert_eq!(newest[1].entry.target, (MOST - 1).to_string());
    assert_eq!(records.audit().verify().await, Ok(MOST as u64 + 1));
    assert_eq!(records.audit().lost().await.expect("a number"), 10);
    // Whoever comes after the end is not kept waiting.
    audit.write(entry(0)).await;
    records.close().await;
}

#[tokio::test]
async fn entries_are_written_in_their_order_and_waited_for() {
    let records = Records::in_memory().await.expect("records");
    let (audit, writer) = audit(&records);
    let stop = CancellationToken::new();
    let task = tokio::spawn(writer.run(stop.clone()));
    for n in 0..300 {
        if n % 3 == 0 {
            audit.write(entry(n)).await;
            let newest = records.audit().page(None, 1, None).await.expect("a page");
            assert_eq!(newest[0].entry.target, n.to_string(), "it is on disk");
        } else {
            audit.note(entry(n));
        }
    }
    stop.cancel();
    task.await.expect("it ends");
    let mut all = records
        .audit()
        .page(None, 1_000, None)
        .await
        .expect("a page");
    all.reverse();
    let targets: Vec<_> = all.into_iter().map(|stored| stored.entry.target).collect();
    let wanted: Vec<_> = (0..300).map(|n| n.to_string()).collect();
    assert_eq!(targets, wanted);
    records.close().await;
}

/// Nobody waits for records that take nothing.
#[tokio::test]
async fn whoever_waits_is_let_go_when_nothing_can_be_written() {
    let queue = Arc::new(Queue::new(Arc::new(Metrics::new())));
    let waiting = Arc::clone(&queue);
    let task = tokio::spawn(async move { waiting.push_and_wait(record(1)).await });
    queue.added().await;
    assert_eq!(queue.batch(BATCH).len(), 1);
    queue.failed(&RecordsError::Invalid("a full disk"));
    task.await.expect("let go");
    queue.push_and_wait(record(2)).await;
    let waits = queue.batch(BATCH);
    assert_eq!(waits, [record(1), record(2)], "both are kept");
    assert!(queue.is_failing());
    queue.written(2);
    assert!(!queue.is_failing());
    assert!(queue.batch(BATCH).is_empty());
}

#[derive(Debug, Clone)]
enum Step {
    Push(u16),
    Write(u8),
    Fail,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        (1_u16..3_000).prop_map(Step::Push),
        any::<u8>().prop_map(Step::Write),
        Just(Step::Fail),
    ]
}

proptest! {
    /// Whatever the records take, and when: each entry is there once and in its place, or in a gap that
    /// says how many are missing and from when to when.
    #[test]
    fn every_entry_is_written_or_in_a_gap(steps in proptest::collection::vec(step(), 1..60)) {
        let queue = Queue::new(Arc::new(Metrics::new()));
        let mut log: Vec<Record> = Vec::new();
        let mut next = 0;
        let mut write = |most: usize| {
            let batch = queue.batch(most);
            queue.written(batch.len());
            log.extend(batch.iter().cloned());
            batch.len()
        };
        for step in steps {
            match step {
                Step::Push(count) => for _ in 0..count {
                    queue.push(record(next));
                    next += 1;
                },
                Step::Write(most) => { write(usize::from(most)); }
                Step::Fail => {
                    let batch = queue.batch(BATCH);
                    queue.failed(&RecordsError::Invalid("a full disk"));
                    prop_assert_eq!(queue.batch(BATCH), batch, "they stay");
                }
            }
        }
        while write(MOST) > 0 {}
        let mut at = 0;
        for entry in &log {
            if entry.action == "audit.gap" {
                let missing = entry.detail["entries"].as_i64().expect("a number");
                prop_assert!(missing > 0);
                prop_assert_eq!(&entry.detail["from"], &json!(at));
                at += missing;
                prop_assert_eq!(&entry.detail["to"], &json!(at - 1));
            } else {
                prop_assert_eq!(entry.at, at);
                at += 1;
            }
        }
        prop_assert_eq!(at, next, "none is missing without a word");
    }
}
