//! Many samples as one: count, mean, and the lowest and highest of what is measured.

use crawler_protocol::RobotState;

use super::{Point, Sample, Span};

/// A sample in whole numbers: millimetres, milliradians, thousandths of full duty.
pub(super) type Raw = [i64; 11];
/// A stretch of time in whole numbers, of one sample or many.
pub(super) type Bucket = [i64; 22];

/// Latest time that is kept, in Unix milliseconds: the year 5138. A later one is a mistake of who sent
/// it.
pub const LATEST: i64 = 100_000_000_000_000;
/// Farthest place that is kept, in millimetres.
const FARTHEST: f32 = 1e9;

/// Number of a state where history is stored. Spelled out, so that a new order of the variants changes
/// nothing.
#[must_use]
pub const fn state_number(state: RobotState) -> i64 {
    match state {
        RobotState::Initializing => 0,
        RobotState::Idle => 1,
        RobotState::Moving => 2,
        RobotState::Scanning => 3,
        RobotState::Caution => 4,
        RobotState::Avoiding => 5,
        RobotState::Updating => 6,
        RobotState::Error => 7,
    }
}

/// The state of that number; one that a newer program knows is an error to this one.
#[must_use]
pub fn numbered_state(wanted: i64) -> RobotState {
    let known = RobotState::ALL.iter().copied();
    known
        .into_iter()
        .find(|&state| state_number(state) == wanted)
        .unwrap_or(RobotState::Error)
}

/// Thousandths of `value`, as they are stored; what is no number is 0, what is out of all bounds is
/// brought back into them.
#[must_use]
pub fn thousandths(value: f32) -> i64 {
    // A cast of NaN is 0.
    (value * 1_000.0).clamp(-FARTHEST, FARTHEST).round() as i64
}

/// The sample, without its robot.
pub(super) fn raw(sample: &Sample) -> Raw {
    [
        sample.at.clamp(0, LATEST),
        thousandths(sample.x),
        thousandths(sample.y),
        thousandths(sample.theta),
        thousandths(sample.left),
        thousandths(sample.right),
        i64::from(sample.battery_mv),
        i64::from(sample.battery_percent),
        sample.range_mm.map_or(0, |range| i64::from(range) + 1),
        sample.rssi.map_or(0, |rssi| i64::from(rssi) + 129),
        state_number(sample.state),
    ]
}

/// The stretch that is one sample long.
pub(super) fn bucket(raw: &Raw) -> Bucket {
    let [
        at,
        x,
        y,
        theta,
        left,
        right,
        mv,
        percent,
        range,
        rssi,
        state,
    ] = *raw;
    let (no_range, range) = if range == 0 { (1, 0) } else { (0, range - 1) };
    let (no_rssi, rssi) = if rssi == 0 { (1, 0) } else { (0, rssi - 129) };
    [
        at, 1, x, y, theta, left, right, mv, 0, 0, percent, 0, 0, no_range, range, 0, 0, no_rssi,
        rssi, 0, 0, state,
    ]
}

/// Where the stretch of `step` begins that `at` is in.
pub(super) fn floor(at: i64, step: i64) -> i64 {
    at.saturating_sub(at.rem_euclid(step.max(1)))
}

/// Lowest, mean and highest of what was measured. In floating point, since what comes out of a
/// damaged file may be any number.
#[derive(Debug, Clone, Copy, Default)]
struct Range {
    count: f64,
    sum: f64,
    min: f64,
    max: f64,
}

impl Range {
    fn add(&mut self, count: i64, mean: i64, below: i64, above: i64) {
        if count <= 0 {
            return;
        }
        let (min, max) = (mean as f64 - below as f64, mean as f64 + above as f64);
        if self.count == 0.0 {
            (self.min, self.max) = (min, max);
        }
        self.count += count as f64;
        self.sum += mean as f64 * count as f64;
        self.min = self.min.min(min);
        self.max = self.max.max(max);
    }

    fn mean(&self) -> f64 {
        if self.count == 0.0 {
            0.0
        } else {
            self.sum / self.count
        }
    }

    /// Mean, and how far the lowest and the highest are from it.
    fn columns(&self) -> [i64; 3] {
        let mean = self.mean().round();
        let (below, above) = (mean - self.min, self.max - mean);
        if self.count == 0.0 {
            [0; 3]
        } else {
            [mean as i64, below as i64, above as i64]
        }
    }

