//! Rounds by hand, and nodes that do whatever they like.

use proptest::prelude::*;

use super::*;
use crate::CheckpointError;
use crate::quantise::Quantised;

const SECOND: Duration = Duration::from_secs(1);

fn settings() -> Settings {
    Settings {
        rounds: 3,
        nodes: 3,
        quorum: 2,
        deadline: 10 * SECOND,
        aggregation: Aggregation::Mean,
        momentum: 0.0,
        plan: Plan {
            seed: 1,
            worlds: 4,
            rounds: 1,
            minibatch: 64,
            units: 8,
            central: true,
            proximal: 0.0,
        },
    }
}

fn begun() -> Coordinator {
    Coordinator::new(settings(), vec![0.0; 4], Duration::ZERO).expect("a run")
}

/// What a node answers to an announcement that it has heard.
fn update(announced: &[u8], change: [f32; 4]) -> Vec<u8> {
    let heard = Announcement::from_bytes(announced).expect("an announcement");
    let update = Update {
        round: heard.round,
        base: Announcement::base(announced),
        report: Report {
            samples: 100,
            episodes: 2,
            success: 0.5,
            ..Report::default()
        },
        change: Quantised::of(&change),
    };
    update.to_bytes()
}

#[test]
fn a_round_is_over_when_all_have_answered() {
    let mut run = begun();
    let announced = run.announcement();
    for (node, change) in [("a", 1.27), ("b", 2.54)] {
        let answer = run.receive(node, &update(&announced, [change; 4]));
        assert_eq!(answer, Answer::Taken);
        assert_eq!(run.close(SECOND), None, "one is still waited for");
    }
    run.receive("c", &update(&announced, [0.0; 4]));
    assert_eq!(run.answered().collect::<Vec<_>>(), ["a", "b", "c"]);
    assert_eq!(run.due(SECOND), Some(Duration::ZERO));
    let round = run.close(SECOND).expect("all have answered");
    assert_eq!((round.round, run.rounds()), (1, 1));
    let names: Vec<&str> = round.nodes.iter().map(|part| part.node.as_str()).collect();
    assert_eq!(names, ["a", "b", "c"]);
    assert!(
        run.weights()
            .iter()
            .all(|weight| (weight - 1.27).abs() < 1e-6),
        "{:?}",
        run.weights()
    );
    assert!((round.step - 2.54).abs() < 1e-6 && (round.nodes[1].step - 5.08).abs() < 1e-6);
    assert_ne!(run.announcement(), announced);
    assert_eq!(run.answered().count(), 0);
}

#[test]
fn momentum_adds_up_what_is_agreed_on() {
    let own = Settings {
        momentum: 0.5,
        ..settings()
    };
    let mut run = Coordinator::new(own, vec![0.0; 4], Duration::ZERO).expect("a run");
    // 1, then half of it and 1, then half of that and 1; a coordinator that was killed knows of it.
    for wanted in [1.0, 2.5, 4.25] {
        let announced = run.announcement();
        for node in ["a", "b", "c"] {
            run.receive(node, &update(&announced, [1.0; 4]));
        }
        run.close(SECOND).expect("over");
        let near = |weight: &f32| (weight - wanted).abs() < 1e-5;
        assert!(run.weights().iter().all(near), "{:?}", run.weights());
        run = Coordinator::resume(own, &run.checkpoint(), SECOND).expect("a checkpoint");
    }
}

#[test]
fn a_quorum_is_enough_after_the_deadline_and_fewer_are_not() {
    let mut run = begun();
    let announced = run.announcement();
    run.receive("a", &update(&announced, [1.0; 4]));
    assert_eq!(run.close(1_000 * SECOND), None, "one is no quorum");
    assert_eq!(run.due(1_000 * SECOND), None);
    run.receive("b", &update(&announced, [1.0; 4]));
    assert_eq!(run.due(4 * SECOND), Some(6 * SECOND));
    assert_eq!(run.close(9 * SECOND), None);
    assert!(run.close(10 * SECOND).is_some());
    // The next one has a deadline of its own.
    let announced = run.announcement();
    for node in ["a", "b"] {
        run.receive(node, &update(&announced, [1.0; 4]));
    }
    assert_eq!(run.due(12 * SECOND), Some(8 * SECOND));
}

