//! Reading what a server says, by hand: a robot has no room for what reads any structure there may be. A test holds it
//! against what a derived reader takes, and finds wrong.

use super::{BuildId, ReleaseId, UpdateCommand, UpdateDelta, UpdateName};
use crate::MAX_MESSAGE;
use crate::json::{DecodeError, MAX_DEPTH, Reader, Text, Value, prove};

/// Longest name of a field, and of a message.
const MAX_NAME: usize = 16;

/// See [`UpdateCommand::from_json`].
pub(super) fn command(payload: &[u8]) -> Result<Option<UpdateCommand>, DecodeError> {
    if payload.len() > MAX_MESSAGE {
        return Err(DecodeError::TooLarge);
    }
    let text = core::str::from_utf8(payload).map_err(|_| DecodeError::Malformed)?;
    prove(text)?;

    // What it is, whatever stands beside it.
    let mut update = None;
    members(&mut Reader::new(text), &mut |reader, name| {
        if name == "update" {
            once(&mut update, || update_name(reader))
        } else {
            reader.skip(MAX_DEPTH)
        }
    })?;
    let update = update.ok_or(DecodeError::MissingField)?;
    if matches!(
        update,
        UpdateName::Have | UpdateName::Want | UpdateName::Progress | UpdateName::Outcome
    ) {
        return Ok(None);
    }

    let (mut again, mut release, mut delta) = (None, None, None);
    members(&mut Reader::new(text), &mut |reader, name| match name {
        "update" => once(&mut again, || update_name(reader)),
        "release" => once(&mut release, || release_id(reader)),
        "delta" => once(&mut delta, || {
            let before = reader.clone();
            if let Value::Null = reader.value()? {
                return Ok(None);
            }
            *reader = before;
            update_delta(reader).map(Some)
        }),
        _ => Err(DecodeError::UnknownField),
    })?;
    let release = release.ok_or(DecodeError::MissingField)?;
    let delta = delta.flatten();
    match update {
        UpdateName::Offer => Ok(Some(UpdateCommand::Offer { release, delta })),
        _ if delta.is_some() => Err(DecodeError::UnknownField),
        UpdateName::Confirm => Ok(Some(UpdateCommand::Confirm { release })),
        _ => Ok(Some(UpdateCommand::Cancel { release })),
    }
}

/// Has `take` read the value of each member of an object. Not generic: there is one of it.
fn members<'a>(
    reader: &mut Reader<'a>,
    take: &mut dyn FnMut(&mut Reader<'a>, &str) -> Result<(), DecodeError>,
) -> Result<(), DecodeError> {
    let Value::Object = reader.value()? else {
        return Err(DecodeError::WrongType);
    };
    reader.open_object()?;
    let mut first = true;
    while let Some(name) = reader.member(first)? {
        first = false;
        // A longer one is none of ours.
        let name = name.decode::<MAX_NAME>().unwrap_or_default();
        take(reader, &name)?;
    }
    Ok(())
}

/// Keeps the value of a field that was not met before.
fn once<T>(
    place: &mut Option<T>,
    read: impl FnOnce() -> Result<T, DecodeError>,
) -> Result<(), DecodeError> {
    if place.is_some() {
        return Err(DecodeError::DuplicateField);
    }
    *place = Some(read()?);
    Ok(())
}

fn text<'a>(reader: &mut Reader<'a>) -> Result<Text<'a>, DecodeError> {
    match reader.value()? {
        Value::Text(text) => Ok(text),
        _ => Err(DecodeError::WrongType),
    }
}

fn update_name(reader: &mut Reader<'_>) -> Result<UpdateName, DecodeError> {
    let name = text(reader)?.decode::<MAX_NAME>();
    name.and_then(|name| UpdateName::from_name(&name))
        .ok_or(DecodeError::OutOfRange)
}

fn release_id(reader: &mut Reader<'_>) -> Result<ReleaseId, DecodeError> {
    let digits = text(reader)?.decode::<16>();
    digits
        .and_then(|digits| digits.parse().ok())
        .ok_or(DecodeError::OutOfRange)
}

fn update_delta(reader: &mut Reader<'_>) -> Result<UpdateDelta, DecodeError> {
    let (mut base, mut bytes) = (None, None);
    members(reader, &mut |reader, name| match name {
        "base" => once(&mut base, || {
            let name = text(reader)?.decode::<{ super::MAX_BUILD }>();
            name.and_then(|name| BuildId::new(&name).ok())
                .ok_or(DecodeError::OutOfRange)
        }),
        "bytes" => once(&mut bytes, || match reader.value()? {
            Value::Number(digits) if !digits.contains(['.', 'e', 'E']) => {
                let number = digits.parse::<i64>().ok();
                number
                    .and_then(|number| u32::try_from(number).ok())
                    .ok_or(DecodeError::OutOfRange)
            }
            _ => Err(DecodeError::WrongType),
        }),
        _ => Err(DecodeError::UnknownField),
    })?;
    Ok(UpdateDelta {
        base: base.ok_or(DecodeError::MissingField)?,
        bytes: bytes.ok_or(DecodeError::MissingField)?,
    })
}