    fn span(&self) -> Option<Span> {
        (self.count > 0.0).then(|| Span {
            min: self.min as f32,
            mean: self.mean() as f32,
            max: self.max as f32,
        })
    }
}

/// Stretches that become one.
#[derive(Debug, Clone, Default)]
pub(super) struct Fold {
    count: i64,
    /// Time of what `theta` and `state` are from.
    latest: i64,
    theta: i64,
    state: i64,
    x: Range,
    y: Range,
    left: Range,
    right: Range,
    mv: Range,
    percent: Range,
    range: Range,
    rssi: Range,
}

impl Fold {
    pub(super) fn add(&mut self, bucket: &Bucket) {
        let [
            at,
            count,
            x,
            y,
            theta,
            left,
            right,
            mv,
            mv_below,
            mv_above,
            percent,
            percent_below,
            percent_above,
            no_range,
            range,
            range_below,
            range_above,
            no_rssi,
            rssi,
            rssi_below,
            rssi_above,
            state,
        ] = *bucket;
        if count <= 0 {
            return;
        }
        if self.count == 0 || at >= self.latest {
            (self.latest, self.theta, self.state) = (at, theta, state);
        }
        self.count = self.count.saturating_add(count);
        self.x.add(count, x, 0, 0);
        self.y.add(count, y, 0, 0);
        self.left.add(count, left, 0, 0);
        self.right.add(count, right, 0, 0);
        self.mv.add(count, mv, mv_below, mv_above);
        self.percent
            .add(count, percent, percent_below, percent_above);
        let seen = count.saturating_sub(no_range);
        self.range.add(seen, range, range_below, range_above);
        let seen = count.saturating_sub(no_rssi);
        self.rssi.add(seen, rssi, rssi_below, rssi_above);
    }

    /// The stretch that begins at `at`, in whole numbers.
    pub(super) fn bucket(&self, at: i64) -> Bucket {
        let [mv, mv_below, mv_above] = self.mv.columns();
        let [percent, percent_below, percent_above] = self.percent.columns();
        let [range, range_below, range_above] = self.range.columns();
        let [rssi, rssi_below, rssi_above] = self.rssi.columns();
        [
            at,
            self.count,
            self.x.mean().round() as i64,
            self.y.mean().round() as i64,
            self.theta,
            self.left.mean().round() as i64,
            self.right.mean().round() as i64,
            mv,
            mv_below,
            mv_above,
            percent,
            percent_below,
            percent_above,
            self.count.saturating_sub(self.range.count as i64),
            range,
            range_below,
            range_above,
            self.count.saturating_sub(self.rssi.count as i64),
            rssi,
            rssi_below,
            rssi_above,
            self.state,
        ]
    }

    /// The stretch that begins at `at`, in the units of telemetry. `None` where nothing was.
    pub(super) fn point(&self, at: i64) -> Option<Point> {
        let thousandth = |range: &Range| (range.mean() / 1_000.0) as f32;
        Some(Point {
            at,
            count: u64::try_from(self.count).ok()?,
            x: thousandth(&self.x),
            y: thousandth(&self.y),
            theta: (self.theta as f64 / 1_000.0) as f32,
            left: thousandth(&self.left),
            right: thousandth(&self.right),
            battery_mv: self.mv.span()?,
            battery_percent: self.percent.span()?,
            range_mm: self.range.span(),
            rssi: self.rssi.span(),
            state: numbered_state(self.state),
        })
    }
}

/// The stretches of `step` that `rows` make, which are in order of time.
pub(super) fn buckets(rows: &[Raw], step: i64) -> Vec<Bucket> {
    let mut out = Vec::new();
    let mut current: Option<(i64, Fold)> = None;
    for row in rows {
        let at = floor(row[0], step);
        match &mut current {
            Some((begin, fold)) if *begin == at => fold.add(&bucket(row)),
            _ => {
                if let Some((begin, fold)) = current.take() {
                    out.push(fold.bucket(begin));
                }
                let mut fold = Fold::default();
                fold.add(&bucket(row));
                current = Some((at, fold));
            }
        }
    }
    if let Some((begin, fold)) = current {
        out.push(fold.bucket(begin));
    }
    out
}

/// Two stretches that begin at the same time, as one.
pub(super) fn merge(one: &Bucket, other: &Bucket) -> Bucket {
    let mut fold = Fold::default();
    fold.add(one);
    fold.add(other);
    fold.bucket(one[0])
}
