//! What a robot and its tracker said, taken in only where it can be meant.
//!
//! Nothing here trusts a stamp, an order or a number: what is refused is counted by its reason, and
//! whoever makes something of the evidence looks at the counts.

use serde::{Deserialize, Serialize};

/// What is allowed to be that late and is put in its place, seconds.
const REORDERED_S: f64 = 3.0;
/// Stamps that part so far from the time they arrive at belong to a clock that jumped, seconds.
const JUMP_S: f64 = 0.5;
/// Delays of so many seconds before and after a stamp say how late its clock is, seconds.
const ALIGNED_S: f64 = 3.0;
/// Latest stamp, seconds: some thousand years.
pub(crate) const LATEST_S: f64 = 1e11;
/// Longest drive, seconds.
const LONGEST_S: f64 = 24.0 * 3_600.0;
/// Farthest place, metres along each axis.
const FARTHEST_M: f64 = 1_000.0;
/// Most rows of a kind.
const MOST_ROWS: usize = 2_000_000;

/// Duties of both wheels at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Duty {
    /// The robot's stamp, seconds.
    pub at_s: f64,
    /// When it came, on a clock that does not jump, seconds; `None` where nobody looked.
    pub arrived_s: Option<f64>,
    /// Left and right, −1 to 1.
    pub duty: [f64; 2],
}

/// Voltage of the pack at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Supply {
    /// The robot's stamp, seconds.
    pub at_s: f64,
    /// When it came, on a clock that does not jump, seconds; `None` where nobody looked.
    pub arrived_s: Option<f64>,
    /// Volts.
    pub volts: f64,
}

/// Where a tracker saw the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    /// The tracker's stamp, seconds.
    pub at_s: f64,
    /// When it came, on a clock that does not jump, seconds; `None` where nobody looked.
    pub arrived_s: Option<f64>,
    /// Metres.
    pub x: f64,
    /// Metres.
    pub y: f64,
    /// Radians.
    pub theta: f64,
    /// One standard deviation of the position along each axis, metres; 0 is not known.
    pub sigma_m: f64,
}

/// Anything of these.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Row {
    /// What the motors were told.
    Duty(Duty),
    /// What the gauge shows.
    Supply(Supply),
    /// Where the tracker saw the robot.
    Fix(Fix),
}

impl Row {
    /// When it came, seconds; `None` where nobody looked.
    #[must_use]
    pub const fn arrived_s(&self) -> Option<f64> {
        match self {
            Self::Duty(row) => row.arrived_s,
            Self::Supply(row) => row.arrived_s,
            Self::Fix(row) => row.arrived_s,
        }
    }
}

/// Why something was not taken in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Refusal {
    /// It is no number.
    NotANumber,
    /// No robot does this, or is there.
    OutOfRange,
    /// A row of this stamp was taken already.
    Doubled,
    /// It comes after rows that are much newer.
    Late,
    /// Its clock jumped.
    ClockJumped,
    /// There is no room for more.
    Full,
}

/// How often what was found; a certificate has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Counts {
    /// Rows with something that is no number, or that no robot does.
    pub absurd: u64,
    /// Rows of a stamp that was there already.
    pub doubled: u64,
    /// Rows that came late and were put in their place.
    pub reordered: u64,
    /// Rows that came far too late.
    pub late: u64,
    /// Rows whose clock had jumped.
    pub clock_jumps: u64,
    /// Rows beyond what there is room for.
    pub beyond: u64,
}

impl Counts {
    fn count(&mut self, refusal: Refusal) {
        let counter = match refusal {
            Refusal::NotANumber | Refusal::OutOfRange => &mut self.absurd,
            Refusal::Doubled => &mut self.doubled,
            Refusal::Late => &mut self.late,
            Refusal::ClockJumped => &mut self.clock_jumps,
            Refusal::Full => &mut self.beyond,
        };
        *counter += 1;
    }
}

/// All that is known of a drive.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Evidence {
    duties: Vec<Duty>,
    supply: Vec<Supply>,
    fixes: Vec<Fix>,
    counts: Counts,
    robot_clock: Clock,
    tracker_clock: Clock,
}

impl Evidence {
    /// Takes in a row of any kind.
    ///
    /// # Errors
    /// [`Refusal`]; it is counted.
    pub fn take(&mut self, row: Row) -> Result<(), Refusal> {
        match row {
            Row::Duty(row) => self.duty(row),
            Row::Supply(row) => self.supply(row),
            Row::Fix(row) => self.fix(row),
        }
    }

