//! Angles, directions and lengths in whole numbers, for boards without a floating-point unit: on one of those a
//! sine of `libm` takes 1,700 instructions, and one of these 20.
//!
//! Estimates and duties stay in `f32`; what is reckoned for every neighbour is in millimetres and in these.

use core::f32::consts::PI;

use crawler_protocol::Pose;

/// What stands for 1 in sines, cosines and directions.
pub const ONE: i32 = 1 << ONE_BITS;
/// The same as a shift.
pub const ONE_BITS: u32 = 14;
/// Longest coordinate that [`length`] and [`Angle::of`] take as it is; of longer ones the low bits count for nothing.
const LONGEST: u32 = 1 << 15;

/// An angle as a binary fraction of a full turn, counter-clockwise from the x axis: sums and differences wrap by
/// themselves. One unit is 0.0055°.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Angle(i16);

/// Units of a radian.
const PER_RADIAN: f32 = 32_768.0 / PI;
const QUARTER: i32 = 1 << 14;
/// Units of a turn.
pub const TURN: i32 = 1 << 16;

impl Angle {
    /// The angle of so many units.
    pub const fn from_units(units: i16) -> Self {
        Self(units)
    }

    /// Units, from −2¹⁵ up to below 2¹⁵.
    pub const fn units(self) -> i16 {
        self.0
    }

    /// Which of `parts` equal parts of a full turn it is in, counted counter-clockwise from the x axis.
    pub const fn part(self, parts: u16) -> usize {
        (self.0.cast_unsigned() as usize * parts as usize) >> 16
    }

    /// The angle of so many radians; 0 for what is no number.
    pub const fn from_radians(radians: f32) -> Self {
        // Saturating, then around as often as it takes.
        Self((radians * PER_RADIAN) as i32 as i16)
    }

    /// Radians, from −π up to below π.
    pub fn radians(self) -> f32 {
        f32::from(self.0) * (PI / 32_768.0)
    }

    /// The direction of a vector, to 0.0002 rad; 0 for one without a length.
    pub const fn of(vector: [i32; 2]) -> Self {
        let ([x, y], _) = fitted(vector);
        let (across, along) = (x.unsigned_abs(), y.unsigned_abs());
        let steep = along > across;
        let (short, long) = if steep {
            (across, along)
        } else {
            (along, across)
        };
        if long == 0 {
            return Self(0);
        }
        // Hastings, Approximations for Digital Computers, 1955, sheet 9, in quarters of a unit.
        let ratio = ((short << ONE_BITS) / long) as i32;
        let square = (ratio * ratio) >> ONE_BITS;
        let mut sum = (-1_627 * square) >> ONE_BITS;
        sum = ((6_103 + sum) * square) >> ONE_BITS;
        sum = ((-13_400 + sum) * square) >> ONE_BITS;
        let mut angle = ((41_689 + sum) * ratio + 2 * ONE) >> (ONE_BITS + 2);
        if steep {
            angle = QUARTER - angle;
        }
        if x < 0 {
            angle = 2 * QUARTER - angle;
        }
        if y < 0 {
            angle = -angle;
        }
        Self(angle as i16)
    }

    /// Cosine and sine, in 1/[`ONE`], to four of them.
    pub const fn direction(self) -> [i32; 2] {
        [sine(self.0.wrapping_add(QUARTER as i16)), sine(self.0)]
    }

    /// The sum of both.
    #[must_use]
    pub const fn plus(self, other: Self) -> Self {
        Self(self.0.wrapping_add(other.0))
    }

    /// What is left of it without `other`, the short way round.
    #[must_use]
    pub const fn minus(self, other: Self) -> Self {
        Self(self.0.wrapping_sub(other.0))
    }

    /// Milliradians, from −3,142 to 3,142.
    pub const fn milliradians(self) -> i32 {
        (self.0 as i32 * 6_283) >> 16
    }

    /// The angle of so many milliradians.
    pub const fn from_milliradians(milliradians: i32) -> Self {
        Self(((milliradians * 10_681) >> 10) as i16)
    }
}

/// The sine in 1/[`ONE`]: odd in the half turn about 0, and the same mirrored in the other one.
const fn sine(angle: i16) -> i32 {
    let angle = angle as i32;
    let x = if angle > QUARTER {
        2 * QUARTER - angle
    } else if angle < -QUARTER {
        -2 * QUARTER - angle
    } else {
        angle
    };
    // Hastings, sheet 14: of a quarter turn as 1.
    let square = (x * x) >> ONE_BITS;
    let mut sum = (1_191 * square) >> ONE_BITS;
    sum = ((-10_539 + sum) * square) >> ONE_BITS;
    ((25_733 + sum) * x + ONE / 2) >> ONE_BITS
}

/// The vector, halved until both coordinates are within [`LONGEST`], and how often.
const fn fitted([mut x, mut y]: [i32; 2]) -> ([i32; 2], u32) {
    let mut halved = 0;
    while x.unsigned_abs() > LONGEST || y.unsigned_abs() > LONGEST {
        x /= 2;
        y /= 2;
        halved += 1;
    }
    ([x, y], halved)
}

