//! The state machine against its drawing, and what must hold of every transition.

use std::borrow::ToOwned;
use std::collections::BTreeSet;
use std::string::String;
use std::vec::Vec;

use crawler_hal::{Duration, Instant};

use super::{Escape, Event, Fault, Side, State};
use crate::goal::Goal;
use crate::motion::Twist;

/// The drawing, as people see it.
const DRAWING: &str = include_str!("../../../../docs/robot-states.md");

const NOW: Instant = Instant::from_millis(60_000);
const LATER: Instant = Instant::from_millis(70_000);

const FAULTS: [Fault; 4] = [
    Fault::EmergencyStop,
    Fault::Motor,
    Fault::Battery,
    Fault::Ranger,
];

fn manual() -> Goal {
    Goal::Manual {
        twist: Twist { v: 0.3, w: 0.0 },
        until: LATER,
        bounded: true,
    }
}

fn goals() -> [Goal; 3] {
    [
        manual(),
        Goal::Wander { speed: 0.6 },
        Goal::Goto {
            x: 1.0,
            y: 2.0,
            deadline: LATER,
        },
    ]
}

fn states() -> Vec<State> {
    let mut states = std::vec![
        State::Initializing,
        State::Idle,
        State::Updating,
        State::Scanning { deadline: LATER },
    ];
    for goal in goals() {
        states.push(State::Moving(goal));
        states.push(State::Caution(goal));
        if goal.is_autonomous() {
            // Looking for a way out, and still in the least turn.
            let early = Instant::from_millis(50_000);
            states.push(State::Avoiding(goal, Escape::turning(Side::Left, early)));
            states.push(State::Avoiding(goal, Escape::turning(Side::Right, NOW)));
        }
    }
    states.extend(FAULTS.map(State::Error));
    states
}

fn events() -> Vec<Event> {
    let mut events = std::vec![
        Event::Ready,
        Event::BeginScan { deadline: LATER },
        Event::End,
        Event::Free,
        Event::Near,
        Event::Blind,
        Event::Blocked(Side::Left),
        Event::Stuck(Side::Right),
        Event::Recovered,
        Event::Reset,
        Event::BeginUpdate,
        Event::EndUpdate,
    ];
    events.extend(goals().map(Event::Begin));
    events.extend(FAULTS.map(Event::Fault));
    events
}

/// Name of a state in the drawing. Without a wildcard: a new state needs a name here.
fn node(state: &State) -> &'static str {
    match state {
        State::Initializing => "INITIALIZING",
        State::Idle => "IDLE",
        State::Moving(_) => "MOVING",
        State::Caution(_) => "CAUTION",
        State::Avoiding(..) => "AVOIDING",
        State::Scanning { .. } => "SCANNING",
        State::Updating => "UPDATING",
        State::Error(Fault::EmergencyStop) => "ERROR_ESTOP",
        State::Error(Fault::Motor | Fault::Battery | Fault::Ranger) => "ERROR_FAULT",
    }
}

/// Name of an event in the drawing.
fn label(event: &Event) -> &'static str {
    match event {
        Event::Ready => "ready",
        Event::Begin(_) => "begin",
        Event::BeginScan { .. } => "scan",
        Event::End => "end",
        Event::Free => "free",
        Event::Near => "near",
        Event::Blind => "blind",
        Event::Blocked(_) => "blocked",
        Event::Stuck(_) => "stuck",
        Event::Fault(Fault::EmergencyStop) => "estop",
        Event::Fault(Fault::Motor | Fault::Battery | Fault::Ranger) => "fault",
        Event::Recovered => "recovered",
        Event::Reset => "reset",
        Event::BeginUpdate => "update",
        Event::EndUpdate => "update over",
    }
}

type Arrow = (String, String, String);

fn arrows_of_the_code() -> BTreeSet<Arrow> {
    let mut arrows = BTreeSet::new();
    for state in states() {
        for event in events() {
            let next = state.step(event, NOW);
            let (from, to) = (node(&state), node(&next));
            if from != to {
                arrows.insert((from.to_owned(), label(&event).to_owned(), to.to_owned()));
            }
        }
    }
    arrows
}

