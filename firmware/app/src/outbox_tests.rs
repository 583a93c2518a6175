//! The outbox: what is reserved is kept, in order.

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use proptest::prelude::*;
use std::collections::{BTreeMap, VecDeque};
use std::string::ToString;
use std::vec::Vec;

use super::*;
use crate::trouble::KEPT_EVENTS;

type Box = Outbox<NoopRawMutex>;

fn ada() -> Source {
    Source::new("operator:ada").expect("a source")
}

const NOW: Instant = Instant::from_millis(1_000);

const fn outgoing(seq: u64, status: ResponseStatus) -> Outgoing {
    Outgoing {
        source: SourceNumber::NONE,
        seq,
        status,
        reason: None,
        timestamp: 0,
    }
}

#[test]
fn a_time_is_kept_for_the_next_thousand_years() {
    let outbox = Box::new();
    for timestamp in [0, 1_800_000_000_123, (1 << 48) - 1] {
        let answer = Outgoing {
            timestamp,
            ..outgoing(1, ResponseStatus::Completed)
        };
        outbox.answer(&ada(), answer);
        let (ticket, told) = outbox.next_answer().expect("an answer");
        assert_eq!(told, answer);
        outbox.delivered(ticket);
    }
}

fn deliver_all(outbox: &Box) -> Vec<(u64, ResponseStatus)> {
    core::iter::from_fn(|| {
        let (ticket, answer) = outbox.next_answer()?;
        outbox.sent(ticket);
        outbox.delivered(ticket);
        Some((answer.seq, answer.status))
    })
    .collect()
}

#[test]
fn an_admitted_command_gets_both_its_answers_out_whatever_else_is_there() {
    let outbox = Box::new();
    let mut admitted = Vec::new();
    for seq in 0..100 {
        if outbox.admit(&ada(), seq, NOW).is_ok() {
            admitted.push(seq);
        }
    }
    assert_eq!(admitted.len(), RESERVATIONS);
    for seq in 1_000..1_100 {
        outbox.send_best_effort(outgoing(seq, ResponseStatus::Rejected));
        outbox.answer(&ada(), outgoing(seq + 1_000, ResponseStatus::Completed));
    }
    for seq in &admitted {
        outbox.answer(&ada(), outgoing(*seq, ResponseStatus::Accepted));
    }
    for seq in &admitted {
        outbox.answer(&ada(), outgoing(*seq, ResponseStatus::Completed));
    }
    assert_eq!(outbox.pending(), ANSWERS);
    let delivered = deliver_all(&outbox);
    for seq in admitted {
        for status in [ResponseStatus::Accepted, ResponseStatus::Completed] {
            assert!(delivered.contains(&(seq, status)), "{seq} {status}");
        }
    }
}

#[test]
fn a_flood_of_refusals_leaves_room_for_a_stop() {
    let outbox = Box::new();
    for seq in 0..1_000 {
        outbox.send_best_effort(outgoing(seq, ResponseStatus::Rejected));
    }
    assert_eq!(outbox.pending(), COURTESY_LIMIT);
    outbox.answer(&ada(), outgoing(7_777, ResponseStatus::Completed));
    assert!(deliver_all(&outbox).contains(&(7_777, ResponseStatus::Completed)));
    let record = outbox.next_log(0, NOW).expect("the loss is told");
    assert!(record.text.contains("976 answers"), "{}", record.text);
}

#[test]
fn when_even_the_room_for_stops_is_taken_the_newest_stop_is_answered() {
    let outbox = Box::new();
    for seq in 0..200 {
        outbox.answer(&ada(), outgoing(seq, ResponseStatus::Completed));
    }
    let delivered = deliver_all(&outbox);
    assert_eq!(delivered.len(), ANSWERS);
    assert_eq!(delivered.last(), Some(&(199, ResponseStatus::Completed)));
    assert!(
        outbox
            .next_log(0, NOW)
            .expect("told")
            .text
            .contains("168 answers")
    );
}

#[test]
fn one_answer_repeated_takes_one_place() {
    let outbox = Box::new();
    for _ in 0..50 {
        outbox.send_best_effort(outgoing(3, ResponseStatus::Stale));
    }
    assert_eq!(outbox.pending(), 1);
}

