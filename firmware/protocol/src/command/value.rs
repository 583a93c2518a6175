//! Values of parameters.

use core::fmt;

use heapless::{String, Vec};
use serde::de::{Error, Unexpected, Visitor};
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Most parameters in one command.
pub const MAX_SET: usize = 8;

/// Parameters to set, in the order in which they came. No name comes twice.
pub type ParameterValues = Vec<(String<32>, ParameterValue), MAX_SET>;

/// The value of one parameter: a JSON scalar.
#[derive(Debug, Clone, PartialEq)]
pub enum ParameterValue {
    /// Yes or no.
    Bool(bool),
    /// A finite number.
    Number(f32),
    /// A text without control characters.
    Text(String<64>),
}

/// Whether `text` can be the text of a parameter: no control characters.
pub(super) fn is_text(text: &str) -> bool {
    !text.chars().any(char::is_control)
}

impl Serialize for ParameterValue {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Bool(value) => serializer.serialize_bool(*value),
            Self::Number(value) if value.is_finite() => serializer.serialize_f32(*value),
            Self::Number(_) => Err(S::Error::custom("a number that is not finite")),
            Self::Text(value) => serializer.serialize_str(value),
        }
    }
}

impl<'de> Deserialize<'de> for ParameterValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ValueVisitor;

        impl Visitor<'_> for ValueVisitor {
            type Value = ParameterValue;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("true, false, a finite number, or a text of at most 64 bytes")
            }

            fn visit_bool<E: Error>(self, value: bool) -> Result<ParameterValue, E> {
                Ok(ParameterValue::Bool(value))
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<ParameterValue, E> {
                Ok(ParameterValue::Number(value as f32))
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<ParameterValue, E> {
                Ok(ParameterValue::Number(value as f32))
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<ParameterValue, E> {
                let number = value as f32;
                if number.is_finite() {
                    Ok(ParameterValue::Number(number))
                } else {
                    Err(E::invalid_value(Unexpected::Float(value), &self))
                }
            }

            fn visit_str<E: Error>(self, value: &str) -> Result<ParameterValue, E> {
                if !is_text(value) {
                    return Err(E::invalid_value(Unexpected::Str(value), &self));
                }
                String::try_from(value)
                    .map(ParameterValue::Text)
                    .map_err(|_| E::invalid_length(value.len(), &self))
            }
        }

        deserializer.deserialize_any(ValueVisitor)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for ParameterValue {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "ParameterValue".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "description": "The value of one parameter.",
            "type": ["boolean", "number", "string"],
            "minimum": f32::MIN,
            "maximum": f32::MAX,
            "maxLength": 64,
            "pattern": r"^[^\u0000-\u001f\u007f-\u009f]*$",
        })
    }
}
