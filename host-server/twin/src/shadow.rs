//! A body that follows a robot while it drives.
//!
//! Duties drive it, fixes correct it: an extended Kalman filter over the pose and two slow gains, one of each
//! wheel. Beside the corrected pose a second one is only ever driven, so that every prediction made seconds
//! ago can be held against a fix now. It lags behind the robot by one sample of telemetry, and says where the
//! robot is from there.

mod predictions;
mod state;

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::body::{Parameters, Pose, STEP_S, wrap};
use crate::detect::{Detector, Fault, Innovation, Sight};
use crate::drift::{Drift, Watch};
use crate::drive::{RAMP_PER_S, Timeline};
use crate::evidence::{Duty, Fix, LATEST_S, Refusal, Row, Supply};
use crate::gap::{HORIZONS_S, Samples};
use crate::identify::{SIGMA_M, SIGMA_RAD, jumps_between};
use crate::predict::quantile;
use predictions::Predictions;
use state::{Gains, STRETCH, State};

/// Most rows that wait for what belongs to them.
const MOST_WAITING: usize = 256;
/// Without a word of the robot for so long nothing follows from what was before, seconds.
const LOST_S: f64 = 1.5;
/// A fix that is older than the state by more cannot correct it any more, seconds.
const TOO_LATE_S: f64 = 0.1;
/// A state is never taken on further than this at once, seconds.
const LONGEST_S: f64 = 30.0;
/// Delays of the last so many seconds say how late the robot's clock is.
const ALIGNED_S: f64 = 6.0;
/// A network that holds messages up by this more than the quickest is late, seconds.
const LATE_S: f64 = 0.3;
/// How many errors a summary is of.
const REMEMBERED: usize = 128;
/// Delays of the last so many seconds, and of as many before, say how late the tracker's fixes come.
const TRACKED_S: f64 = 60.0;
/// A delay that differs by more is of a clock that was set, seconds.
const SET_S: f64 = 3.0;
/// Of clocks that differ by less what was aligned by one is aligned by the other, seconds.
const CLOSE_S: f64 = 0.1;
/// What the heading wanders at least, radians for the root of a metre.
const WANDER: f64 = 0.015;
/// What it wanders about where nobody knows how far the wheels act apart.
const WIDE_WANDER: f64 = 0.08;
/// Ways of a wheel are off by this for a change of duty of one between two samples, metres per second: when
/// within the pause it began is not known.
const RAMP_MPS: f64 = 0.12;
/// The squares of three innovations are below this in half of all cases.
const MEDIAN: f64 = 2.366;
/// And below this in four of five.
const FOUR_FIFTHS: f64 = 4.642;
/// And above this in one of fifty.
const SURPRISING: f64 = 10.0;
/// Squares that half of all fixes need to have until they count as noisier than they say.
const FEWEST: usize = 20;
/// Time constants of the gauge's filter, and of the open voltage that is made of it, seconds.
const GAUGE_S: f64 = 4.0;

/// A place with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Where.
    pub pose: Pose,
    /// One standard deviation of the position along its longer axis, metres.
    pub sigma_m: f64,
    /// Of the heading, radians.
    pub sigma_rad: f64,
}

/// Where a robot will be if its duties stay as they are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Forecast {
    /// How far ahead, seconds.
    pub horizon_s: f64,
    /// Where.
    pub at: Estimate,
}

/// How good forecasts over a horizon were, given what the duties then turned out to be.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Residual {
    /// How far ahead, seconds.
    pub horizon_s: f64,
    /// Of so many.
    pub count: usize,
    /// Median error, metres.
    pub median_m: f64,
    /// In nine of ten it is below, metres.
    pub p90_m: f64,
}

