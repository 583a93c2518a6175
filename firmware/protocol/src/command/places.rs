//! A few places on the floor, as parameters of behaviours.

use core::fmt;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{MAX_COORDINATE, ParameterValue};

/// Most places in one command.
pub const MAX_PLACES: usize = 8;

/// Up to [`MAX_PLACES`] places, in the order in which they came: metres along the x axis and along the
/// y axis, each within ±[`MAX_COORDINATE`]. On the wire an array of arrays of two numbers.
#[derive(Clone, Copy, PartialEq, Default)]
pub struct Places {
    at: [[f32; 2]; MAX_PLACES],
    count: u8,
}

impl Places {
    /// None yet.
    pub const NONE: Self = Self {
        at: [[0.0; 2]; MAX_PLACES],
        count: 0,
    };

    /// These places; `None` where there are too many, or one is too far away or no place.
    #[must_use]
    pub fn new(places: &[[f32; 2]]) -> Option<Self> {
        let mut all = Self::NONE;
        places.iter().all(|place| all.push(*place)).then_some(all)
    }

    /// Adds one behind the others. Whether there was room, and it is one.
    pub fn push(&mut self, place: [f32; 2]) -> bool {
        let is_place = place.iter().all(|along| along.abs() <= MAX_COORDINATE);
        match self.at.get_mut(usize::from(self.count)) {
            Some(free) if is_place => {
                *free = place;
                self.count += 1;
                true
            }
            Some(_) | None => false,
        }
    }

    /// All of them.
    #[must_use]
    pub fn as_slice(&self) -> &[[f32; 2]] {
        self.at.get(..usize::from(self.count)).unwrap_or_default()
    }

    /// How many there are.
    #[must_use]
    pub const fn count(&self) -> u8 {
        self.count
    }
}

impl fmt::Debug for Places {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.as_slice()).finish()
    }
}

impl Serialize for Places {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // Through `ParameterValue`, as other numbers of commands.
        serializer.collect_seq(
            self.as_slice()
                .iter()
                .map(|place| place.map(ParameterValue::Number)),
        )
    }
}

impl<'de> Deserialize<'de> for Places {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct PlacesVisitor;

        impl<'de> Visitor<'de> for PlacesVisitor {
            type Value = Places;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("up to eight places within 10 km, each two numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut all: A) -> Result<Places, A::Error> {
                let mut places = Places::NONE;
                while let Some(place) = all.next_element::<[f32; 2]>()? {
                    if !places.push(place) {
                        return Err(A::Error::invalid_length(
                            usize::from(places.count) + 1,
                            &self,
                        ));
                    }
                }
                Ok(places)
            }
        }

        deserializer.deserialize_seq(PlacesVisitor)
    }
}
