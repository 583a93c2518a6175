use super::*;

fn sample(n: i64, at: i64) -> Sample {
    Sample {
        robot: RobotId::new("sim-1").expect("a robot id"),
        at,
        x: n as f32 * 0.37,
        y: n as f32 * -0.11,
        theta: 0.0,
        range_mm: None,
        battery_mv: 7_000 + (n % 977) as u16,
        battery_percent: 50,
        rssi: None,
        left: 0.0,
        right: 0.0,
        state: RobotState::Idle,
    }
}

async fn pragma(history: &History, sql: &'static str) {
    let db = history.db().expect("a history that is kept here");
    let done = db.write(move |connection| {
        Box::pin(async move {
            sqlx::raw_sql(sql).execute(connection).await?;
            Ok(())
        })
    });
    done.await.expect("a pragma");
}

async fn count(history: &History, begin: i64) -> u64 {
    let robot = RobotId::new("sim-1").expect("a robot id");
    let points = history.query(&robot, begin, begin + 60_000, 1_000).await;
    let points = points.expect("points");
    points.iter().map(|point| point.count).sum()
}

#[tokio::test]
async fn a_full_disk_delays_samples_and_loses_none() {
    let (history, _running) = History::in_memory().await.expect("a history");
    let history = &history;
    let begin = now() - 3_600_000;
    pragma(history, "PRAGMA max_page_count = 1").await;
    for n in 0..5_000 {
        history.push(sample(n, begin + n)).expect("room");
    }
    let error = history.flush().await.expect_err("no room on disk");
    assert!(matches!(error, RecordsError::Storage(_)), "{error}");
    assert_eq!(count(history, begin).await, 0);
    // What comes in meanwhile waits behind.
    history.push(sample(5_000, begin + 5_000)).expect("room");
    let stats = history.stats();
    assert!(stats.failures >= 1 && stats.written == 0, "{stats:?}");

    pragma(history, "PRAGMA max_page_count = 1000000").await;
    history.flush().await.expect("room again");
    assert_eq!(history.stats().written, 5_001);
    assert_eq!(count(history, begin).await, 5_001);

    // The same between tail and blocks.
    pragma(history, "PRAGMA max_page_count = 1").await;
    let error = history.settle().await.expect_err("no room for blocks");
    assert!(matches!(error, RecordsError::Storage(_)), "{error}");
    assert_eq!(history.stats().open, 5_001);
    assert_eq!(count(history, begin).await, 5_001);
    pragma(history, "PRAGMA max_page_count = 1000000").await;
    history.settle().await.expect("room again");
    assert_eq!(history.stats().open, 0);
    assert_eq!(count(history, begin).await, 5_001);
}

#[tokio::test]
async fn a_robot_that_sent_nothing_has_no_block_in_a_seal() {
    let (history, _running) = History::in_memory().await.expect("a history");
    let history = &history;
    let begin = now() - 3_600_000;
    // Room that one seal leaves is used by the next but one.
    for (turn, name) in (1..).zip(["sim-1", "sim-2", "sim-3", "sim-1", "sim-1"]) {
        let robot = RobotId::new(name).expect("a robot id");
        let sample = sample(turn, begin + turn);
        history.push(Sample { robot, ..sample }).expect("room");
        history.settle().await.expect("room on disk");
        let stats = history.stats();
        assert_eq!(stats.open, 0);
        // Every sample, seconds, minutes.
        assert_eq!(stats.blocks, 3 * turn.unsigned_abs(), "{name}");
    }
    assert_eq!(count(history, begin).await, 3);
}
