//! Robots under watch: what they were told, what breaks, and the safety rules at every look.

use std::collections::{BTreeMap, BTreeSet};

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, Direction, LogRecord, Response, ResponseStatus, Topic};
use crawler_sim::faults::{Fault, LinkCut, Wheel};
use crawler_sim::net::lockstep::Origin;
use crawler_sim::run::Simulation;
use proptest::prelude::*;
use proptest::sample::select;

use super::wander;

/// One look at the robots: a period of control.
pub(crate) const LOOK: Duration = Duration::from_millis(20);
/// The last reading is too old for motion after 300 ms, and a ping may have been under way.
const BLIND: Duration = Duration::from_millis(400);
/// Wheels come to rest behind the answer to the last thing that moved the robot.
const RUN_OUT: Duration = Duration::from_millis(1_000);

/// Anything that may break.
pub(crate) fn fault() -> impl Strategy<Value = Fault> {
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

/// Anything that a person may tell a robot, halts above all.
pub(crate) fn action() -> impl Strategy<Value = Action> {
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

/// What is known of one robot.
#[derive(Debug, Clone, Default)]
pub(crate) struct Watched {
    /// A halt is known to have been obeyed, and nothing that moves was said since.
    halted: bool,
    duty: [i16; 2],
    /// Halts and other commands that wait for an answer.
    pub(crate) open: BTreeMap<u64, Action>,
    /// Those among them for which the broker had no room: the queue of a robot that is away holds
    /// so many messages and no more.
    pub(crate) dropped: BTreeSet<u64>,
    /// Answers that it said it could not send: a flood may take the room of those of refused
    /// commands, though not of others.
    pub(crate) not_sent: usize,
    /// Whether the last of what it was told that moves it ends by itself, and is answered then.
    ends: bool,
    /// When that was answered.
    still_since: Option<Instant>,
    /// From when until when its ranger is silent.
    blind: Option<(Instant, Option<Instant>)>,
}

/// All robots of a simulation, watched from when they have settled.
#[derive(Debug)]
pub(crate) struct Watch {
    pub(crate) robots: Vec<Watched>,
}

impl Watch {
    pub(crate) fn new(simulation: &Simulation) -> Self {
        Self {
            robots: vec![Watched::default(); simulation.robots()],
        }
    }

    /// Gives a robot a command, and notes whether the broker dropped anything over it.
    pub(crate) fn tell(&mut self, simulation: &mut Simulation, robot: usize, action: &Action) {
        let known = &mut self.robots[robot];
        if action.is_motion() {
            known.halted = false;
            known.still_since = None;
            known.ends = !matches!(action, Action::Behave(_));
        }
        let dropped = |simulation: &Simulation| simulation.network().unwrap().statistics().dropped;
        let before = dropped(simulation);
        let seq = simulation.submit(robot, action.clone());
        if dropped(simulation) > before {
            known.dropped.insert(seq);
        }
        known.open.insert(seq, action.clone());
    }

    pub(crate) fn break_it(
        &mut self,
        simulation: &mut Simulation,
        robot: usize,
        fault: Fault,
        lasting: Option<Duration>,
    ) {
        simulation.inject(robot, fault, lasting).unwrap();
        let now = simulation.now();
        match fault {
            Fault::RangerDead => {
                self.robots[robot].blind = Some((now, lasting.map(|span| now + span)));
            }
            // One takes the place of the other.
            Fault::RangerStuck { .. } | Fault::RangerNoisy { .. } => {
                self.robots[robot].blind = None;
            }
            _ => {}
        }
    }

    pub(crate) fn heal(&mut self, simulation: &mut Simulation, robot: usize) {
        simulation.heal(robot);
        self.robots[robot].blind = None;
    }

    /// Lets a period pass, takes in what robots answered, and looks at each of them.
    pub(crate) fn pass(&mut self, simulation: &mut Simulation) {
        simulation.run_for(LOOK);
        self.listen(simulation);
        for (robot, known) in self.robots.iter_mut().enumerate() {
            known.look(simulation, robot);
        }
    }

    fn listen(&mut self, simulation: &Simulation) {
        for published in simulation.network().unwrap().take_record() {
            let topic = Topic::parse(simulation.fleet(), &published.topic).unwrap();
            let (Topic::Response(id) | Topic::Logs(id), true) =
                (&topic, published.origin != Origin::Repeated)
            else {
                continue;
            };
            let robot = (0..self.robots.len()).find(|&robot| simulation.id(robot) == Some(id));
            let known = &mut self.robots[robot.expect("a robot of ours")];
            if let Topic::Logs(_) = topic {
                let record = LogRecord::from_json(&published.payload).unwrap();
                known.not_sent += answers_not_sent(&record);
                continue;
            }
            let response = Response::from_json(&published.payload).unwrap();
            if response.status.is_final() {
                known.hear(&response, simulation.now());
            }
        }
    }
}

impl Watched {
    /// A command has its last answer.
    fn hear(&mut self, response: &Response, now: Instant) {
        let Some(action) = self.open.remove(&response.seq) else {
            return;
        };
        // What was said later and could move it has not been answered by then.
        if self.open.values().any(Action::is_motion) {
            return;
        }
        // Who refuses a motion goes on with the one before.
        if self.ends && action.is_motion() && response.status == ResponseStatus::Completed {
            self.still_since.get_or_insert(now);
        }
        self.halted |= matches!(action, Action::Stop | Action::Estop);
    }

    /// Its duties are within limits, grow no faster than the ramp lets them, pass zero before they turn over, and are
    /// zero behind a halt, without power, without a ranger, and when nothing that it was told goes on.
    fn look(&mut self, simulation: &Simulation, robot: usize) {
        let now = simulation.now();
        let seen = simulation.observe(robot).unwrap();
        for (duty, before) in seen.duty.into_iter().zip(self.duty) {
            assert!(duty.abs() <= 255);
            // Five percent a period of control by default; two periods may fall between two looks.
            let grown = duty.abs() - before.abs();
            assert!(grown <= 2 * 13 + 2, "from {before} to {duty}");
            assert!(duty == 0 || before == 0 || (duty > 0) == (before > 0));
        }
        self.duty = seen.duty;
        let over = |since: Instant, span| now.saturating_since(since) > span;
        let why = if self.halted {
            "was told to stand"
        } else if !seen.powered {
            "has no power"
        } else if self.is_blind(now) {
            "has no ranger"
        } else if self.still_since.is_some_and(|since| over(since, RUN_OUT)) {
            "was told nothing that moves it"
        } else {
            return;
        };
        assert_eq!(seen.duty, [0, 0], "robot {robot} {why}, at {now:?}");
    }

    fn is_blind(&self, now: Instant) -> bool {
        self.blind.is_some_and(|(since, until)| {
            now.saturating_since(since) > BLIND && until.is_none_or(|until| now < until)
        })
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