/// What is known of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// The tracker's time of it, seconds.
    pub at_s: f64,
    /// Where it is.
    pub now: Estimate,
    /// Speed ahead, metres per second.
    pub v: f64,
    /// Turning rate, radians per second.
    pub w: f64,
    /// What the wheels make of their duty against the parameters: left, right.
    pub gains: [f64; 2],
    /// One standard deviation of each.
    pub gain_sigma: [f64; 2],
    /// How good predictions were lately.
    pub residuals: Vec<Residual>,
    /// Mean of the normalised innovations squared, over three: 1 when the filter knows what it knows.
    pub consistency: f64,
    /// Share of fixes within the region that should hold 95 of 100.
    pub coverage: f64,
    /// Fixes that were taken in.
    pub fixes: u64,
    /// Jumps of the tracker or of the robot.
    pub jumps: u64,
    /// Times in which the robot was not heard of for too long.
    pub gaps: u64,
    /// What is wrong with it, as far as can be told.
    pub faults: Vec<Fault>,
    /// How far its wheels are from the body that was certified; `None` for the nominal one.
    pub drift: Option<Drift>,
}

/// The last of some numbers.
#[derive(Debug, Clone, Default)]
struct Recent(VecDeque<f64>);

impl Recent {
    fn push(&mut self, value: f64) {
        if self.0.len() == REMEMBERED {
            self.0.pop_front();
        }
        self.0.push_back(value);
    }

    fn quantile(&self, share: f64) -> f64 {
        let mut values: Vec<f64> = self.0.iter().copied().collect();
        quantile(&mut values, share)
    }

    fn mean(&self, of: impl Fn(f64) -> f64) -> f64 {
        self.0.iter().map(|value| of(*value)).sum::<f64>() / self.0.len().max(1) as f64
    }
}

/// The least delay of late, of which clocks that run apart make another one.
#[derive(Debug, Clone, Copy, Default)]
struct Least {
    now: Option<f64>,
    before: Option<f64>,
    since_s: f64,
}

impl Least {
    fn take(&mut self, delay: f64, arrived_s: f64) {
        if self.now.is_none() || arrived_s - self.since_s > TRACKED_S {
            (self.before, self.now, self.since_s) = (self.now, None, arrived_s);
        }
        self.now = Some(self.now.map_or(delay, |least| least.min(delay)));
    }

    fn get(&self) -> Option<f64> {
        let [now, before] = [self.now, self.before].map(|least| least.unwrap_or(f64::INFINITY));
        Some(now.min(before)).filter(|least| least.is_finite())
    }
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Shadow {
    parameters: Parameters,
    wander: f64,
    /// What is believed of the gains where it begins.
    gains: Gains,
    /// Whether it takes what it has learned of them along when it begins anew.
    learns: bool,
    /// Aligned.
    duties: VecDeque<Duty>,
    /// Each with whether something that the robot may touch is within reach there.
    waiting: VecDeque<(Fix, bool)>,
    delays: VecDeque<(f64, f64)>,
    mean_delay: f64,
    tracker_delay: Least,
    last_fix: Option<Fix>,
    /// `None` before the first fix, and when the robot was lost.
    state: Option<State>,
    open_v: Option<f64>,
    smooth_a: f64,
    predictions: Predictions,
    drift: Watch,
    innovations: Recent,
    detector: Detector,
    /// Whether something that the robot may touch is within reach at the next fix that comes.
    is_near: bool,
    /// The same of the fix before, and of that which is looked at.
    near: [bool; 2],
    fixes: u64,
    jumps: u64,
    gaps: u64,
}

impl Shadow {
    /// A shadow of a robot with these parameters, whose heading wanders by so much beyond them.
    #[must_use]
    pub fn new(parameters: Parameters, wander: f64) -> Self {
        Self {
            parameters,
            wander: wander.max(WANDER),
            gains: Gains::CALIBRATED,
            learns: false,
            duties: VecDeque::new(),
            waiting: VecDeque::new(),
            delays: VecDeque::new(),
            mean_delay: 0.0,
            tracker_delay: Least::default(),
            last_fix: None,
            state: None,
            open_v: None,
            smooth_a: parameters.quiescent_a,
            predictions: Predictions::default(),
            drift: Watch::default(),
            innovations: Recent::default(),
            detector: Detector::default(),
            is_near: false,
            near: [false; 2],
            fixes: 0,
            jumps: 0,
            gaps: 0,
        }
    }

    /// A shadow of a robot that nobody has calibrated. It learns what the wheels make of their duty from as far off as
    /// robots are, and names only what shows on any body: a motor that is weaker than that of the nominal
    /// body is no fault.
    #[must_use]
    pub fn uncalibrated() -> Self {
        Self {
            wander: WIDE_WANDER,
            gains: Gains::WIDE,
            learns: true,
            detector: Detector::coarse(),
            ..Self::new(Parameters::NOMINAL, 0.0)
        }
    }

