//! Frames of many robots are what each robot's points are, whatever level and stage they are in.

use std::collections::BTreeSet;

use crate::support::{Folder, memory, now, open, robot, sample};
use crawler_history::{Frame, History, MAX_FRAMES, Recorded, Track};
use crawler_protocol::RobotId;
use crawler_records::{Records, RecordsError, backup};

const HOUR: i64 = 3_600_000;
/// Robots with a history.
const ROBOTS: usize = 20;

/// Whether two frames are the same, but for what becomes of means once they are in blocks: whole
/// millimetres and percent.
fn alike(one: &Frame, other: &Frame) -> bool {
    let near = |one: f32, other: f32, by: f32| (one - other).abs() <= by;
    let ranges = match (one.range_mm, other.range_mm) {
        (Some(one), Some(other)) => near(one, other, 1.0),
        (one, other) => one == other,
    };
    (one.at, one.state, one.theta.to_bits()) == (other.at, other.state, other.theta.to_bits())
        && near(one.x, other.x, 0.002)
        && near(one.y, other.y, 0.002)
        && near(one.battery_percent, other.battery_percent, 1.0)
        && ranges
}

/// Holds the frames of `robots` to what is asked robot by robot.
async fn compare(history: &History, robots: &BTreeSet<RobotId>, (from, to, step): (i64, i64, i64)) {
    let found = history.frames(robots, from, to, step).await.unwrap();
    let mut wanted = Vec::new();
    for robot in robots {
        let points = history.query(robot, from, to, step).await.unwrap();
        let frames: Vec<Frame> = points.iter().map(Frame::from).collect();
        if !frames.is_empty() {
            wanted.push(Track {
                robot: robot.clone(),
                frames,
            });
        }
    }
    let what = format!("{} robots, {from}..{to} by {step}", robots.len());
    let names = |tracks: &[Track]| -> Vec<_> {
        let names = tracks.iter().map(|track| track.robot.clone());
        names.collect()
    };
    assert_eq!(names(&found), names(&wanted), "{what}");
    for (found, wanted) in found.iter().zip(&wanted) {
        assert_eq!(found.frames.len(), wanted.frames.len(), "{what}");
        for (found, wanted) in found.frames.iter().zip(&wanted.frames) {
            assert!(alike(found, wanted), "{what}: {found:?} is not {wanted:?}");
        }
    }
}

#[tokio::test]
async fn frames_are_the_points_of_each_robot() {
    let folder = Folder::new();
    let begin = now() / HOUR * HOUR - 2 * HOUR;
    let mut records = open(&folder).await;
    assert_eq!(records.history().recorded().await.unwrap(), None);
    let mut end = begin;
    // In blocks, in blocks that were written after a restart, in the tail alone.
    for part in 0..3 {
        for n in 0..8_000 {
            let n = part * 8_000 + n;
            end = begin + n * 150 + n % 7;
            let sample = sample(&robot(n as usize % ROBOTS), n, end);
            records.history().push(sample).unwrap();
        }
        records.history().flush().await.unwrap();
        if part == 1 {
            records.close().await;
            drop(records);
            records = open(&folder).await;
        }
        if part < 2 {
            records.history().settle().await.unwrap();
        }
    }
    let history = records.history();
    let Some(Recorded { from, to }) = history.recorded().await.unwrap() else {
        panic!("nothing is recorded");
    };
    assert!((begin - 60_000..=begin).contains(&from), "{from} {begin}");
    assert_eq!(to, end);
    let known = history.robots().await.unwrap();
    assert_eq!(known, (0..ROBOTS).map(robot).collect());

    let nobody = robot(ROBOTS + 7);
    let few: BTreeSet<_> = [robot(3), nobody.clone()].into();
    let some: BTreeSet<_> = (0..ROBOTS / 2).map(robot).collect();
    for robots in [&known, &some, &few, &[nobody].into(), &BTreeSet::new()] {
        for stretch in [
            (begin, end + 1, 3_000),
            (begin, end + 1, 60_000),
            (begin, end + 1, 600_000),
            (begin + 1_000_123, begin + 1_100_000, 500),
            (begin + 1_200_000, begin + 1_260_001, 100),
            (begin + 1_200_333, begin + 2_400_777, 7_000),
            (begin - HOUR, begin, 10_000),
        ] {
            compare(history, robots, stretch).await;
        }
    }
    let stats = history.stats();
    assert_eq!((stats.damaged, stats.dropped), (0, 0), "{stats:?}");

    // A process that does not keep the history sees what is in blocks.
    history.settle().await.unwrap();
    let other = Records::open(folder.path()).await.unwrap();
    assert!(!other.history().stats().keeper);
    assert_eq!(other.history().robots().await.unwrap(), known);
    let of_blocks = other
        .history()
        .frames(&known, begin, begin + 1_000_000, 5_000)
        .await;
    assert_eq!(of_blocks.unwrap().len(), ROBOTS);
    compare(other.history(), &known, (begin, end, 5_000)).await;
    other.close().await;
    records.close().await;
}

