//! Looking for the run that breaks something.
//!
//! Candidates are drawn from a seed: a seed for the world, parameters, obstacles and faults.
//! Later generations change the candidates that came nearest to failing. The same search gives
//! the same candidates on any number of threads.

use std::sync::atomic::AtomicBool;

use rand_core::Rng;
use rand_pcg::Pcg32;

use super::batch::{Job, run_all};
use super::shrink::confirmed;
use super::sweep::drawn;
use super::trial::Trial;
use super::verdict::{Criterion, Failure};
use crate::faults::{Fault, LinkCut, Wheel};
use crate::scenario::{Metric, Quota, Scenario, Selector, Success, TimedFault};
use crate::world::Profile;

/// Candidates that are tried before the next ones are drawn.
const GENERATION: usize = 16;
/// Candidates that later ones are made of.
const PARENTS: usize = 6;
/// Most faults of a candidate.
const MOST_FAULTS: u32 = 3;

/// What a search looks for.
#[derive(Debug, Clone)]
pub struct Search {
    /// The scenario to vary.
    pub scenario: Scenario,
    /// Names the search.
    pub seed: u64,
    /// Most runs.
    pub budget: usize,
    /// The criteria of which one is to be broken; none means any.
    pub hunted: Vec<Criterion>,
}

/// A run that broke a criterion.
#[derive(Debug, Clone)]
pub struct Find {
    /// The scenario, with everything stated that was varied or drawn, and nothing asked but what
    /// it breaks.
    pub scenario: Scenario,
    /// The seed of the run.
    pub seed: u64,
    /// What it broke.
    pub failure: Failure,
    /// Runs so far.
    pub runs: usize,
}

#[derive(Debug, Clone)]
struct Candidate {
    scenario: Scenario,
    seed: u64,
    score: f64,
}

/// What every robot program must hold to, whatever the scenario says: goals are reached, robots
/// come back from every fault, every command is answered, nobody moves after a stop, and nobody
/// drives into things at speed.
#[must_use]
pub fn invariants(scenario: &Scenario) -> Success {
    let stated = scenario.success;
    Success {
        reach: stated
            .reach
            .or((!scenario.goals.is_empty()).then_some(Quota::All)),
        impact_mps: stated.impact_mps.or(Some(0.4)),
        alive: stated.alive.or(Some(Quota::All)),
        answer_s: stated.answer_s.or(Some(5.0)),
        recovery_s: stated.recovery_s.or(Some(20.0)),
        still_s: stated.still_s.or(Some(0.2)),
        ..stated
    }
}

impl Search {
    /// Runs the search until something breaks, the budget is spent, or `stop` is set. Calls `done`
    /// with the number of runs so far.
    pub fn run(
        &self,
        threads: usize,
        stop: &AtomicBool,
        done: &(dyn Fn(usize) + Sync),
    ) -> Option<Find> {
        let mut rng = Pcg32::new(self.seed, 0x666F_756C);
        let mut best: Vec<Candidate> = Vec::new();
        let mut runs = 0;
        while runs < self.budget {
            let size = GENERATION.min(self.budget - runs);
            let mut candidates: Vec<Candidate> = (0..size)
                .map(|number| {
                    let parent = best.get(number / 2).filter(|_| number % 2 == 1);
                    self.vary(parent, &mut rng)
                })
                .collect();
            let jobs: Vec<Job<'_>> = candidates
                .iter()
                .map(|candidate| Job {
                    scenario: &candidate.scenario,
                    seed: candidate.seed,
                })
                .collect();
            let trials = run_all(&jobs, threads, stop, &|now| done(runs + now.runs));
            for (number, (candidate, trial)) in candidates.iter_mut().zip(trials).enumerate() {
                let trial = trial?;
                if let Some(failure) = self.broken(&trial) {
                    let find = Find {
                        scenario: candidate.scenario.clone(),
                        seed: candidate.seed,
                        failure: failure.clone(),
                        runs: runs + number + 1,
                    };
                    if let Some(find) = confirmed(&find) {
                        return Some(find);
                    }
                }
                candidate.score = score(&candidate.scenario, &trial);
            }
            runs += size;
            best.append(&mut candidates);
            best.sort_by(|a, b| b.score.total_cmp(&a.score));
            best.truncate(PARENTS);
        }
        None
    }

