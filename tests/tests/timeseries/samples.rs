//! Samples that are drawn from a seed, and what it means that points are alike.

use crawler_history::{Point, Sample, Span};
use crawler_protocol::{RobotId, RobotState};

/// A small generator: the same numbers for the same seed.
pub(crate) struct Dice(pub(crate) u64);

impl Dice {
    pub(crate) fn below(&mut self, most: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % most
    }

    fn metres(&mut self) -> f32 {
        (self.below(20_001) as f32 - 10_000.0) / 997.0
    }
}

pub(crate) fn sample(robot: &RobotId, at: i64, dice: &mut Dice) -> Sample {
    Sample {
        robot: robot.clone(),
        at,
        x: dice.metres(),
        y: dice.metres(),
        theta: dice.metres(),
        range_mm: (dice.below(3) > 0).then(|| dice.below(4_000) as u16),
        battery_mv: 6_000 + dice.below(2_400) as u16,
        battery_percent: dice.below(101) as u8,
        rssi: (dice.below(4) > 0).then(|| -(dice.below(128) as i8)),
        left: dice.metres() / 10.0,
        right: dice.metres() / 10.0,
        state: RobotState::ALL[dice.below(RobotState::ALL.len() as u64) as usize],
    }
}

/// Samples of a robot from `begin` on: at uneven steps, with gaps, and stretches without a range.
pub(crate) fn walk(robot: &RobotId, begin: i64, length: i64, dice: &mut Dice) -> Vec<Sample> {
    let (mut at, mut out) = (begin, Vec::new());
    let mut blind = false;
    while at < begin + length {
        let mut one = sample(robot, at, dice);
        if dice.below(40) == 0 {
            blind = !blind;
        }
        if blind {
            (one.range_mm, one.rssi) = (None, None);
        }
        out.push(one);
        at += match dice.below(60) {
            0 => 1 + dice.below(90_000) as i64,
            1..10 => 1 + dice.below(20) as i64,
            _ => 150 + dice.below(900) as i64,
        };
    }
    out
}

/// Whether `one` is what `other` is, up to what means may differ by: so many thousandths of a metre, or
/// so many whole units.
pub(crate) fn alike(one: &Point, other: &Point, by: f32) -> Result<(), String> {
    let near = |what: &str, one: f32, other: f32, by: f32| {
        let off = (one - other).abs() > by + one.abs() * 1e-5;
        if off {
            Err(format!("{what}: {one} and {other}"))
        } else {
            Ok(())
        }
    };
    let spans = |what: &str, one: Option<Span>, other: Option<Span>| match (one, other) {
        (None, None) => Ok(()),
        (Some(one), Some(other)) => {
            near(what, one.min, other.min, 0.01)?;
            near(what, one.mean, other.mean, by + 0.001)?;
            near(what, one.max, other.max, 0.01)
        }
        other => Err(format!("{what}: {other:?}")),
    };
    if (one.at, one.count, one.state) != (other.at, other.count, other.state) {
        return Err(format!("time, count or state: {one:?} and {other:?}"));
    }
    near("x", one.x, other.x, by / 1_000.0 + 1e-6)?;
    near("y", one.y, other.y, by / 1_000.0 + 1e-6)?;
    near("left", one.left, other.left, by / 1_000.0 + 1e-6)?;
    near("right", one.right, other.right, by / 1_000.0 + 1e-6)?;
    near("theta", one.theta, other.theta, 1e-5)?;
    spans("battery_mv", Some(one.battery_mv), Some(other.battery_mv))?;
    spans(
        "battery_percent",
        Some(one.battery_percent),
        Some(other.battery_percent),
    )?;
    spans("range_mm", one.range_mm, other.range_mm)?;
    spans("rssi", one.rssi, other.rssi)
}
