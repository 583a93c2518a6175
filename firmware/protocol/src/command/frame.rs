//! The first step: bytes to a frame of bounded scalars, and of places.

use heapless::{String, Vec};

use super::{CommandName, MAX_SET, Places};
use crate::json::{self, MAX_DEPTH, Reader, Text, Value};
use crate::{DecodeError, MAX_MESSAGE, Reason, Source};

/// A parameter as it stands in the text.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Scalar {
    Bool(bool),
    /// Finite.
    Number(f64),
    Text(String<64>),
    /// An array of arrays of two numbers.
    Places(Places),
}

/// Everything read of a command, and the first thing found wrong with it.
#[derive(Debug, Default)]
pub(super) struct Frame {
    pub(super) fault: Option<Reason>,
    pub(super) command: Option<CommandName>,
    pub(super) parameters: Vec<(String<32>, Scalar), MAX_SET>,
    /// A parameter's name was longer than any name is. What that means depends on the command.
    pub(super) long_name: bool,
    pub(super) timestamp: Option<u64>,
    pub(super) seq: Option<u64>,
    pub(super) source: Option<Source>,
}

/// Which fields there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Expect {
    /// All of them.
    Command,
    /// `command` and `parameters`.
    Action,
}

/// The fields of a command.
#[derive(Debug, Clone, Copy)]
enum Field {
    Command,
    Parameters,
    Timestamp,
    Seq,
    Source,
}

impl Field {
    fn from_name(name: &str, expect: Expect) -> Option<Self> {
        match (name, expect) {
            ("command", _) => Some(Self::Command),
            ("parameters", _) => Some(Self::Parameters),
            ("timestamp", Expect::Command) => Some(Self::Timestamp),
            ("seq", Expect::Command) => Some(Self::Seq),
            ("source", Expect::Command) => Some(Self::Source),
            _ => None,
        }
    }
}

/// Reads as much as can be read.
pub(super) fn read(payload: &[u8], expect: Expect) -> Frame {
    let mut frame = Frame::default();
    let fits = payload.get(..MAX_MESSAGE).unwrap_or(payload);
    let (text, whole) = match core::str::from_utf8(fits) {
        Ok(text) => (text, fits.len() == payload.len()),
        Err(error) => {
            let valid = fits.get(..error.valid_up_to()).unwrap_or_default();
            (core::str::from_utf8(valid).unwrap_or_default(), false)
        }
    };
    let syntax = frame.object(text, expect);
    if payload.len() > MAX_MESSAGE {
        frame.fault = Some(Reason::TooLarge);
    } else if syntax.is_err() || !whole {
        frame.fault = Some(Reason::Malformed);
    }
    frame
}

impl Frame {
    /// The first fault stays; later ones may only follow from it.
    fn blame(&mut self, reason: Reason) {
        self.fault.get_or_insert(reason);
    }

    fn object(&mut self, text: &str, expect: Expect) -> Result<(), DecodeError> {
        let mut reader = Reader::new(text);
        let Value::Object = reader.value()? else {
            // Some other JSON value: right syntax, wrong type; unless the syntax is wrong too.
            json::prove(text)?;
            self.blame(Reason::WrongType);
            return Ok(());
        };
        reader.open_object()?;
        let mut met = 0;
        let mut first = true;
        while let Some(name) = reader.member(first)? {
            first = false;
            self.field(&mut reader, name, &mut met, expect)?;
        }
        reader.end()
    }

    /// Reads one member; `met` has a bit for every field that came before.
    fn field(
        &mut self,
        reader: &mut Reader<'_>,
        name: Text<'_>,
        met: &mut u8,
        expect: Expect,
    ) -> Result<(), DecodeError> {
        let name = name.decode::<16>();
        let Some(field) = name.and_then(|name| Field::from_name(&name, expect)) else {
            self.blame(Reason::UnknownField);
            return reader.skip(MAX_DEPTH - 1);
        };
        let bit = 1 << field as u8;
        if *met & bit != 0 {
            self.blame(Reason::DuplicateField);
            return reader.skip(MAX_DEPTH - 1);
        }
        *met |= bit;
        match field {
            Field::Command => self.command = self.scalar(reader, 1, command_name)?,
            Field::Parameters => self.parameters(reader)?,
            Field::Timestamp => self.timestamp = self.scalar(reader, 1, whole_number)?,
            Field::Seq => {
                let seq = self.scalar(reader, 1, whole_number)?;
                // A number at the end of a truncated text may be the front of another.
                if reader.goes_on() {
                    self.seq = seq;
                }
            }
            Field::Source => self.source = self.scalar(reader, 1, source)?,
        }
        Ok(())
    }

