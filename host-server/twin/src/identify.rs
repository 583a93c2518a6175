//! Parameters from a drive: Gauss–Newton over windows of it.
//!
//! Every parameter is told as a number of deviations from its prior, whose spread is that of the
//! simulator's wildest draws; so what a drive does not show stays where the prior has it, and its
//! deviation says so. In a window of some seconds the pose at its beginning is a nuisance, which is
//! eliminated; fixes count with Huber's loss, so a few that lie do not matter, and many end it.

use serde::{Deserialize, Serialize};

use crate::body::{Parameters, Pose, wrap};
use crate::drive::{Drive, OpenVoltage, Track, residual};
use crate::evidence::Fix;
use crate::linear::{Square, cholesky, inverse, solve};

/// Parameters that are identified.
pub const COUNT: usize = 11;

/// Names of the parameters, as in certificates.
pub const NAMES: [&str; COUNT] = [
    "speed_left",
    "speed_right",
    "friction_left",
    "friction_right",
    "backward",
    "lag_straight",
    "lag_turn",
    "coast",
    "track",
    "latency",
    "internal_ohm",
];

/// Deviation of each prior: relative, but for the latency, which is in seconds.
const SPREAD: [f64; COUNT] = [
    0.15, 0.15, 0.25, 0.25, 0.03, 0.25, 0.25, 0.4, 0.04, 0.1, 0.4,
];

/// Differences are taken over so many deviations.
const DIFFERENCE: f64 = 0.02;
/// Huber's loss is linear from here, standard deviations.
const HUBER: f64 = 2.0;
/// What is left of a fit tells of more than the noise of fixes from here, in deviations.
const NOISY: f64 = 1.02;
/// Most noise of the way itself, radians for the root of a metre.
const MOST_NOISE: f64 = 0.12;
/// Seconds of a window.
const WINDOW_S: f64 = 6.0;
/// No parameter goes further from its prior than so many deviations.
const FARTHEST: f64 = 3.5;
/// Parameters that every drive tells: speeds, frictions, track and latency. Of one of them that ends up at its bound
/// nobody can say where it would go.
const CERTAIN: [usize; 6] = [0, 1, 2, 3, 8, 9];
/// Fewest fixes that make a window.
const FEWEST_FIXES: usize = 6;
/// Fewest windows that make a result.
const FEWEST_WINDOWS: usize = 4;
/// Most rounds.
const ROUNDS: usize = 30;
/// A round that moves no parameter by more deviations than this is the last.
const SETTLED: f64 = 0.02;
/// No robot is that fast, metres per second; a fix that says so is of another one, or of another place.
const FASTEST_MPS: f64 = 1.6;
/// And none turns so fast, radians per second.
const FASTEST_RAD: f64 = 12.0;
/// Heading's deviation of a fix where nothing is said of it, radians.
pub(crate) const SIGMA_RAD: f64 = 0.02;
/// Position's deviation of a fix where it is not known, metres.
pub(crate) const SIGMA_M: f64 = 0.01;

/// Why nothing was identified.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Unidentified {
    /// There is too little: more duties, more fixes, or no voltage at all.
    TooLittle,
    /// The robot hardly moved.
    StoodStill,
    /// Equations had no solution: the evidence contradicts itself.
    NoSolution,
    /// What came out is no robot.
    Implausible,
}

impl std::fmt::Display for Unidentified {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::TooLittle => "too little is known of the drive",
            Self::StoodStill => "the robot hardly moved",
            Self::NoSolution => "the evidence contradicts itself",
            Self::Implausible => "what fits best is no robot",
        })
    }
}

/// What a drive says of a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Identified {
    /// What fits best.
    pub parameters: Parameters,
    /// Covariance in deviations of the priors, in the order of [`NAMES`].
    pub covariance: Square<COUNT>,
    /// Rounds until it settled.
    pub rounds: usize,
    /// Fixes in windows.
    pub fixes: usize,
    /// Share of them beyond Huber's bound.
    pub outliers: f64,
    /// Root mean square of what is left, in deviations of fixes.
    pub residual: f64,
    /// Jumps of the tracker, or of the robot, that windows end at.
    pub jumps: usize,
    /// How much the heading wanders beyond what the model has, radians for the root of a metre.
    pub wander: f64,
}

