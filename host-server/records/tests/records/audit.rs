//! The audit log keeps what it was told, shows it page by page, and notices when it was changed.

use crate::support::{Folder, entry, memory, on_postgres, open};
use crawler_records::{Broken, Entry, Records, RecordsError};
use serde_json::{Value, json};

async fn fill(records: &Records, count: i64) {
    for n in 1..=count {
        assert_eq!(records.audit().append(entry(n)).await.unwrap(), n as u64);
    }
}

/// A disk without room.
struct Full;
impl std::io::Write for Full {
    fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
        Err(std::io::ErrorKind::StorageFull.into())
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[tokio::test]
async fn entries_come_back_newest_first_in_pages() {
    let folder = Folder::new();
    let records = open(&folder).await;
    assert_eq!(records.audit().verify().await, Ok(0));
    fill(&records, 5).await;
    records.close().await;
    let records = open(&folder).await;
    assert_eq!(records.audit().append(entry(6)).await.unwrap(), 6);

    let page = records.audit().page(None, 4, None).await.unwrap();
    let seqs: Vec<u64> = page.iter().map(|stored| stored.seq).collect();
    assert_eq!(seqs, [6, 5, 4, 3]);
    assert_eq!(page[0].entry, entry(6));
    assert_eq!(page[0].hash.len(), 64);
    let page = records.audit().page(Some(3), 4, None).await.unwrap();
    assert_eq!(page.len(), 2);
    let page = records.audit().page(None, 100, Some("bob")).await.unwrap();
    let seqs: Vec<u64> = page.iter().map(|stored| stored.seq).collect();
    assert_eq!(seqs, [5, 3, 1]);
    let page = records.audit().page(Some(5), 1, Some("bob")).await.unwrap();
    assert_eq!(page[0].seq, 3);
    assert!(
        records
            .audit()
            .page(Some(u64::MAX), 0, None)
            .await
            .unwrap()
            .is_empty()
    );
    assert_eq!(records.audit().verify().await, Ok(6));
}

#[tokio::test]
async fn what_is_too_long_is_cut_and_kept() {
    let records = memory().await;
    let long = "ä\0\"".repeat(20_000);
    let flood = Entry {
        at: i64::MIN,
        who: long.clone(),
        from: long.clone(),
        action: long.clone(),
        target: long.clone(),
        detail: json!({ "text": long }),
        outcome: long,
    };
    assert_eq!(records.audit().append(flood).await.unwrap(), 1);
    let page = records.audit().page(None, 1, None).await.unwrap();
    let entry = &page[0].entry;
    assert!(entry.who.len() <= 64 && entry.who.ends_with('…'));
    assert!(entry.outcome.len() <= 128);
    assert!(entry.detail["cut"].is_string());
    assert!(entry.detail.to_string().len() <= 8_192);
    assert_eq!(records.audit().verify().await, Ok(1));
}

#[tokio::test]
async fn an_export_has_every_entry_once_in_order() {
    let records = memory().await;
    fill(&records, 1_203).await;
    let mut text = Vec::new();
    assert_eq!(records.audit().export(&mut text).await.unwrap(), 1_203);
    let text = String::from_utf8(text).unwrap();
    for (index, line) in text.lines().enumerate() {
        let value: Value = serde_json::from_str(line).unwrap();
        assert_eq!(value["seq"], index as u64 + 1);
        assert_eq!(value["target"], format!("robot-{}", index + 1));
        assert_eq!(value["hash"].as_str().unwrap().len(), 64);
    }
    assert_eq!(text.lines().count(), 1_203);
    assert_eq!(records.audit().verify().await, Ok(1_203));

    assert!(matches!(
        records.audit().export(&mut Full).await,
        Err(RecordsError::Io { .. })
    ));
}

#[tokio::test]
async fn the_database_refuses_to_change_the_log() {
    let folder = Folder::new();
    let records = open(&folder).await;
    fill(&records, 3).await;
    // The ways around a trigger differ.
    let around = if on_postgres() {
        [
            "TRUNCATE audit, audit_end",
            "UPDATE audit_end SET hash = decode(repeat('00', 32), 'hex')",
        ]
    } else {
        [
            "INSERT OR REPLACE INTO audit SELECT seq, at, 'eve', came_from, action, target, detail,
             outcome, hash FROM audit WHERE seq = 2",
            "UPDATE audit_end SET hash = zeroblob(32)",
        ]
    };
    for sql in [
        "UPDATE audit SET who = 'eve' WHERE seq = 2",
        "DELETE FROM audit WHERE seq = 3",
        "DELETE FROM audit",
        "INSERT INTO audit SELECT seq, at, 'eve', came_from, action, target, detail, outcome, hash
         FROM audit WHERE seq = 2 ON CONFLICT (seq) DO UPDATE SET who = excluded.who",
        "INSERT INTO audit SELECT 9, at, 'eve', came_from, action, target, detail, outcome, hash
         FROM audit WHERE seq = 2",
        "UPDATE audit_end SET seq = 2",
        "DELETE FROM audit_end",
    ]
    .into_iter()
    .chain(around)
    {
        let error = folder.tamper(sql).await.expect_err(sql).to_string();
        assert!(error.contains("append-only"), "{sql}: {error}");
    }
    assert_eq!(records.audit().verify().await, Ok(3));
}

#[tokio::test]
async fn tampering_is_found_where_it_was_done() {
    let open_up = if on_postgres() {
        "ALTER TABLE audit DISABLE TRIGGER USER; ALTER TABLE audit_end DISABLE TRIGGER USER"
    } else {
        "DROP TRIGGER audit_never_changes; DROP TRIGGER audit_never_shrinks;
         DROP TRIGGER audit_only_grows; DROP TRIGGER audit_end_stays;
         DROP TRIGGER audit_end_follows;"
    };
    let no_hash = if on_postgres() {
        "UPDATE audit SET hash = decode(repeat('00', 32), 'hex') WHERE seq = 3"
    } else {
        "UPDATE audit SET hash = zeroblob(32) WHERE seq = 3"
    };
    let original = Folder::new();
    let records = open(&original).await;
    // A few together, since each alone waits for the disk; all together, the last would wait too long.
    for first in (1..=703).step_by(37) {
        let mut writes = tokio::task::JoinSet::new();
        for n in first..first + 37 {
            let records = records.clone();
            writes.spawn(async move { records.audit().append(entry(n)).await.unwrap() });
        }
        writes.join_all().await;
    }
    assert_eq!(records.audit().verify().await, Ok(703));
    records.close().await;
    for (sql, seq) in [
        ("UPDATE audit SET who = 'eve' WHERE seq = 700", 700),
        ("UPDATE audit SET at = at + 1 WHERE seq = 1", 1),
        ("UPDATE audit SET detail = '{}' WHERE seq = 2", 2),
        // The border between two fields moves; the texts one after the other stay the same.
        (
            "UPDATE audit SET action = 'commandr', target = substr(target, 2) WHERE seq = 4",
            4,
        ),
        (no_hash, 3),
        ("DELETE FROM audit WHERE seq = 5", 5),
        ("DELETE FROM audit WHERE seq >= 701", 701),
        ("DELETE FROM audit", 1),
        // The end moved along with it.
        (
            "DELETE FROM audit WHERE seq > 700; UPDATE audit_end SET seq = 700",
            700,
        ),
        (
            "UPDATE audit SET seq = 9999 WHERE seq = 6; UPDATE audit SET seq = 6 WHERE seq = 7;
             UPDATE audit SET seq = 7 WHERE seq = 9999",
            6,
        ),
        ("DELETE FROM audit_end", 1),
        // Beside what is sealed: behind the end, far behind it, and before the beginning.
        (
            "INSERT INTO audit SELECT 704, at, 'eve', came_from, action, target, detail, outcome, hash
             FROM audit WHERE seq = 2",
            704,
        ),
        (
            "INSERT INTO audit SELECT 9999, at, 'eve', came_from, action, target, detail, outcome, hash
             FROM audit WHERE seq = 2",
            9_999,
        ),
        (
            "INSERT INTO audit SELECT -7, at, 'eve', came_from, action, target, detail, outcome, hash
             FROM audit WHERE seq = 2",
            0,
        ),
    ] {
        let folder = original.copy();
        let records = open(&folder).await;
        folder.tamper(open_up).await.unwrap();
        folder.tamper(sql).await.unwrap();
        let Err(Broken { seq: found, why }) = records.audit().verify().await else {
            panic!("{sql}: not found");
        };
        assert_eq!(found, seq, "{sql}: {why}");
        records.close().await;
    }
}

#[tokio::test]
async fn many_at_once_make_one_chain() {
    let folder = Folder::new();
    // Two handles as two processes have them: neither knows of the other.
    let (one, other) = (open(&folder).await, open(&folder).await);
    let mut tasks = tokio::task::JoinSet::new();
    for n in 0..200 {
        let records = if n % 2 == 0 { &one } else { &other }.clone();
        tasks.spawn(async move { records.audit().append(entry(n)).await.unwrap() });
    }
    let mut seqs = tasks.join_all().await;
    seqs.sort_unstable();
    assert_eq!(seqs, (1..=200).collect::<Vec<u64>>());
    assert_eq!(one.audit().verify().await, Ok(200));
    assert_eq!(other.audit().verify().await, Ok(200));
}

/// The statement that puts the entry `seq` of `records` into another log, as it is.
async fn as_it_is(records: &Records, seq: u64) -> &'static str {
    let page = records.audit().page(Some(seq + 1), 1, None).await.unwrap();
    let stored = &page[0];
    let entry = &stored.entry;
    let hash = if on_postgres() {
        format!("decode('{}', 'hex')", stored.hash)
    } else {
        format!("x'{}'", stored.hash)
    };
    let sql = format!(
        "INSERT INTO audit VALUES ({seq}, {}, '{}', '{}', '{}', '{}', '{}', '{}', {hash})",
        entry.at, entry.who, entry.from, entry.action, entry.target, entry.detail, entry.outcome
    );
    sql.leak()
}