    /// The first criterion of those hunted that a run broke.
    pub(super) fn broken<'a>(&self, trial: &'a Trial) -> Option<&'a Failure> {
        trial.failures.iter().find(|failure| {
            // A world without room for its robots is nobody's weakness.
            failure.criterion != Criterion::SetUp
                && (self.hunted.is_empty() || self.hunted.contains(&failure.criterion))
        })
    }

    fn vary(&self, parent: Option<&Candidate>, rng: &mut Pcg32) -> Candidate {
        let mut scenario = parent.map_or_else(
            || Scenario {
                success: invariants(&self.scenario),
                difficulty: None,
                thresholds: Vec::new(),
                ..self.scenario.clone()
            },
            |parent| parent.scenario.clone(),
        );
        // Half of the children live in their parent's world.
        let seed = match parent {
            Some(parent) if rng.next_u32().is_multiple_of(2) => parent.seed,
            _ => u64::from(rng.next_u32()),
        };
        if parent.is_none() || rng.next_u32().is_multiple_of(2) {
            let profile = Profile::ALL[rng.next_u32() as usize % Profile::ALL.len()];
            let stated = Scenario {
                parameters: self.scenario.parameters,
                ..scenario
            };
            scenario = drawn(&stated, profile, seed);
        }
        let scatter = &mut scenario.arena.scatter;
        if parent.is_none() && scatter.per_square_metre > 0.0 {
            scatter.per_square_metre *= 0.5 + unit(rng);
            scatter.side[1] = (scatter.side[1] * (1.0 + 2.0 * unit(rng))).min(2.0);
        }
        let faults = if parent.is_some() {
            1
        } else {
            rng.next_u32() % (MOST_FAULTS + 1)
        };
        for _ in 0..faults {
            if scenario.faults.len() > MOST_FAULTS as usize + self.scenario.faults.len() {
                let worst = rng.next_u32() as usize % scenario.faults.len();
                scenario.faults.remove(worst);
            }
            let fault = draw_fault(&scenario, rng);
            scenario.faults.push(fault);
        }
        Candidate {
            scenario,
            seed,
            score: 0.0,
        }
    }
}

fn unit(rng: &mut Pcg32) -> f32 {
    (rng.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// A fault that a robot has to get over.
fn draw_fault(scenario: &Scenario, rng: &mut Pcg32) -> TimedFault {
    let tenths = |value: f32| libm::roundf(value * 10.0) * 0.1;
    let wheel = if rng.next_u32().is_multiple_of(2) {
        Wheel::Left
    } else {
        Wheel::Right
    };
    let fault = match rng.next_u32() % 8 {
        0 => Fault::RangerDead,
        1 => Fault::RangerStuck {
            mm: 100 + (rng.next_u32() % 40) as u16 * 50,
        },
        2 => Fault::LineNoise {
            flips: 0.01 + 0.05 * unit(rng),
        },
        3 => Fault::LineStuck,
        4 => Fault::LinkLoss {
            how: LinkCut::Radio,
        },
        5 => Fault::BrownOut,
        6 => Fault::MotorWeak {
            wheel,
            strength: 0.5 + 0.5 * unit(rng),
        },
        _ => Fault::BatterySag {
            ohm: 2.0 + 4.0 * unit(rng),
        },
    };
    // Not before robots are on their way, and with time to get over it.
    let latest = (scenario.duration_s * 0.5).max(8.0);
    TimedFault {
        at_s: tenths(6.0 + (latest - 6.0) * unit(rng)),
        for_s: Some(tenths(0.5 + 7.5 * unit(rng))),
        every_s: None,
        until_s: None,
        robots: Selector::List(vec![rng.next_u32() % scenario.robots.max(1)]),
        fault,
    }
}

/// How near a run came to breaking something; more is nearer.
fn score(scenario: &Scenario, trial: &Trial) -> f64 {
    let get = |metric| trial.measured.get(metric).unwrap_or(0.0);
    let detours = trial.measured.get(Metric::PathOptimality);
    get(Metric::TimeToGoalS) / f64::from(scenario.duration_s)
        + (1.0 - detours.unwrap_or(1.0))
        + get(Metric::RecoveryS) / 20.0
        + (1.0 - trial.measured.get(Metric::CommandSuccess).unwrap_or(1.0))
        + 0.1 * get(Metric::Collisions).min(5.0)
}