impl Identified {
    /// Standard deviation of a parameter, relative; of the latency in seconds.
    #[must_use]
    pub fn deviation(&self, parameter: usize) -> f64 {
        self.covariance[parameter][parameter].sqrt() * SPREAD[parameter]
    }
}

/// Parameters so many deviations from `prior`.
pub(crate) fn at(prior: &Parameters, x: &[f64; COUNT]) -> Parameters {
    let times = |k: usize| (SPREAD[k] * x[k]).exp();
    let p = prior;
    Parameters {
        speed_per_volt: [
            p.speed_per_volt[0] * times(0),
            p.speed_per_volt[1] * times(1),
        ],
        friction_v: [p.friction_v[0] * times(2), p.friction_v[1] * times(3)],
        backward: p.backward * times(4),
        lag_straight_s: p.lag_straight_s * times(5),
        lag_turn_s: p.lag_turn_s * times(6),
        coast: (p.coast * times(7)).min(0.9),
        track_m: p.track_m * times(8),
        latency_s: p.latency_s + SPREAD[9] * x[9],
        internal_ohm: p.internal_ohm * times(10),
        ..*p
    }
}

/// Fixes that a window is made of.
struct Window<'a> {
    fixes: &'a [Fix],
    start: Pose,
}

/// Cuts a drive into windows: where duties are known, and where nobody jumps.
fn windows<'a>(drive: &Drive<'a>) -> (Vec<Window<'a>>, usize) {
    let (mut windows, mut jumps) = (Vec::new(), 0);
    let fixes = drive.evidence.fixes();
    let fixes = &fixes[fixes.partition_point(|fix| fix.at_s < drive.span.0)..];
    let fixes = &fixes[..fixes.partition_point(|fix| fix.at_s <= drive.span.1)];
    let mut begin = 0;
    for i in 0..fixes.len() {
        let jumped = i > begin && jumps_between(&fixes[i - 1], &fixes[i]);
        jumps += usize::from(jumped);
        let full = fixes[i].at_s - fixes[begin].at_s >= WINDOW_S;
        let last = i + 1 == fixes.len();
        if !(jumped || full || last) {
            continue;
        }
        let end = if jumped { i } else { i + 1 };
        let part = &fixes[begin..end];
        if part.len() >= FEWEST_FIXES && drive.covers(part[0].at_s, part[part.len() - 1].at_s) {
            let first = &part[0];
            let start = Pose {
                x: first.x,
                y: first.y,
                theta: first.theta,
            };
            windows.push(Window { fixes: part, start });
        }
        begin = i;
    }
    (windows, jumps)
}

/// Whether no robot gets from one fix to the other.
#[must_use]
pub fn jumps_between(a: &Fix, b: &Fix) -> bool {
    let span = (b.at_s - a.at_s).max(1e-3);
    let noise = 6.0 * a.sigma_m.max(b.sigma_m).max(SIGMA_M);
    (b.x - a.x).hypot(b.y - a.y) > FASTEST_MPS * span + noise
        || wrap(b.theta - a.theta).abs() > FASTEST_RAD * span + 10.0 * SIGMA_RAD
}