#[cfg(test)]
mod tests {
    use std::format;
    use std::string::String;
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;
    use crate::json::from_slice;

    #[derive(serde::Deserialize)]
    struct Named {
        update: UpdateName,
    }

    /// Every field that one of the three can have.
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Fields {
        #[serde(rename = "update")]
        _update: UpdateName,
        release: ReleaseId,
        delta: Option<Delta>,
    }

    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Delta {
        base: BuildId,
        bytes: u32,
    }

    /// What is made of a message by what reads any structure.
    fn derived(payload: &[u8]) -> Result<Option<UpdateCommand>, DecodeError> {
        let update = from_slice::<Named>(payload)?.update;
        if !matches!(
            update,
            UpdateName::Offer | UpdateName::Confirm | UpdateName::Cancel
        ) {
            return Ok(None);
        }
        let Fields { release, delta, .. } = from_slice(payload)?;
        let delta = delta.map(|Delta { base, bytes }| UpdateDelta { base, bytes });
        match update {
            UpdateName::Offer => Ok(Some(UpdateCommand::Offer { release, delta })),
            _ if delta.is_some() => Err(DecodeError::UnknownField),
            UpdateName::Confirm => Ok(Some(UpdateCommand::Confirm { release })),
            _ => Ok(Some(UpdateCommand::Cancel { release })),
        }
    }

    fn values() -> impl Strategy<Value = String> {
        prop_oneof![
            8 => Just(r#""9f2c1ab034d5e6f7""#.into()),
            1 => Just(r#""9f2c1ab034d5e6\u0066\u0037""#.into()),
            1 => Just(r#""9F2c1ab034d5e6f7""#.into()),
            6 => Just(r#"{"base":"0.3.0+1f","bytes":41984}"#.into()),
            2 => members(3, nested(), sizes()),
            1 => Just("null".into()),
            1 => Just("[1,{}]".into()),
            1 => sizes(),
            1 => Just("true".into()),
            1 => Just(r#""a text that is longer than any name or number here""#.into()),
        ]
    }

    fn sizes() -> impl Strategy<Value = String> + Clone {
        prop_oneof![
            4 => any::<u32>().prop_map(|number| format!("{number}")),
            1 => Just("4294967296".into()),
            1 => Just("-1".into()),
            1 => Just("-0".into()),
            1 => Just("1.0".into()),
            1 => Just("1e2".into()),
            1 => Just("99999999999999999999999999999999999999999999".into()),
            1 => Just(r#""0.3.0""#.into()),
        ]
    }

    fn nested() -> impl Strategy<Value = String> + Clone {
        prop_oneof![3 => Just("base".into()), 3 => Just("bytes".into()), 1 => Just("x".into())]
    }

    fn names() -> impl Strategy<Value = String> + Clone {
        prop_oneof![
            8 => Just("release".into()),
            4 => Just("delta".into()),
            1 => Just("update".into()),
            1 => Just("bu\\u0069ld".into()),
            1 => Just("a-name-of-some-more-letters".into()),
        ]
    }

    fn members(
        most: usize,
        names: impl Strategy<Value = String>,
        values: impl Strategy<Value = String>,
    ) -> impl Strategy<Value = String> {
        prop::collection::vec((names, values), 0..=most).prop_map(|members| {
            let members: Vec<String> = members
                .iter()
                .map(|(name, value)| format!(r#""{name}":{value}"#))
                .collect();
            format!("{{{}}}", members.join(" , "))
        })
    }

    fn messages() -> impl Strategy<Value = String> {
        let word = prop_oneof![
            3 => Just(r#""offer""#), 2 => Just(r#""confirm""#), 2 => Just(r#""cancel""#),
            1 => Just(r#""have""#), 1 => Just(r#""erase""#), 1 => Just("7"),
        ];
        (word, members(4, names(), values()), any::<bool>()).prop_map(|(word, rest, first)| {
            let inner = &rest[1..rest.len() - 1];
            match (inner.is_empty(), first) {
                (true, _) => format!(r#"{{"update":{word}}}"#),
                (false, true) => format!(r#"{{"update":{word},{inner}}}"#),
                (false, false) => format!(r#"{{{inner},"update":{word}}}"#),
            }
        })
    }

    proptest! {
        #![proptest_config(crawler_properties::cases(4_000))]

        #[test]
        fn by_hand_and_derived_are_the_same(message in messages(), cut in prop::option::weighted(0.1, 0..120_usize)) {
            let bytes = message.as_bytes();
            let bytes = bytes.get(..cut.unwrap_or(bytes.len())).unwrap_or(bytes);
            prop_assert_eq!(command(bytes), derived(bytes), "{}", message);
        }
    }
}