#[test]
fn late_doubled_and_foreign_answers_are_told_apart_and_change_nothing() {
    let mut run = begun();
    let first = run.announcement();
    for node in ["a", "b", "c"] {
        run.receive(node, &update(&first, [1.0; 4]));
    }
    run.close(SECOND).expect("over");
    let weights = run.weights().to_vec();
    assert_eq!(run.receive("a", &update(&first, [9.0; 4])), Answer::Late);
    let second = run.announcement();
    assert_eq!(run.receive("a", &update(&second, [1.0; 4])), Answer::Taken);
    assert_eq!(
        run.receive("a", &update(&second, [9.0; 4])),
        Answer::Doubled
    );
    // Of the right round, but of another run, or made for other weights.
    let mut other = update(&second, [1.0; 4]);
    other[9] ^= 1;
    assert_eq!(run.receive("b", &other), Answer::OtherAnnouncement);
    let mut short = Update::from_bytes(&update(&second, [1.0; 4])).expect("an update");
    short.change = Quantised::of(&[1.0; 3]);
    assert_eq!(
        run.receive("b", &short.to_bytes()),
        Answer::OtherAnnouncement
    );
    assert_eq!(
        run.receive("b", b"hello"),
        Answer::Invalid(MessageError::Foreign)
    );
    assert_eq!(run.receive("", &update(&second, [1.0; 4])), Answer::Name);
    let long = "n".repeat(LONGEST_NAME + 1);
    assert_eq!(run.receive(&long, &update(&second, [1.0; 4])), Answer::Name);
    assert_eq!(run.weights(), weights);
    for node in ["b", "c"] {
        run.receive(node, &update(&second, [1.0; 4]));
    }
    assert_eq!(run.receive("d", &update(&second, [9.0; 4])), Answer::Full);
    let counts = Counts {
        taken: 6,
        doubled: 1,
        late: 1,
        refused: 6,
        samples: 300,
    };
    assert_eq!(run.counts(), counts);
}

#[test]
fn after_the_last_round_nothing_counts() {
    let mut run = begun();
    for _ in 0..3 {
        let announced = run.announcement();
        for node in ["a", "b", "c"] {
            run.receive(node, &update(&announced, [1.0; 4]));
        }
        run.close(SECOND).expect("over");
    }
    let last = run.announcement();
    assert!(run.is_over() && Announcement::from_bytes(&last).expect("one").is_over());
    assert_eq!(
        run.receive("a", &update(&last, [1.0; 4])),
        Answer::OtherAnnouncement
    );
    assert_eq!(run.close(1_000 * SECOND), None);
}

#[test]
fn a_step_beyond_all_floats_is_left_out() {
    let mut run = Coordinator::new(settings(), vec![3.4e38; 4], Duration::ZERO).expect("a run");
    let announced = run.announcement();
    for node in ["a", "b", "c"] {
        run.receive(node, &update(&announced, [2e36; 4]));
    }
    assert_eq!(
        run.close(SECOND).map(|round| round.step),
        Some(f64::INFINITY)
    );
    assert_eq!(run.weights(), [3.4e38; 4]);
}

#[test]
fn settings_out_of_range_are_named() {
    let with = |change: fn(&mut Settings)| {
        let mut own = settings();
        change(&mut own);
        own.validate().expect_err("refused").field
    };
    assert_eq!(with(|own| own.rounds = 0), "rounds");
    assert_eq!(with(|own| own.nodes = 65), "nodes");
    assert_eq!(with(|own| own.quorum = 4), "quorum");
    assert_eq!(with(|own| own.quorum = 0), "quorum");
    assert_eq!(with(|own| own.deadline = Duration::ZERO), "deadline");
    assert_eq!(with(|own| own.momentum = 1.0), "momentum");
    assert_eq!(with(|own| own.plan.worlds = 0), "worlds");
    assert_eq!(with(|own| own.plan.minibatch = 8), "minibatch");
    assert_eq!(with(|own| own.plan.units = 65), "units");
    assert_eq!(with(|own| own.plan.proximal = f32::NAN), "proximal");
    let none = Coordinator::new(settings(), Vec::new(), Duration::ZERO);
    assert_eq!(none.expect_err("refused").field, "weights");
    let nan = Coordinator::new(settings(), vec![f32::NAN], Duration::ZERO);
    assert_eq!(nan.expect_err("refused").field, "weights");
}

