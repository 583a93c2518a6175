use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crawler_protocol::{Direction, ParameterValue, ParameterValues, Reason, ResponseStatus};

use super::*;

/// Keeps what would go out; refuses when told to.
#[derive(Default)]
pub(super) struct Wire {
    pub(super) sent: Mutex<Vec<(Topic, Vec<u8>)>>,
    pub(super) broken: Mutex<Option<PublishError>>,
}

impl Outlet for Wire {
    fn is_up(&self) -> bool {
        *self.broken.lock().expect("lock") != Some(PublishError::NotConnected)
    }

    fn publish(&self, topic: &Topic, payload: &[u8], _: Ms) -> Result<(), PublishError> {
        if let Some(error) = *self.broken.lock().expect("lock") {
            return Err(error);
        }
        let mut sent = self.sent.lock().expect("lock");
        sent.push((topic.clone(), payload.to_vec()));
        Ok(())
    }
}

pub(super) fn center() -> (Arc<Wire>, CommandCenter) {
    let wire = Arc::new(Wire::default());
    let outlet: Arc<dyn Outlet> = Arc::clone(&wire) as _;
    let source = Source::new("server").expect("source");
    let sequence = Sequence::in_memory(1_000);
    let center = CommandCenter::new(outlet, Arc::new(Metrics::new()), source, sequence);
    (wire, center)
}

pub(super) fn id(text: &str) -> RobotId {
    RobotId::new(text).expect("robot id")
}

pub(super) fn answer(robot: &str, seq: u64, status: ResponseStatus) -> Response {
    Response {
        robot: id(robot),
        seq,
        status: status.into(),
        reason: None,
        timestamp: 7,
        source: None,
    }
}

/// A setting, which is held for a robot that is away.
pub(super) fn set(value: f32) -> Action {
    let mut values = ParameterValues::new();
    let name = "safe_distance_mm".try_into().expect("a name");
    values
        .push((name, ParameterValue::Number(value)))
        .expect("room");
    Action::Set(values)
}

/// Takes what was sent since the last call.
pub(super) fn sent(wire: &Wire) -> Vec<Command> {
    let sent = std::mem::take(&mut *wire.sent.lock().expect("lock"));
    let commands = sent.iter();
    commands
        .map(|(_, payload)| Command::parse(payload).expect("a command"))
        .collect()
}

/// Gives robot `a` a command, and returns its number.
pub(super) fn give(center: &CommandCenter, action: Action, now: Instant) -> u64 {
    let view = center.send(action, Target::Robot(id("a")), [id("a")], now);
    view.expect("taken").id.parse().expect("a number")
}

pub(super) const MOVE: Action = Action::Move {
    direction: Direction::Forward,
    speed: 50,
    duration_ms: 2_000,
};

#[test]
fn numbers_rise_and_what_goes_out_is_a_command() {
    let (wire, center) = center();
    let now = Instant::now();
    for expected in 1_000..1_003 {
        let view = center
            .send(MOVE, Target::Robot(id("a")), [id("a")], now)
            .expect("sent");
        assert_eq!(view.seq, expected);
        assert_eq!(view.status, OutcomeStatus::Pending);
    }
    let sent = wire.sent.lock().expect("lock");
    for (number, (topic, payload)) in sent.iter().enumerate() {
        assert_eq!(*topic, Topic::CommandRobot(id("a")));
        let command = Command::parse(payload).expect("a command");
        assert_eq!(command.seq, 1_000 + number as u64);
        assert_eq!(command.action, MOVE);
        assert_eq!(command.source.as_str(), "server");
    }
}

/// Two controllers may use one number. Robots that name the source of a command tell them apart; what others say is
/// taken at its number.
#[test]
fn an_answer_to_another_source_is_not_ours() {
    let (_, center) = center();
    let now = Instant::now();
    let of = |seq, status, source: &str| Response {
        source: Some(Source::new(source).expect("a source")),
        ..answer("a", seq, status)
    };
    let seq = give(&center, MOVE, now);
    let status = |seq| center.view(seq).expect("known").status;
    for stranger in ["operator:ada", "settings", "Server", "server "] {
        center.answer(&of(seq, ResponseStatus::Completed, stranger), true, now);
        assert_eq!(status(seq), OutcomeStatus::Pending, "{stranger}");
    }
    center.answer(&of(seq, ResponseStatus::Accepted, "server"), true, now);
    assert_eq!(status(seq), OutcomeStatus::Accepted);
    center.answer(&answer("a", seq, ResponseStatus::Completed), true, now);
    assert_eq!(status(seq), OutcomeStatus::Completed);

    // A setting goes under another name.
    let seq = give(&center, set(420.0), now);
    center.answer(&of(seq, ResponseStatus::Rejected, "server"), true, now);
    assert_eq!(status(seq), OutcomeStatus::Pending);
    center.answer(&of(seq, ResponseStatus::Completed, "settings"), true, now);
    assert_eq!(status(seq), OutcomeStatus::Completed);
}

