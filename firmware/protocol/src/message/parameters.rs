//! The parameters of a robot: values and what they may be.

use core::fmt;
use core::marker::PhantomData;

use heapless::{String, Vec};
use serde::de::{self, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::{DecodeError, EncodeError, ParameterValue, RobotId, json};

/// Most parameters of one robot. As many fit a message, whatever their values, as long as their names
/// have no more than 17 bytes on average, and no more than one of them is a text, which needs no
/// escapes.
pub const MAX_PARAMETERS: usize = 20;

/// The parameters of one robot.
pub type Reports = Vec<ParameterReport, MAX_PARAMETERS>;

/// One parameter: its value and what it may be.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterReport {
    /// Its name. No name comes twice.
    pub name: String<20>,
    /// Its value.
    pub value: ParameterValue,
    /// Its value in a robot as it comes; `None` where it was left out for room.
    pub default: Option<ParameterValue>,
    /// Its least value; `None` where there is none, or it was left out for room.
    pub min: Option<f32>,
    /// Its greatest value; `None` where there is none, or it was left out for room.
    pub max: Option<f32>,
    /// Its unit; `None` where there is none, or it was left out for room. A name says its unit too
    /// where that is not the SI unit.
    pub unit: Option<String<8>>,
}

/// The parameters of a robot, retained.
///
/// On the wire `values` is an object with one member per parameter:
/// `"safe_distance_mm":{"value":600,"default":500,"min":100,"max":2000,"unit":"mm"}`.
/// A retained message cannot be split, so what says least is left out where it would be too large:
/// first units, then defaults, then ranges. Values are always there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ParametersMessage {
    /// The robot.
    pub robot: RobotId,
    /// Its parameters.
    #[serde(serialize_with = "everything", deserialize_with = "members")]
    #[cfg_attr(
        feature = "schema",
        schemars(
            with = "std::collections::BTreeMap<std::string::String, Body>",
            length(max = 20)
        )
    )]
    pub values: Reports,
}

/// How much to tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Detail {
    Values,
    Ranges,
    Defaults,
    Units,
}

impl ParametersMessage {
    /// Writes the message as JSON to the front of `buf` and returns its length.
    ///
    /// # Errors
    /// [`EncodeError::TooLarge`] when not even the values fit `buf`, or more than one of them is a
    /// long text; [`EncodeError::NotFinite`] when a value is not.
    pub fn to_json(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        Self::encode(&self.robot, || self.values.iter().cloned(), buf)
    }

    /// The same for a message that is not in one place: `reports` gives its parameters one by
    /// one, and is asked again each time something has to be left out. All of them at once take
    /// five kilobytes, which a robot's stack does not have.
    ///
    /// # Errors
    /// As [`Self::to_json`].
    pub fn encode<I: Iterator<Item = ParameterReport>>(
        robot: &RobotId,
        reports: impl Fn() -> I,
        buf: &mut [u8],
    ) -> Result<usize, EncodeError> {
        #[derive(Serialize)]
        #[serde(bound = "F: Fn() -> I, I: Iterator<Item = ParameterReport>")]
        struct Fitting<'a, F, I> {
            robot: &'a RobotId,
            values: Members<'a, F, I>,
        }

        let mut result = Err(EncodeError::TooLarge);
        for detail in [
            Detail::Units,
            Detail::Defaults,
            Detail::Ranges,
            Detail::Values,
        ] {
            let fitting = Fitting {
                robot,
                values: Members {
                    reports: &reports,
                    detail,
                    each: PhantomData,
                },
            };
            result = json::to_slice(&fitting, buf);
            if result != Err(EncodeError::TooLarge) {
                break;
            }
        }
        result
    }

    /// Reads the message from the whole of `payload`.
    ///
    /// # Errors
    /// [`DecodeError`] names what is wrong with `payload`.
    pub fn from_json(payload: &[u8]) -> Result<Self, DecodeError> {
        json::from_slice(payload)
    }
}

/// A parameter on the wire, without its name.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "ParameterReport"))]
#[serde(deny_unknown_fields)]
struct Body {
    value: ParameterValue,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    default: Option<ParameterValue>,
    #[serde(default, with = "crate::number::optional")]
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f32>"))]
    min: Option<f32>,
    #[serde(default, with = "crate::number::optional")]
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f32>"))]
    max: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "Option<std::string::String>", length(max = 8))
    )]
    unit: Option<String<8>>,
}

/// The reports as an object.
struct Members<'a, F, I> {
    reports: &'a F,
    detail: Detail,
    each: PhantomData<I>,
}

impl<F, I> Serialize for Members<'_, F, I>
where
    F: Fn() -> I,
    I: Iterator<Item = ParameterReport>,
{
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let finite = |value: Option<f32>| value.filter(|value| value.is_finite());
        let mut map = serializer.serialize_map(None)?;
        for report in (self.reports)() {
            let ranges = self.detail >= Detail::Ranges;
            let body = Body {
                value: report.value,
                default: report.default.filter(|_| self.detail >= Detail::Defaults),
                min: finite(report.min).filter(|_| ranges),
                max: finite(report.max).filter(|_| ranges),
                unit: report.unit.filter(|_| self.detail >= Detail::Units),
            };
            map.serialize_entry(report.name.as_str(), &body)?;
        }
        map.end()
    }
}

fn everything<S: Serializer>(reports: &Reports, serializer: S) -> Result<S::Ok, S::Error> {
    let members = Members {
        reports: &|| reports.iter().cloned(),
        detail: Detail::Units,
        each: PhantomData,
    };
    members.serialize(serializer)
}

fn members<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Reports, D::Error> {
    struct MembersVisitor;

    impl<'de> Visitor<'de> for MembersVisitor {
        type Value = Reports;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "an object of at most {MAX_PARAMETERS} parameters")
        }

        fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Reports, A::Error> {
            let mut reports = Reports::new();
            while let Some((name, body)) = map.next_entry::<String<20>, Body>()? {
                if reports.iter().any(|report| report.name == name) {
                    return Err(de::Error::duplicate_field("values"));
                }
                let report = ParameterReport {
                    name,
                    value: body.value,
                    default: body.default,
                    min: body.min,
                    max: body.max,
                    unit: body.unit,
                };
                if reports.push(report).is_err() {
                    return Err(de::Error::invalid_length(MAX_PARAMETERS + 1, &self));
                }
            }
            Ok(reports)
        }
    }

    deserializer.deserialize_map(MembersVisitor)
}