#[test]
fn a_run_that_is_killed_announces_what_it_had_announced() {
    let mut run = begun();
    let announced = run.announcement();
    for node in ["a", "b", "c"] {
        run.receive(node, &update(&announced, [1.0; 4]));
    }
    run.close(SECOND).expect("over");
    let kept = run.checkpoint();
    let second = run.announcement();
    run.receive("a", &update(&second, [1.0; 4]));
    let mut again = Coordinator::resume(settings(), &kept, 50 * SECOND).expect("a checkpoint");
    assert_eq!(again.announcement(), second);
    assert_eq!(again.counts().taken, 3);
    // Who had answered says it once more.
    for (run, at) in [(&mut run, SECOND), (&mut again, 50 * SECOND)] {
        for node in ["a", "b", "c"] {
            run.receive(node, &update(&second, [1.0; 4]));
        }
        run.close(at).expect("over");
    }
    assert_eq!(again.weights(), run.weights());
}

#[test]
fn no_other_bytes_are_gone_on_from() {
    let resume = |own: Settings, bytes: &[u8]| {
        Coordinator::resume(own, bytes, Duration::ZERO).map(|run| run.rounds())
    };
    let kept = begun().checkpoint();
    assert_eq!(resume(settings(), &kept), Ok(0));
    assert_eq!(resume(settings(), b""), Err(CheckpointError::Foreign));
    assert_eq!(resume(settings(), b"TCRL"), Err(CheckpointError::Foreign));
    let mut other = settings();
    other.plan.seed = 2;
    assert_eq!(resume(other, &kept), Err(CheckpointError::OtherSettings));
    other = settings();
    other.rounds = 4;
    assert_eq!(resume(other, &kept), Err(CheckpointError::OtherSettings));
    for at in 0..kept.len() {
        let mut changed = kept.clone();
        changed[at] ^= 1;
        let refused = resume(settings(), &changed).expect_err("changed");
        let wanted = match at {
            0..4 => CheckpointError::Foreign,
            4 => CheckpointError::Version(0),
            _ => CheckpointError::Damaged,
        };
        assert_eq!(refused, wanted, "{at}");
        assert!(resume(settings(), &kept[..at]).is_err(), "{at}");
    }
}

/// What a node does.
#[derive(Debug, Clone)]
enum Act {
    /// It answers one of the announcements so far.
    Answers(usize, prop::sample::Index, f32),
    /// It sends something.
    Sends(usize, Vec<u8>),
    /// Time passes, and whoever keeps the run looks at it.
    Looks(u64),
    /// The coordinator is killed.
    Dies,
}

fn any_act() -> impl Strategy<Value = Act> {
    prop_oneof![
        8 => (0_usize..5, any::<prop::sample::Index>(), -1.0_f32..1.0)
            .prop_map(|(node, which, change)| Act::Answers(node, which, change)),
        1 => (0_usize..5, prop::collection::vec(any::<u8>(), 0..80)).prop_map(|(node, bytes)| Act::Sends(node, bytes)),
        4 => (0_u64..12).prop_map(Act::Looks),
        1 => Just(Act::Dies),
    ]
}

proptest! {
    /// Rounds follow each other without a gap, each of a quorum or more and of no node twice; weights are the sum of what was taken.
    #[test]
    fn whatever_nodes_do_rounds_stay_whole(acts in prop::collection::vec(any_act(), 0..120)) {
        let mut run = begun();
        let mut now = Duration::ZERO;
        let mut announced = vec![run.announcement()];
        let mut kept = run.checkpoint();
        for act in acts {
            match act {
                Act::Answers(node, which, change) => {
                    let heard = which.get(&announced);
                    let answer = run.receive(&format!("n{node}"), &update(heard, [change; 4]));
                    if *heard != run.announcement() {
                        prop_assert_ne!(answer, Answer::Taken);
                    }
                }
                Act::Sends(node, bytes) => {
                    let answer = run.receive(&format!("n{node}"), &bytes);
                    prop_assert!(matches!(answer, Answer::Invalid(_)));
                }
                Act::Looks(seconds) => {
                    now += Duration::from_secs(seconds);
                    let before = run.rounds();
                    if let Some(round) = run.close(now) {
                        prop_assert_eq!(round.round, before + 1);
                        prop_assert!((2..=3).contains(&round.nodes.len()));
                        let mut names: Vec<_> = round.nodes.iter().map(|part| &part.node).collect();
                        names.dedup();
                        prop_assert_eq!(names.len(), round.nodes.len());
                        announced.push(run.announcement());
                        kept = run.checkpoint();
                    } else {
                        prop_assert_eq!(run.rounds(), before);
                    }
                }
                Act::Dies => {
                    run = Coordinator::resume(settings(), &kept, now).expect("its own checkpoint");
                    prop_assert_eq!(Some(&run.announcement()), announced.last());
                }
            }
            prop_assert!(run.answered().count() <= 3);
            prop_assert!(run.weights().iter().all(|weight| weight.abs() <= 3.001));
        }
    }
}