#[test]
fn a_lasting_command_is_accepted_then_completed() {
    let (_, center) = center();
    let now = Instant::now();
    let seq = center
        .send(MOVE, Target::Robot(id("a")), [id("a")], now)
        .expect("sent")
        .seq;
    let status = |center: &CommandCenter| center.view(seq).expect("known").status;
    assert!(
        center
            .answer(&answer("a", seq, ResponseStatus::Accepted), true, now)
            .is_none()
    );
    assert_eq!(status(&center), OutcomeStatus::Accepted);
    assert!(
        center
            .answer(&answer("a", seq, ResponseStatus::Completed), true, now)
            .is_some()
    );
    assert_eq!(status(&center), OutcomeStatus::Completed);
    // A repeated or contradicting answer changes nothing.
    center.answer(&answer("a", seq, ResponseStatus::Failed), true, now);
    center.answer(&answer("a", seq, ResponseStatus::Accepted), true, now);
    assert_eq!(status(&center), OutcomeStatus::Completed);
    let totals = center.totals();
    assert_eq!((totals.sent, totals.answered, totals.open), (1, 1, 0));
}

#[test]
fn answers_nobody_asked_for_are_nothing() {
    let (_, center) = center();
    let now = Instant::now();
    let seq = center
        .send(MOVE, Target::Robot(id("a")), [id("a")], now)
        .expect("sent")
        .seq;
    center.answer(&answer("b", seq, ResponseStatus::Completed), true, now);
    center.answer(&answer("a", seq + 1, ResponseStatus::Completed), true, now);
    let view = center.view(seq).expect("known");
    assert_eq!(view.status, OutcomeStatus::Pending);
    assert_eq!(view.outcomes.len(), 1);
    assert_eq!(center.totals().answered, 0);
}

#[test]
fn silence_is_a_time_out_and_a_late_answer_still_counts() {
    let (_, center) = center();
    let start = Instant::now();
    let seq = center
        .send(Action::Stop, Target::Robot(id("a")), [id("a")], start)
        .expect("sent")
        .seq;
    assert!(
        center
            .sweep(start + Duration::from_millis(4_999))
            .is_empty()
    );
    let over = center.sweep(start + Duration::from_secs(5));
    assert_eq!(over.len(), 1);
    assert_eq!(over[0].status, OutcomeStatus::Timeout);
    let late = start + Duration::from_secs(6);
    center.answer(&answer("a", seq, ResponseStatus::Completed), true, late);
    assert_eq!(
        center.view(seq).expect("known").status,
        OutcomeStatus::Completed
    );
}

#[test]
fn an_accepted_move_may_take_its_duration() {
    let (_, center) = center();
    let start = Instant::now();
    let seq = center
        .send(MOVE, Target::Robot(id("a")), [id("a")], start)
        .expect("sent")
        .seq;
    center.answer(&answer("a", seq, ResponseStatus::Accepted), true, start);
    assert!(
        center
            .sweep(start + Duration::from_millis(6_999))
            .is_empty()
    );
    assert_eq!(center.sweep(start + Duration::from_secs(7)).len(), 1);
}

#[test]
fn a_swarm_command_is_over_when_all_have_answered() {
    let (wire, center) = center();
    let now = Instant::now();
    let robots = ["a", "b", "c"].map(id);
    let seq = center
        .send(Action::Stop, Target::Swarm, robots, now)
        .expect("sent")
        .seq;
    center.answer(&answer("a", seq, ResponseStatus::Completed), true, now);
    center.answer(&answer("b", seq, ResponseStatus::Rejected), true, now);
    // A robot that was away a moment ago answers as well; one that nobody knows does not count.
    center.answer(&answer("d", seq, ResponseStatus::Completed), true, now);
    center.answer(&answer("e", seq, ResponseStatus::Completed), false, now);
    let over = center
        .answer(&answer("c", seq, ResponseStatus::Completed), true, now)
        .expect("over");
    assert_eq!(over.counts.completed, 3);
    assert_eq!(over.counts.rejected, 1);
    assert_eq!(over.status, OutcomeStatus::Rejected);

    let sent = wire.sent.lock().expect("lock");
    assert_eq!(sent[0].0, Topic::CommandSwarm);
    assert_eq!(sent[1].0, Topic::ResponseSwarm);
    let told = SwarmResponse::from_json(&sent[1].1).expect("a swarm response");
    assert_eq!(told.seq, seq);
    assert_eq!(told.robots, 4);
    assert_eq!(told.outcomes.completed, 3);
    assert_eq!(told.outcomes.unanswered, 0);
    assert_eq!(sent.len(), 2, "told once");
}

