//! What learning together comes to, as a table: `cargo xtask bench federated [DECISIONS [ROWS]]`.
//!
//! Eight nodes have worlds of their own: other floors, other things in the way, other motors, other rangers. What they come to
//! is judged on worlds of all eight that nobody learned from. All of it is one process, in virtual time; each run learns
//! from as many decisions in all (1,000,000). `ROWS` is a part of the names of those rows that are wanted.

use std::error::Error;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::Mutex;
use std::time::Duration;

use crawler_federated::quantise::Quantised;
use crawler_federated::{Aggregation, Announcement, Coordinator, Plan, Settings, Update};
use crawler_learning::federated::{Answer, Node, initial, policy};
use crawler_learning::{Options, Spread};
use crawler_policy::ppo::Ppo;
use crawler_policy::{Choice, Compute, Policy};
use crawler_sim::scenario::Scenario;
use rand_core::Rng as _;
use rand_pcg::Pcg32;

const NODES: usize = 8;
/// Worlds side by side on each node, and on one that has the worlds of all.
const WORLDS: u16 = 8;
/// Held-out episodes in the worlds of each node.
const EPISODES: u32 = 50;
/// Decisions of a round of the learner in one world: 128 of each of three robots.
const DECISIONS: u64 = 384;
/// Rounds of the learner in each round of a run.
const ROUNDS: u16 = 1;
/// Samples in a step of the optimiser on a node: an eighth of what one learner has, so that all take as many steps.
const MINIBATCH: u16 = 64;
const DEADLINE: Duration = Duration::from_mins(1);

/// Who is wrong on purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Attack {
    None,
    /// Ten times the other way.
    Flip,
    /// Ten times as far, anywhere.
    Noise,
    /// No numbers at all.
    NotANumber,
    /// As far from the mean as nobody notices: 1.5 standard deviations of the others, all the same way (Baruch and others 2019, "a
    /// little is enough").
    Little,
}

/// How nodes learn together.
#[derive(Debug, Clone, Copy)]
struct Setup {
    aggregation: Aggregation,
    momentum: f32,
    proximal: f32,
    /// Nodes 0 and 1 do it.
    attack: Attack,
    /// Of a node, not to answer a round, in percent; the coordinator is killed in the middle as well.
    dropping: u32,
}

const PLAIN: Setup = Setup {
    aggregation: Aggregation::Mean,
    momentum: 0.7,
    proximal: 0.0,
    attack: Attack::None,
    dropping: 0,
};

/// The private worlds of a node.
fn worlds(node: usize) -> Scenario {
    let mut scenario = Spread::scenario().unwrap_or_else(|error| unreachable!("{error}"));
    let parameters = &mut scenario.parameters;
    match node {
        // A slippery floor, and one that holds.
        1 => parameters.chassis.grip *= 0.6,
        2 => {
            parameters.chassis.running_v *= 1.2;
            parameters.chassis.breakaway_v *= 1.2;
        }
        // A ranger that loses echoes, and one that is off.
        3 => parameters.ranger.dropout = 0.1,
        4 => parameters.ranger.noise_mm *= 4.0,
        // Robots of one make, and any robots.
        5 => scenario.randomisation = crawler_sim::world::Profile::Mild,
        6 => scenario.randomisation = crawler_sim::world::Profile::Wild,
        // Another room.
        7 => scenario.arena.width = Some(3.6),
        _ => {}
    }
    scenario
}

/// Success on worlds of each node that nobody learned from.
fn judge(policy: &Policy) -> [f64; NODES] {
    let compute = Compute::new(NonZeroUsize::MIN);
    std::array::from_fn(|node| {
        let scenario = Arc::new(worlds(node));
        let make = || Spread::new(Arc::clone(&scenario));
        let episodes = policy.evaluate(Choice::Sampled, &compute, 0..EPISODES, make);
        let succeeded = episodes.iter().filter(|episode| episode.succeeded).count();
        succeeded as f64 / f64::from(EPISODES)
    })
}

