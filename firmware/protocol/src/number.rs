//! Numbers that must be numbers: what is not finite neither leaves nor enters.

use serde::de::{Error as _, Unexpected};
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serializer};

// The signature is that of `serde(with)`.
#[allow(clippy::trivially_copy_pass_by_ref)]
pub(crate) fn serialize<S: Serializer>(value: &f32, serializer: S) -> Result<S::Ok, S::Error> {
    if value.is_finite() {
        serializer.serialize_f32(*value)
    } else {
        Err(S::Error::custom("a number that is not finite"))
    }
}

pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f32, D::Error> {
    let value = f32::deserialize(deserializer)?;
    finite(value)
        .ok_or_else(|| D::Error::invalid_value(Unexpected::Float(value.into()), &"a finite number"))
}

fn finite(value: f32) -> Option<f32> {
    value.is_finite().then_some(value)
}

/// A share of 0 to 100 %.
pub(crate) fn percent<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u8, D::Error> {
    let value = u8::deserialize(deserializer)?;
    if value <= 100 {
        Ok(value)
    } else {
        Err(D::Error::invalid_value(
            Unexpected::Unsigned(value.into()),
            &"0 to 100",
        ))
    }
}

/// The same for numbers that may be missing: what is not finite leaves as `null`.
pub(crate) mod optional {
    use super::{Deserialize, Deserializer, Serializer, finite};
    use serde::de::{Error as _, Unexpected};

    // The signature is that of `serde(with)`.
    #[allow(clippy::ref_option, clippy::trivially_copy_pass_by_ref)]
    pub(crate) fn serialize<S: Serializer>(
        value: &Option<f32>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        match value.and_then(finite) {
            Some(value) => serializer.serialize_some(&value),
            None => serializer.serialize_none(),
        }
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<f32>, D::Error> {
        let value = Option::<f32>::deserialize(deserializer)?;
        match value {
            Some(value) if !value.is_finite() => Err(D::Error::invalid_value(
                Unexpected::Float(value.into()),
                &"a finite number or null",
            )),
            other => Ok(other),
        }
    }
}
