//! The filter of a shadow: where its robot is, how fast its wheels turn, and what they make of their duty.

use super::Estimate;
use crate::body::{Parameters, Pose, STEP_S, Wheels, arc, wrap};
use crate::detect::Sight;
use crate::evidence::Fix;
use crate::identify::SIGMA_RAD;
use crate::linear::{Square, cholesky, inverse};

/// Covariance goes on in stretches of so many steps.
pub(super) const STRETCH: u32 = 10;
/// What a place wanders, metres for the root of a metre.
const STRAY_M: f64 = 0.004;
/// What a gain wanders, for the root of a second.
const GAIN_WALK: f64 = 4e-4;
/// What a place, along each axis, and a heading are off by between two fixes of a robot that something holds up, metres and
/// radians.
const HELD_UP: [f64; 3] = [0.02, 0.02, 0.05];
/// What a gain of a robot that nobody has calibrated is off by at most, as a logarithm.
const WIDEST: f64 = 0.4;

/// What is believed of the gains of both wheels at the beginning: their logarithms, and one deviation of each.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gains {
    mean: [f64; 2],
    sigma: [f64; 2],
}

impl Gains {
    /// Of a robot that was calibrated.
    pub(super) const CALIBRATED: Self = Self {
        mean: [0.0; 2],
        sigma: [0.02; 2],
    };
    /// Of one that was not.
    pub(super) const WIDE: Self = Self {
        mean: [0.0; 2],
        sigma: [0.15; 2],
    };
}

/// See the [module](self).
#[derive(Debug, Clone, Copy)]
pub(super) struct State {
    pub(super) at_s: f64,
    pub(super) pose: Pose,
    pub(super) driven: Pose,
    /// Logarithms.
    pub(super) gains: [f64; 2],
    pub(super) wheels: Wheels,
    pub(super) covariance: Square<5>,
    pub(super) steps: u32,
    /// Variance of the ways of both wheels since then, beyond what ways have anyhow.
    pub(super) jitter: [f64; 2],
    /// Where the stretch began, and the ways of both wheels since.
    pub(super) begun: Pose,
    pub(super) ways: [f64; 2],
    /// Ways since the last fix.
    pub(super) since: Sight,
}

/// What was driven since a covariance was taken on the last time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stretch {
    ways: [f64; 2],
    jitter: [f64; 2],
    seconds: f64,
    track_m: f64,
    wander: f64,
    learns: bool,
}

impl Stretch {
    /// The covariance of who was at `begun` and went on to `pose` meanwhile.
    pub(super) fn spread(&self, covariance: &Square<5>, begun: Pose, pose: Pose) -> Square<5> {
        let track_m = self.track_m;
        let (dx, dy) = (pose.x - begun.x, pose.y - begun.y);
        let heading = (pose.theta + begun.theta) * 0.5;
        let (sin, cos) = heading.sin_cos();
        let [left, right] = self.ways;
        let mut step = [[0.0; 5]; 5];
        for (i, row) in step.iter_mut().enumerate() {
            row[i] = 1.0;
        }
        (step[0][2], step[1][2]) = (-dy, dx);
        for (k, way, side) in [(3, left, -1.0), (4, right, 1.0)] {
            step[0][k] = cos * way * 0.5;
            step[1][k] = sin * way * 0.5;
            step[2][k] = side * way / track_m;
        }
        let p = covariance;
        let mut half = [[0.0; 5]; 5];
        for (row, factors) in half.iter_mut().zip(&step) {
            for (j, entry) in row.iter_mut().enumerate() {
                *entry = (0..5).map(|k| factors[k] * p[k][j]).sum();
            }
        }
        let mut next = [[0.0; 5]; 5];
        for (row, factors) in next.iter_mut().zip(&half) {
            for (entry, other) in row.iter_mut().zip(&step) {
                *entry = factors.iter().zip(other).map(|(a, b)| a * b).sum();
            }
        }
        let way = (left.abs() + right.abs()) * 0.5;
        next[0][0] += STRAY_M * STRAY_M * way;
        next[1][1] += STRAY_M * STRAY_M * way;
        next[2][2] += self.wander * self.wander * way;
        for (jitter, side) in self.jitter.into_iter().zip([-1.0, 1.0]) {
            let by = [cos * 0.5, sin * 0.5, side / track_m];
            for i in 0..3 {
                for j in 0..3 {
                    next[i][j] += jitter * by[i] * by[j];
                }
            }
        }
        if self.learns {
            next[3][3] += GAIN_WALK * GAIN_WALK * self.seconds;
            next[4][4] += GAIN_WALK * GAIN_WALK * self.seconds;
        }
        next
    }
}

/// What a correction found.
pub(super) struct Told {
    /// The innovation, normalised and squared.
    pub(super) square: f64,
    /// Inverse of its covariance.
    pub(super) inverse: Square<3>,
    /// What is left of an error of the pose.
    pub(super) rest: Square<3>,
}

impl State {
    pub(super) fn at(fix: &Fix, sigma: f64, gains: Gains) -> Self {
        let pose = Pose {
            x: fix.x,
            y: fix.y,
            theta: fix.theta,
        };
        let mut covariance = [[0.0; 5]; 5];
        for (i, sigma) in [sigma, sigma, SIGMA_RAD, gains.sigma[0], gains.sigma[1]]
            .into_iter()
            .enumerate()
        {
            covariance[i][i] = sigma * sigma;
        }
        Self {
            at_s: fix.at_s,
            pose,
            driven: pose,
            gains: gains.mean,
            wheels: Wheels::default(),
            covariance,
            steps: 0,
            jitter: [0.0; 2],
            begun: pose,
            ways: [0.0; 2],
            since: Sight::default(),
        }
    }

