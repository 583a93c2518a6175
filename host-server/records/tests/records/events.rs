//! Events come back page by page, each once, and not for ever; arenas by their time.

use crate::support::{Folder, memory, on_postgres, open, robot};
use crawler_records::{
    Event, EventLevel, EventQuery, EventRetention, MAX_ARENA, MAX_EVENT_TEXT, Records,
    RecordsError, StoredEvent,
};
use proptest::prelude::*;

fn event(at: i64, level: EventLevel, of: Option<usize>, text: &str) -> Event {
    Event {
        at,
        level,
        robot: of.map(robot),
        text: text.to_owned(),
    }
}

fn all(limit: u32) -> EventQuery {
    EventQuery {
        from: 0,
        to: i64::MAX,
        level: EventLevel::Info,
        robot: None,
        before: None,
        limit,
    }
}

/// The `n`th event of a test.
fn numbered(n: usize) -> Event {
    let levels = [EventLevel::Info, EventLevel::Warn, EventLevel::Error];
    let of = (!n.is_multiple_of(4)).then_some(n % 4);
    // Several at the same time.
    let at = 1_000 + n as i64 / 3;
    event(at, levels[n % 3], of, &format!("event {n}"))
}

fn texts(events: &[StoredEvent]) -> Vec<&str> {
    let texts = events.iter().map(|stored| stored.event.text.as_str());
    texts.collect()
}

#[tokio::test]
async fn events_survive_and_are_found_by_what_is_asked() {
    let folder = Folder::new();
    let records = open(&folder).await;
    assert_eq!(records.events().page(all(10)).await.unwrap(), []);
    records.events().add(Vec::new()).await.unwrap();
    // More than go into one statement.
    let events: Vec<Event> = (0..250).map(numbered).collect();
    records.events().add(events.clone()).await.unwrap();
    records.close().await;
    let records = open(&folder).await;

    let found = records.events().page(all(1_000)).await.unwrap();
    let kept: Vec<Event> = found
        .iter()
        .rev()
        .map(|stored| stored.event.clone())
        .collect();
    assert_eq!(kept, events);
    assert_eq!(records.events().page(all(0)).await.unwrap(), []);

    for level in [EventLevel::Info, EventLevel::Warn, EventLevel::Error] {
        for of in [None, Some(2), Some(9)] {
            let wanted = EventQuery {
                level,
                robot: of.map(robot),
                from: 1_010,
                to: 1_050,
                ..all(1_000)
            };
            let found = records.events().page(wanted).await.unwrap();
            let fits = |event: &&Event| {
                event.level >= level
                    && (1_010..1_050).contains(&event.at)
                    && of.is_none_or(|of| event.robot == Some(robot(of)))
            };
            let expected: Vec<&Event> = events.iter().rev().filter(fits).collect();
            let found: Vec<&Event> = found.iter().map(|stored| &stored.event).collect();
            assert_eq!(found, expected, "{level:?} {of:?}");
        }
    }
    records.close().await;
}

#[tokio::test]
async fn pages_have_neither_gap_nor_repeat_while_new_ones_come() {
    let records = memory().await;
    let events: Vec<Event> = (0..97).map(numbered).collect();
    records.events().add(events).await.unwrap();
    let mut query = all(10);
    let (mut seen, mut later) = (Vec::new(), 97);
    loop {
        let page = records.events().page(query.clone()).await.unwrap();
        let Some(last) = page.last() else { break };
        query.before = Some(last.cursor());
        seen.extend(texts(&page).into_iter().map(str::to_owned));
        // What comes in meanwhile is of later.
        let new = (later..later + 15).map(numbered).collect();
        records.events().add(new).await.unwrap();
        later += 15;
    }
    let expected: Vec<String> = (0..97).rev().map(|n| format!("event {n}")).collect();
    assert_eq!(seen, expected);
    // A page before a place, and only of what is asked.
    query.before = None;
    query.to = 1_005;
    query.limit = 2;
    let page = records.events().page(query.clone()).await.unwrap();
    assert_eq!(texts(&page), ["event 14", "event 13"]);
    query.before = Some(page[1].cursor());
    let page = records.events().page(query).await.unwrap();
    assert_eq!(texts(&page), ["event 12", "event 11"]);
}

#[tokio::test]
async fn what_is_too_long_is_cut_and_nonsense_is_tamed() {
    let records = memory().await;
    let long = "ä\0".repeat(2_000);
    records
        .events()
        .add(vec![event(i64::MIN, EventLevel::Error, None, &long)])
        .await
        .unwrap();
    let found = records.events().page(all(1)).await.unwrap();
    let Event { at, text, .. } = &found[0].event;
    assert_eq!(*at, 0);
    assert!(
        text.len() <= MAX_EVENT_TEXT && text.ends_with('…'),
        "{text}"
    );
    assert!(text.starts_with("ä?ä?"), "{text}");
}

