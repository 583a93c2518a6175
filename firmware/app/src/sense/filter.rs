//! From raw measurements to a reading one may act upon.

use crawler_drivers::median::Median;
use crawler_drivers::us100::RangeError;
use crawler_hal::{Duration, Instant, Millimeters};

use crate::motion::wrap;
use crate::perception::{Reading, STALE_AFTER, SensorHealth, Sight};

/// Silence that makes a sensor dead: a dozen measurements.
const DEAD_AFTER: Duration = Duration::from_millis(1_000);
/// The very same range to the millimetre, for this long of driving. The real sensor's last digit
/// is never at rest that long, and a moving robot's surroundings are not either.
const STUCK_AFTER: Duration = Duration::from_millis(4_000);
/// No obstacle, and no robot, comes or goes this far between two measurements.
const JUMP_MM: u16 = 1_200;
/// So many jumps among the last sixteen measurements are absurd. A robot that drives past corners
/// sees one now and then, and one that hears the bursts of another sees four or five.
const ABSURD_JUMPS: u32 = 9;
/// A robot that has turned further than this between two measurements, in radians, looks elsewhere: a
/// jump says nothing of its sensor then. An escape turns three times as far in the time of a
/// measurement, and looks from one robot to the next.
const ELSEWHERE_RAD: f32 = 0.05;
/// Down to so many, the sensor is believed again.
const SANE_JUMPS: u32 = 3;
/// Two measurements this near each other show the same thing: two robots that meet at half a metre per second
/// each are so much nearer at the next one.
const AGREE_MM: u16 = 100;
/// For so long what was seen last counts where nothing is agreed on: longer than one measurement takes, so that a
/// single one is never believed, and less than half of what makes a view stale.
const AGREED_WITHIN: Duration = Duration::from_millis(130);
/// Good measurements in a row that make a sensor believed at first, or again.
const PROVING: u8 = 3;

/// Stands for [`Sight::Clear`] in the median: farther than anything.
const CLEAR: Millimeters = Millimeters(u16::MAX);
/// Stands for [`Sight::Touching`]: nearer than anything.
const TOUCHING: Millimeters = Millimeters(0);

/// What two of three measurements agree on, and the judgement of the sensor.
///
/// A ranger that hears the burst of another robot measures nonsense, mostly too near. As robots measure at
/// [uneven times](super::Jitter), it is other nonsense each time, and no two measurements agree on it (Borenstein
/// and Koren 1995, "Error eliminating rapid ultrasonic firing for mobile robot obstacle avoidance"). Where nothing
/// is agreed on, what was seen last stays; at the second time in a row the median counts, for else a robot would be
/// blind that faces another one, or turns slowly along a slanted wall. So it does, each time, while a robot turns:
/// it looks at another thing each time.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RangeFilter {
    median: Median<3>,
    reading: Reading,
    /// Last reply, of whatever content.
    heard: Instant,
    /// Last observation.
    observed: Instant,
    /// Last range, and where it was looked for: the heading, in radians.
    last: Option<(Millimeters, f32)>,
    /// The range before the last.
    before: Option<Millimeters>,
    /// Whether the newest range may be believed by itself.
    is_confirmed: bool,
    /// How long the robot has been driving on the same range.
    same_for: Duration,
    /// One bit per reply, the newest lowest: whether it jumped to what was not there before, although the robot
    /// looked the same way.
    jumps: u16,
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
            before: None,
            is_confirmed: false,
            same_for: Duration::ZERO,
            jumps: 0,
            proof: 0,
        }
    }

    /// The present reading.
    pub const fn reading(&self) -> Reading {
        self.reading
    }

    /// Whether the newest measurement shows what one of the two before it has shown, or the robot turns.
    pub const fn is_confirmed(&self) -> bool {
        self.is_confirmed
    }

    /// Takes one measurement in; `moving` tells whether the wheels are driven, and `heading` where the
    /// robot looks, in radians of odometry.
    pub fn observe(
        &mut self,
        measured: Result<Millimeters, RangeError>,
        moving: bool,
        heading: f32,
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
            Some(raw) => {
                self.same_for = if self.repeats(raw) {
                    self.same_for + if moving { since } else { Duration::ZERO }
                } else {
                    Duration::ZERO
                };
                self.replied(raw, heading, now);
            }
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
            self.before = None;
        }
        if silence >= DEAD_AFTER {
            self.reading.health = SensorHealth::Dead;
        }
    }

    /// Whether the sensor says the very same as last time.
    fn repeats(&self, raw: Millimeters) -> bool {
        let in_range = raw != CLEAR && raw != TOUCHING;
        in_range && self.last.is_some_and(|(last, _)| last == raw)
    }

    fn replied(&mut self, raw: Millimeters, heading: f32, now: Instant) {
        self.heard = now;
        let looks_elsewhere = self
            .last
            .is_some_and(|(_, looked)| libm::fabsf(wrap(heading - looked)) > ELSEWHERE_RAD);
        let last = self.last.map(|(last, _)| last);
        let before = core::mem::replace(&mut self.before, last);
        let is_repeated = [last, before]
            .into_iter()
            .flatten()
            .any(|one| do_agree(one, raw));
        let jumped = !is_repeated && last.is_some_and(|last| is_jump(last, raw));
        // Nor does looking elsewhere clear a sensor of what it has said.
        if !(looks_elsewhere && self.reading.health == SensorHealth::Absurd) {
            self.jumps = self.jumps << 1 | u16::from(jumped && !looks_elsewhere);
        }
        self.last = Some((raw, heading));
        self.is_confirmed = is_repeated || looks_elsewhere;
        self.proof = self.proof.saturating_add(1).min(PROVING);

        let median = self.median.push(raw);
        self.reading.health = self.judge();
        let is_old = |(_, at): (Sight, Instant)| now - at > AGREED_WITHIN;
        let seen = if looks_elsewhere {
            median
        } else if is_repeated {
            raw
        } else if let (Some(last), Some(before)) = (last, before)
            && do_agree(last, before)
        {
            last
        } else if self.reading.sight.is_some_and(is_old) {
            median
        } else {
            return;
        };
        self.reading.sight = Some((
            match seen {
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

/// Whether two measurements show the same thing.
fn do_agree(one: Millimeters, other: Millimeters) -> bool {
    one.0.abs_diff(other.0) <= AGREE_MM
}