#[test]
fn a_promise_nobody_keeps_gives_way_in_the_end() {
    let outbox = Box::new();
    for seq in 0..RESERVATIONS as u64 {
        assert_eq!(outbox.admit(&ada(), seq, NOW), Ok(()));
    }
    assert_eq!(
        outbox.admit(&ada(), 100, NOW + RESERVATION_LIFE),
        Err(NoRoom)
    );
    let later = NOW + RESERVATION_LIFE + Duration::from_millis(1);
    assert_eq!(outbox.admit(&ada(), 100, later), Ok(()));
    outbox.dismiss(&ada(), 100);
    assert_eq!(outbox.admit(&ada(), 101, later), Ok(()));
}

#[test]
fn the_log_keeps_the_newest_and_says_how_many_it_lost() {
    let outbox = Box::new();
    for number in 0..LOGS + 5 {
        outbox.log(Level::Info, "tick", format_args!("{number}"), 0);
    }
    let lost = outbox.next_log(9, NOW).expect("a record of the loss");
    assert_eq!((lost.event, lost.timestamp), ("outbox-full", 9));
    assert!(lost.text.starts_with("5 log records"), "{}", lost.text);
    let rest: Vec<_> = core::iter::from_fn(|| outbox.next_log(9, NOW)).collect();
    let texts: Vec<_> = rest.iter().map(|entry| entry.text.as_str()).collect();
    let expected: Vec<_> = (5..LOGS + 5).map(|number| number.to_string()).collect();
    assert_eq!(texts, expected);
    assert_eq!(rest[0].seq, 5, "the gap shows in the numbers too");
}

#[test]
fn losses_are_told_once_in_a_while_and_not_one_by_one() {
    let outbox = Box::new();
    let mut told = 0;
    for ms in 0..5_000 {
        outbox.withheld();
        let now = NOW + Duration::from_millis(ms);
        told += u32::from(outbox.next_log(0, now).is_some());
    }
    assert_eq!(told, 5);
}

#[test]
fn long_text_is_cut_between_characters() {
    let outbox = Box::new();
    outbox.log(Level::Info, "long", format_args!("x{}", "é".repeat(100)), 0);
    let entry = outbox.next_log(0, NOW).expect("a record");
    assert_eq!(entry.text.len(), LOG_TEXT - 1);
    assert!(entry.text.ends_with('é'));
}

#[test]
fn what_happens_often_does_not_displace_what_happened_once() {
    let outbox = Box::new();
    outbox.log(Level::Error, "panic", format_args!("src/x.rs:12: no"), 0);
    for number in 0..1_000 {
        outbox.log(Level::Warn, "link-failed", format_args!("{number}"), 0);
        outbox.log(Level::Info, "motion-ended", format_args!("{number}"), 0);
    }
    let records: Vec<_> = core::iter::from_fn(|| outbox.next_log(0, NOW)).collect();
    let has = |event, text| {
        let mut records = records.iter();
        records.any(|r| r.event == event && r.text.as_str() == text)
    };
    assert!(has("panic", "src/x.rs:12: no"), "{records:?}");
    assert!(has("link-failed", "999"), "{records:?}");
}

#[test]
fn a_fault_is_sent_again_until_something_proves_that_it_arrived() {
    let outbox = Box::new();
    let sent = || -> Vec<_> {
        core::iter::from_fn(|| outbox.next_log(0, NOW))
            .map(|record| record.event)
            .collect()
    };
    outbox.log(Level::Info, "scan", format_args!(""), 0);
    outbox.log(Level::Error, "ranger", format_args!("dead"), 0);
    assert_eq!(sent(), ["scan", "ranger"]);
    assert!(outbox.logs_unproven() && sent().is_empty());
    outbox.rewind_logs();
    assert_eq!(sent(), ["ranger"], "the other was sent and that is all");
    outbox.logs_asked();
    assert!(!outbox.logs_unproven());
    // Written after the question, so not proven by its answer.
    outbox.log(Level::Error, "flash", format_args!("refused"), 0);
    assert_eq!(sent(), ["flash"]);
    outbox.logs_proven();
    outbox.rewind_logs();
    assert_eq!(sent(), ["flash"]);
    outbox.logs_asked();
    outbox.logs_proven();
    outbox.rewind_logs();
    assert_eq!(sent(), [""; 0]);
}

