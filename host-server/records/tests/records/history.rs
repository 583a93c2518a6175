//! The history answers what a simple list would, whatever level and stage the samples are in.

use std::time::{Duration, Instant};

use crate::support::{Folder, memory, now, open, robot, sample};
use crawler_history::{Full, MAX_ROBOTS, Point, QUEUE, Retention, Sample};
use crawler_protocol::{RobotId, RobotState};
use crawler_records::RecordsError;

const HOUR: i64 = 3_600_000;

/// What the points should say, from a list of everything that was pushed.
fn expected(all: &[Sample], robot: &RobotId, from: i64, to: i64, step: i64) -> Vec<Point> {
    let mut mine: Vec<&Sample> = all
        .iter()
        .filter(|sample| &sample.robot == robot && (from..to).contains(&sample.at))
        .collect();
    mine.sort_by_key(|sample| sample.at);
    mine.chunk_by(|a, b| a.at / step == b.at / step)
        .map(|chunk| {
            let of = |pick: &dyn Fn(&Sample) -> Option<f32>| {
                let values: Vec<f32> = chunk.iter().filter_map(|sample| pick(sample)).collect();
                let sum: f64 = values.iter().map(|&value| f64::from(value)).sum();
                (!values.is_empty()).then(|| crawler_history::Span {
                    min: values.iter().copied().fold(f32::INFINITY, f32::min),
                    mean: (sum / values.len() as f64) as f32,
                    max: values.iter().copied().fold(f32::NEG_INFINITY, f32::max),
                })
            };
            let last = chunk.last().expect("chunks are not empty");
            Point {
                at: last.at / step * step,
                count: chunk.len() as u64,
                x: of(&|sample| Some(sample.x)).unwrap().mean,
                y: of(&|sample| Some(sample.y)).unwrap().mean,
                theta: last.theta,
                left: of(&|sample| Some(sample.left)).unwrap().mean,
                right: of(&|sample| Some(sample.right)).unwrap().mean,
                battery_mv: of(&|sample| Some(f32::from(sample.battery_mv))).unwrap(),
                battery_percent: of(&|sample| Some(f32::from(sample.battery_percent))).unwrap(),
                range_mm: of(&|sample| sample.range_mm.map(f32::from)),
                rssi: of(&|sample| sample.rssi.map(f32::from)),
                state: last.state,
            }
        })
        .collect()
}

fn assert_alike(found: &[Point], wanted: &[Point], what: &str) {
    assert_eq!(found.len(), wanted.len(), "{what}");
    for (found, wanted) in found.iter().zip(wanted) {
        assert_eq!((found.at, found.count), (wanted.at, wanted.count), "{what}");
        assert_eq!(found.state, wanted.state, "{what}");
        let near = |a: f32, b: f32, by: f32| {
            assert!((a - b).abs() <= by, "{what}: {found:?} is not {wanted:?}");
        };
        near(found.x, wanted.x, 0.002);
        near(found.y, wanted.y, 0.002);
        near(found.theta, wanted.theta, 0.001);
        near(found.left, wanted.left, 0.001);
        near(found.right, wanted.right, 0.001);
        let spans = [
            (Some(found.battery_mv), Some(wanted.battery_mv)),
            (Some(found.battery_percent), Some(wanted.battery_percent)),
            (found.range_mm, wanted.range_mm),
            (found.rssi, wanted.rssi),
        ];
        for (one, other) in spans {
            assert_eq!(
                one.is_some(),
                other.is_some(),
                "{what}: {found:?} {wanted:?}"
            );
            if let (Some(one), Some(other)) = (one, other) {
                assert_eq!((one.min, one.max), (other.min, other.max), "{what}");
                // Means of seconds and minutes are rounded to whole units.
                near(one.mean, other.mean, 1.0);
            }
        }
    }
}