    /// Says whether anything is within reach that the robot may touch, as of the next fix. What touches is held up by more than its
    /// body: meanwhile nothing is learned of that, and no fault is named but one that shows beside a wall too.
    pub const fn near(&mut self, is_near: bool) {
        self.is_near = is_near;
    }

    /// Takes in a row of any kind.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn take(&mut self, row: Row) -> Result<(), Refusal> {
        match row {
            Row::Duty(row) => self.duty(row),
            Row::Supply(row) => self.supply(row),
            Row::Fix(row) => self.fix(row),
        }
    }

    /// Takes in what the motors were told.
    ///
    /// # Errors
    /// [`Refusal`] for what is no number, is not newer, or comes from a clock that jumped.
    pub fn duty(&mut self, row: Duty) -> Result<(), Refusal> {
        if !(row.at_s.is_finite() && row.duty.iter().all(|duty| duty.is_finite())) {
            return Err(Refusal::NotANumber);
        }
        if row.at_s.abs() > LATEST_S || row.duty.iter().any(|duty| duty.abs() > 1.0) {
            return Err(Refusal::OutOfRange);
        }
        let at_s = self.align(row.at_s, row.arrived_s)? + self.parameters.latency_s;
        if let Some(last) = self.duties.back() {
            let pause = at_s - last.at_s;
            if pause <= 0.0 {
                return Err(Refusal::Doubled);
            }
            if pause > LOST_S {
                // The robot may be anywhere by now, and so may its clock.
                self.gaps += 1;
                self.forget();
            }
        }
        if let (Some(last), Some(state)) = (self.duties.back(), &mut self.state) {
            let pause = at_s - last.at_s;
            for k in 0..2 {
                let off = RAMP_MPS * pause * (row.duty[k] - last.duty[k]);
                state.jitter[k] += off * off;
            }
        }
        if self.duties.len() == MOST_WAITING {
            self.duties.pop_front();
        }
        self.duties.push_back(Duty { at_s, ..row });
        self.pump();
        Ok(())
    }

    /// Takes in what the gauge shows.
    ///
    /// # Errors
    /// [`Refusal`] for what is no voltage.
    pub fn supply(&mut self, row: Supply) -> Result<(), Refusal> {
        if !(1.0..=60.0).contains(&row.volts) {
            return Err(Refusal::OutOfRange);
        }
        let open = row.volts + self.parameters.internal_ohm * self.smooth_a;
        // A pack changes by minutes; the gauge is noisy.
        let before = self.open_v.unwrap_or(open);
        self.open_v = Some(before + (open - before) * 0.2);
        Ok(())
    }

    /// Takes in where the tracker saw it.
    ///
    /// # Errors
    /// [`Refusal`] for what is no number, is not newer, or comes from a clock that jumped.
    pub fn fix(&mut self, fix: Fix) -> Result<(), Refusal> {
        let numbers = [fix.at_s, fix.x, fix.y, fix.theta, fix.sigma_m];
        if !numbers.iter().all(|number| number.is_finite()) {
            return Err(Refusal::NotANumber);
        }
        if fix.at_s.abs() > LATEST_S
            || fix.x.abs() > 1e3
            || fix.y.abs() > 1e3
            || fix.theta.abs() > 1e4
            || !(0.0..=1.0).contains(&fix.sigma_m)
        {
            return Err(Refusal::OutOfRange);
        }
        if let Some(arrived_s) = fix.arrived_s {
            let delay = arrived_s - fix.at_s;
            if !delay.is_finite() {
                return Err(Refusal::NotANumber);
            }
            let least = self.tracker_delay.get();
            if least.is_some_and(|least| (delay - least).abs() > SET_S) {
                // Its clock was set: all that is known is of times that are no more.
                self.tracker_delay = Least::default();
                self.last_fix = None;
                self.duties.clear();
                self.forget();
                self.gaps += 1;
                return Err(Refusal::ClockJumped);
            }
            if least.is_none() && delay.abs() > CLOSE_S {
                // Until now nobody knew what the tracker's time is.
                self.duties.clear();
            }
            self.tracker_delay.take(delay, arrived_s);
        }
        let waiting = self.waiting.back().map(|(fix, _)| fix);
        let last = waiting.or(self.last_fix.as_ref());
        if last.is_some_and(|last| fix.at_s <= last.at_s) {
            return Err(Refusal::Doubled);
        }
        if self.waiting.len() == MOST_WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back((fix, self.is_near));
        self.pump();
        Ok(())
    }