#[tokio::test]
async fn frames_stay_the_same_while_blocks_are_made() {
    let records = memory().await;
    let begin = now() / HOUR * HOUR - HOUR;
    let known: BTreeSet<_> = (0..5).map(robot).collect();
    for n in 0..30_000_usize {
        let sample = sample(&robot(n % 5), n as i64, begin + n as i64 * 100);
        records.history().push(sample).unwrap();
    }
    records.history().flush().await.unwrap();
    let (from, to) = (begin, begin + HOUR);
    let before = records.history().frames(&known, from, to, 10_000).await;
    let before = before.unwrap();
    assert_eq!(before.len(), 5);
    assert!(before.iter().all(|track| track.frames.len() == 300));
    let settling = records.clone();
    let settled = tokio::spawn(async move { settling.history().settle().await });
    loop {
        let over = settled.is_finished();
        let found = records.history().frames(&known, from, to, 10_000).await;
        for (found, before) in found.unwrap().iter().zip(&before) {
            assert_eq!(found.frames.len(), before.frames.len());
            for (found, before) in found.frames.iter().zip(&before.frames) {
                // Means of seconds are rounded to the millimetre.
                assert_eq!((found.at, found.state), (before.at, before.state));
                assert!((found.x - before.x).abs() < 0.002, "{found:?} {before:?}");
            }
        }
        if over {
            break;
        }
        tokio::task::yield_now().await;
    }
    settled.await.unwrap().unwrap();
}

#[tokio::test]
async fn a_question_that_is_too_large_is_refused() {
    let records = memory().await;
    let begin = now() - HOUR;
    let many = MAX_FRAMES / 5_000;
    let known: BTreeSet<_> = (0..=many).map(robot).collect();
    for robot in &known {
        let sample = sample(robot, 1, begin);
        records.history().push(sample).unwrap();
    }
    records.history().flush().await.unwrap();
    let ask = async |robots: &BTreeSet<RobotId>, to: i64, step: i64| {
        records.history().frames(robots, begin, to, step).await
    };
    let error = ask(&known, begin + 500_000, 100).await.unwrap_err();
    assert!(matches!(error, RecordsError::Invalid(_)), "{error}");
    let fewer: BTreeSet<_> = (0..many).map(robot).collect();
    let found = ask(&fewer, begin + 500_000, 100).await.unwrap();
    assert_eq!(found.len(), many);
    for (to, step) in [
        (begin, 100),
        (begin - 1, 100),
        (begin + 1, 0),
        (i64::MAX, 1),
    ] {
        let error = ask(&fewer, to, step).await.unwrap_err();
        assert!(matches!(error, RecordsError::Invalid(_)), "{error}");
    }
}

#[tokio::test]
async fn a_history_that_is_elsewhere_has_nothing() {
    let folder = Folder::new();
    let records = Records::open_without_history(folder.path()).await.unwrap();
    let history = records.history();
    assert!(history.push(sample(&robot(1), 1, now())).is_err());
    assert_eq!(history.recorded().await.unwrap(), None);
    assert_eq!(history.robots().await.unwrap(), BTreeSet::new());
    let robots = [robot(1)].into();
    let frames = history.frames(&robots, 0, now(), HOUR * 24).await;
    assert_eq!(frames.unwrap(), []);
    assert_eq!(history.query(&robot(1), 0, 5, 1).await.unwrap(), []);
    assert!(!folder.path().join("history.sqlite").exists());
    let backup = folder.path().join("backup");
    backup::create(&records, &backup).await.unwrap();
    assert!(!backup.join("history.sqlite").exists());
    records.close().await;
}
