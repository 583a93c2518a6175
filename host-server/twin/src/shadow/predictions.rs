//! Predictions that wait for what comes: begun every second while a body is driven, and held against fixes.
//!
//! Beside the body of the twin the nominal one is driven by the same duties, so that both are held against the same fix.

use std::collections::VecDeque;

use super::Recent;
use super::state::{State, Stretch};
use crate::body::{Parameters, Pose, STEP_S, Wheels, arc};
use crate::course::Random;
use crate::evidence::Fix;
use crate::gap::{DISPLACEMENT_S, Displacement, HORIZONS_S, Pair, Samples};
use crate::linear::Square;

/// A prediction begins so often, seconds.
const EVERY_S: f64 = 1.0;
/// The first fix may come so much after what a prediction or a displacement is for, seconds.
const LATEST_S: f64 = 0.5;
/// Stamps of what comes in time differ by this, seconds.
const TOLERANCE_S: f64 = 0.02;
/// Over less way a prediction of each horizon shows nothing of a body, metres.
const LEAST_WAY_M: [f64; 2] = [0.05, 0.5];
/// Nor does a displacement over less.
const LEAST_DISPLACED_M: f64 = 0.1;

/// Where a prediction begins.
#[derive(Debug, Clone, Copy)]
struct Mark {
    at_s: f64,
    pose: Pose,
    driven: Pose,
    nominal: Pose,
    way_m: f64,
    /// How sure the pose was.
    begun: Square<5>,
    /// Where the robot is by now, as it said, and how sure that is.
    here: Pose,
    covariance: Square<5>,
    /// Which horizons it was held against a fix for.
    used: [bool; 2],
}

/// Where a displacement begins.
#[derive(Debug, Clone, Copy)]
struct Start {
    fix: Fix,
    sigma: f64,
    heading: f64,
    heading_sigma: f64,
    there: There,
}

/// Where bodies that are only driven are at the moment of a fix.
#[derive(Debug, Clone, Copy)]
pub(super) struct There {
    driven: Pose,
    nominal: Pose,
    way_m: f64,
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub(super) struct Predictions {
    marks: VecDeque<Mark>,
    start: Option<Start>,
    wheels: Wheels,
    nominal: Pose,
    way_m: f64,
    random: Random,
    pub(super) samples: Samples,
    /// Errors of each horizon, of every fix.
    pub(super) residuals: [Recent; 2],
}

impl Default for Predictions {
    fn default() -> Self {
        Self {
            marks: VecDeque::new(),
            start: None,
            wheels: Wheels::default(),
            nominal: Pose::default(),
            way_m: 0.0,
            random: Random::new(1),
            samples: Samples::default(),
            residuals: [Recent::default(), Recent::default()],
        }
    }
}

/// Where somebody is whose covariance is `begun` and who rolled to `motion` from there: the part of the position.
fn carried(begun: &Square<5>, from: Pose, to: Pose) -> [f64; 3] {
    let p = begun;
    let (dx, dy) = (to.x - from.x, to.y - from.y);
    [
        p[0][0] - 2.0 * dy * p[0][2] + dy * dy * p[2][2],
        p[0][1] + dx * p[0][2] - dy * p[1][2] - dx * dy * p[2][2],
        p[1][1] + 2.0 * dx * p[1][2] + dx * dx * p[2][2],
    ]
}

impl Predictions {
    /// Nothing that was begun has to do with what comes now.
    pub(super) fn begin(&mut self) {
        self.interrupt();
        self.wheels = Wheels::default();
        self.nominal = Pose::default();
    }

    /// Something happens that is of no body: what is predicted begins after it.
    pub(super) fn interrupt(&mut self) {
        self.marks.clear();
        self.start = None;
    }

    /// A step of the nominal body, of a robot whose wheels have these `speeds` by its own.
    pub(super) fn step(&mut self, duty: [f64; 2], open_v: f64, speeds: [f64; 2]) {
        let before = self.wheels;
        self.wheels.step(&Parameters::NOMINAL, duty, open_v);
        let motion = self.wheels.motion(before, Parameters::NOMINAL.track_m);
        self.nominal = self.nominal.then(motion);
        self.way_m += (speeds[0] + speeds[1]).abs() * 0.5 * STEP_S;
    }

    /// Takes on how sure all that was begun is, over a stretch that led to `state`.
    pub(super) fn spread(&mut self, stretch: &Stretch, state: &State) {
        for mark in &mut self.marks {
            let here = mark.pose.then(mark.driven.sees(state.driven));
            mark.covariance = stretch.spread(&mark.covariance, mark.here, here);
            mark.here = here;
        }
    }

    /// Whether another one is to begin.
    pub(super) fn is_due(&self, at_s: f64) -> bool {
        let last = self.marks.back();
        last.is_none_or(|last| at_s - last.at_s >= EVERY_S)
    }

    /// Begins one, where the covariance of `state` is up to now.
    pub(super) fn mark(&mut self, state: &State) {
        self.marks.push_back(Mark {
            at_s: state.at_s,
            pose: state.pose,
            driven: state.driven,
            nominal: self.nominal,
            way_m: self.way_m,
            begun: state.covariance,
            here: state.pose,
            covariance: state.covariance,
            used: [false; 2],
        });
    }

    /// Forgets those that are too old for any horizon.
    pub(super) fn prune(&mut self, at_s: f64) {
        let is_old = |first: &Mark| at_s - first.at_s > HORIZONS_S[1] + 2.0;
        while self.marks.front().is_some_and(is_old) {
            self.marks.pop_front();
        }
    }

