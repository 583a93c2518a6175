//! Commands that go from one server to another.

use std::time::Duration;

use crawler_cluster::{Cluster, Fields, HEAD, Numbers, Renewed};
use crawler_protocol::ResponseStatus;

use super::tests::{Wire, answer, center, give, id, sent, set};
use super::*;

/// A server with a lease. Redis is not asked: what is told is handed from one to the other here.
fn server(slot: u8) -> (Arc<Wire>, CommandCenter) {
    let (wire, center) = center();
    let cluster = Cluster::open("redis://127.0.0.1:1", "swarm", "0".repeat(16)).expect("a name");
    let membership = Arc::new(ClusterMembership::new(cluster));
    let lease = Renewed {
        until: Instant::now() + Duration::from_hours(1),
        leader: true,
        ahead_us: 0,
        greatest: 0,
    };
    membership.renewed(slot, &lease);
    let center = center.with_cluster(&membership);
    center.share(Numbers::new(slot, 0), 0);
    (wire, center)
}

/// What Redis would hold of a command.
fn told(center: &CommandCenter, number: u64) -> Fields {
    let mut all = center.everything().into_iter();
    let (_, fields) = all.find(|(id, _)| *id == number).expect("told");
    fields
}

/// Writes down every change, and returns those commands of which nothing is left to do.
fn flush(center: &CommandCenter) -> Vec<u64> {
    let changes = center.changes().into_iter();
    let told = changes.map(|change| {
        let finished = change.finished.then_some(change.id);
        center.written(change);
        finished
    });
    told.flatten().collect()
}

#[tokio::test]
async fn another_server_goes_on_under_the_same_number_and_source() {
    let (wire, first) = server(1);
    let now = Instant::now();
    first.status(&id("a"), true, 3, now);
    for (action, source) in [(Action::Identify, "server"), (set(420.0), "settings-1")] {
        let number = give(&first, action.clone(), now);
        assert_eq!(sent(&wire).len(), 1);
        let (wire, second) = server(2);
        second.status(&id("a"), true, 3, now);
        assert_eq!(second.take_over(number, &told(&first, number), now), None);
        second.sweep(now);
        let [command] = &sent(&wire)[..] else {
            panic!("it goes again")
        };
        assert_eq!((command.seq, command.source.as_str()), (number, source));
        assert_eq!(command.action, action);
        let completed = answer("a", number, ResponseStatus::Completed);
        let over = second.answer(&completed, true, now).expect("over");
        assert_eq!(
            (over.id, over.status),
            (number.to_string(), OutcomeStatus::Completed)
        );
        assert_eq!(flush(&second), [number]);
        // What the next one gives is above it, for robots compare.
        assert!(give(&second, Action::Stop, now) > number);
        first.answer(&completed, true, now);
    }
}

#[tokio::test]
async fn an_answer_that_both_heard_ends_it_at_once() {
    let (_, first) = server(1);
    let now = Instant::now();
    let number = give(&first, Action::Identify, now);
    let (wire, second) = server(2);
    second.answer(&answer("a", number, ResponseStatus::Completed), true, now);
    let over = second.take_over(number, &told(&first, number), now);
    assert_eq!(over.expect("over").status, OutcomeStatus::Completed);
    second.status(&id("a"), true, 3, now);
    second.sweep(now + Duration::from_secs(2));
    assert_eq!(sent(&wire), []);
    assert_eq!(flush(&second), [number]);
}

#[tokio::test]
async fn a_new_number_is_told_before_it_goes() {
    let (wire, first) = server(1);
    let now = Instant::now();
    first.status(&id("a"), false, 3, now);
    let setting = give(&first, set(420.0), now);
    let stop = give(&first, Action::Stop, now);
    assert_eq!(sent(&wire).len(), 1, "the stop");
    first.answer(&answer("a", stop, ResponseStatus::Completed), true, now);
    first.status(&id("a"), true, 3, now);
    assert_eq!(sent(&wire), [], "nobody else knows its number yet");
    // What cannot be told now is told later.
    for change in first.changes() {
        first.unwritten(change);
    }
    first.sweep(now);
    assert_eq!(sent(&wire), []);
    let fields = told(&first, setting);
    flush(&first);
    first.sweep(now);
    let number = sent(&wire)[0].seq;
    assert!(number > stop);
    // Whoever takes over after that gives it no other.
    let (wire, second) = server(2);
    second.status(&id("a"), true, 3, now);
    second.take_over(setting, &fields, now);
    second.sweep(now);
    assert_eq!(sent(&wire)[0].seq, number);
    second.answer(&answer("a", number, ResponseStatus::Completed), true, now);
    assert_eq!(
        second.view(setting).expect("known").status,
        OutcomeStatus::Completed
    );
}

#[tokio::test]
async fn what_was_taken_over_is_let_go() {
    let (wire, first) = server(1);
    let now = Instant::now();
    first.status(&id("a"), false, 3, now);
    let setting = give(&first, set(420.0), now);
    first.let_go();
    first.status(&id("a"), true, 3, now);
    first.sweep(now + Duration::from_secs(2));
    assert_eq!(sent(&wire), []);
    assert_eq!(first.view(setting), None);
    assert_eq!(first.totals().open, 0);
    assert!(first.changes().is_empty());
}

#[tokio::test]
async fn without_a_lease_only_halts_go() {
    let (wire, first) = server(1);
    let now = Instant::now();
    first.status(&id("a"), false, 3, now);
    give(&first, Action::Identify, now);
    first.membership.as_ref().expect("several").lapsed();
    first.status(&id("a"), true, 3, now);
    assert_eq!(sent(&wire), [], "it may be another server's by now");
    give(&first, Action::Stop, now);
    assert_eq!(sent(&wire).len(), 1);
    let refused = first.give(
        None,
        Action::Identify,
        Target::Robot(id("a")),
        vec![id("a")],
    );
    let sent = false;
    assert_eq!(refused.await, Err(SendError::NotShared { sent }));
}

#[tokio::test]
async fn old_commands_come_to_an_end_and_nonsense_to_nothing() {
    let (_, first) = server(1);
    let now = Instant::now();
    let number = give(&first, Action::Identify, now);
    let mut fields = told(&first, number);
    let head = fields[HEAD].clone();
    let expires = head.find("\"expires\":").expect("a field") + 10;
    let end = expires + head[expires..].find(['}', ',']).expect("an end");
    fields.insert(
        HEAD.to_owned(),
        format!("{}1{}", &head[..expires], &head[end..]),
    );
    let (_, second) = server(2);
    let over = second.take_over(number, &fields, now).expect("over");
    assert_eq!(over.status, OutcomeStatus::Timeout);
    for (name, value) in [(HEAD, "{}"), ("a", "x"), ("NO ID", "{}")] {
        let mut fields = told(&first, number);
        fields.insert(name.to_owned(), value.to_owned());
        assert_eq!(second.take_over(number + 1, &fields, now), None, "{name}");
        assert_eq!(view_of(number, &fields), None, "{name}");
    }
    assert_eq!(second.take_over(number + 2, &Fields::new(), now), None);
    // Of what is nothing, nothing is left to do.
    assert_eq!(flush(&second), [number, number + 1, number + 2]);
}
