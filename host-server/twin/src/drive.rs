//! From samples of duty to what the motors had at every moment, and from there to where a body went.

use crate::body::{Parameters, Pose, STEP_S, Wheels, wrap};
use crate::evidence::{Alignment, Duty, Evidence, Supply};

/// How fast the robot changes a duty, 1/s: `ramp_step` of 5 % in 20 ms.
pub const RAMP_PER_S: f64 = 2.5;

/// Longest time between two samples that says what was between them, seconds.
const LONGEST_PAUSE_S: f64 = 0.6;

/// After a pause the wheels turn as they should again, seconds.
const FORGOTTEN_S: f64 = 1.0;

/// Most that aligned stamps still are off, seconds.
const LATENCY_S: f64 = 0.5;

/// Longest time constant of the gauge's filter and what it is made up with, seconds.
const GAUGE_S: f64 = 4.0;

/// What the motors had, as straight lines between knots.
#[derive(Debug, Clone, PartialEq)]
pub struct Timeline {
    wheels: [Vec<(f64, f64)>; 2],
    pauses: Vec<(f64, f64)>,
}

impl Timeline {
    /// Reconstructs duties from samples of them. A robot goes from one duty to the next at a known rate;
    /// so a change that took less than the time between two samples was at its beginning when it had
    /// begun before, and at its end when it goes on after.
    #[must_use]
    pub fn of(duties: &[Duty], ramp_per_s: f64) -> Self {
        let wheels = [0, 1].map(|k| {
            let mut knots: Vec<(f64, f64)> = Vec::with_capacity(duties.len() * 2);
            for (i, row) in duties.iter().enumerate() {
                if let Some(before) = i.checked_sub(1).and_then(|i| duties.get(i)) {
                    let earlier = i.checked_sub(2).and_then(|i| duties.get(i));
                    let slope = |a: &Duty, b: &Duty| (b.duty[k] - a.duty[k]) / (b.at_s - a.at_s);
                    let change = row.duty[k] - before.duty[k];
                    let (pause, needs) = (row.at_s - before.at_s, change.abs() / ramp_per_s);
                    let ramps = |rate: f64| rate * change.signum() > 0.6 * ramp_per_s;
                    if change != 0.0 && needs < 0.95 * pause && pause < LONGEST_PAUSE_S {
                        let goes_on = duties
                            .get(i + 1)
                            .is_some_and(|next| ramps(slope(row, next)));
                        let begun = earlier.is_some_and(|earlier| ramps(slope(earlier, before)));
                        let start = match (begun, goes_on) {
                            (true, false) => before.at_s,
                            (false, true) => row.at_s - needs,
                            _ => before.at_s + (pause - needs) * 0.5,
                        };
                        for (at, duty) in [(start, before.duty[k]), (start + needs, row.duty[k])] {
                            if knots.last().is_none_or(|last| last.0 < at) && at < row.at_s {
                                knots.push((at, duty));
                            }
                        }
                    }
                }
                knots.push((row.at_s, row.duty[k]));
            }
            knots
        });
        let pauses = duties
            .windows(2)
            .filter(|pair| pair[1].at_s - pair[0].at_s > LONGEST_PAUSE_S)
            .map(|pair| (pair[0].at_s, pair[1].at_s + FORGOTTEN_S))
            .collect();
        Self { wheels, pauses }
    }

    /// Both wheels' duties from here on, one moment after the other.
    pub(crate) fn walk(&self) -> [Walk<'_>; 2] {
        [0, 1].map(|k: usize| Walk {
            knots: &self.wheels[k],
            next: 0,
        })
    }

    /// Whether all duties from one stamp to another are known.
    #[must_use]
    pub fn covers(&self, from_s: f64, to_s: f64) -> bool {
        let [left, _] = &self.wheels;
        let (Some(first), Some(last)) = (left.first(), left.last()) else {
            return false;
        };
        first.0 <= from_s
            && to_s <= last.0
            && !self
                .pauses
                .iter()
                .any(|pause| pause.0 < to_s && from_s < pause.1)
    }

    /// Times in which duties are not known, and how long each is told apart.
    #[must_use]
    pub fn pauses(&self) -> usize {
        self.pauses.len()
    }
}

/// Goes along a timeline, forward only.
#[derive(Debug, Clone)]
pub(crate) struct Walk<'a> {
    knots: &'a [(f64, f64)],
    next: usize,
}