#[tokio::test]
async fn what_stands_behind_the_end_is_told_of_and_blocks_nothing() {
    let original = Folder::new();
    let records = open(&original).await;
    fill(&records, 3).await;
    records.close().await;
    let longer = original.copy();
    let records = open(&longer).await;
    assert_eq!(records.audit().append(entry(4)).await.unwrap(), 4);
    // Its hash is right, as if the server had written it.
    let right = as_it_is(&records, 4).await;
    records.close().await;
    let wrong = "INSERT INTO audit SELECT 4, at, 'eve', came_from, action, target, detail, outcome,
                 hash FROM audit WHERE seq = 2";
    for sql in [right, wrong] {
        let folder = original.copy();
        let records = open(&folder).await;
        // It has the number that comes next, so the database takes it from anybody.
        folder.tamper(sql).await.unwrap();
        assert_eq!(records.audit().verify().await.unwrap_err().seq, 4, "{sql}");
        // The log goes on behind it, and says so.
        assert_eq!(records.audit().append(entry(5)).await.unwrap(), 6, "{sql}");
        let page = records.audit().page(None, 2, None).await.unwrap();
        assert_eq!(page[0].entry, entry(5));
        let note = &page[1].entry;
        assert_eq!(
            (note.who.as_str(), note.action.as_str()),
            ("server", "audit.foreign")
        );
        assert_eq!(
            (note.target.as_str(), &note.detail["first"]),
            ("4", &json!(4))
        );
        assert_eq!(records.audit().append(entry(6)).await.unwrap(), 7, "{sql}");
        // That does not make it good.
        assert_eq!(records.audit().verify().await.unwrap_err().seq, 4, "{sql}");
        records.close().await;
    }
}

#[tokio::test]
async fn a_batch_stays_in_its_order_and_a_gap_is_counted() {
    let folder = Folder::new();
    let records = open(&folder).await;
    records.audit().append_all(Vec::new()).await.unwrap();
    assert_eq!(records.audit().lost().await.unwrap(), 0);
    let mut batch: Vec<Entry> = (1..=130).map(entry).collect();
    batch.push(Entry::gap(7, 131, 137));
    batch.push(Entry::gap(5, 138, 142));
    records.audit().append_all(batch.clone()).await.unwrap();
    records.audit().append(entry(143)).await.unwrap();
    assert_eq!(
        records.audit().verify().await,
        Ok(133),
        "gaps are sealed too"
    );
    assert_eq!(records.audit().lost().await.unwrap(), 12);
    let mut page = records.audit().page(None, 1_000, None).await.unwrap();
    page.reverse();
    batch.push(entry(143));
    let kept: Vec<Entry> = page.into_iter().map(|stored| stored.entry).collect();
    assert_eq!(kept, batch);
}