    /// Reads one value as what `meaning` takes it for; blames it and goes on where it is not. There are
    /// so many `levels` around it.
    fn scalar<T>(
        &mut self,
        reader: &mut Reader<'_>,
        levels: u8,
        meaning: fn(Value<'_>) -> Result<T, Reason>,
    ) -> Result<Option<T>, DecodeError> {
        let before = reader.clone();
        let result = match reader.value()? {
            Value::Object | Value::Array => {
                *reader = before;
                reader.skip(MAX_DEPTH - levels)?;
                Err(Reason::WrongType)
            }
            value => meaning(value),
        };
        Ok(result.map_err(|reason| self.blame(reason)).ok())
    }

    /// Reads the value of a parameter: a scalar, or places.
    fn parameter(&mut self, reader: &mut Reader<'_>) -> Result<Option<Scalar>, DecodeError> {
        let before = reader.clone();
        let array = matches!(reader.value()?, Value::Array);
        *reader = before.clone();
        if !array {
            return self.scalar(reader, 2, parameter);
        }
        match places(reader) {
            Ok(places) => Ok(Some(Scalar::Places(places))),
            Err(reason) => {
                *reader = before;
                self.blame(reason);
                reader.skip(MAX_DEPTH - 2)?;
                Ok(None)
            }
        }
    }

    fn parameters(&mut self, reader: &mut Reader<'_>) -> Result<(), DecodeError> {
        let before = reader.clone();
        match reader.value()? {
            Value::Null => return Ok(()),
            Value::Object => reader.open_object()?,
            Value::Bool(_) | Value::Number(_) | Value::Text(_) | Value::Array => {
                *reader = before;
                self.blame(Reason::WrongType);
                return reader.skip(MAX_DEPTH - 1);
            }
        }
        let mut first = true;
        while let Some(name) = reader.member(first)? {
            first = false;
            let name = name.decode::<32>();
            let value = self.parameter(reader)?;
            let Some(name) = name else {
                self.long_name = true;
                continue;
            };
            if self.parameters.iter().any(|(known, _)| *known == name) {
                self.blame(Reason::DuplicateField);
            } else if let Some(value) = value
                && self.parameters.push((name, value)).is_err()
            {
                self.blame(Reason::TooLarge);
            }
        }
        Ok(())
    }
}

/// Reads an array of places. What is wrong with the syntax is for whoever passes over it to find.
fn places(reader: &mut Reader<'_>) -> Result<Places, Reason> {
    let wrong = |_: DecodeError| Reason::WrongType;
    let mut places = Places::NONE;
    reader.open_array().map_err(wrong)?;
    while reader.element(places.count() == 0).map_err(wrong)? {
        let mut place = [0.0; 2];
        let Value::Array = reader.value().map_err(wrong)? else {
            return Err(Reason::WrongType);
        };
        reader.open_array().map_err(wrong)?;
        for (at, along) in place.iter_mut().enumerate() {
            if !reader.element(at == 0).map_err(wrong)? {
                return Err(Reason::WrongType);
            }
            let Value::Number(text) = reader.value().map_err(wrong)? else {
                return Err(Reason::WrongType);
            };
            *along = text.parse().map_err(|_| Reason::OutOfRange)?;
        }
        if reader.element(false).map_err(wrong)? {
            return Err(Reason::WrongType);
        }
        if !places.push(place) {
            return Err(Reason::OutOfRange);
        }
    }
    Ok(places)
}

fn command_name(value: Value<'_>) -> Result<CommandName, Reason> {
    match value {
        Value::Text(text) => text
            .decode::<16>()
            .and_then(|name| CommandName::from_name(&name))
            .ok_or(Reason::UnknownCommand),
        _ => Err(Reason::WrongType),
    }
}

fn whole_number(value: Value<'_>) -> Result<u64, Reason> {
    match value {
        Value::Number(text) if text.contains(['.', 'e', 'E']) => Err(Reason::WrongType),
        Value::Number(text) => text.parse().map_err(|_| Reason::OutOfRange),
        _ => Err(Reason::WrongType),
    }
}

fn source(value: Value<'_>) -> Result<Source, Reason> {
    match value {
        Value::Text(text) => text
            .decode::<{ crate::MAX_SOURCE }>()
            .and_then(|name| Source::new(&name).ok())
            .ok_or(Reason::OutOfRange),
        _ => Err(Reason::WrongType),
    }
}

fn parameter(value: Value<'_>) -> Result<Scalar, Reason> {
    match value {
        Value::Bool(value) => Ok(Scalar::Bool(value)),
        Value::Number(text) => match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Scalar::Number(value)),
            _ => Err(Reason::OutOfRange),
        },
        Value::Text(text) => text.decode().map(Scalar::Text).ok_or(Reason::OutOfRange),
        Value::Null | Value::Object | Value::Array => Err(Reason::WrongType),
    }
}