#[test]
fn a_swarm_command_is_over_after_a_while() {
    let (wire, center) = center();
    let start = Instant::now();
    let seq = center
        .send(Action::Stop, Target::Swarm, ["a", "b"].map(id), start)
        .expect("sent")
        .seq;
    center.answer(&answer("a", seq, ResponseStatus::Completed), true, start);
    center.sweep(start + Duration::from_secs(5));
    let sent = wire.sent.lock().expect("lock");
    let told =
        SwarmResponse::from_json(&sent.last().expect("a message").1).expect("a swarm response");
    assert_eq!((told.outcomes.completed, told.outcomes.unanswered), (1, 1));
}

#[test]
fn what_cannot_go_out_leaves_no_trace() {
    let (wire, center) = center();
    let now = Instant::now();
    for (broken, error) in [
        (PublishError::NotConnected, SendError::NotConnected),
        (PublishError::Full, SendError::Full),
    ] {
        *wire.broken.lock().expect("lock") = Some(broken);
        let result = center.send(MOVE, Target::Robot(id("a")), [id("a")], now);
        assert_eq!(result.map(|view| view.seq), Err(error));
    }
    assert!(center.view(1_000).is_none());
    *wire.broken.lock().expect("lock") = None;
    let view = center.send(MOVE, Target::Robot(id("a")), [id("a")], now);
    assert_eq!(view.expect("sent").seq, 1_000, "no number is lost");
}

#[test]
fn records_are_bounded_by_count_outcomes_and_age() {
    let (_, center) = center();
    let start = Instant::now();
    for _ in 0..MAX_RECORDS + 10 {
        center
            .send(Action::Stop, Target::Robot(id("a")), [id("a")], start)
            .expect("sent");
    }
    assert!(center.view(1_009).is_none());
    assert!(center.view(1_010).is_some());

    let robots: Vec<_> = (0..20_000)
        .map(|number| id(&format!("r-{number}")))
        .collect();
    for _ in 0..20 {
        center
            .send(Action::Stop, Target::Swarm, robots.iter().cloned(), start)
            .expect("sent");
    }
    assert!(center.book().table.outcomes <= MAX_OUTCOMES);

    center.sweep(start + MAX_AGE + Duration::from_secs(1));
    assert_eq!(center.book().table.records.len(), 0);
    assert_eq!(center.book().table.outcomes, 0);
    assert_eq!(center.totals().open, 0);
}

#[test]
fn reasons_reach_the_operator() {
    let (_, center) = center();
    let now = Instant::now();
    let seq = center
        .send(MOVE, Target::Robot(id("a")), [id("a")], now)
        .expect("sent")
        .seq;
    let rejected = Response {
        reason: Some(Reason::Estopped.into()),
        ..answer("a", seq, ResponseStatus::Rejected)
    };
    center.answer(&rejected, true, now);
    let view = center.view(seq).expect("known");
    assert_eq!(view.reason, Some(Reason::Estopped.into()));
    assert_eq!(view.outcomes[0].reason, Some(Reason::Estopped.into()));
}

#[test]
fn commands_keep_the_time_of_robots_when_the_clock_is_set_back() {
    let (wire, mut center) = center();
    let now = Instant::now();
    let before = clock::unix_ms() + 60_000;
    let set_by = Arc::new(AtomicI64::new(60_000));
    let set = Arc::clone(&set_by);
    center.time = FleetTime::by(move || {
        let ms = set.load(Ordering::Relaxed);
        clock::unix_ms().saturating_add_signed(ms)
    });
    give(&center, MOVE, now);
    set_by.store(0, Ordering::Relaxed);
    give(&center, MOVE, now);
    // Robots want to hear of it more often than once.
    let told = center.time.tell().set_by_ms.expect("news");
    assert!((-61_000..-59_000).contains(&told), "{told}");
    give(&center, Action::Stop, now);
    let commands = sent(&wire);
    assert_eq!(commands.len(), 3);
    for command in commands {
        assert!(command.timestamp >= before, "{command:?} before {before}");
    }
}
