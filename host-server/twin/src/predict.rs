//! Predictions held against what happened: where a robot is so many seconds on.

use serde::{Deserialize, Serialize};

use crate::body::{Parameters, Pose};
use crate::drive::{Drive, residual};
use crate::evidence::Fix;
use crate::identify::{SIGMA_M, SIGMA_RAD, jumps_between};
use crate::linear::{cholesky, solve};

/// Fixes of so many seconds say where a prediction begins.
const LOOK_BACK_S: f64 = 3.0;
/// Fewest of them.
const FEWEST_FIXES: usize = 4;

/// Errors of predictions over one horizon.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Score {
    /// How far ahead, seconds.
    pub horizon_s: f64,
    /// Predictions.
    pub count: usize,
    /// Metres driven meanwhile, on average.
    pub way_m: f64,
    /// Median of the errors, metres.
    pub median_m: f64,
    /// So many are below in nine of ten cases, metres.
    pub p90_m: f64,
}

/// The value below which a share of `values` lies; 0 without any.
#[must_use]
pub fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (values.len() as f64 - 1.0).max(0.0) * share;
    let (below, above) = (place.floor() as usize, place.ceil() as usize);
    match (values.get(below), values.get(above)) {
        (Some(a), Some(b)) => a + (b - a) * (place - below as f64),
        _ => 0.0,
    }
}

/// Errors of predictions `horizon_s` ahead, one begun at every second of the drive: moment, metres, and
/// metres driven. The duties are those that the robot then had; a prediction is of the body, not of what
/// its program would do.
#[must_use]
pub fn errors(drive: &Drive<'_>, parameters: &Parameters, horizon_s: f64) -> Vec<(f64, f64, f64)> {
    let Some(open) = drive.open_voltage(parameters) else {
        return Vec::new();
    };
    let track = drive.track(parameters, &open);
    let fixes = drive.evidence.fixes();
    let (mut errors, mut at_s) = (Vec::new(), drive.span.0 + LOOK_BACK_S);
    while at_s + horizon_s <= drive.span.1 {
        let begin = fixes.partition_point(|fix| fix.at_s < at_s - LOOK_BACK_S);
        let end = fixes.partition_point(|fix| fix.at_s <= at_s);
        // The first fix then. Where none comes for long nothing can be said.
        let then = fixes.partition_point(|fix| fix.at_s < at_s + horizon_s);
        let before = &fixes[begin..end];
        if let (Some(last), Some(seen)) = (before.last(), fixes.get(then))
            && before.len() >= FEWEST_FIXES
            && seen.at_s - (at_s + horizon_s) < 1.0
            && drive.covers(before[0].at_s, seen.at_s)
            && !fixes[begin..=then]
                .windows(2)
                .any(|pair| jumps_between(&pair[0], &pair[1]))
            && let Some(start) = place(before, |at_s| track.at(at_s))
        {
            let motion = track.at(last.at_s).sees(track.at(seen.at_s));
            let left = residual(seen, start.then(motion));
            let way = track.way(seen.at_s) - track.way(last.at_s);
            errors.push((at_s, left[0].hypot(left[1]), way));
        }
        at_s += 1.0;
    }
    errors
}

/// Where the robot was at the last of some fixes, given how it moved between them.
pub(crate) fn place(fixes: &[Fix], track: impl Fn(f64) -> Pose) -> Option<Pose> {
    let last = fixes.last()?;
    let base = track(last.at_s);
    let mut pose = Pose {
        x: last.x,
        y: last.y,
        theta: last.theta,
    };
    for _ in 0..3 {
        let (mut own, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
        for fix in fixes {
            let there = pose.then(base.sees(track(fix.at_s)));
            let left = residual(fix, there);
            let sigma = if fix.sigma_m > 0.0 {
                fix.sigma_m
            } else {
                SIGMA_M
            };
            let weights = [sigma.powi(-2), sigma.powi(-2), SIGMA_RAD.powi(-2)];
            let (dx, dy) = (there.x - pose.x, there.y - pose.y);
            let rows = [[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]];
            for axis in 0..3 {
                for a in 0..3 {
                    right[a] += weights[axis] * rows[axis][a] * left[axis];
                    for b in 0..3 {
                        own[a][b] += weights[axis] * rows[axis][a] * rows[axis][b];
                    }
                }
            }
        }
        let step = solve(&cholesky(&own)?, &right);
        pose = Pose {
            x: pose.x + step[0],
            y: pose.y + step[1],
            theta: pose.theta + step[2],
        };
    }
    Some(pose)
}

/// The score of some errors.
#[must_use]
pub fn score(errors: &[(f64, f64, f64)], horizon_s: f64) -> Score {
    let mut distances: Vec<f64> = errors.iter().map(|(_, error, _)| *error).collect();
    let ways: f64 = errors.iter().map(|(_, _, way)| way).sum();
    Score {
        horizon_s,
        count: errors.len(),
        way_m: ways / errors.len().max(1) as f64,
        median_m: quantile(&mut distances, 0.5),
        p90_m: quantile(&mut distances, 0.9),
    }
}
