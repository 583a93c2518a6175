//! Random faults at random times, on robots that are told what to do: whatever breaks, the safety
//! rules hold.

use std::collections::{BTreeMap, BTreeSet};

use crate::common::{lockstep, settle, wander};
use crawler_hal::Duration;
use crawler_protocol::{Action, Direction, LogRecord, Response, Topic};
use crawler_sim::faults::{Fault, LinkCut, Wheel};
use crawler_sim::net::lockstep::Origin;
use crawler_sim::run::Simulation;
use proptest::prelude::*;
use proptest::sample::select;

const ROBOTS: usize = 2;
/// One look at the robots.
const LOOK: Duration = Duration::from_millis(20);
/// Looks of one run.
const LOOKS: u32 = 600;

fn fault() -> impl Strategy<Value = Fault> {
    let wheel = || select(Wheel::ALL);
    prop_oneof![
        Just(Fault::RangerDead),
        (100..4_000_u16).prop_map(|mm| Fault::RangerStuck { mm }),
        (0..=1_000_u16).prop_map(|mm| Fault::RangerNoisy { mm }),
        (0.0..=1.0_f32).prop_map(|flips| Fault::LineNoise { flips }),
        Just(Fault::LineStuck),
        (wheel(), 0.0..=1.0_f32).prop_map(|(wheel, strength)| Fault::MotorWeak { wheel, strength }),
        wheel().prop_map(|wheel| Fault::MotorDead { wheel }),
        wheel().prop_map(|wheel| Fault::MotorStuckOn { wheel }),
        select(LinkCut::ALL).prop_map(|how| Fault::LinkLoss { how }),
        (1..=100_u16).prop_map(|per_s| Fault::HostilePackets { per_s }),
        (-7_200_000..=7_200_000_i64).prop_map(|ms| Fault::ClockStep { ms }),
        Just(Fault::BrownOut),
        (0.0..=30.0_f32).prop_map(|ohm| Fault::BatterySag { ohm }),
        (0..=200_u32).prop_map(|after_bytes| Fault::FlashPowerCut { after_bytes }),
        any::<u32>().prop_map(|seed| Fault::FlashNoise { seed }),
    ]
}

fn action() -> impl Strategy<Value = Action> {
    prop_oneof![
        3 => Just(Action::Stop),
        1 => Just(Action::Estop),
        1 => Just(Action::Reset),
        1 => Just(wander()),
        1 => (select(Direction::ALL), 20..=100_u8, 100..3_000_u32).prop_map(
            |(direction, speed, duration_ms)| Action::Move { direction, speed, duration_ms }
        ),
        1 => (-0.4..=0.4_f32, -2.0..=2.0_f32).prop_map(|(v, w)| Action::Drive { v, w }),
    ]
}

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

/// What is known of one robot.
#[derive(Debug, Clone, Default)]
struct Watched {
    /// A halt is known to have been obeyed, and nothing that moves was said since.
    halted: bool,
    duty: [i16; 2],
    /// Halts and other commands that wait for an answer.
    open: BTreeMap<u64, Action>,
    /// Those among them for which the broker had no room: the queue of a robot that is away holds
    /// so many messages and no more.
    dropped: BTreeSet<u64>,
    /// Answers that it said it could not send: a flood may take the room of those of refused
    /// commands, though not of others.
    not_sent: usize,
}

/// Takes in what robots answered.
fn listen(simulation: &Simulation, watched: &mut [Watched]) {
    for published in simulation.network().unwrap().take_record() {
        let topic = Topic::parse(simulation.fleet(), &published.topic).unwrap();
        let (Topic::Response(id) | Topic::Logs(id), true) =
            (&topic, published.origin != Origin::Repeated)
        else {
            continue;
        };
        let robot = (0..ROBOTS).find(|&robot| simulation.id(robot) == Some(id));
        let known = &mut watched[robot.expect("a robot of ours")];
        if let Topic::Logs(_) = topic {
            let record = LogRecord::from_json(&published.payload).unwrap();
            known.not_sent += answers_not_sent(&record);
            continue;
        }
        let response = Response::from_json(&published.payload).unwrap();
        if !response.status.is_final() {
            continue;
        }
        let Some(action) = known.open.remove(&response.seq) else {
            continue;
        };
        // What was said later and could move it has not been answered by then.
        let later = known.open.values().any(Action::is_motion);
        if matches!(action, Action::Stop | Action::Estop) && !later {
            known.halted = true;
        }
    }
}