    /// What is known of the gains, to begin with another time.
    pub(super) fn learned(&self) -> Gains {
        let sigma = [3, 4].map(|i: usize| self.covariance[i][i].max(0.0).sqrt());
        Gains {
            mean: self.gains,
            sigma: [0, 1].map(|k: usize| sigma[k].max(Gains::CALIBRATED.sigma[k])),
        }
    }

    /// Keeps the gains where those of a robot can be.
    pub(super) fn bound_gains(&mut self) {
        self.gains = self.gains.map(|gain| gain.clamp(-WIDEST, WIDEST));
    }

    pub(super) fn speeds(&self) -> [f64; 2] {
        [0, 1].map(|k| self.wheels.rims[k] * (1.0 + self.gains[k]))
    }

    pub(super) fn step(&mut self, parameters: &Parameters, duty: [f64; 2], open_v: f64) -> f64 {
        let before = self.wheels;
        let current = self.wheels.step(parameters, duty, open_v);
        let ways = [0, 1]
            .map(|k| (before.rims[k] + self.wheels.rims[k]) * 0.5 * STEP_S * (1.0 + self.gains[k]));
        let motion = arc(ways[0], ways[1], parameters.track_m);
        self.pose = self.pose.then(motion);
        self.driven = self.driven.then(motion);
        for (k, way) in ways.into_iter().enumerate() {
            self.ways[k] += way;
            self.since.ways[k] += way;
        }
        self.since.seconds += STEP_S;
        self.at_s += STEP_S;
        self.steps += 1;
        current
    }

    /// Where it is a moment later at the same speed.
    pub(super) fn ahead(&self, parameters: &Parameters, seconds: f64) -> Pose {
        let [left, right] = self.speeds();
        let arc = arc(left * seconds, right * seconds, parameters.track_m);
        self.pose.then(arc)
    }

    /// Takes the covariance on over what was driven since the last time, which it returns.
    pub(super) fn stretch(
        &mut self,
        parameters: &Parameters,
        wander: f64,
        learns: bool,
    ) -> Option<Stretch> {
        if self.steps == 0 {
            return None;
        }
        let stretch = Stretch {
            ways: self.ways,
            jitter: self.jitter,
            seconds: f64::from(self.steps) * STEP_S,
            track_m: parameters.track_m,
            wander,
            learns,
        };
        self.covariance = stretch.spread(&self.covariance, self.begun, self.pose);
        self.jitter = [0.0; 2];
        self.steps = 0;
        self.begun = self.pose;
        self.ways = [0.0; 2];
        Some(stretch)
    }

    /// Inflates the covariance, so that the next fix is believed rather than the wheels: something may have held it up.
    pub(super) fn inflate(&mut self) {
        for (i, sigma) in HELD_UP.into_iter().enumerate() {
            self.covariance[i][i] += sigma * sigma;
        }
    }

    /// Takes in a fix; `None` when the covariance is none.
    pub(super) fn correct(
        &mut self,
        innovation: [f64; 3],
        place: f64,
        heading: f64,
        learns: bool,
    ) -> Option<Told> {
        let p = self.covariance;
        let mut s = [[0.0; 3]; 3];
        for (i, row) in s.iter_mut().enumerate() {
            row.copy_from_slice(&p[i][..3]);
        }
        s[0][0] += place * place;
        s[1][1] += place * place;
        s[2][2] += heading * heading;
        let inverse = inverse(&cholesky(&s)?);
        let weighed =
            inverse.map(|row| row.iter().zip(innovation).map(|(a, b)| a * b).sum::<f64>());
        let square: f64 = weighed.iter().zip(innovation).map(|(a, b)| a * b).sum();
        let change: [f64; 5] = std::array::from_fn(|i| (0..3).map(|k| p[i][k] * weighed[k]).sum());
        // Gains do not learn a fault: it is to be seen as long as it is there.
        let most = if learns { 5 } else { 3 };
        let mut next = p;
        for i in 0..most {
            for j in 0..most {
                let taken: f64 = (0..3)
                    .map(|a| {
                        (0..3)
                            .map(|b| p[i][a] * inverse[a][b] * p[b][j])
                            .sum::<f64>()
                    })
                    .sum();
                next[i][j] -= taken;
            }
        }
        if !learns {
            // What ties the gains to all else is forgotten.
            for (i, row) in next.iter_mut().enumerate() {
                for (j, entry) in row.iter_mut().enumerate() {
                    if i != j && i.max(j) > 2 {
                        *entry = 0.0;
                    }
                }
            }
        }
        self.covariance = next;
        self.pose.x += change[0];
        self.pose.y += change[1];
        self.pose.theta += change[2];
        if learns {
            self.gains[0] += change[3];
            self.gains[1] += change[4];
        }
        self.begun = self.pose;
        let sound = square.is_finite() && change.iter().all(|change| change.is_finite());
        let rest = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let taken: f64 = (0..3).map(|k| p[i][k] * inverse[k][j]).sum();
                f64::from(u8::from(i == j)) - taken
            })
        });
        sound.then_some(Told {
            square,
            inverse,
            rest,
        })
    }

    pub(super) fn estimate(&self) -> Estimate {
        let p = &self.covariance;
        let (mean, half) = ((p[0][0] + p[1][1]) * 0.5, (p[0][0] - p[1][1]) * 0.5);
        let largest = mean + half.hypot(p[0][1]);
        Estimate {
            pose: Pose {
                theta: wrap(self.pose.theta),
                ..self.pose
            },
            sigma_m: largest.max(0.0).sqrt(),
            sigma_rad: p[2][2].max(0.0).sqrt(),
        }
    }
}