    /// Driven so far, metres.
    pub(super) const fn way_m(&self) -> f64 {
        self.way_m
    }

    /// Where the driven bodies are `rest` seconds after `state`.
    pub(super) fn there(&self, state: &State, parameters: &Parameters, rest: f64) -> There {
        let driven = State {
            pose: state.driven,
            ..*state
        };
        let [left, right] = self.wheels.rims.map(|rim| rim * rest);
        There {
            driven: driven.ahead(parameters, rest),
            nominal: self
                .nominal
                .then(arc(left, right, Parameters::NOMINAL.track_m)),
            way_m: self.way_m,
        }
    }

    /// Holds a fix against what was predicted of it. Of a robot with a fault, whatever it is, nothing is learned of bodies.
    pub(super) fn hold(&mut self, fix: &Fix, sigma: f64, there: &There, is_well: bool) {
        for (horizon, horizon_s) in HORIZONS_S.into_iter().enumerate() {
            let age = |mark: &Mark| (fix.at_s - mark.at_s - horizon_s).abs();
            let mark = self.marks.iter().min_by(|a, b| age(a).total_cmp(&age(b)));
            if let Some(mark) = mark.filter(|mark| age(mark) <= 0.5) {
                let place = mark.pose.then(mark.driven.sees(there.driven));
                self.residuals[horizon].push((fix.x - place.x).hypot(fix.y - place.y));
            }
            let in_time = |mark: &&mut Mark| {
                let late_s = fix.at_s - mark.at_s - horizon_s;
                (-TOLERANCE_S..=LATEST_S).contains(&late_s)
            };
            let mark = self.marks.iter_mut().rev().find(in_time);
            if let Some(mark) = mark.filter(|mark| is_well && !mark.used[horizon]) {
                mark.used[horizon] = true;
                let way_m = there.way_m - mark.way_m;
                if way_m >= LEAST_WAY_M[horizon]
                    && let Some(pair) = pair(mark, fix, sigma, there, &mut self.random)
                {
                    self.samples.pair(horizon, pair);
                }
            }
        }
        self.displacement(fix, sigma, there, is_well);
    }

    fn displacement(&mut self, fix: &Fix, sigma: f64, there: &There, is_well: bool) {
        let Some(start) = self.start else { return };
        let span_s = fix.at_s - start.fix.at_s;
        if is_well && span_s < DISPLACEMENT_S - TOLERANCE_S {
            return;
        }
        self.start = None;
        let way_m = there.way_m - start.there.way_m;
        if !is_well || span_s > DISPLACEMENT_S + LATEST_S || way_m < LEAST_DISPLACED_M {
            return;
        }
        let from = Pose {
            x: start.fix.x,
            y: start.fix.y,
            theta: start.heading,
        };
        let seen = from.sees(Pose {
            x: fix.x,
            y: fix.y,
            theta: start.heading,
        });
        let own = start.there.driven.sees(there.driven);
        let nominal = start.there.nominal.sees(there.nominal);
        // Both fixes are off, and so is the direction from which the second one is seen.
        let turn = start.heading_sigma * self.random.normal();
        let mut noise = || sigma.hypot(start.sigma) * self.random.normal();
        let copy = [
            own.x - turn * own.y + noise(),
            own.y + turn * own.x + noise(),
        ];
        let single = |point: [f64; 2]| point.map(|value| value as f32);
        self.samples.displacement(Displacement {
            at_s: fix.at_s,
            seen: single([seen.x, seen.y]),
            own: single([own.x, own.y]),
            nominal: single([nominal.x, nominal.y]),
            copy: single(copy),
        });
    }

    /// After a fix was taken in: a displacement may begin there.
    pub(super) fn start(&mut self, fix: &Fix, sigma: f64, there: There, state: &State) {
        if self.start.is_none() {
            self.start = Some(Start {
                fix: *fix,
                sigma,
                heading: state.pose.theta,
                heading_sigma: state.covariance[2][2].max(0.0).sqrt(),
                there,
            });
        }
    }
}

fn pair(mark: &Mark, fix: &Fix, sigma: f64, there: &There, random: &mut Random) -> Option<Pair> {
    let own = mark.pose.then(mark.driven.sees(there.driven));
    let nominal = mark.pose.then(mark.nominal.sees(there.nominal));
    let (left, noise) = ([fix.x - own.x, fix.y - own.y], sigma * sigma);
    let p = &mark.covariance;
    let (along, cross, across) = (p[0][0] + noise, p[0][1], p[1][1] + noise);
    let square = (across * left[0] * left[0] - 2.0 * cross * left[0] * left[1]
        + along * left[1] * left[1])
        / (along * across - cross * cross);
    // A perfect copy rolls to the very place, and begins where fixes said.
    let [xx, xy, yy] = carried(&mark.begun, mark.pose, own);
    let first = (xx + noise).max(0.0).sqrt();
    let slope = xy / first;
    let second = (yy + noise - slope * slope).max(0.0).sqrt();
    let [one, two] = [random.normal(), random.normal()];
    let copy = (first * one).hypot(slope * one + second * two);
    let is_sound = square >= 0.0 && copy.is_finite();
    is_sound.then_some(Pair {
        at_s: fix.at_s,
        own_m: left[0].hypot(left[1]) as f32,
        nominal_m: (fix.x - nominal.x).hypot(fix.y - nominal.y) as f32,
        copy_m: copy as f32,
        square: square as f32,
        way_m: (there.way_m - mark.way_m) as f32,
    })
}