fn arrows_of_the_drawing() -> BTreeSet<Arrow> {
    let mermaid = DRAWING
        .split("```mermaid")
        .nth(1)
        .and_then(|rest| rest.split("```").next())
        .expect("docs/robot-states.md has a mermaid drawing");
    let mut arrows = BTreeSet::new();
    for line in mermaid.lines().map(str::trim) {
        let Some((from, rest)) = line.split_once("-->") else {
            continue;
        };
        if from.trim() == "[*]" {
            assert_eq!(rest.trim(), "INITIALIZING", "the robot starts there");
            continue;
        }
        let (to, labels) = rest.split_once(':').expect("every arrow names its events");
        for label in labels.split(',') {
            let arrow = (
                from.trim().to_owned(),
                label.trim().to_owned(),
                to.trim().to_owned(),
            );
            assert!(arrows.insert(arrow.clone()), "drawn twice: {arrow:?}");
        }
    }
    arrows
}

#[test]
fn the_drawing_shows_exactly_what_the_code_does() {
    let (code, drawing) = (arrows_of_the_code(), arrows_of_the_drawing());
    let missing: Vec<_> = code.difference(&drawing).collect();
    let invented: Vec<_> = drawing.difference(&code).collect();
    assert!(missing.is_empty(), "not drawn: {missing:#?}");
    assert!(invented.is_empty(), "drawn, but not so: {invented:#?}");
}

#[test]
fn the_drawing_and_the_wire_use_the_same_names() {
    for state in states() {
        let reported = state.reported().name();
        assert!(
            node(&state).starts_with(reported),
            "{state:?} is reported as {reported}"
        );
    }
}

#[test]
fn an_emergency_stop_is_reached_from_everywhere_and_left_by_reset_alone() {
    let stopped = State::Error(Fault::EmergencyStop);
    for state in states() {
        assert_eq!(
            state.step(Event::Fault(Fault::EmergencyStop), NOW),
            stopped,
            "{state:?}"
        );
    }
    for event in events() {
        let next = stopped.step(event, NOW);
        let left = next != stopped;
        assert_eq!(left, event == Event::Reset, "{event:?} leads to {next:?}");
    }
}

#[test]
fn only_an_order_sets_a_standing_robot_in_motion() {
    for state in states() {
        if state.goal().is_some() || matches!(state, State::Scanning { .. }) {
            continue;
        }
        for event in events() {
            let next = state.step(event, NOW);
            let moves = next.goal().is_some() || matches!(next, State::Scanning { .. });
            let ordered = matches!(event, Event::Begin(_) | Event::BeginScan { .. });
            let ready = state == State::Idle;
            assert_eq!(moves, ordered && ready, "{state:?}, {event:?}: {next:?}");
        }
    }
}

#[test]
fn manual_driving_never_turns_aside_by_itself() {
    for state in [State::Moving(manual()), State::Caution(manual())] {
        for event in events() {
            let next = state.step(event, NOW);
            let avoiding = matches!(next, State::Avoiding(goal, _) if !goal.is_autonomous());
            assert!(!avoiding, "{state:?}, {event:?}");
        }
    }
}

#[test]
fn turning_aside_lasts_its_least_turn_and_escalates() {
    let wander = Goal::Wander { speed: 0.6 };
    let start = State::Moving(wander).step(Event::Blocked(Side::Left), NOW);
    assert_eq!(start.step(Event::Free, NOW), start, "not at once");
    let State::Avoiding(_, first) = start else {
        panic!("{start:?}")
    };
    assert_eq!(
        start.step(Event::Free, first.least_until),
        State::Moving(wander)
    );
    assert_eq!(first.back_until, NOW, "the first attempt only turns");

    let State::Avoiding(_, second) = start.step(Event::Stuck(Side::Right), NOW) else {
        panic!("still avoiding")
    };
    assert_eq!((second.attempt, second.side), (1, Side::Right));
    assert!(second.back_until > NOW, "the second one backs off");
    assert!(second.until - NOW > first.until - NOW, "and turns further");

    let mut state = start;
    for _ in 0..1_000 {
        state = state.step(Event::Stuck(Side::Left), NOW);
    }
    let State::Avoiding(_, last) = state else {
        panic!("still avoiding")
    };
    assert!(last.until - NOW < Duration::from_secs(10), "bounded");
}