impl Walk<'_> {
    pub(crate) fn at(&mut self, at_s: f64) -> f64 {
        while self.knots.get(self.next).is_some_and(|knot| knot.0 <= at_s) {
            self.next += 1;
        }
        let after = self.knots.get(self.next);
        let before = self.next.checked_sub(1).and_then(|i| self.knots.get(i));
        match (before, after) {
            // Nobody says what is in a pause; it is not used either.
            (Some(&(t0, d0)), Some(&(t1, d1))) => d0 + (d1 - d0) * (at_s - t0) / (t1 - t0),
            (Some(&(_, duty)), None) | (None, Some(&(_, duty))) => duty,
            (None, None) => 0.0,
        }
    }
}

/// Voltage of the pack without load, as a line over time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OpenVoltage {
    at_s: f64,
    volts: f64,
    per_s: f64,
}

impl OpenVoltage {
    /// The same at all times.
    #[must_use]
    pub const fn constant(volts: f64) -> Self {
        Self {
            at_s: 0.0,
            volts,
            per_s: 0.0,
        }
    }

    /// Volts at a moment.
    #[must_use]
    pub fn at(&self, at_s: f64) -> f64 {
        self.volts + self.per_s * (at_s - self.at_s)
    }

    /// From what a smoothing gauge said and what the motors drew meanwhile.
    fn fit(volts: &[Supply], parameters: &Parameters, currents: &[(f64, f64)]) -> Option<Self> {
        let open: Vec<(f64, f64)> = volts
            .iter()
            .map(|row| {
                let at = row.at_s + parameters.latency_s;
                let i = currents.partition_point(|(at_s, _)| *at_s < at);
                let current = currents.get(i.min(currents.len().saturating_sub(1)));
                let current = current.map_or(parameters.quiescent_a, |(_, current)| *current);
                (at, row.volts + parameters.internal_ohm * current)
            })
            .collect();
        let n = open.len() as f64;
        if open.is_empty() {
            return None;
        }
        let at_s = open.iter().map(|(at, _)| at).sum::<f64>() / n;
        let volts = open.iter().map(|(_, volts)| volts).sum::<f64>() / n;
        let spread: f64 = open.iter().map(|(at, _)| (at - at_s) * (at - at_s)).sum();
        let slope: f64 = open.iter().map(|(at, v)| (at - at_s) * (v - volts)).sum();
        // A pack only empties, and not in a minute.
        let per_s = if spread > 0.0 {
            (slope / spread).clamp(-2e-3, 0.0)
        } else {
            0.0
        };
        Some(Self { at_s, volts, per_s })
    }
}

/// Where a body went that began at zero, on the tracker's clock.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    begun_s: f64,
    poses: Vec<Pose>,
    /// Way of the middle, metres.
    ways: Vec<f64>,
}

impl Track {
    /// Drives a body of `parameters` through a drive, from rest.
    #[must_use]
    pub fn drive(
        parameters: &Parameters,
        timeline: &Timeline,
        open: &OpenVoltage,
        (from_s, to_s): (f64, f64),
    ) -> Self {
        Self::drive_with(parameters, timeline, open, (from_s, to_s), |_, _| {})
    }

    fn drive_with(
        parameters: &Parameters,
        timeline: &Timeline,
        open: &OpenVoltage,
        (from_s, to_s): (f64, f64),
        mut current: impl FnMut(f64, f64),
    ) -> Self {
        let steps = ((to_s - from_s) / STEP_S).ceil().max(0.0) as usize + 1;
        let mut walks = timeline.walk();
        let (mut wheels, mut pose, mut way) = (Wheels::default(), Pose::default(), 0.0);
        let mut track = Self {
            begun_s: from_s,
            poses: Vec::with_capacity(steps + 1),
            ways: Vec::with_capacity(steps + 1),
        };
        track.poses.push(pose);
        track.ways.push(way);
        for step in 0..steps {
            let at_s = from_s + step as f64 * STEP_S;
            // The duty in the middle of the step.
            let stamp = at_s + 0.5 * STEP_S - parameters.latency_s;
            let duty = [walks[0].at(stamp), walks[1].at(stamp)];
            let before = wheels;
            current(at_s, wheels.step(parameters, duty, open.at(at_s)));
            let motion = wheels.motion(before, parameters.track_m);
            pose = pose.then(motion);
            way += motion.x.abs();
            track.poses.push(pose);
            track.ways.push(way);
        }
        track
    }

