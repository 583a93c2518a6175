//! From raw measurements to a reading one may act upon.

use crawler_drivers::median::Median;
use crawler_drivers::us100::RangeError;
use crawler_hal::{Duration, Instant, Millimeters};

use crate::perception::{Reading, STALE_AFTER, SensorHealth, Sight};

/// Silence that makes a sensor dead: a dozen measurements.
const DEAD_AFTER: Duration = Duration::from_millis(1_000);
/// The very same range to the millimetre, for this long of driving. The real sensor's last digit
/// is never at rest that long, and a moving robot's surroundings are not either.
const STUCK_AFTER: Duration = Duration::from_millis(4_000);
/// No obstacle, and no robot, comes or goes this far between two measurements.
const JUMP_MM: u16 = 1_200;
/// So many jumps among the last eight measurements are absurd. A robot that turns past corners
/// sees one now and then.
const ABSURD_JUMPS: u32 = 5;
/// Down to so many, the sensor is believed again.
const SANE_JUMPS: u32 = 1;
/// Good measurements in a row that make a sensor believed at first, or again.
const PROVING: u8 = 3;

/// Stands for [`Sight::Clear`] in the median: farther than anything.
const CLEAR: Millimeters = Millimeters(u16::MAX);
/// Stands for [`Sight::Touching`]: nearer than anything.
const TOUCHING: Millimeters = Millimeters(0);

/// Median of three, and the judgement of the sensor.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RangeFilter {
    median: Median<3>,
    reading: Reading,
    /// Last reply, of whatever content.
    heard: Instant,
    /// Last observation.
    observed: Instant,
    last: Option<Millimeters>,
    /// How long the robot has been driving on the same range.
    same_for: Duration,
    /// One bit per reply, the newest lowest: whether it jumped.
    jumps: u8,
    /// Good replies in a row.
    proof: u8,
}

impl RangeFilter {
    /// A filter that has seen nothing. The sensor has from `now` on to answer.
    pub const fn new(now: Instant) -> Self {
        Self {
            median: Median::new(),
            reading: Reading {
                sight: None,
                health: SensorHealth::Unproven,
                temperature: None,
            },
            heard: now,
            observed: now,
            last: None,
            same_for: Duration::ZERO,
            jumps: 0,
            proof: 0,
        }
    }

    /// The present reading.
    pub const fn reading(&self) -> Reading {
        self.reading
    }

    /// Takes one measurement in; `moving` tells whether the wheels are driven.
    pub fn observe(
        &mut self,
        measured: Result<Millimeters, RangeError>,
        moving: bool,
        now: Instant,
    ) -> Reading {
        let since = now - self.observed;
        self.observed = now;
        let raw = match measured {
            Ok(range) => Some(range),
            Err(RangeError::TooNear(_)) => Some(TOUCHING),
            Err(RangeError::NoEcho(_)) => Some(CLEAR),
            Err(_) => None,
        };
        match raw {
            Some(raw) => self.replied(raw, moving, since, now),
            None => self.silent(now),
        }
        self.reading
    }

    fn silent(&mut self, now: Instant) {
        self.proof = 0;
        let silence = now - self.heard;
        if silence > STALE_AFTER {
            // What comes after a gap has nothing to do with what came before it.
            self.median.clear();
            self.last = None;
        }
        if silence >= DEAD_AFTER {
            self.reading.health = SensorHealth::Dead;
        }
    }

    fn replied(&mut self, raw: Millimeters, moving: bool, since: Duration, now: Instant) {
        self.heard = now;
        let jumped = self.last.is_some_and(|last| is_jump(last, raw));
        self.jumps = self.jumps << 1 | u8::from(jumped);
        let in_range = raw != CLEAR && raw != TOUCHING;
        let same = self.last == Some(raw) && in_range;
        if !same {
            self.same_for = Duration::ZERO;
        } else if moving {
            self.same_for = self.same_for + since;
        }
        self.last = Some(raw);
        self.proof = self.proof.saturating_add(1).min(PROVING);

        let filtered = self.median.push(raw);
        self.reading.health = self.judge();
        self.reading.sight = Some((
            match filtered {
                CLEAR => Sight::Clear,
                TOUCHING => Sight::Touching,
                range => Sight::Range(range),
            },
            now,
        ));
    }

    fn judge(&mut self) -> SensorHealth {
        let before = self.reading.health;
        let jumps = self.jumps.count_ones();
        if self.same_for >= STUCK_AFTER {
            self.proof = 0;
            SensorHealth::Stuck
        } else if jumps >= ABSURD_JUMPS || before == SensorHealth::Absurd && jumps > SANE_JUMPS {
            self.proof = 0;
            SensorHealth::Absurd
        } else if self.proof >= PROVING {
            SensorHealth::Good
        } else {
            before
        }
    }
}

/// Whether the sensor sees something else than a moment ago. Losing or finding an echo is not
/// counted: slanted walls do that.
fn is_jump(last: Millimeters, raw: Millimeters) -> bool {
    let seen = |range: Millimeters| range != CLEAR && range != TOUCHING;
    seen(last) && seen(raw) && last.0.abs_diff(raw.0) > JUMP_MM
}