/// The length of a vector, to one of its last digits: of one that is longer than `LONGEST` to 1/6,000.
pub const fn length(vector: [i32; 2]) -> i32 {
    let ([x, y], halved) = fitted(vector);
    let (x, y) = (x.unsigned_abs(), y.unsigned_abs());
    let (short, long) = if x < y { (x, y) } else { (y, x) };
    if short == 0 {
        return saturated(long, halved);
    }
    // Within a thirtieth, and each step of Newton's method squares that.
    let mut guess = long - long / 8 + short / 2;
    if guess < long {
        guess = long;
    }
    let square = x * x + y * y;
    guess = (guess + square / guess) >> 1;
    guess = (guess + square / guess) >> 1;
    saturated(guess, halved)
}

const fn saturated(value: u32, halved: u32) -> i32 {
    let value = (value as u64) << halved;
    if value > i32::MAX as u64 {
        i32::MAX
    } else {
        value as i32
    }
}

/// The direction of a vector, in 1/[`ONE`]; that of the x axis for one without a length.
pub const fn unit(vector: [i32; 2]) -> [i32; 2] {
    let ([x, y], _) = fitted(vector);
    let length = length([x, y]);
    if length == 0 {
        return [ONE, 0];
    }
    [(x << ONE_BITS) / length, (y << ONE_BITS) / length]
}

/// A length of so many metres in millimetres; saturating, and 0 for what is no number.
pub const fn millimetres(metres: f32) -> i32 {
    (metres * 1_000.0) as i32
}

/// A pose in whole numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PoseMm {
    /// Millimetres along both axes.
    pub at: [i32; 2],
    /// Heading.
    pub heading: Angle,
    /// The same as a direction.
    pub ahead: [i32; 2],
}

impl PoseMm {
    /// A pose in whole numbers; 0 for what is no number.
    pub fn new(pose: &Pose) -> Self {
        let heading = Angle::from_radians(pose.theta);
        Self {
            at: [pose.x, pose.y].map(millimetres),
            heading,
            ahead: heading.direction(),
        }
    }

    /// A vector of up to 40,000 along its heading, and across it to the left.
    pub const fn turned(&self, vector: [i32; 2]) -> [i32; 2] {
        turned(vector, self.ahead)
    }
}

/// A vector of up to 40,000 along a direction, and across it to the left.
pub const fn turned([x, y]: [i32; 2], [cos, sin]: [i32; 2]) -> [i32; 2] {
    [
        (x * cos + y * sin) >> ONE_BITS,
        (y * cos - x * sin) >> ONE_BITS,
    ]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn every_angle_has_its_sine_and_cosine_and_comes_back_from_them() {
        for units in i16::MIN..=i16::MAX {
            let angle = Angle(units);
            let exact = f64::from(units) * (core::f64::consts::PI / 32_768.0);
            let [cos, sin] = angle.direction();
            for (one, other) in [(cos, exact.cos()), (sin, exact.sin())] {
                let off = f64::from(one) - other * f64::from(ONE);
                assert!(off.abs() <= 4.0, "{units}: {one} is off by {off}");
            }
            let back = Angle::of([cos, sin]).minus(angle);
            assert!(back.0.abs() <= 3, "{units}: {back:?}");
            assert!(back.radians().abs() <= 0.000_3);
            assert_eq!(
                Angle::from_radians(angle.radians()).minus(angle).0.abs() / 2,
                0
            );
            let mrad = f64::from(angle.milliradians());
            assert!((mrad - exact * 1_000.0).abs() <= 1.5, "{units}: {mrad}");
            let again = Angle::from_milliradians(angle.milliradians()).minus(angle);
            assert!(again.0.abs() <= 24, "{units}: {again:?}");
        }
    }

    #[test]
    fn what_is_no_number_is_some_angle() {
        assert_eq!(Angle::from_radians(f32::NAN), Angle(0));
        for radians in [f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
            let _ = Angle::from_radians(radians).direction();
        }
        let far = 7.0 - 2.0 * PI;
        assert!((Angle::from_radians(7.0).radians() - far).abs() < 2e-4);
        assert_eq!(Angle::of([0, 0]), Angle(0));
        assert_eq!(unit([0, 0]), [ONE, 0]);
        assert_eq!((length([0, 0]), length([3, -4])), (0, 5));
    }

    #[test]
    fn lengths_of_short_vectors_are_exact_to_the_digit() {
        for x in -300..300_i32 {
            for y in -300..300_i32 {
                let off = f64::from(length([x, y])) - f64::from(x).hypot(f64::from(y));
                assert!((-1.0..=1.0).contains(&off), "{x} {y}: {off}");
            }
        }
    }

    proptest! {
        #![proptest_config(crawler_properties::cases(5_000))]
        #[test]
        fn lengths_and_directions_are_those_of_floats(
            x in prop_oneof![-20_000..20_000_i32, any::<i32>()],
            y in prop_oneof![-20_000..20_000_i32, any::<i32>()],
        ) {
            let exact = f64::from(x).hypot(f64::from(y));
            let found = f64::from(length([x, y]));
            prop_assert!((found - exact.min(f64::from(i32::MAX))).abs() <= 1.0 + exact / 6_000.0, "{found} for {exact}");
            if exact > 2_000.0 {
                let angle = f64::from(y).atan2(f64::from(x)) as f32;
                let off = Angle::of([x, y]).minus(Angle::from_radians(angle)).radians();
                prop_assert!(off.abs() <= 0.000_4, "{off}");
                let [cos, sin] = unit([x, y]);
                let off = (f64::from(cos) - f64::from(x) / exact * f64::from(ONE)).hypot(f64::from(sin) - f64::from(y) / exact * f64::from(ONE));
                prop_assert!(off <= 12.0, "{off}");
            }
        }
    }
}
