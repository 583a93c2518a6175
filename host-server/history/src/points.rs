//! Puts samples together into the points of an answer.

use super::fold::{self, Bucket, Fold};
use super::seal::STEPS;
use super::{Point, Sample};
use crawler_database::RecordsError;

/// Most stretches in one answer.
pub const MAX_POINTS: i64 = 10_000;

/// The coarsest level that is fine enough for `step`.
pub(super) fn level(step: i64) -> usize {
    STEPS.iter().rposition(|&of| of <= step).unwrap_or(0)
}

/// A stretch of time, cut into places of one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stretch {
    /// Where the first place begins.
    pub(super) begin: i64,
    pub(super) step: i64,
    pub(super) from: i64,
    pub(super) to: i64,
    pub(super) places: usize,
}

impl Stretch {
    /// What is asked for from `from` until before `to`, answered from `level`.
    pub(super) fn at_level(
        from: i64,
        to: i64,
        step: i64,
        level: usize,
    ) -> Result<Self, RecordsError> {
        if step < 1 || from < 0 || to <= from {
            return Err(RecordsError::Invalid(
                "a question about history has a step, and a beginning before its end",
            ));
        }
        // The stretch of the level that `from` is in counts as a whole: nobody knows more of it.
        let from = fold::floor(from, STEPS[level]);
        let begin = fold::floor(from, step);
        let places = (to - 1 - begin) / step + 1;
        if places > MAX_POINTS {
            return Err(RecordsError::Invalid(
                "an answer about history has at most 10000 points: ask for a longer step",
            ));
        }
        Ok(Self {
            begin,
            step,
            from,
            to,
            places: places as usize,
        })
    }

    /// The place of a time, if it is asked for.
    pub(super) fn place(&self, at: i64) -> Option<usize> {
        let asked = (self.from..self.to).contains(&at);
        asked.then(|| ((at - self.begin) / self.step) as usize)
    }

    /// When a place begins.
    pub(super) const fn at(&self, place: usize) -> i64 {
        self.begin + place as i64 * self.step
    }
}

/// The answer to a question about history, while it is put together: one place for each stretch.
///
/// The rules of [`History::query`](super::History::query) are here, for whoever keeps history
/// elsewhere and must answer alike.
#[derive(Debug)]
pub struct Points {
    stretch: Stretch,
    folds: Vec<Fold>,
}

impl Points {
    /// An answer without points to a question about `from` until before `to`, in stretches of `step`
    /// milliseconds.
    ///
    /// # Errors
    /// [`RecordsError::Invalid`] when the step or the time is none, or for more than [`MAX_POINTS`]
    /// stretches.
    pub fn new(from: i64, to: i64, step: i64) -> Result<Self, RecordsError> {
        let level = level(step);
        let mut points = Self::at_level(from, to, step, level)?;
        // Likewise the stretch of the level that the end is in, as far as the last point reaches.
        let whole = fold::floor(to - 1, STEPS[level]).saturating_add(STEPS[level]);
        let length = step.saturating_mul(points.folds.len() as i64);
        let reaches = points.stretch.begin.saturating_add(length);
        points.stretch.to = whole.min(reaches).max(to);
        Ok(points)
    }

    pub(super) fn at_level(
        from: i64,
        to: i64,
        step: i64,
        level: usize,
    ) -> Result<Self, RecordsError> {
        let stretch = Stretch::at_level(from, to, step, level)?;
        Ok(Self {
            stretch,
            folds: vec![Fold::default(); stretch.places],
        })
    }

    /// When the first sample may be that counts, which is at most a second or a minute before the
    /// beginning that was asked for: where the step is as long, whole seconds and minutes count.
    #[must_use]
    pub const fn from(&self) -> i64 {
        self.stretch.from
    }

    /// Before when the last sample must be that counts, likewise.
    #[must_use]
    pub const fn to(&self) -> i64 {
        self.stretch.to
    }

    /// Adds a sample of the robot in question, where it is of the time in question. Those of a robot
    /// are added in order of their time.
    pub fn add(&mut self, sample: &Sample) {
        self.add_bucket(&fold::bucket(&fold::raw(sample)));
    }

    pub(super) fn add_bucket(&mut self, bucket: &Bucket) {
        let place = self.stretch.place(bucket[0]);
        if let Some(fold) = place.and_then(|place| self.folds.get_mut(place)) {
            fold.add(bucket);
        }
    }

    /// The points, oldest first. Stretches without a sample have none.
    #[must_use]
    pub fn finish(&self) -> Vec<Point> {
        self.folds
            .iter()
            .enumerate()
            .filter_map(|(place, fold)| fold.point(self.stretch.at(place)))
            .collect()
    }
}