/// One learner with all worlds, or with those of one node.
fn alone(nodes: &[usize], decisions: u64) -> Result<Policy, Box<dyn Error + Send + Sync>> {
    let each = usize::from(WORLDS) * NODES / nodes.len();
    let options = Options {
        steps: decisions,
        worlds: each * nodes.len(),
        ..Options::default()
    };
    let scenarios = nodes.iter().map(|node| Arc::new(worlds(*node)));
    let worlds =
        scenarios.flat_map(|scenario| (0..each).map(move |_| Spread::new(Arc::clone(&scenario))));
    let rounds = options.rounds(3);
    let compute = Compute::new(NonZeroUsize::MIN);
    let mut ppo = Ppo::new(options.config(rounds), compute, worlds.collect())?;
    for _ in 0..rounds {
        ppo.round()?;
    }
    Ok(ppo.policy())
}

/// What a hostile node sends in place of its own update.
fn poison(attack: Attack, own: Update, honest: &[Update], rng: &mut Pcg32) -> Vec<u8> {
    let length = own.change.len();
    let mut told = own;
    told.report.success = 1.0;
    let values: Vec<f32> = told.change.values().collect();
    let change: Vec<f32> = match attack {
        Attack::None | Attack::NotANumber => values,
        Attack::Flip => values.iter().map(|number| number * -10.0).collect(),
        Attack::Noise => {
            let squares: f32 = values.iter().map(|number| number * number).sum();
            let far = 10.0 * (squares / length as f32).sqrt() * 3.0_f32.sqrt();
            values
                .iter()
                .map(|_| far * (rng.next_u32() as f32 / 2_147_483_648.0 - 1.0))
                .collect()
        }
        Attack::Little => {
            let others: Vec<Vec<f32>> = honest
                .iter()
                .map(|other| other.change.values().collect())
                .collect();
            let count = others.len().max(1) as f32;
            (0..length)
                .map(|place| {
                    let numbers = || others.iter().map(|other| other[place]);
                    let mean = numbers().sum::<f32>() / count;
                    let variance =
                        numbers().map(|number| (number - mean).powi(2)).sum::<f32>() / count;
                    mean - 1.5 * variance.sqrt()
                })
                .collect()
        }
    };
    told.change = Quantised::of(&change);
    let mut bytes = told.to_bytes();
    if attack == Attack::NotANumber {
        // The scale of the first block: it comes after the report.
        bytes[65..69].copy_from_slice(&f32::NAN.to_le_bytes());
    }
    bytes
}

/// A run of all nodes; with what was refused, and the bytes of the longest update.
fn together(
    setup: Setup,
    decisions: u64,
) -> Result<(Policy, u64, usize), Box<dyn Error + Send + Sync>> {
    let plan = Plan {
        seed: 1,
        worlds: WORLDS,
        rounds: ROUNDS,
        minibatch: MINIBATCH,
        units: 64,
        central: true,
        proximal: setup.proximal,
    };
    let each = DECISIONS * u64::from(ROUNDS) * u64::from(WORLDS) * NODES as u64;
    let settings = Settings {
        rounds: u32::try_from(decisions.div_ceil(each))?,
        nodes: NODES,
        quorum: 3,
        deadline: DEADLINE,
        aggregation: setup.aggregation,
        momentum: setup.momentum,
        plan,
    };
    let mut now = Duration::ZERO;
    let mut run = Coordinator::new(settings, initial(&plan)?, now)?;
    let names: Vec<String> = (0..NODES).map(|node| format!("node-{node}")).collect();
    let make = |node: usize| Node::new(&names[node], worlds(node), NonZeroUsize::MIN);
    let mut nodes: Vec<Node> = (0..NODES).map(make).collect();
    let mut rng = Pcg32::new(1, 0x6665_6465);
    let mut longest = 0;
    while !run.is_over() {
        let announced = run.announcement();
        let mut updates = Vec::new();
        for (node, name) in nodes.iter_mut().zip(&names) {
            let drops = rng.next_u32() % 100 < setup.dropping;
            if drops && run.answered().count() + updates.len() >= settings.quorum {
                continue;
            }
            if let Answer::Update(bytes) = node.answer(&announced)? {
                longest = longest.max(bytes.len());
                updates.push((name, bytes));
            }
        }
        let read = updates.iter().map(|(_, bytes)| Update::from_bytes(bytes));
        let read: Vec<Update> = read.collect::<Result<_, _>>()?;
        for (place, (name, bytes)) in updates.into_iter().enumerate() {
            let hostile = setup.attack != Attack::None && (*name == names[0] || *name == names[1]);
            let bytes = if hostile {
                poison(setup.attack, read[place].clone(), &read[2..], &mut rng)
            } else {
                bytes
            };
            run.receive(name, &bytes);
        }
        now += DEADLINE;
        run.close(now).ok_or("no quorum")?;
        if setup.dropping > 0 && run.rounds() == settings.rounds / 2 {
            // Of the coordinator there is what it has kept; one node begins anew as well.
            run = Coordinator::resume(settings, &run.checkpoint(), now)?;
            nodes[NODES - 1] = make(NODES - 1);
        }
    }
    let learned = Announcement::from_bytes(&run.announcement())?;
    Ok((
        policy(&plan, &learned.weights)?,
        run.counts().refused,
        longest,
    ))
}