    /// The time of a stamp on the clock that it arrived by.
    fn align(&mut self, at_s: f64, arrived_s: Option<f64>) -> Result<f64, Refusal> {
        let Some(arrived_s) = arrived_s else {
            return Ok(at_s);
        };
        if !arrived_s.is_finite() || arrived_s.abs() > LATEST_S {
            return Err(Refusal::NotANumber);
        }
        let delay = arrived_s - at_s;
        while self
            .delays
            .front()
            .is_some_and(|first| first.0 < arrived_s - ALIGNED_S)
        {
            self.delays.pop_front();
        }
        let least = |delays: &VecDeque<(f64, f64)>| {
            delays
                .iter()
                .map(|(_, delay)| *delay)
                .fold(f64::INFINITY, f64::min)
        };
        let before = least(&self.delays);
        if before.is_finite() && (delay - before).abs() > 3.0 {
            // Set anew, or a stamp from nowhere: what was known of this clock is worth nothing.
            self.delays.clear();
            self.duties.clear();
            self.forget();
            self.gaps += 1;
            return Err(Refusal::ClockJumped);
        }
        if self.delays.len() == MOST_WAITING {
            self.delays.pop_front();
        }
        self.delays.push_back((arrived_s, delay));
        let least = before.min(delay);
        self.mean_delay += (delay - least - self.mean_delay) / 16.0;
        self.detector
            .late(self.mean_delay > LATE_S, arrived_s, self.mean_delay);
        Ok(at_s + least - self.delay_s())
    }

    /// Least time from a stamp of the tracker to its arrival of late, seconds; 0 where nobody looked.
    #[must_use]
    pub fn delay_s(&self) -> f64 {
        self.tracker_delay.get().unwrap_or(0.0)
    }

    /// Whether it knows what the motors are told.
    #[must_use]
    pub fn has_duties(&self) -> bool {
        !self.duties.is_empty()
    }

    /// Begins where a fix says.
    fn begin(&mut self, fix: &Fix, sigma: f64) {
        self.state = Some(State::at(fix, sigma, self.gains));
        self.predictions.begin();
        self.detector.begin();
    }

    /// Keeps what was learned, for when it begins anew.
    fn remember(&mut self) {
        if let (true, Some(state)) = (self.learns, &self.state) {
            self.gains = state.learned();
        }
    }

    fn forget(&mut self) {
        self.remember();
        self.state = None;
        self.predictions.begin();
        self.waiting.clear();
    }

    /// Goes on as far as duties are known for sure, and takes the fixes in on the way.
    fn pump(&mut self) {
        let Some(known_s) = self
            .duties
            .len()
            .checked_sub(2)
            .map(|i| self.duties[i].at_s)
        else {
            return;
        };
        let timeline = self.timeline();
        while let Some((fix, is_near)) = self.waiting.front().copied() {
            if fix.at_s > known_s {
                break;
            }
            self.waiting.pop_front();
            self.near = [self.near[1], is_near];
            self.see(fix, &timeline);
        }
        self.advance(known_s, &timeline);
        // Two more than are needed say how the first one came about.
        let needed_s = self.state.map_or(known_s, |state| state.at_s) - STEP_S;
        while self.duties.len() > 4 && self.duties[3].at_s < needed_s {
            self.duties.pop_front();
        }
    }

    /// What the motors had since the oldest duty that is kept.
    fn timeline(&mut self) -> Timeline {
        Timeline::of(self.duties.make_contiguous(), RAMP_PER_S)
    }