#[tokio::test]
async fn every_stage_answers_like_a_list() {
    let folder = Folder::new();
    // Whole hours, so that no step cuts a stretch in two.
    let begin = now() / HOUR * HOUR - 2 * HOUR;
    let mut all = Vec::new();
    let mut records = open(&folder).await;
    // Samples come in over an hour and more, in three parts: one in blocks, one in blocks that were
    // written after a restart, one in the tail alone.
    for part in 0..3 {
        for n in 0..4_500 {
            let n = part * 4_500 + n;
            let sample = sample(&robot(n as usize % 3), n, begin + n * 334 + n % 7);
            records.history().push(sample.clone()).unwrap();
            all.push(sample);
        }
        records.history().flush().await.unwrap();
        if part == 1 {
            records.close().await;
            drop(records);
            records = open(&folder).await;
            assert_eq!(records.history().stats().open, 4_500, "read again");
        }
        if part < 2 {
            records.history().settle().await.unwrap();
            assert_eq!(records.history().stats().open, 0);
        }
    }
    let end = all.last().unwrap().at + 1;
    let after = end / 60_000 * 60_000 + 60_000;
    for (from, to, step) in [
        (begin, end, 500),
        (begin, end, 1_000),
        (begin, end, 5_000),
        (begin, end, 60_000),
        (begin, end, 600_000),
        (begin + 1_000_000, begin + 1_100_000, 334),
        (begin + 1_000_000, begin + 1_010_000, 1),
        (begin + 1_200_000, begin + 1_500_000, 1_000),
        (begin + 1_200_000, begin + 1_800_000, 60_000),
        (begin - HOUR, begin, 1_000),
        (after, after + HOUR, 1_000),
    ] {
        for robot in (0..4).map(robot) {
            let found = records
                .history()
                .query(&robot, from, to, step)
                .await
                .unwrap();
            let wanted = expected(&all, &robot, from, to, step);
            assert_alike(&found, &wanted, &format!("{robot} {from} {to} {step}"));
        }
    }
    let stats = records.history().stats();
    assert_eq!((stats.damaged, stats.failures, stats.dropped), (0, 0, 0));
    assert!(stats.blocks > 0 && stats.keeper);
}

#[tokio::test]
async fn an_answer_stays_the_same_while_blocks_are_made() {
    let records = memory().await;
    let (begin, robot) = (now() / HOUR * HOUR - HOUR, robot(1));
    for n in 0..30_000 {
        records
            .history()
            .push(sample(&robot, n, begin + n * 100))
            .unwrap();
    }
    records.history().flush().await.unwrap();
    let settling = records.clone();
    let settled = tokio::spawn(async move { settling.history().settle().await });
    let mut rounds = 0;
    loop {
        let over = settled.is_finished();
        for step in [1_000, 60_000] {
            let points = records
                .history()
                .query(&robot, begin, begin + HOUR, step)
                .await
                .unwrap();
            let count: u64 = points.iter().map(|point| point.count).sum();
            assert_eq!(count, 30_000, "step {step}, round {rounds}");
        }
        rounds += 1;
        if over {
            break;
        }
        tokio::task::yield_now().await;
    }
    settled.await.unwrap().unwrap();
}

#[tokio::test]
async fn a_full_queue_refuses_and_counts() {
    let records = memory().await;
    let begin = now() - HOUR;
    // Nothing here waits, so nobody empties the queue.
    for n in 0..QUEUE as i64 {
        let sample = sample(&robot(n as usize % 10), n, begin + n);
        assert_eq!(records.history().push(sample), Ok(()));
    }
    for n in 0..3 {
        assert_eq!(
            records.history().push(sample(&robot(1), n, begin)),
            Err(Full)
        );
    }
    let stats = records.history().stats();
    assert_eq!((stats.queued, stats.dropped), (QUEUE as u64, 3));
    records.history().flush().await.unwrap();
    let stats = records.history().stats();
    assert_eq!((stats.queued, stats.written), (0, QUEUE as u64));
    assert_eq!(records.history().push(sample(&robot(1), 0, begin)), Ok(()));

    records.close().await;
    assert_eq!(
        records.history().push(sample(&robot(1), 0, begin)),
        Err(Full)
    );
    assert!(matches!(
        records.history().flush().await,
        Err(RecordsError::Closed)
    ));
}

#[tokio::test]
async fn robots_are_bounded() {
    let records = memory().await;
    let begin = now() - HOUR;
    for n in 0..=MAX_ROBOTS {
        records.history().push(sample(&robot(n), 1, begin)).unwrap();
    }
    records.history().flush().await.unwrap();
    let stats = records.history().stats();
    assert_eq!((stats.written, stats.beyond), (MAX_ROBOTS as u64, 1));
    // Those that are known go on.
    records.history().push(sample(&robot(5), 2, begin)).unwrap();
    records.history().flush().await.unwrap();
    assert_eq!(records.history().stats().written, MAX_ROBOTS as u64 + 1);
}

#[tokio::test]
async fn odd_samples_are_kept_within_bounds() {
    let records = memory().await;
    let at = now() - 1_000;
    let robot = robot(1);
    let mut odd = sample(&robot, 1, at);
    (odd.x, odd.y, odd.theta) = (f32::NAN, f32::INFINITY, f32::NEG_INFINITY);
    (odd.left, odd.right) = (f32::MAX, f32::MIN);
    records.history().push(odd.clone()).unwrap();
    for at in [i64::MIN, i64::MAX, -1] {
        odd.at = at;
        records.history().push(odd.clone()).unwrap();
    }
    records.history().settle().await.unwrap();
    let points = records
        .history()
        .query(&robot, at, at + 1, 1)
        .await
        .unwrap();
    assert_eq!(points.len(), 1);
    assert_eq!((points[0].x, points[0].y), (0.0, 1e6));
    let points = records.history().query(&robot, 0, 1, 60_000).await.unwrap();
    assert_eq!(points[0].count, 2, "times before 1970 count as 1970");
}