/// How many answers a record says were not sent.
fn answers_not_sent(record: &LogRecord) -> usize {
    if record.event != "outbox-full" {
        return 0;
    }
    let told = record.text.split(' ').rev().nth(4);
    told.and_then(|number| number.parse().ok())
        .expect("'… and 3 answers were not sent'")
}

/// Looks at a robot: its duties are within limits, grow no faster than the ramp lets them, and
/// are zero behind a halt and without power.
fn look(simulation: &Simulation, robot: usize, known: &mut Watched) {
    let seen = simulation.observe(robot).unwrap();
    for (duty, before) in seen.duty.into_iter().zip(known.duty) {
        assert!(duty.abs() <= 255);
        // Five percent a period of control by default; two periods may fall between two looks.
        let grown = duty.abs() - before.abs();
        assert!(grown <= 2 * 13 + 2, "from {before} to {duty}");
        assert!(duty == 0 || before == 0 || (duty > 0) == (before > 0));
    }
    if known.halted || !seen.powered {
        assert_eq!(seen.duty, [0, 0], "robot {robot} was told to stand");
    }
    known.duty = seen.duty;
}

/// Lets it all happen to robots of this seed, and a minute more in which all is well. Returns what
/// is known of each robot then.
fn live_through(seed: u64, mut steps: Vec<(u32, usize, Step)>) -> Vec<Watched> {
    steps.sort_by_key(|(at, ..)| *at);
    let mut simulation = lockstep("empty", ROBOTS as u32, seed);
    settle(&mut simulation);
    let mut watched = vec![Watched::default(); ROBOTS];
    let mut steps = steps.into_iter().peekable();
    for now in 0..LOOKS {
        while let Some((_, robot, step)) = steps.next_if(|(at, ..)| *at <= now) {
            match step {
                Step::Break(fault, ms) => {
                    let lasting = ms.map(Duration::from_millis);
                    simulation.inject(robot, fault, lasting).unwrap();
                }
                Step::Heal => simulation.heal(robot),
                Step::Tell(action) => tell(&mut simulation, robot, &action, &mut watched),
            }
        }
        simulation.run_for(LOOK);
        listen(&simulation, &mut watched);
        for (robot, known) in watched.iter_mut().enumerate() {
            look(&simulation, robot, known);
        }
    }
    // Mended, every robot is there again, and every command has its answer: but those that were
    // dropped, those whose refusal is reported as not sent, and those of a robot that restarted
    // meanwhile and has forgotten them.
    for robot in 0..ROBOTS {
        simulation.heal(robot);
    }
    for _ in 0..60 * 50 {
        simulation.run_for(LOOK);
        listen(&simulation, &mut watched);
        for (robot, known) in watched.iter_mut().enumerate() {
            look(&simulation, robot, known);
        }
    }
    for (robot, known) in watched.iter().enumerate() {
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
    watched
}

/// Gives a robot a command, and notes whether the broker dropped anything over it.
fn tell(simulation: &mut Simulation, robot: usize, action: &Action, watched: &mut [Watched]) {
    let known = &mut watched[robot];
    known.halted &= !action.is_motion();
    let dropped = |simulation: &Simulation| simulation.network().unwrap().statistics().dropped;
    let before = dropped(simulation);
    let seq = simulation.submit(robot, action.clone());
    if dropped(simulation) > before {
        known.dropped.insert(seq);
    }
    known.open.insert(seq, action.clone());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

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
