//! Fields of a message that stand beside the name of its kind, as those of faults do.
//!
//! There is no heap, so such a message is read in two steps: the fields that are there, each with its
//! type, then what the kind makes of them.

use serde::de::{Deserialize, Deserializer, Error, Unexpected};

/// A field that is there has a value: `null` is another type.
///
/// # Errors
/// Those of the value.
pub fn given<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<T>, D::Error> {
    T::deserialize(deserializer).map(Some)
}

/// The value of a field that must be there.
///
/// # Errors
/// When it is missing.
pub fn must<T, E: Error>(value: Option<T>, name: &'static str) -> Result<T, E> {
    value.ok_or_else(|| E::missing_field(name))
}

/// Refuses a field that is there and does not belong.
///
/// # Errors
/// When one is there that is not `allowed`.
pub fn only<const N: usize, E: Error>(
    there: [(&'static str, bool); N],
    allowed: &'static [&'static str],
) -> Result<(), E> {
    match there
        .iter()
        .find(|(name, there)| *there && !allowed.contains(name))
    {
        None => Ok(()),
        Some((name, _)) => Err(E::unknown_field(name, allowed)),
    }
}

/// A number from 1 to `most`.
///
/// # Errors
/// When it is another; `expected` says which it may be.
pub fn whole<E: Error>(value: u32, most: u32, expected: &'static &'static str) -> Result<u32, E> {
    if (1..=most).contains(&value) {
        Ok(value)
    } else {
        let number = Unexpected::Unsigned(value.into());
        Err(E::invalid_value(number, expected))
    }
}