/// Identifies a body from a drive, beginning at `prior`.
///
/// # Errors
/// [`Unidentified`].
pub fn identify(drive: &Drive<'_>, prior: &Parameters) -> Result<Identified, Unidentified> {
    let (mut windows, jumps) = windows(drive);
    if windows.len() < FEWEST_WINDOWS {
        return Err(Unidentified::TooLittle);
    }
    let mut open = drive.open_voltage(prior).ok_or(Unidentified::TooLittle)?;
    let driven = drive.track(prior, &open).way(drive.span.1);
    if driven < 1.0 {
        return Err(Unidentified::StoodStill);
    }
    let mut x = [0.0; COUNT];
    let mut system = System::default();
    let (mut rounds, mut noise) = (0, 0.0);
    while rounds < ROUNDS {
        rounds += 1;
        let built = System::of(drive, prior, &x, &open, &windows, noise);
        system = built.ok_or(Unidentified::NoSolution)?;
        let (step, starts) = system.step().ok_or(Unidentified::NoSolution)?;
        // A long step is one of a model that is not linear so far.
        let longest = step
            .iter()
            .fold(0.0_f64, |longest, step| longest.max(step.abs()));
        if !longest.is_finite() {
            return Err(Unidentified::NoSolution);
        }
        // One that goes to and fro over the edge of a standstill is halved.
        let scale = (1.0 / longest).min(if rounds > 8 { 0.5 } else { 1.0 });
        for (x, step) in x.iter_mut().zip(step) {
            *x = (*x + step * scale).clamp(-FARTHEST, FARTHEST);
        }
        for (window, start) in windows.iter_mut().zip(starts) {
            window.start.x += start[0];
            window.start.y += start[1];
            window.start.theta += start[2];
        }
        open = drive
            .open_voltage(&at(prior, &x))
            .ok_or(Unidentified::TooLittle)?;
        // What fixes cannot have got wrong is the way itself: it counts for less, the longer it is.
        let settled = longest * scale < SETTLED || rounds % 5 == 0;
        if settled && system.residual() > NOISY && noise < MOST_NOISE {
            noise += MOST_NOISE / 12.0;
        } else if longest * scale < SETTLED {
            break;
        }
    }
    let parameters = at(prior, &x);
    if !parameters.is_sound() || CERTAIN.iter().any(|k| x[*k].abs() >= FARTHEST) {
        return Err(Unidentified::Implausible);
    }
    let residual = system.residual();
    let factor = cholesky(&system.hessian).ok_or(Unidentified::NoSolution)?;
    // What fits worse than the noise of fixes says less than they could.
    let inflation = (residual * residual).max(1.0);
    let covariance = inverse(&factor).map(|row| row.map(|value| value * inflation));
    Ok(Identified {
        parameters,
        covariance,
        rounds,
        fixes: system.rows / 3,
        outliers: system.beyond as f64 / system.rows.max(1) as f64,
        residual,
        jumps,
        wander: noise,
    })
}

/// Normal equations, with the poses at the beginning of windows eliminated.
#[derive(Default)]
struct System {
    hessian: Square<COUNT>,
    gradient: [f64; COUNT],
    /// For each window the factor of its own block, its right side, and what ties it to the parameters.
    blocks: Vec<(Square<3>, [f64; 3], [[f64; COUNT]; 3])>,
    square: f64,
    rows: usize,
    beyond: usize,
}

