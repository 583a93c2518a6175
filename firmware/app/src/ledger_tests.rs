//! The ledger against a model that forgets nothing.

use proptest::prelude::*;
use std::collections::BTreeMap;
use std::format;
use std::vec::Vec;

use super::*;

fn source(index: usize) -> Source {
    Source::new(&format!("sender-{index}")).expect("a source")
}

fn at(ms: u64) -> Instant {
    Instant::from_millis(ms)
}

const DONE: Answer = Answer {
    status: ResponseStatus::Completed,
    reason: None,
};

#[test]
fn repeated_commands_are_answered_from_memory_and_older_ones_are_stale() {
    let mut ledger = Ledger::new();
    let ada = source(0);
    assert_eq!(ledger.judge(&ada, 5, 100), Verdict::Fresh);
    ledger.record(&ada, 5, Some(100), at(0));
    assert_eq!(ledger.judge(&ada, 5, 100), Verdict::Repeated(None));
    ledger.answer(&ada, 5, DONE);
    assert_eq!(ledger.judge(&ada, 5, 100), Verdict::Repeated(Some(DONE)));
    assert_eq!(ledger.judge(&ada, 4, 100), Verdict::Stale);
    assert_eq!(ledger.judge(&ada, 6, 101), Verdict::Fresh);
    // An answer to something older does not become the answer to something newer.
    ledger.record(&ada, 6, Some(101), at(1));
    ledger.answer(&ada, 5, DONE);
    assert_eq!(ledger.judge(&ada, 6, 101), Verdict::Repeated(None));
    // Another source has its own numbers.
    assert_eq!(ledger.judge(&source(1), 1, 50), Verdict::Fresh);
}

#[test]
fn a_source_goes_by_a_number_as_long_as_it_is_remembered() {
    let mut ledger = Ledger::new();
    assert_eq!(ledger.number(&source(0)), SourceNumber::NONE);
    assert_eq!(ledger.source(SourceNumber::NONE), None);
    ledger.record(&source(0), 1, Some(1), at(0));
    let number = ledger.number(&source(0));
    ledger.record(&source(0), 2, Some(2), at(1));
    assert_eq!(ledger.number(&source(0)), number);
    assert_eq!(ledger.source(number), Some(&source(0)));
    // So many others that its number would come again if it were one byte.
    for index in 1..=300 {
        ledger.record(&source(index), 1, Some(10), at(index as u64 + 1));
        assert_ne!(ledger.number(&source(index)), number);
        let told = ledger.number(&source(index));
        assert_eq!(ledger.source(told), Some(&source(index)));
        let first = ledger.source(number);
        assert_eq!(first, (index < SOURCES).then(|| source(0)).as_ref());
    }
    // Met again, it is another one.
    ledger.record(&source(0), 3, Some(20), at(400));
    assert_ne!(ledger.number(&source(0)), number);
    // All numbers were used, and none is that of nobody.
    ledger.last = u16::MAX;
    ledger.record(&source(999), 1, Some(30), at(401));
    let told = ledger.number(&source(999));
    assert!(told != SourceNumber::NONE && ledger.source(told) == Some(&source(999)));
}

#[test]
fn the_forgotten_cannot_be_replayed_not_even_after_their_old_stop() {
    let mut ledger = Ledger::new();
    let ada = source(0);
    ledger.record(&ada, 5, Some(1_000), at(0));
    for index in 1..=SOURCES {
        ledger.record(&source(index), 1, Some(500), at(index as u64));
    }
    assert_eq!(ledger.judge(&ada, 5, 1_000), Verdict::Stale);
    assert_eq!(ledger.judge(&ada, 6, 1_001), Verdict::Fresh);
    // A halt is recorded without being judged, here an old one.
    ledger.record(&ada, 3, Some(900), at(20));
    assert_eq!(ledger.judge(&ada, 5, 1_000), Verdict::Stale);
    assert_eq!(ledger.judge(&ada, 6, 1_001), Verdict::Fresh);
}

#[test]
fn the_quietest_source_is_the_one_forgotten() {
    let mut ledger = Ledger::new();
    for index in 0..SOURCES {
        ledger.record(&source(index), 1, Some(10), at(index as u64));
    }
    ledger.record(&source(0), 2, Some(20), at(100));
    ledger.record(&source(SOURCES), 1, Some(30), at(101));
    assert_eq!(ledger.judge(&source(0), 2, 20), Verdict::Repeated(None));
    assert_eq!(ledger.judge(&source(1), 1, 10), Verdict::Stale);
}