    /// Takes in a duty.
    ///
    /// # Errors
    /// [`Refusal`]; it is counted.
    pub fn duty(&mut self, row: Duty) -> Result<(), Refusal> {
        let sound = row.duty.iter().all(|duty| duty.abs() <= 1.0);
        let taken = check(
            &[row.at_s, row.duty[0], row.duty[1]],
            sound && row.at_s.abs() <= LATEST_S,
        )
        .and_then(|()| self.robot_clock.check(row.at_s, row.arrived_s))
        .and_then(|()| put(&mut self.duties, row, |row| row.at_s));
        self.counted(taken)
    }

    /// Takes in a voltage.
    ///
    /// # Errors
    /// [`Refusal`]; it is counted.
    pub fn supply(&mut self, row: Supply) -> Result<(), Refusal> {
        let sound = (1.0..=60.0).contains(&row.volts);
        let taken = check(&[row.at_s, row.volts], sound && row.at_s.abs() <= LATEST_S)
            .and_then(|()| self.robot_clock.check(row.at_s, row.arrived_s))
            .and_then(|()| put(&mut self.supply, row, |row| row.at_s));
        self.counted(taken)
    }

    /// Takes in a fix.
    ///
    /// # Errors
    /// [`Refusal`]; it is counted.
    pub fn fix(&mut self, row: Fix) -> Result<(), Refusal> {
        let sound = row.x.abs() <= FARTHEST_M
            && row.y.abs() <= FARTHEST_M
            && row.theta.abs() <= 1e4
            && (0.0..=1.0).contains(&row.sigma_m);
        let taken = check(
            &[row.at_s, row.x, row.y, row.theta, row.sigma_m],
            sound && row.at_s.abs() <= LATEST_S,
        )
        .and_then(|()| self.tracker_clock.check(row.at_s, row.arrived_s))
        .and_then(|()| put(&mut self.fixes, row, |row| row.at_s));
        self.counted(taken)
    }

    /// Duties, by their stamps.
    #[must_use]
    pub fn duties(&self) -> &[Duty] {
        &self.duties
    }

    /// Voltages, by their stamps.
    #[must_use]
    pub fn volts(&self) -> &[Supply] {
        &self.supply
    }

    /// Fixes, by their stamps.
    #[must_use]
    pub fn fixes(&self) -> &[Fix] {
        &self.fixes
    }

    /// What was found while it was taken in.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        self.counts
    }

    /// How far the robot's clock is behind the tracker's by the quickest messages of both, seconds, where
    /// arrivals are known.
    #[must_use]
    pub fn behind_s(&self) -> Option<f64> {
        Some(self.robot_clock.least? - self.tracker_clock.least?)
    }

    /// Least time from a stamp of the tracker to its arrival, seconds, where both clocks' arrivals are known.
    pub(crate) fn tracker_delay_s(&self) -> Option<f64> {
        self.robot_clock.least.and(self.tracker_clock.least)
    }

    /// Stamps of the tracker between which everything is known.
    #[must_use]
    pub fn span(&self) -> Option<(f64, f64)> {
        Some((self.fixes.first()?.at_s, self.fixes.last()?.at_s))
    }

    /// The part in which fixes are from one second to another. All that the robot said of itself stays.
    #[must_use]
    pub fn part(&self, from_s: f64, to_s: f64) -> Self {
        let within = |at_s: f64| from_s <= at_s && at_s <= to_s;
        Self {
            fixes: self
                .fixes
                .iter()
                .filter(|row| within(row.at_s))
                .copied()
                .collect(),
            ..self.clone()
        }
    }

    /// A name for exactly this evidence: the first half of the SHA-256 of its numbers, hexadecimal.
    #[must_use]
    pub fn hash(&self) -> String {
        use sha2::{Digest as _, Sha256};
        let mut hash = Sha256::new();
        let mut take = |kind: u8, numbers: &[f64]| {
            hash.update([kind]);
            for number in numbers {
                hash.update(number.to_le_bytes());
            }
        };
        for row in &self.duties {
            take(0, &[row.at_s, row.duty[0], row.duty[1]]);
        }
        for row in &self.supply {
            take(1, &[row.at_s, row.volts]);
        }
        for row in &self.fixes {
            take(2, &[row.at_s, row.x, row.y, row.theta, row.sigma_m]);
        }
        hash.finalize()[..16]
            .iter()
            .fold(String::new(), |mut text, byte| {
                use std::fmt::Write as _;
                // Writing to a String does not fail.
                let _ = write!(text, "{byte:02x}");
                text
            })
    }

    fn counted(&mut self, taken: Result<bool, Refusal>) -> Result<(), Refusal> {
        match taken {
            Ok(reordered) => self.counts.reordered += u64::from(reordered),
            Err(refusal) => {
                self.counts.count(refusal);
                return Err(refusal);
            }
        }
        Ok(())
    }
}

