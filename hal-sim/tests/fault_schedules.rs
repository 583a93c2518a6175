//! Random faults at random times, on robots that are told what to do: whatever breaks, the safety
//! rules hold.

use crate::common::watch::{Watch, Watched, action, fault};
use crate::common::{lockstep, settle, wander};
use crawler_hal::Duration;
use crawler_protocol::{Action, Direction};
use crawler_sim::faults::{Fault, LinkCut};
use proptest::prelude::*;

const ROBOTS: usize = 2;
/// Looks of one run.
const LOOKS: u32 = 600;

/// What happens to a robot.
#[derive(Debug, Clone)]
enum Step {
    Break(Fault, Option<u64>),
    Heal,
    Tell(Box<Action>),
}

fn step() -> impl Strategy<Value = (u32, usize, Step)> {
    let what = prop_oneof![
        3 => (fault(), proptest::option::of(10..6_000_u64)).prop_map(|(f, ms)| Step::Break(f, ms)),
        1 => Just(Step::Heal),
        4 => action().prop_map(|action| Step::Tell(Box::new(action))),
    ];
    (0..LOOKS, 0..ROBOTS, what)
}

/// Lets it all happen to robots of this seed, and a minute more in which all is well. Returns what
/// is known of each robot then.
fn live_through(seed: u64, mut steps: Vec<(u32, usize, Step)>) -> Vec<Watched> {
    steps.sort_by_key(|(at, ..)| *at);
    let mut simulation = lockstep("empty", ROBOTS as u32, seed);
    settle(&mut simulation);
    let mut watch = Watch::new(&simulation);
    let mut steps = steps.into_iter().peekable();
    for now in 0..LOOKS {
        while let Some((_, robot, step)) = steps.next_if(|(at, ..)| *at <= now) {
            match step {
                Step::Break(fault, ms) => {
                    let lasting = ms.map(Duration::from_millis);
                    watch.break_it(&mut simulation, robot, fault, lasting);
                }
                Step::Heal => watch.heal(&mut simulation, robot),
                Step::Tell(action) => watch.tell(&mut simulation, robot, &action),
            }
        }
        watch.pass(&mut simulation);
    }
    // Mended, every robot is there again, and every command has its answer: but those that were
    // dropped, those whose refusal is reported as not sent, and those of a robot that restarted
    // meanwhile and has forgotten them.
    for robot in 0..ROBOTS {
        watch.heal(&mut simulation, robot);
    }
    for _ in 0..60 * 50 {
        watch.pass(&mut simulation);
    }
    for (robot, known) in watch.robots.iter().enumerate() {
        assert_eq!(simulation.observe(robot).unwrap().flash_violations, 0);
        let unanswered: Vec<_> = known
            .open
            .iter()
            .filter(|(seq, action)| {
                // Wandering goes on for ever, and has its answer only at its end.
                !matches!(action, Action::Behave(_)) && !known.dropped.contains(seq)
            })
            .collect();
        assert!(
            unanswered.len() <= known.not_sent || simulation.boots(robot) > 1,
            "robot {robot}: {unanswered:?}, {} not sent",
            known.not_sent
        );
        assert_eq!(simulation.robot(robot).unwrap().link_trouble(), None);
    }
    watch.robots
}

proptest! {
    #![proptest_config(crawler_properties::cases(24))]

    #[test]
    fn no_schedule_of_faults_breaks_a_safety_rule(
        seed: u64,
        steps in proptest::collection::vec(step(), 1..24),
    ) {
        live_through(seed, steps);
    }
}

/// Found by the property above: hostile packets alone fill the queue of a robot that cannot join,
/// so a command that comes then has no answer, ever.
#[test]
fn what_finds_the_queue_of_an_absent_robot_full_is_dropped_and_counted() {
    let turn = Action::Move {
        direction: Direction::Forward,
        speed: 20,
        duration_ms: 100,
    };
    let away = LinkCut::Password;
    let run = |at| {
        let steps = vec![
            (5, 0, Step::Break(Fault::HostilePackets { per_s: 62 }, None)),
            (7, 0, Step::Break(Fault::LinkLoss { how: away }, None)),
            (at, 0, Step::Tell(Box::new(turn.clone()))),
        ];
        let known = live_through(530_606_908_893, steps).swap_remove(0);
        (known.dropped.len(), known.open.len())
    };
    // Five in six of them are commands: 256 after five seconds, which are 250 looks.
    assert_eq!(run(200), (0, 0), "there is room, and it is answered later");
    assert_eq!(run(400), (1, 1), "it was dropped, and has no answer");
}

/// Found by the property above: behind a link that was gone wait so many hostile packets that the
/// refusal of a command among them is not given. It is counted then, and the count reported.
#[test]
fn a_refusal_that_a_flood_leaves_no_room_for_is_reported() {
    let turn = Action::Move {
        direction: Direction::Right,
        speed: 20,
        duration_ms: 2_944,
    };
    let cut = |how| Fault::LinkLoss { how };
    let run = |per_s, at| {
        let steps = vec![
            (42, 1, Step::Tell(Box::new(wander()))),
            (184, 1, Step::Break(cut(LinkCut::Radio), None)),
            (370, 1, Step::Break(cut(LinkCut::Password), Some(4_690))),
            (414, 1, Step::Break(Fault::HostilePackets { per_s }, None)),
            (466, 1, Step::Tell(Box::new(wander()))),
            (at, 1, Step::Tell(Box::new(turn.clone()))),
        ];
        let known = live_through(13_275_292_227_663_089_749, steps).swap_remove(1);
        assert!(known.dropped.is_empty(), "the broker kept it");
        (known.open.len(), known.not_sent > 0)
    };
    assert_eq!(run(2, 485), (0, false));
    // When the command comes among them is a matter of milliseconds.
    let floods = [40, 50, 62].map(|per_s| [470, 478, 485, 492, 500].map(|at| run(per_s, at)));
    assert!(floods.as_flattened().contains(&(1, true)), "{floods:?}");
}

#[test]
fn the_same_faults_at_the_same_times_are_the_same_history() {
    let run = || {
        let mut simulation = lockstep("empty", 3, 5);
        settle(&mut simulation);
        for (robot, fault) in [
            (0, Fault::HostilePackets { per_s: 40 }),
            (1, Fault::RangerNoisy { mm: 200 }),
            (2, Fault::BrownOut),
        ] {
            let lasting = Some(Duration::from_millis(700 + 900 * robot as u64));
            simulation.inject(robot, fault, lasting).unwrap();
        }
        simulation.submit_all(wander());
        simulation.run_for(Duration::from_secs(6));
        simulation
    };
    let (one, other) = (run(), run());
    assert_eq!(one.history_hash(), other.history_hash());
    // What was injected is in the journal, and leads there again.
    let mut again = lockstep("empty", 3, 5);
    again.follow(one.journal().entries(), one.now());
    assert_eq!(again.history_hash(), one.history_hash());
}