#[test]
fn long_texts_displace_chatter_and_cut_nothing_but_themselves() {
    let outbox = Box::new();
    let long = std::format!("x{}", "é".repeat(LOG_TEXT / 2 - 1));
    for _ in 0..LOGS {
        outbox.log(Level::Info, "tick", format_args!("{long}"), 0);
    }
    for (number, event) in (0..).zip(KEPT_EVENTS) {
        outbox.log(Level::Error, event, format_args!("{long}"), number);
    }
    // An old word makes room for the new one.
    outbox.log(Level::Error, KEPT_EVENTS[0], format_args!("{long}"), 100);
    let records: Vec<_> = core::iter::from_fn(|| outbox.next_log(0, NOW)).collect();
    let (loss, records) = records.split_first().expect("records");
    assert_eq!(loss.event, "outbox-full");
    let told = std::format!("{} log records and 0 answers were not sent", LOGS + 1);
    assert_eq!(loss.text, *told);
    let mut told: Vec<_> = records.iter().map(|record| record.event).collect();
    told.sort_unstable();
    let mut kept = KEPT_EVENTS;
    kept.sort_unstable();
    assert_eq!(told, kept);
    let whole = records
        .iter()
        .filter(|record| *record.text == *long)
        .count();
    assert_eq!(
        whole,
        LOG_TEXTS / long.len(),
        "as many as there is room for"
    );
    assert!(
        records
            .iter()
            .all(|record| long.starts_with(record.text.as_str()))
    );
    let numbers: Vec<_> = records.iter().map(|record| record.seq).collect();
    assert!(numbers.is_sorted(), "{numbers:?}");
    assert_eq!(
        numbers.last(),
        Some(&(LOGS + KEPT_EVENTS.len()).try_into().expect("small"))
    );
}

#[derive(Debug, Clone, Copy)]
enum LogStep {
    /// Something that is kept, by its place in the list.
    Fault(usize),
    Ordinary,
    Send,
    Ask,
    Answered,
    Reconnect,
}

fn log_steps() -> impl Strategy<Value = Vec<LogStep>> {
    let step = prop_oneof![
        6 => (0..KEPT_EVENTS.len()).prop_map(LogStep::Fault),
        6 => Just(LogStep::Ordinary),
        4 => Just(LogStep::Send),
        2 => Just(LogStep::Ask),
        2 => Just(LogStep::Answered),
        1 => Just(LogStep::Reconnect),
    ];
    proptest::collection::vec(step, 0..400)
}

proptest! {
    /// A broker that takes records in only while it answers, against every order of events.
    #[test]
    fn the_newest_word_on_every_fault_arrives(steps in log_steps()) {
        let outbox = Box::new();
        let mut newest: BTreeMap<&str, u64> = BTreeMap::new();
        // Sent on this connection; those of them that an answer under way proves.
        let mut sent: Vec<(&str, u64)> = Vec::new();
        let mut asked = None;
        let mut arrived: Vec<(&str, u64)> = Vec::new();
        for (number, step) in steps.into_iter().enumerate() {
            let number = number as u64;
            match step {
                LogStep::Fault(index) => {
                    let event = KEPT_EVENTS[index];
                    outbox.log(Level::Error, event, format_args!("{number}"), number);
                    newest.insert(event, number);
                }
                LogStep::Ordinary => outbox.log(Level::Info, "tick", format_args!(""), number),
                LogStep::Send => {
                    sent.extend(outbox.next_log(0, NOW).map(|r| (r.event, r.timestamp)));
                }
                LogStep::Ask if asked.is_none() => {
                    outbox.logs_asked();
                    asked = Some(sent.len());
                }
                LogStep::Answered => {
                    if let Some(count) = asked.take() {
                        outbox.logs_proven();
                        arrived.extend(sent.drain(..count));
                    }
                }
                LogStep::Reconnect => {
                    // Nothing of what was not answered arrived.
                    sent.clear();
                    asked = None;
                    outbox.rewind_logs();
                }
                LogStep::Ask => {}
            }
        }
        outbox.rewind_logs();
        for now in 0..4 {
            let now = NOW + LOSS_PERIOD * now;
            arrived.extend(core::iter::from_fn(|| outbox.next_log(0, now)).map(|r| (r.event, r.timestamp)));
        }
        for (event, number) in newest {
            prop_assert!(arrived.contains(&(event, number)), "{event} of step {number} is lost");
        }
    }
}

