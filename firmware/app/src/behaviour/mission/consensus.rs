//! `consensus`: agree on a number, with failures and liars among the neighbours.
//!
//! W-MSR, the weighted mean-subsequence-reduced rule: a robot takes the values of its neighbours, drops the
//! `f` largest of those above its own and the `f` smallest of those below it (all of them where there are
//! fewer), and moves to the mean of what is left and its own.
//!
//! With at most `f` liars among the neighbours of each honest robot, whatever they say and to whom, no honest
//! robot ever leaves the range of values that honest robots began with: a value outside of it comes from a liar,
//! is therefore among the `f` most extreme, and is dropped. When who hears whom is (2f+1)-robust as well, all honest
//! robots come to one value (`LeBlanc`, Zhang, Koutsoukos and Sundaram, "Resilient asymptotic consensus in
//! robust networks", IEEE JSAC 31(4), 2013), also where what is heard is some rounds old (Dibaji and Ishii,
//! "Resilient consensus of second-order agent networks: asynchronous update rules with delays", Automatica
//! 81, 2017). Whole numbers of a thousandth stop the approach a few thousandths earlier.

use crawler_hal::{Duration, Instant};
use crawler_protocol::{BehaviourName, Measure, Says};
use heapless::Vec;

use super::{MissionNews, Scene, Wish};
use crate::neighbours::{MOST, Neighbour};

/// Time between two rounds: neighbours are told about as often.
const ROUND: Duration = Duration::from_millis(500);
/// Those are agreed that are no farther apart, in thousandths.
const AGREED: u32 = 20;
/// So many rounds in a row all that counts has agreed, until a robot says that it is settled.
const SETTLED: u8 = 6;
/// What says a value in thousandths.
const SCALE: f32 = 1_000.0;

/// A robot that looks for a value with others.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Consensus {
    measure: Measure,
    f: u8,
    /// In thousandths; `None` until it is measured.
    value: Option<i32>,
    round: u16,
    /// Rounds in a row in which it was agreed with all that counts.
    calm: u8,
    looked: Option<Instant>,
}

impl Consensus {
    pub(super) const fn new(measure: Measure, f: u8) -> Self {
        Self {
            measure,
            f,
            value: None,
            round: 0,
            calm: 0,
            looked: None,
        }
    }

    /// `None` while it has no value of its own.
    pub(super) fn says(&self) -> Option<Says> {
        let settled = i32::from(self.calm >= SETTLED);
        let rest = [self.value?, i32::from(self.round), settled];
        Some(Says::new(BehaviourName::Consensus, &rest))
    }

    pub(super) fn step(&mut self, scene: &Scene<'_>) -> (Wish, Option<MissionNews>) {
        if self.looked.is_none_or(|at| scene.now - at >= ROUND) {
            self.looked = Some(scene.now);
            match self.value {
                None => self.value = self.measured(scene),
                Some(own) => self.value = Some(self.next(own, scene.near)),
            }
        }
        (Wish::Rest, None)
    }

    /// What it begins with.
    fn measured(&self, scene: &Scene<'_>) -> Option<i32> {
        let value = match self.measure {
            Measure::Value(value) => value,
            Measure::Temperature => f32::from(scene.reading.temperature?.0),
            Measure::Range => f32::from(scene.reading.range_mm(scene.now)?) / 1_000.0,
        };
        // Saturating cast, and bounded by the command or by what a sensor tells.
        Some((value * SCALE) as i32)
    }

    /// One round.
    fn next(&mut self, own: i32, near: &[Neighbour]) -> i32 {
        self.round = self.round.saturating_add(1);
        let said = near.iter().filter_map(|other| {
            let said = other.says.as_ref()?.by(BehaviourName::Consensus)?;
            said.first().copied()
        });
        let mut values: Vec<i32, MOST> = said.take(MOST).collect();
        // Whoever hears too few to tell liars from others agrees with nobody.
        let enough = values.len() > 2 * usize::from(self.f);
        let kept = keep(&mut values, own, self.f);
        let agreed = kept.iter().all(|value| value.abs_diff(own) <= AGREED);
        self.calm = if agreed && enough {
            self.calm.saturating_add(1)
        } else {
            0
        };
        mean(kept, own)
    }
}

/// What is left of `values`, in order, without the `f` largest above `own` and the `f` smallest below it.
pub(super) fn keep(values: &mut [i32], own: i32, f: u8) -> &[i32] {
    sort(values);
    let f = usize::from(f);
    let below = values.partition_point(|value| *value < own);
    let above = values.len() - values.partition_point(|value| *value <= own);
    let end = values.len() - above.min(f);
    values.get(below.min(f)..end).unwrap_or_default()
}

/// Sorts sixteen values at most, by insertion: what the standard library has for any number takes 2.3 KB of flash.
fn sort(values: &mut [i32]) {
    for end in 1..=values.len() {
        let mut sorted = values.iter_mut().take(end).rev();
        let Some(mut new) = sorted.next() else { return };
        for before in sorted {
            if *before <= *new {
                break;
            }
            core::mem::swap(before, new);
            new = before;
        }
    }
}

/// The mean of `kept` and `own`, to the nearest whole number: it lies between the least and the largest.
pub(super) fn mean(kept: &[i32], own: i32) -> i32 {
    let count = kept.len() as i64 + 1;
    let off: i64 = kept
        .iter()
        .map(|value| i64::from(*value) - i64::from(own))
        .sum();
    let half = if off < 0 { -count / 2 } else { count / 2 };
    // No farther than the farthest of `kept`.
    (i64::from(own) + (off + half) / count) as i32
}

#[cfg(test)]
mod tests;