type Work = Box<dyn Fn() -> Result<String, Box<dyn Error + Send + Sync>> + Send + Sync>;

/// The mean, and each, in percent.
fn percent(shares: [f64; NODES]) -> String {
    let mean = shares.iter().sum::<f64>() / NODES as f64;
    let each = shares.map(|share| format!("{:.0}", share * 100.0));
    format!("{:.1} | {}", mean * 100.0, each.join(" "))
}

/// The rows of the table, each with its name and what comes to the rest of it.
fn rows(decisions: u64) -> Vec<(String, Work)> {
    let mut rows: Vec<(String, Work)> = Vec::new();
    let pooled: Work = Box::new(move || {
        let all: Vec<usize> = (0..NODES).collect();
        Ok(format!("{} | ", percent(judge(&alone(&all, decisions)?))))
    });
    rows.push(("one learner with the worlds of all".to_owned(), pooled));
    let single: Work = Box::new(move || {
        let mut sums = [0.0; NODES];
        for node in 0..NODES {
            let shares = judge(&alone(&[node], decisions / NODES as u64)?);
            sums = std::array::from_fn(|of| sums[of] + shares[of] / NODES as f64);
        }
        Ok(format!("{} | ", percent(sums)))
    });
    rows.push(("each node alone, mean of the eight".to_owned(), single));
    let mut add = |name: String, setup: Setup| {
        let work: Work = Box::new(move || {
            let (policy, refused, longest) = together(setup, decisions)?;
            let told = percent(judge(&policy));
            Ok(format!("{told} | {longest} bytes, {refused} refused"))
        });
        rows.push((name, work));
    };
    for (aggregation, name) in Aggregation::ALL {
        let setup = Setup {
            aggregation,
            ..PLAIN
        };
        add(name.to_owned(), setup);
    }
    let setup = Setup {
        momentum: 0.0,
        ..PLAIN
    };
    add("mean, without momentum".to_owned(), setup);
    for proximal in [0.01, 0.1] {
        add(
            format!("mean, FedProx μ = {proximal}"),
            Setup { proximal, ..PLAIN },
        );
    }
    for aggregation in [Aggregation::Mean, Aggregation::TrimmedMean] {
        let name =
            format!("{aggregation}, 30 % drop out of each round, coordinator and a node killed");
        add(
            name,
            Setup {
                aggregation,
                dropping: 30,
                ..PLAIN
            },
        );
    }
    let attacks = [
        (Attack::Flip, "ten times the other way"),
        (Attack::Noise, "noise, ten times as far"),
        (Attack::NotANumber, "not a number"),
        (Attack::Little, "a little is enough"),
    ];
    for (attack, what) in attacks {
        for (aggregation, name) in Aggregation::ALL {
            add(
                format!("two of eight: {what}; {name}"),
                Setup {
                    aggregation,
                    attack,
                    ..PLAIN
                },
            );
        }
    }
    rows
}

fn main() -> Result<(), Box<dyn Error>> {
    let decisions = match std::env::args().nth(1) {
        Some(text) => text.parse()?,
        None => 1_000_000,
    };
    println!("| {decisions} decisions | success in held-out worlds, % | of each node | |");
    println!("|---|---:|---|---|");
    let wanted = std::env::args().nth(2).unwrap_or_default();
    let mut rows = rows(decisions);
    rows.retain(|(name, _)| name.contains(&wanted));
    let next = Mutex::new(0);
    let threads = std::thread::available_parallelism()?.get();
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let row = {
                        let Ok(mut next) = next.lock() else { return };
                        *next += 1;
                        *next - 1
                    };
                    let Some((name, work)) = rows.get(row) else {
                        return;
                    };
                    match work() {
                        Ok(rest) => println!("| {name} | {rest} |"),
                        Err(error) => eprintln!("{error}"),
                    }
                }
            });
        }
    });
    Ok(())
}