#[derive(Debug, Clone)]
enum Step {
    Admit,
    /// Answers the n-th open command, finally or not.
    Answer(usize, bool),
    Courtesy,
    Halt,
    Send,
    /// The n-th answer on its way is acknowledged.
    Acknowledge(usize),
    Reconnect,
    /// The session was lost too: everything is sent again.
    Rewind,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        4 => Just(Step::Admit),
        6 => (0_usize..8, any::<bool>()).prop_map(|(n, last)| Step::Answer(n, last)),
        2 => Just(Step::Courtesy),
        2 => Just(Step::Halt),
        4 => Just(Step::Send),
        3 => (0_usize..8).prop_map(Step::Acknowledge),
        1 => Just(Step::Reconnect),
        1 => Just(Step::Rewind),
    ];
    proptest::collection::vec(step, 0..300)
}

proptest! {
    #[test]
    fn no_promised_answer_is_lost_and_order_is_kept(steps in steps()) {
        let outbox = Box::new();
        let mut seq = 0;
        // Open commands: number, whether `accepted` was given.
        let mut open: Vec<(u64, bool)> = Vec::new();
        // Reserved answers in the order they were given, and those that arrived.
        let mut owed: VecDeque<(u64, ResponseStatus)> = VecDeque::new();
        let mut on_the_way: Vec<Ticket> = Vec::new();
        let arrive = |ticket, owed: &mut VecDeque<(u64, ResponseStatus)>| {
            let answer = outbox.get(ticket).expect("kept until delivered");
            owed.retain(|reserved| *reserved != (answer.seq, answer.status));
            outbox.delivered(ticket);
        };
        for step in steps {
            match step {
                Step::Admit => {
                    seq += 1;
                    if outbox.admit(&ada(), seq, NOW).is_ok() {
                        open.push((seq, false));
                    }
                }
                Step::Answer(index, last) if index < open.len() => {
                    let (number, accepted) = open[index];
                    if last {
                        open.remove(index);
                        outbox.answer(&ada(), outgoing(number, ResponseStatus::Completed));
                        owed.push_back((number, ResponseStatus::Completed));
                    } else if !accepted {
                        open[index].1 = true;
                        outbox.answer(&ada(), outgoing(number, ResponseStatus::Accepted));
                        owed.push_back((number, ResponseStatus::Accepted));
                    }
                }
                Step::Answer(..) => {}
                Step::Courtesy => {
                    seq += 1;
                    outbox.send_best_effort(outgoing(seq, ResponseStatus::Stale));
                }
                Step::Halt => {
                    seq += 1;
                    outbox.answer(&ada(), outgoing(seq, ResponseStatus::Completed));
                }
                Step::Send => {
                    if on_the_way.len() < 8 && let Some((ticket, answer)) = outbox.next_answer() {
                        // The first of the reserved ones that is not on its way.
                        let waiting = owed.iter().find(|reserved| {
                            !on_the_way.iter().any(|ticket| {
                                outbox.get(*ticket).map(|a| (a.seq, a.status)) == Some(**reserved)
                            })
                        });
                        if owed.contains(&(answer.seq, answer.status)) {
                            prop_assert_eq!(waiting, Some(&(answer.seq, answer.status)));
                        }
                        outbox.sent(ticket);
                        on_the_way.push(ticket);
                    }
                }
                Step::Acknowledge(index) => {
                    if index < on_the_way.len() {
                        arrive(on_the_way.remove(index), &mut owed);
                    }
                }
                Step::Reconnect => {
                    for ticket in on_the_way.drain(..) {
                        arrive(ticket, &mut owed);
                    }
                }
                Step::Rewind => {
                    on_the_way.clear();
                    outbox.rewind();
                }
            }
            prop_assert!(outbox.pending() <= ANSWERS);
        }
        outbox.rewind();
        let delivered = deliver_all(&outbox);
        let reserved: Vec<_> = delivered.into_iter().filter(|d| owed.contains(d)).collect();
        prop_assert_eq!(reserved, Vec::from(owed));
    }
}