    fn advance(&mut self, to_s: f64, timeline: &Timeline) {
        let Some(mut state) = self.state else {
            return;
        };
        if to_s - state.at_s > LONGEST_S {
            // Duties and fixes are of times that have nothing to do with each other.
            self.gaps += 1;
            self.forget();
            return;
        }
        let open_v = self.open_v.unwrap_or(7.4);
        let [mut left, mut right] = timeline.walk();
        while state.at_s + STEP_S <= to_s {
            let middle_s = state.at_s + 0.5 * STEP_S;
            let duty = [left.at(middle_s), right.at(middle_s)];
            let current = state.step(&self.parameters, duty, open_v);
            self.smooth_a += (current - self.smooth_a) * STEP_S / GAUGE_S;
            self.predictions.step(duty, open_v, state.speeds());
            let due = self.predictions.is_due(state.at_s);
            if due || state.steps == STRETCH {
                self.stretch(&mut state);
            }
            if due {
                self.predictions.mark(&state);
            }
        }
        self.predictions.prune(state.at_s);
        self.state = Some(state);
    }

    /// Whether what the robot does is what its body does.
    const fn is_well(&self) -> bool {
        self.detector.is_quiet() && !self.touches()
    }

    /// Whether something may have held the robot up since the last fix.
    const fn touches(&self) -> bool {
        self.near[0] || self.near[1]
    }

    /// Takes on how sure the state is, and all that was predicted.
    fn stretch(&mut self, state: &mut State) {
        let learns = self.is_well();
        if let Some(stretch) = state.stretch(&self.parameters, self.wander, learns) {
            self.predictions.spread(&stretch, state);
        }
    }

    fn see(&mut self, fix: Fix, timeline: &Timeline) {
        let last = self.last_fix;
        let jumped = last.is_some_and(|last| jumps_between(&last, &fix));
        self.last_fix = Some(fix);
        self.fixes += 1;
        self.detector.jumped(jumped, fix.at_s);
        if jumped {
            // Carried, or another robot: in either case it is there now, and predictions begin anew.
            self.jumps += 1;
            self.remember();
            self.state = None;
            self.predictions.begin();
        }
        self.advance(fix.at_s, timeline);
        // What says nothing of its noise has that of any camera; nothing has none.
        let sigma = match fix.sigma_m {
            0.0 => SIGMA_M,
            sigma => sigma.max(0.1 * SIGMA_M),
        };
        let heading = SIGMA_RAD;
        let Some(mut state) = self.state else {
            // Where it was before anything is known of its wheels says nothing of where it is now.
            if self
                .duties
                .front()
                .is_some_and(|first| first.at_s <= fix.at_s + TOO_LATE_S)
            {
                self.begin(&fix, sigma);
            }
            return;
        };
        if fix.at_s < state.at_s - TOO_LATE_S {
            // What its wheels did then is not known any more.
            return;
        }
        if fix.at_s - state.at_s > TOO_LATE_S {
            // Not of the time that is known: it begins anew there.
            self.remember();
            self.begin(&fix, sigma);
            return;
        }
        self.stretch(&mut state);
        // The last hundredth of a second at most.
        let rest = fix.at_s - state.at_s;
        let pose = state.ahead(&self.parameters, rest);
        let innovation = [fix.x - pose.x, fix.y - pose.y, wrap(fix.theta - pose.theta)];
        let (was_quiet, was_well) = (self.detector.is_quiet(), self.is_well());
        if self.touches() {
            state.inflate();
            self.predictions.interrupt();
        }
        let there = self.predictions.there(&state, &self.parameters, rest);
        self.predictions.hold(&fix, sigma, &there, was_well);
        let before = state;
        let Some(mut told) = state.correct(innovation, sigma, heading, was_well) else {
            self.begin(&fix, sigma);
            return;
        };
        if told.square > SURPRISING {
            // Something happened that no duty tells of. It is to be seen once, and not in all fixes that come.
            state = before;
            state.inflate();
            if let Some(then) = state.correct(innovation, sigma, heading, was_well) {
                told.rest = then.rest;
            }
        }
        if self.learns {
            state.bound_gains();
        }
        // Where fixes are noisier than they say, or the body less sure, less follows from each. A fault is
        // in fewer than half of what is remembered by the time at which it is named.
        let noisier = match self.innovations.0.len() {
            FEWEST.. => {
                let [median, most] = [0.5, 0.8].map(|share| self.innovations.quantile(share));
                (median / MEDIAN).max(most / FOUR_FIFTHS).max(1.2)
            }
            _ => 2.5,
        };
        // What a fault makes of them says nothing about the noise.
        if was_well {
            self.innovations.push(told.square);
            self.predictions.samples.innovation(told.square);
        }
        // While a fault is there gains stand still.
        if was_well {
            self.predictions.start(&fix, sigma, there, &state);
            let sigmas = [3, 4].map(|i: usize| state.covariance[i][i].max(0.0).sqrt());
            let way_m = self.predictions.way_m();
            self.drift.look(fix.at_s, way_m, state.gains, sigmas);
        }
        let sight = Sight {
            heading: pose.theta,
            ..state.since
        };
        let inverse = told.inverse.map(|row| row.map(|value| value / noisier));
        let told = Innovation {
            left: innovation,
            inverse,
            rest: told.rest,
        };
        let touches = self.touches();
        self.detector
            .look(&sight, &told, fix.at_s, self.parameters.track_m, touches);
        state.since = Sight::default();
        self.state = Some(state);
        if self.learns && !was_quiet && self.detector.is_quiet() {
            // What was learned before a fault was named is of the fault as well.
            self.gains = Gains::WIDE;
            self.begin(&fix, sigma);
        }
    }