fn check(numbers: &[f64], sound: bool) -> Result<(), Refusal> {
    if !numbers.iter().all(|number| number.is_finite()) {
        Err(Refusal::NotANumber)
    } else if !sound {
        Err(Refusal::OutOfRange)
    } else {
        Ok(())
    }
}

/// Puts a row in its place; returns whether it came late.
fn put<T>(rows: &mut Vec<T>, row: T, at_s: impl Fn(&T) -> f64) -> Result<bool, Refusal> {
    let at = at_s(&row);
    if rows.len() >= MOST_ROWS {
        return Err(Refusal::Full);
    }
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else {
        rows.push(row);
        return Ok(false);
    };
    if at - at_s(first) > LONGEST_S {
        return Err(Refusal::ClockJumped);
    }
    if at > at_s(last) {
        rows.push(row);
        return Ok(false);
    }
    if at < at_s(last) - REORDERED_S {
        return Err(Refusal::Late);
    }
    let place = rows.partition_point(|row| at_s(row) < at);
    if rows.get(place).is_some_and(|there| at_s(there) == at) {
        return Err(Refusal::Doubled);
    }
    rows.insert(place, row);
    Ok(true)
}

/// Times of stamps on the clock that they arrived by, quickest way: a stamp and the least delay of those
/// around it. So a robot's clock may be late, and be set to rights by and by, and a network may hold
/// things up. Stamps without an arrival stay as they are.
#[derive(Debug, Clone, Default)]
pub(crate) struct Alignment {
    /// Stamp and delay.
    delays: Vec<(f64, f64)>,
}

impl Alignment {
    pub(crate) fn of(rows: impl Iterator<Item = (f64, Option<f64>)>) -> Self {
        let delays = rows.filter_map(|(at, arrived)| Some((at, arrived? - at)));
        Self {
            delays: delays.collect(),
        }
    }

    /// The aligned time of a stamp.
    pub(crate) fn of_stamp(&self, at_s: f64) -> f64 {
        let begin = self
            .delays
            .partition_point(|delay| delay.0 < at_s - ALIGNED_S);
        let end = self
            .delays
            .partition_point(|delay| delay.0 <= at_s + ALIGNED_S);
        let around = self.delays[begin..end].iter();
        let least = around
            .map(|(_, delay)| *delay)
            .fold(f64::INFINITY, f64::min);
        if least.is_finite() {
            at_s + least
        } else {
            at_s
        }
    }
}

/// How stamps of one clock stand to arrivals.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Clock {
    /// Least delay so far, which is that of the quickest message and what the clock is behind.
    least: Option<f64>,
    /// Mean delay, over some thirty messages.
    mean: f64,
}

impl Clock {
    /// Takes in a stamp.
    ///
    /// # Errors
    /// [`Refusal::ClockJumped`] for a stamp that is ahead of the quickest message so far, or behind the
    /// others, by more than half a second.
    pub fn check(&mut self, at_s: f64, arrived_s: Option<f64>) -> Result<(), Refusal> {
        let Some(arrived_s) = arrived_s else {
            return Ok(());
        };
        if !arrived_s.is_finite() {
            return Err(Refusal::NotANumber);
        }
        let delay = arrived_s - at_s;
        let Some(least) = self.least else {
            (self.least, self.mean) = (Some(delay), delay);
            return Ok(());
        };
        // What is late by seconds was held up by a network; stamps do not come from the future.
        if delay < least - JUMP_S || delay > self.mean.max(least) + REORDERED_S {
            return Err(Refusal::ClockJumped);
        }
        self.least = Some(least.min(delay));
        self.mean += (delay - self.mean) / 32.0;
        Ok(())
    }

    /// Least delay so far, seconds.
    #[must_use]
    pub const fn least_s(&self) -> Option<f64> {
        self.least
    }

    /// Mean delay, seconds.
    #[must_use]
    pub const fn mean_s(&self) -> f64 {
        self.mean
    }
}