impl System {
    fn of(
        drive: &Drive<'_>,
        prior: &Parameters,
        x: &[f64; COUNT],
        open: &OpenVoltage,
        windows: &[Window<'_>],
        noise: f64,
    ) -> Option<Self> {
        let track = drive.track(&at(prior, x), open);
        let moved: Vec<Track> = (0..COUNT)
            .map(|k| {
                let mut other = *x;
                other[k] += DIFFERENCE;
                drive.track(&at(prior, &other), open)
            })
            .collect();
        let mut system = Self::default();
        for (k, row) in system.hessian.iter_mut().enumerate() {
            // The prior: one deviation.
            row[k] = 1.0;
            system.gradient[k] = -x[k];
        }
        for window in windows {
            system.add(window, &track, &moved, noise)?;
        }
        Some(system)
    }

    /// Root mean square of what is left, in deviations; what lies beyond the bound counts as being on it.
    fn residual(&self) -> f64 {
        (self.square / self.rows.max(1) as f64).sqrt()
    }

    fn add(
        &mut self,
        window: &Window<'_>,
        track: &Track,
        moved: &[Track],
        noise: f64,
    ) -> Option<()> {
        let mut own = [[0.0; 3]; 3];
        let mut right = [0.0; 3];
        let mut ties = [[0.0; COUNT]; 3];
        let begun_s = window.fixes[0].at_s;
        let base = track.at(begun_s);
        let bases: Vec<Pose> = moved.iter().map(|track| track.at(begun_s)).collect();
        for fix in window.fixes {
            let motion = base.sees(track.at(fix.at_s));
            let pose = window.start.then(motion);
            let left = residual(fix, pose);
            let sigma = if fix.sigma_m > 0.0 {
                fix.sigma_m
            } else {
                SIGMA_M
            };
            let way = track.way(fix.at_s) - track.way(begun_s);
            let turned = motion.theta.abs();
            // A heading wanders with the root of the way, and the place with what that does to it.
            let wander = noise * (way + 0.07 * turned).sqrt();
            let place = sigma.hypot(wander * way * 0.58);
            let weights = [1.0 / place, 1.0 / place, 1.0 / SIGMA_RAD.hypot(wander)];
            // Rows of the Jacobian: by the parameters, and by the pose at the beginning.
            let by_parameter: Vec<[f64; 3]> = moved
                .iter()
                .zip(&bases)
                .map(|(track, base)| {
                    let other = window.start.then(base.sees(track.at(fix.at_s)));
                    [
                        (other.x - pose.x) / DIFFERENCE,
                        (other.y - pose.y) / DIFFERENCE,
                        (other.theta - pose.theta) / DIFFERENCE,
                    ]
                })
                .collect();
            let (dx, dy) = (pose.x - window.start.x, pose.y - window.start.y);
            let by_start = [[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]];
            for axis in 0..3 {
                let size = (left[axis] * weights[axis]).abs();
                let loss = if size > HUBER { HUBER / size } else { 1.0 };
                let weight = weights[axis] * weights[axis] * loss;
                self.square += size.min(HUBER) * size.min(HUBER);
                self.rows += 1;
                self.beyond += usize::from(size > 2.0 * HUBER);
                for (i, first) in by_parameter.iter().enumerate() {
                    self.gradient[i] += weight * first[axis] * left[axis];
                    for (j, second) in by_parameter.iter().enumerate() {
                        self.hessian[i][j] += weight * first[axis] * second[axis];
                    }
                    for (tie, start) in ties.iter_mut().zip(by_start[axis]) {
                        tie[i] += weight * first[axis] * start;
                    }
                }
                for a in 0..3 {
                    right[a] += weight * by_start[axis][a] * left[axis];
                    for b in 0..3 {
                        own[a][b] += weight * by_start[axis][a] * by_start[axis][b];
                    }
                }
            }
        }
        // The window's own unknowns go out of the equations.
        let factor = cholesky(&own)?;
        let solved = solve(&factor, &right);
        let columns: Vec<[f64; 3]> = (0..COUNT)
            .map(|k| solve(&factor, &[ties[0][k], ties[1][k], ties[2][k]]))
            .collect();
        for (a, tie) in ties.iter().enumerate() {
            for (i, own) in tie.iter().enumerate() {
                self.gradient[i] -= own * solved[a];
                for (entry, column) in self.hessian[i].iter_mut().zip(&columns) {
                    *entry -= own * column[a];
                }
            }
        }
        self.blocks.push((factor, right, ties));
        Some(())
    }

    /// What to change of the parameters, and of the beginnings of windows.
    fn step(&self) -> Option<([f64; COUNT], Vec<[f64; 3]>)> {
        let factor = cholesky(&self.hessian)?;
        let step = solve(&factor, &self.gradient);
        let starts = self
            .blocks
            .iter()
            .map(|(factor, right, ties)| {
                let mut right = *right;
                for a in 0..3 {
                    for k in 0..COUNT {
                        right[a] -= ties[a][k] * step[k];
                    }
                }
                solve(factor, &right)
            })
            .collect();
        Some((step, starts))
    }
}
