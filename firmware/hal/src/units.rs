//! Units as types, so that a millivolt is never taken for a millimetre.

/// A length in millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Millimeters(pub u16);

impl Millimeters {
    /// The same length in metres.
    #[must_use]
    pub fn as_meters(self) -> f32 {
        f32::from(self.0) * 1e-3
    }
}

/// A voltage in millivolts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Millivolts(pub u16);

/// A temperature in whole degrees Celsius, as the sensors of this robot resolve it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Celsius(pub i16);

/// A share of something, 0 to 100.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Percent(u8);

impl Percent {
    /// Everything.
    pub const FULL: Self = Self(100);

    /// A share of `value` percent; `None` above 100.
    #[must_use]
    pub const fn new(value: u8) -> Option<Self> {
        if value <= 100 {
            Some(Self(value))
        } else {
            None
        }
    }

    /// The number, 0 to 100.
    #[must_use]
    pub const fn get(self) -> u8 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percent_holds_only_what_it_says() {
        for value in 0..=u8::MAX {
            assert_eq!(
                Percent::new(value).map(Percent::get),
                (value <= 100).then_some(value)
            );
        }
    }
}
