use std::sync::atomic::{AtomicU64, Ordering};

use crawler_protocol::MapCell;
use proptest::prelude::*;

use super::*;

fn id(text: &str) -> RobotId {
    RobotId::new(text).expect("a robot id")
}

/// Maps, and how many commands went out: their numbers count from 1.
fn maps() -> (Arc<Maps>, Arc<AtomicU64>) {
    let sent = Arc::new(AtomicU64::new(0));
    let count = Arc::clone(&sent);
    let maps = Maps::new(move |_| Ok(count.fetch_add(1, Ordering::Relaxed) + 1));
    (Arc::new(maps), sent)
}

/// Rows `row` to `row + count` of a map of 24 × 6 cells, the first column of which is blocked.
fn part(robot: &str, seq: u64, row: u8, count: usize) -> MapSegment {
    MapSegment {
        robot: id(robot),
        seq,
        timestamp: 1_000 + u64::from(row),
        cell_mm: 100,
        origin: [-12, 3],
        columns: 24,
        rows: 6,
        row,
        cells: [1, 0, 0, 0, 0, 0].repeat(count).into_iter().collect(),
        goal: (row == 0).then_some([1.0, 2.0]),
        next: None,
        way: (row == 0).then_some([5, 5]).into_iter().collect(),
    }
}

fn refusal(robot: &str, seq: u64, reason: Reason) -> Response {
    Response {
        robot: id(robot),
        seq,
        status: ResponseStatus::Failed.into(),
        reason: Some(reason.into()),
        timestamp: 7,
        source: None,
    }
}

/// Lets everything that waits for nothing run.
async fn settle() {
    for _ in 0..10 {
        tokio::task::yield_now().await;
    }
}

fn reading(maps: &Arc<Maps>, robot: &str) -> tokio::task::JoinHandle<Outcome> {
    let (maps, robot) = (Arc::clone(maps), id(robot));
    tokio::spawn(async move { maps.read(&robot).await })
}

#[tokio::test(start_paused = true)]
async fn many_who_look_ask_once_a_second() {
    let (maps, sent) = maps();
    let [one, two] = [reading(&maps, "ada-1"), reading(&maps, "ada-1")];
    settle().await;
    assert_eq!(sent.load(Ordering::Relaxed), 1);
    maps.segment(&part("ada-1", 1, 0, 4));
    maps.segment(&part("ada-1", 1, 4, 2));
    let map = one.await.expect("joined").expect("a map");
    assert_eq!(two.await.expect("joined").as_ref(), Ok(&map));
    assert_eq!(
        (map.timestamp, map.origin, map.cell_mm),
        (1_000, [-12, 3], 100)
    );
    assert_eq!(
        (map.goal, map.next, &*map.way),
        (Some([1.0, 2.0]), None, &[[5, 5]][..])
    );
    assert_eq!(map.rows.len(), 6);
    for row in &map.rows {
        assert_eq!(row.len(), 24);
        assert_eq!((row[0], row[1]), (MapCell::Blocked, MapCell::Unmarked));
    }
    // What is fresh is given again; a second later the robot is asked.
    assert_eq!(maps.read(&id("ada-1")).await, Ok(map));
    assert_eq!(sent.load(Ordering::Relaxed), 1);
    tokio::time::advance(FRESH).await;
    let again = reading(&maps, "ada-1");
    settle().await;
    assert_eq!(sent.load(Ordering::Relaxed), 2);
    maps.answer(&refusal("ada-1", 2, Reason::NoMap));
    assert_eq!(again.await.expect("joined"), Err(MapError::None));
}

#[tokio::test(start_paused = true)]
async fn a_robot_that_does_not_answer_is_waited_for_so_long() {
    let (maps, _) = maps();
    let began = Instant::now();
    assert_eq!(maps.read(&id("ada-1")).await, Err(MapError::NoAnswer));
    assert_eq!(began.elapsed(), PATIENCE);
    // One that told a part as well; its answer says only that it thinks it has told all.
    let waits = reading(&maps, "ada-1");
    settle().await;
    maps.segment(&part("ada-1", 2, 0, 4));
    let mut done = refusal("ada-1", 2, Reason::Fault);
    (done.status, done.reason) = (ResponseStatus::Completed.into(), None);
    maps.answer(&done);
    assert_eq!(waits.await.expect("joined"), Err(MapError::NoAnswer));
}