#[tokio::test]
async fn old_events_go_and_so_do_too_many() {
    let records = memory().await;
    let events = (0..90).map(numbered).collect();
    records.events().add(events).await.unwrap();
    let keep = EventRetention {
        events: 1_000,
        arenas: 10,
        ms: 500,
    };
    assert_eq!(records.prune_events(keep, 1_500).await.unwrap(), 0);
    assert_eq!(records.prune_events(keep, 1_510).await.unwrap(), 30);
    let found = records.events().page(all(1_000)).await.unwrap();
    assert_eq!(texts(&found).last(), Some(&"event 30"));
    let fewer = EventRetention { events: 20, ..keep };
    assert_eq!(records.prune_events(fewer, 1_510).await.unwrap(), 40);
    let found = records.events().page(all(1_000)).await.unwrap();
    assert_eq!(found.len(), 20);
    assert_eq!(texts(&found).last(), Some(&"event 70"));
    // By default nothing of this is too old or too much.
    let default = EventRetention::default();
    assert_eq!(records.prune_events(default, 2_000).await.unwrap(), 0);
    let (limit, days) = (default.events, default.ms / 86_400_000);
    assert_eq!((limit, days), (1_000_000, 400));
}

#[tokio::test]
async fn the_arena_of_a_time_is_known() {
    let folder = Folder::new();
    let records = open(&folder).await;
    // That there is none is no news.
    records.arenas().add(50, None).await.unwrap();
    assert_eq!(records.arenas().at(60).await.unwrap(), None);
    let arena = |text: &str| Some(text.to_owned());
    for (at, what) in [
        (100, arena("a")),
        // As it was.
        (150, arena("a")),
        (200, arena("b")),
        (210, arena("c")),
        (400, None),
        (450, None),
        (500, arena("c")),
    ] {
        records.arenas().add(at, what).await.unwrap();
    }
    let long = Some("x".repeat(MAX_ARENA + 1));
    let error = records.arenas().add(600, long).await.unwrap_err();
    assert!(matches!(error, RecordsError::Invalid(_)), "{error}");
    records.close().await;

    let records = open(&folder).await;
    for (at, what) in [
        (0, None),
        (99, None),
        (100, arena("a")),
        (199, arena("a")),
        (200, arena("b")),
        (399, arena("c")),
        (400, None),
        (i64::MAX, arena("c")),
    ] {
        assert_eq!(records.arenas().at(at).await.unwrap(), what, "{at}");
    }
    let within = async |from, to, step| records.arenas().changes(from, to, step).await.unwrap();
    assert_eq!(within(0, 100, 1).await, []);
    assert_eq!(
        within(100, 500, 1).await,
        [(200, arena("b")), (210, arena("c")), (400, None)]
    );
    // Of those within a step the last.
    assert_eq!(
        within(0, 1_000, 100).await,
        [
            (100, arena("a")),
            (210, arena("c")),
            (400, None),
            (500, arena("c"))
        ]
    );
    assert_eq!(within(0, 1_000, 0).await.len(), 5);

    let keep = EventRetention {
        events: 10,
        arenas: 100,
        ms: 100,
    };
    // What it was then is still asked for.
    assert_eq!(records.prune_events(keep, 320).await.unwrap(), 2);
    assert_eq!(records.arenas().at(250).await.unwrap(), arena("c"));
    let fewer = EventRetention { arenas: 1, ..keep };
    assert_eq!(records.prune_events(fewer, 320).await.unwrap(), 2);
    assert_eq!(records.arenas().at(450).await.unwrap(), None);
    assert_eq!(records.arenas().at(500).await.unwrap(), arena("c"));
    records.close().await;
}

/// All events that a question has, by pages of its limit.
async fn paged(records: &Records, mut query: EventQuery) -> Vec<StoredEvent> {
    let mut found = Vec::new();
    loop {
        let page = records.events().page(query.clone()).await.expect("a page");
        assert!(page.len() <= query.limit as usize);
        let Some(last) = page.last() else { break };
        query.before = Some(last.cursor());
        found.extend(page);
    }
    found
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        // A database costs a moment each time.
        ..crawler_properties::cases(if on_postgres() { 4 } else { 48 })
    })]

    #[test]
    fn pages_are_a_list_cut_in_pieces(
        events in prop::collection::vec((0..40_i64, 0..3_usize, prop::option::of(0..3_usize)), 0..60),
        (from, length, limit) in (0..30_i64, 1..40_i64, 1..12_u32),
        least in 0..3_usize,
        of in prop::option::of(0..3_usize),
    ) {
        let levels = [EventLevel::Info, EventLevel::Warn, EventLevel::Error];
        let events: Vec<Event> = events
            .into_iter()
            .map(|(at, level, of)| event(at, levels[level], of, "something"))
            .collect();
        let query = EventQuery {
            from,
            to: from + length,
            level: levels[least],
            robot: of.map(robot),
            before: None,
            limit,
        };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let found = runtime.expect("a runtime").block_on(async {
            let records = memory().await;
            records.events().add(events.clone()).await.expect("written");
            let found = paged(&records, query.clone()).await;
            records.close().await;
            found
        });
        let mut expected: Vec<(i64, usize)> = (0..)
            .zip(&events)
            .filter(|(_, event)| {
                event.level >= query.level
                    && (query.from..query.to).contains(&event.at)
                    && (query.robot.is_none() || event.robot == query.robot)
            })
            .map(|(place, event)| (event.at, place))
            .collect();
        expected.sort_unstable_by(|one, other| other.cmp(one));
        let found: Vec<(i64, i64)> = found.iter().map(|stored| (stored.event.at, stored.id)).collect();
        prop_assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(&expected) {
            prop_assert_eq!(found.0, expected.0);
        }
        prop_assert!(found.windows(2).all(|pair| pair[0] > pair[1]), "in order, each once");
    }
}