#[tokio::test]
async fn a_question_that_makes_no_sense_is_refused() {
    let records = memory().await;
    for (from, to, step) in [
        (0, 10, 0),
        (0, 10, -1),
        (10, 10, 1),
        (11, 10, 1),
        (-1, 10, 1),
        (i64::MIN, i64::MAX, 1),
        (0, i64::MAX, 1),
        (now() - HOUR, now(), 300),
    ] {
        let outcome = records.history().query(&robot(1), from, to, step).await;
        assert!(
            matches!(outcome, Err(RecordsError::Invalid(_))),
            "{from} {to} {step}"
        );
    }
    for step in [i64::MAX, i64::MAX / 5] {
        let points = records.history().query(&robot(1), 0, i64::MAX, step).await;
        assert!(points.unwrap().is_empty());
    }
}

#[tokio::test]
async fn each_level_forgets_in_its_time() {
    let records = memory().await;
    let (robot, now) = (robot(1), now());
    let day = 24 * HOUR;
    for age in [1, 25, 8 * 24, 399 * 24, 401 * 24] {
        for n in 0..10 {
            // In one second and one minute, whatever the time is.
            let at = (now - age * HOUR) / 60_000 * 60_000 + n * 100;
            records.history().push(sample(&robot, n, at)).unwrap();
        }
        // A block of its own for each.
        records.history().settle().await.unwrap();
        records.history().settle().await.unwrap();
    }
    let count = async |age: i64, step: i64| {
        let from = (now - age * HOUR) / 60_000 * 60_000;
        let points = records.history().query(&robot, from, from + 2_000, step);
        let points = points.await.unwrap();
        (points.len(), points.iter().map(|point| point.count).sum())
    };
    let kept = records.history().retain(Retention::default(), now).await;
    // Raw of all but the first, seconds of the last three. The minutes share a block, which is as
    // young as its youngest.
    assert_eq!(kept.unwrap(), 7);
    assert_eq!(records.history().stats().expired, 7);
    assert_eq!(count(1, 100).await, (10, 10));
    assert_eq!(count(25, 100).await, (1, 10), "from seconds");
    assert_eq!(count(8 * 24, 100).await, (1, 10), "from minutes");
    assert_eq!(count(399 * 24, 100).await, (1, 10), "from minutes");
    let nothing = Retention {
        raw_ms: 0,
        seconds_ms: 0,
        minutes_ms: 0,
    };
    assert_eq!(
        records.history().retain(nothing, now + day).await.unwrap(),
        4
    );
    assert_eq!(count(1, 100).await, (0, 0));
}

#[tokio::test]
async fn the_second_process_reads_and_leaves_the_keeping_to_the_first() {
    let folder = Folder::new();
    let (begin, robot) = (now() - 60_000, robot(1));
    let first = open(&folder).await;
    let second = open(&folder).await;
    first.history().push(sample(&robot, 1, begin)).unwrap();
    assert_eq!(second.history().push(sample(&robot, 2, begin)), Err(Full));
    assert!(matches!(
        second.history().flush().await,
        Err(RecordsError::Closed)
    ));
    assert!(first.history().stats().keeper && !second.history().stats().keeper);
    first.history().settle().await.unwrap();
    let points = second.history().query(&robot, begin, begin + 1, 1).await;
    assert_eq!(points.unwrap().len(), 1);
    // Without a word of goodbye: what was pushed is written all the same.
    first.history().push(sample(&robot, 3, begin + 1)).unwrap();
    drop((first, second));
    let end = Instant::now() + Duration::from_mins(1);
    loop {
        let records = open(&folder).await;
        if records.history().stats().keeper {
            let points = records.history().query(&robot, begin, begin + 2, 2).await;
            let count: u64 = points.unwrap().iter().map(|point| point.count).sum();
            assert_eq!(count, 2);
            return;
        }
        let stats = records.history().stats();
        assert!(Instant::now() < end, "the first never let go: {stats:?}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

#[tokio::test]
async fn states_keep_their_names() {
    let records = memory().await;
    let begin = now() - HOUR;
    for (n, &state) in RobotState::ALL.iter().enumerate() {
        let mut sample = sample(&robot(1), 0, begin + n as i64);
        sample.state = state;
        records.history().push(sample).unwrap();
    }
    records.history().settle().await.unwrap();
    let points = records
        .history()
        .query(&robot(1), begin, begin + 100, 1)
        .await;
    let states: Vec<RobotState> = points.unwrap().iter().map(|point| point.state).collect();
    assert_eq!(states, RobotState::ALL);
}