#[tokio::test(start_paused = true)]
async fn what_was_not_asked_for_changes_nothing() {
    let (maps, _) = maps();
    // Of nobody who was asked.
    maps.segment(&part("eve-1", 1, 0, 6));
    maps.answer(&refusal("eve-1", 1, Reason::NoMap));
    let waits = reading(&maps, "ada-1");
    settle().await;
    // Of another robot, and of another command.
    maps.segment(&part("eve-1", 1, 0, 6));
    maps.segment(&part("ada-1", 7, 0, 6));
    maps.answer(&refusal("eve-1", 1, Reason::NoMap));
    maps.answer(&refusal("ada-1", 7, Reason::NoMap));
    // Not from the beginning, with a gap, and elsewhere.
    maps.segment(&part("ada-1", 1, 4, 2));
    maps.segment(&part("ada-1", 1, 0, 2));
    maps.segment(&part("ada-1", 1, 4, 2));
    let mut moved = part("ada-1", 1, 2, 4);
    moved.origin = [0, 0];
    maps.segment(&moved);
    settle().await;
    assert!(!waits.is_finished());
    // The map has moved, and is told anew.
    for (row, count) in [(0, 3), (3, 3)] {
        maps.segment(&MapSegment {
            origin: [0, 0],
            ..part("ada-1", 1, row, count)
        });
    }
    let map = waits.await.expect("joined").expect("a map");
    assert_eq!((map.origin, map.rows.len()), ([0, 0], 6));
    // The first outcome stays.
    maps.answer(&refusal("ada-1", 1, Reason::NoMap));
    assert_eq!(maps.read(&id("ada-1")).await, Ok(map));
}

#[tokio::test(start_paused = true)]
async fn no_more_than_so_many_robots_are_asked_at_a_time() {
    let (maps, sent) = maps();
    let robots: Vec<_> = (0..MOST).map(|number| format!("sim-{number:04}")).collect();
    let waiting: Vec<_> = robots.iter().map(|robot| reading(&maps, robot)).collect();
    settle().await;
    assert_eq!(sent.load(Ordering::Relaxed), MOST as u64);
    assert_eq!(maps.read(&id("ada-1")).await, Err(MapError::Busy));
    for waits in waiting {
        assert_eq!(waits.await.expect("joined"), Err(MapError::NoAnswer));
    }
    let waits = reading(&maps, "ada-1");
    settle().await;
    assert_eq!(sent.load(Ordering::Relaxed), MOST as u64 + 1);
    maps.answer(&refusal("ada-1", MOST as u64 + 1, Reason::Busy));
    let busy = Some(Reason::Busy.into());
    assert_eq!(waits.await.expect("joined"), Err(MapError::Refused(busy)));
}

#[tokio::test]
async fn who_cannot_be_asked_is_not_waited_for() {
    let maps = Maps::new(|_| Err(SendError::NotConnected));
    let error = MapError::NotSent(SendError::NotConnected);
    assert_eq!(maps.read(&id("ada-1")).await, Err(error));
    assert!(maps.requests().is_empty());
}

proptest! {
    /// Whatever segments come in whatever order: what is put together is a whole map, with rows of one length.
    #[test]
    fn a_map_is_whole(
        parts in proptest::collection::vec((0..8_u8, 1..6_usize, 0..3_i32, 0..2_u8), 0..40),
    ) {
        let mut assembly = Assembly::default();
        for (row, count, origin, wide) in parts {
            let columns = 24 * (wide + 1);
            let bytes = count * MapSegment::row_bytes(columns);
            let segment = MapSegment {
                origin: [origin, 0],
                columns,
                cells: vec![0x55; bytes].into_iter().collect(),
                ..part("ada-1", 1, row, 0)
            };
            if !segment.is_consistent() {
                continue;
            }
            if let Some(map) = assembly.add(&segment) {
                prop_assert_eq!(map.rows.len(), 6);
                let widths: Vec<_> = map.rows.iter().map(Vec::len).collect();
                prop_assert!(widths.iter().all(|width| *width == widths[0]));
                prop_assert_eq!(map.origin, segment.origin);
            }
        }
    }
}