    /// What is wrong with it, as far as can be told.
    #[must_use]
    pub fn faults(&self) -> Vec<Fault> {
        self.detector.faults()
    }

    /// What was predicted, and what came: what the gap between its body and the robot is measured by.
    #[must_use]
    pub fn gap(&self) -> &Samples {
        &self.predictions.samples
    }

    /// What is known now; `None` before there is anything.
    #[must_use]
    pub fn view(&mut self) -> Option<View> {
        let (state, _) = self.newest()?;
        let sigma = |i: usize| state.covariance[i][i].max(0.0).sqrt();
        let residuals = HORIZONS_S.iter().zip(&self.predictions.residuals);
        let [left, right] = state.speeds();
        Some(View {
            at_s: state.at_s,
            now: state.estimate(),
            v: (left + right) * 0.5,
            w: (right - left) / self.parameters.track_m,
            gains: state.gains.map(f64::exp),
            gain_sigma: [sigma(3), sigma(4)],
            residuals: residuals
                .map(|(horizon_s, errors)| Residual {
                    horizon_s: *horizon_s,
                    count: errors.0.len(),
                    median_m: errors.quantile(0.5),
                    p90_m: errors.quantile(0.9),
                })
                .collect(),
            consistency: self.innovations.mean(|square| square / 3.0),
            // 95 of 100 draws of three squares are below.
            coverage: self
                .innovations
                .mean(|square| f64::from(u8::from(square < 7.815))),
            fixes: self.fixes,
            jumps: self.jumps,
            gaps: self.gaps,
            faults: self.detector.faults(),
            drift: (!self.learns).then(|| self.drift.now()),
        })
    }

    /// The state at the newest duty.
    fn newest(&mut self) -> Option<(State, Duty)> {
        let (mut state, last) = (self.state?, *self.duties.back()?);
        let timeline = self.timeline();
        let [mut left, mut right] = timeline.walk();
        let open_v = self.open_v.unwrap_or(7.4);
        while state.at_s + STEP_S <= last.at_s {
            let middle_s = state.at_s + 0.5 * STEP_S;
            let duty = [left.at(middle_s), right.at(middle_s)];
            state.step(&self.parameters, duty, open_v);
        }
        state.stretch(&self.parameters, self.wander, true);
        Some((state, last))
    }

    /// Where the robot will be in [`HORIZONS_S`] if its duties stay as they are.
    #[must_use]
    pub fn forecast(&mut self) -> Vec<Forecast> {
        let Some((mut state, last)) = self.newest() else {
            return Vec::new();
        };
        let begun_s = state.at_s;
        let open_v = self.open_v.unwrap_or(7.4);
        HORIZONS_S
            .iter()
            .map(|&horizon_s| {
                while state.at_s < begun_s + horizon_s - 0.5 * STEP_S {
                    state.step(&self.parameters, last.duty, open_v);
                    if state.steps == STRETCH {
                        state.stretch(&self.parameters, self.wander, true);
                    }
                }
                let at = state.estimate();
                Forecast { horizon_s, at }
            })
            .collect()
    }
}
