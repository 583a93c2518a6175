use super::*;

const SETTINGS: Schema = Schema {
    id: 1,
    steps: &["CREATE TABLE setting (key TEXT PRIMARY KEY NOT NULL, value BLOB NOT NULL) STRICT;"],
};

async fn put(db: &Db, key: &'static str, value: Vec<u8>) -> Result<(), RecordsError> {
    db.write(move |connection| {
        Box::pin(async move {
            sqlx::query("INSERT INTO setting (key, value) VALUES (?, ?)")
                .bind(key)
                .bind(value)
                .execute(connection)
                .await?;
            Ok(())
        })
    })
    .await
}

async fn count(db: &Db) -> i64 {
    db.read(|connection| {
        Box::pin(async move {
            let (count,): (i64,) = sqlx::query_as("SELECT count(*) FROM setting")
                .fetch_one(connection)
                .await?;
            Ok(count)
        })
    })
    .await
    .expect("a count")
}

async fn pragma(db: &Db, sql: &'static str) -> Result<(), RecordsError> {
    db.write(move |connection| connection.run(sql)).await
}

#[tokio::test]
async fn a_write_that_fails_takes_no_other_with_it() {
    let db = Db::in_memory(&SETTINGS).await.unwrap();
    // All three wait when the writer first looks, and so share a transaction.
    let (one, twin, other) = tokio::join!(
        put(&db, "one", vec![1]),
        put(&db, "one", vec![2]),
        put(&db, "other", vec![3])
    );
    assert!(one.is_ok() && other.is_ok(), "{one:?} {other:?}");
    assert!(matches!(twin, Err(RecordsError::Storage(_))), "{twin:?}");
    assert_eq!(count(&db).await, 2);
}

#[tokio::test]
async fn nothing_is_acknowledged_that_was_not_committed() {
    let db = Db::in_memory(&SETTINGS).await.unwrap();
    // The second ends the transaction that it shares with the others.
    let (one, vandal, other) = tokio::join!(
        put(&db, "one", vec![1]),
        pragma(&db, "ROLLBACK"),
        put(&db, "other", vec![3])
    );
    for outcome in [one, vandal, other] {
        assert!(matches!(outcome, Err(RecordsError::Storage(_))));
    }
    assert_eq!(count(&db).await, 0);
    put(&db, "next", vec![]).await.expect("a new transaction");
    assert_eq!(count(&db).await, 1);
}

#[tokio::test]
async fn a_full_disk_is_an_error_and_passes() {
    let db = Db::in_memory(&SETTINGS).await.unwrap();
    put(&db, "before", vec![0; 100]).await.unwrap();
    pragma(&db, "PRAGMA max_page_count = 1").await.unwrap();
    let outcome = put(&db, "big", vec![0; 60_000]).await;
    let error = outcome.expect_err("no room");
    assert_eq!(error.sqlite_code(), Some(13), "{error}");
    assert_eq!(count(&db).await, 1);
    pragma(&db, "PRAGMA max_page_count = 100000").await.unwrap();
    put(&db, "big", vec![0; 60_000]).await.expect("room again");
    assert_eq!(count(&db).await, 2);
}

#[tokio::test]
async fn who_stops_waiting_does_not_stop_the_write() {
    let db = Db::in_memory(&SETTINGS).await.unwrap();
    {
        let mut write = Box::pin(put(&db, "left", vec![1]));
        // One poll hands the work over.
        tokio::select! {
            biased;
            _ = &mut write => panic!("not before the writer ran"),
            () = std::future::ready(()) => {}
        }
    }
    put(&db, "stayed", vec![2]).await.unwrap();
    assert_eq!(count(&db).await, 2);
}