#[test]
fn a_timestamp_nobody_vouched_for_raises_no_floor() {
    let mut ledger = Ledger::new();
    for index in 0..100 {
        ledger.record(&source(index), 1, None, at(index as u64));
    }
    assert_eq!(ledger.judge(&source(1_000), 1, 1), Verdict::Fresh);
}

#[derive(Debug, Clone)]
struct Arrival {
    sender: usize,
    /// How far back in what the sender has sent; 0 is its next command.
    back: usize,
}

fn arrivals() -> impl Strategy<Value = Vec<Arrival>> {
    let arrival = (
        0_usize..14,
        prop_oneof![3 => Just(0_usize), 2 => 0_usize..6],
    )
        .prop_map(|(sender, back)| Arrival { sender, back });
    proptest::collection::vec(arrival, 1..400)
}

proptest! {
    /// Senders number and date their commands in rising order; the network repeats and reorders
    /// them. Compared with a memory without bounds, the ledger may be stricter with a source it
    /// has forgotten, and must never be more lenient.
    #[test]
    fn never_more_lenient_than_an_unbounded_memory(arrivals in arrivals()) {
        let mut ledger = Ledger::new();
        let mut clock = 1_000_u64;
        let mut sent: BTreeMap<usize, Vec<(u64, u64)>> = BTreeMap::new();
        let mut model: BTreeMap<usize, u64> = BTreeMap::new();
        let mut recent: Vec<usize> = Vec::new();
        for arrival in arrivals {
            clock += 1;
            let history = sent.entry(arrival.sender).or_default();
            if arrival.back == 0 || arrival.back > history.len() {
                history.push((history.len() as u64 + 1, clock));
            }
            let index = history.len() - arrival.back.clamp(1, history.len());
            let (seq, timestamp) = history[index];
            let name = source(arrival.sender);
            let verdict = ledger.judge(&name, seq, timestamp);
            let expected = match model.get(&arrival.sender) {
                Some(last) if seq == *last => Verdict::Repeated(None),
                Some(last) if seq < *last => Verdict::Stale,
                Some(_) | None => Verdict::Fresh,
            };
            let remembered = recent.iter().rev().take(SOURCES).any(|s| *s == arrival.sender);
            let never_full = model.len() < SOURCES;
            if remembered && verdict != Verdict::Stale || never_full {
                prop_assert_eq!(verdict, expected);
            } else {
                prop_assert!(verdict == expected || verdict == Verdict::Stale);
            }
            if verdict == Verdict::Fresh {
                ledger.record(&name, seq, Some(timestamp), at(clock));
                model.insert(arrival.sender, seq);
                recent.retain(|s| *s != arrival.sender);
                recent.push(arrival.sender);
            }
            prop_assert!(ledger.entries.len() <= SOURCES);
        }
    }

    /// A flood of invented sources, before and between: a command judged fresh once is never
    /// judged fresh again.
    #[test]
    fn no_command_is_fresh_twice_under_a_flood(
        flood in proptest::collection::vec(0_usize..40, 0..60),
        replays in proptest::collection::vec((0_usize..60, 0_u64..10), 1..30),
    ) {
        let mut ledger = Ledger::new();
        let ada = source(1_000);
        let mut executed = Vec::new();
        let mut replays = replays.into_iter();
        for (step, invented) in flood.into_iter().enumerate() {
            let now = 1_000 + step as u64 * 10;
            if let Some((_, seq)) = replays.next() {
                // Sent at a moment that rises with its number.
                let timestamp = 1_000 + seq * 60;
                if timestamp <= now && ledger.judge(&ada, seq, timestamp) == Verdict::Fresh {
                    prop_assert!(!executed.contains(&seq), "{} twice", seq);
                    prop_assert!(executed.iter().all(|earlier| *earlier < seq));
                    ledger.record(&ada, seq, Some(timestamp), at(now));
                    executed.push(seq);
                }
            }
            let invented = source(invented);
            if ledger.judge(&invented, now, now) == Verdict::Fresh {
                ledger.record(&invented, now, Some(now), at(now));
            }
        }
    }
}