    /// Where it was at a moment; at the nearest one that is known.
    #[must_use]
    pub fn at(&self, at_s: f64) -> Pose {
        let place = ((at_s - self.begun_s) / STEP_S).max(0.0);
        let last = self.poses.len() - 1;
        let before = (place as usize).min(last);
        let after = (before + 1).min(last);
        let share = (place - before as f64).clamp(0.0, 1.0);
        self.poses[before].between(self.poses[after], share)
    }

    /// Metres driven up to a moment.
    #[must_use]
    pub fn way(&self, at_s: f64) -> f64 {
        let place = ((at_s - self.begun_s) / STEP_S).max(0.0) as usize;
        self.ways[place.min(self.ways.len() - 1)]
    }
}

/// A drive that is ready to be driven once more.
#[derive(Debug, Clone, PartialEq)]
pub struct Drive<'a> {
    /// What is known of it.
    pub evidence: &'a Evidence,
    /// What the motors had.
    pub timeline: Timeline,
    /// First and last fix of which duties are known too.
    pub span: (f64, f64),
    /// Voltages around it, aligned.
    volts: Vec<Supply>,
}

/// Voltages so long before a drive still say something of its pack, seconds.
const PACK_S: f64 = 60.0;

impl<'a> Drive<'a> {
    /// `None` without fixes and duties of the same time.
    #[must_use]
    pub fn new(evidence: &'a Evidence) -> Option<Self> {
        let rows = evidence.duties().iter();
        let alignment = Alignment::of(rows.map(|row| (row.at_s, row.arrived_s)));
        // Both clocks are told by arrivals: what is left between them is `latency_s`.
        let tracker = evidence.tracker_delay_s().unwrap_or(0.0);
        let aligned = |at_s: f64| alignment.of_stamp(at_s) - tracker;
        let mut duties: Vec<Duty> = Vec::with_capacity(evidence.duties().len());
        for row in evidence.duties() {
            let at_s = aligned(row.at_s);
            // A clock that is set may put two samples in one place.
            if duties.last().is_none_or(|last| last.at_s < at_s) {
                duties.push(Duty { at_s, ..*row });
            }
        }
        let (from, to) = evidence.span()?;
        let (first, last) = (duties.first()?.at_s, duties.last()?.at_s);
        let span = (from.max(first + LATENCY_S), to.min(last - LATENCY_S));
        if span.0 >= span.1 {
            return None;
        }
        let volts = evidence.volts().iter().map(|row| Supply {
            at_s: aligned(row.at_s),
            ..*row
        });
        let near = |row: &Supply| (span.0 - PACK_S..=span.1 + PACK_S).contains(&row.at_s);
        Some(Self {
            evidence,
            timeline: Timeline::of(&duties, RAMP_PER_S),
            span,
            volts: volts.filter(near).collect(),
        })
    }

    /// The pack as `parameters` have it.
    #[must_use]
    pub fn open_voltage(&self, parameters: &Parameters) -> Option<OpenVoltage> {
        let volts = &self.volts;
        let mean = volts.iter().map(|row| row.volts).sum::<f64>() / volts.len().max(1) as f64;
        let mut open = OpenVoltage::constant(mean);
        // What the gauge says is smoothed, and so is the current that is held against it.
        for _ in 0..2 {
            let (mut currents, mut smooth) = (Vec::new(), parameters.quiescent_a);
            Track::drive_with(
                parameters,
                &self.timeline,
                &open,
                self.span,
                |at_s, current| {
                    smooth += (current - smooth) * STEP_S / GAUGE_S;
                    currents.push((at_s, smooth));
                },
            );
            open = OpenVoltage::fit(volts, parameters, &currents)?;
        }
        Some(open)
    }

    /// Where a body of `parameters` went.
    #[must_use]
    pub fn track(&self, parameters: &Parameters, open: &OpenVoltage) -> Track {
        Track::drive(parameters, &self.timeline, open, self.span)
    }

    /// Whether duties are known from one moment of the tracker to another, at any latency.
    #[must_use]
    pub fn covers(&self, from_s: f64, to_s: f64) -> bool {
        self.timeline.covers(from_s - LATENCY_S, to_s + LATENCY_S)
    }
}

/// A residual of a fix against a pose: metres, metres, radians.
pub(crate) fn residual(fix: &crate::evidence::Fix, pose: Pose) -> [f64; 3] {
    [fix.x - pose.x, fix.y - pose.y, wrap(fix.theta - pose.theta)]
}
