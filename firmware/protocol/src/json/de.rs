//! A serde deserializer over text. What it has read is known to be JSON.

use core::fmt;

use serde::de::{self, DeserializeSeed, IntoDeserializer as _, Visitor};
use serde::forward_to_deserialize_any;

use super::{DecodeError, MAX_DEPTH, Reader, Text, Value};

/// Longest string with escapes that is decoded. No field of this contract is longer, so a longer
/// one is out of range wherever it stands.
const MAX_ESCAPED: usize = 256;

impl de::Error for DecodeError {
    fn custom<T: fmt::Display>(_: T) -> Self {
        Self::OutOfRange
    }

    fn invalid_type(_: de::Unexpected<'_>, _: &dyn de::Expected) -> Self {
        Self::WrongType
    }

    fn invalid_value(_: de::Unexpected<'_>, _: &dyn de::Expected) -> Self {
        Self::OutOfRange
    }

    fn invalid_length(_: usize, _: &dyn de::Expected) -> Self {
        Self::OutOfRange
    }

    fn unknown_variant(_: &str, _: &'static [&'static str]) -> Self {
        Self::OutOfRange
    }

    fn unknown_field(_: &str, _: &'static [&'static str]) -> Self {
        Self::UnknownField
    }

    fn missing_field(_: &'static str) -> Self {
        Self::MissingField
    }

    fn duplicate_field(_: &'static str) -> Self {
        Self::DuplicateField
    }
}

/// What is done about a field that a message does not have.
pub(crate) trait Strictness {
    /// Whether there may be such fields. A constant, so that a strict reader has no code for them.
    const TOLERANT: bool;

    /// Counts one that was passed over.
    fn passed_over(&mut self);
}

/// There may be none.
pub(crate) struct Strict;

/// They are passed over, and counted.
#[derive(Default)]
pub(crate) struct Tolerant {
    pub(crate) fields: u32,
}

impl Strictness for Strict {
    const TOLERANT: bool = false;

    fn passed_over(&mut self) {}
}

impl Strictness for Tolerant {
    const TOLERANT: bool = true;

    fn passed_over(&mut self) {
        self.fields = self.fields.saturating_add(1);
    }
}

/// The names of a struct's fields; of a map none are known.
type Fields = Option<&'static [&'static str]>;

pub(super) struct Deserializer<'de, S> {
    reader: Reader<'de>,
    skipped: bool,
    pub(super) strictness: S,
}

impl<'de, S: Strictness> Deserializer<'de, S> {
    pub(super) const fn new(text: &'de str, strictness: S) -> Self {
        Self {
            reader: Reader::new(text),
            skipped: false,
            strictness,
        }
    }

    /// Sees that nothing follows.
    pub(super) fn end(&mut self) -> Result<(), DecodeError> {
        self.reader.end()
    }

    /// Whether values were passed over, which may be too deep.
    pub(super) const fn has_skipped(&self) -> bool {
        self.skipped
    }

    fn skip(&mut self) -> Result<(), DecodeError> {
        self.skipped = true;
        self.reader.skip(MAX_DEPTH)
    }

    /// Hands over a value that is no number.
    fn visit<V: Visitor<'de>>(
        &mut self,
        value: Value<'de>,
        fields: Fields,
        visitor: V,
    ) -> Result<V::Value, DecodeError> {
        match value {
            Value::Null => visitor.visit_unit(),
            Value::Bool(value) => visitor.visit_bool(value),
            Value::Number(text) => visit_number(text, visitor),
            Value::Text(text) => visit_text(text, visitor),
            Value::Object => {
                self.reader.open_object()?;
                visitor.visit_map(Members {
                    de: self,
                    fields,
                    first: true,
                })
            }
            Value::Array => {
                self.reader.open_array()?;
                visitor.visit_seq(Elements {
                    de: self,
                    first: true,
                })
            }
        }
    }

    /// Hands over a whole number; one that no integer type holds is out of range, not of another
    /// type.
    fn integer<V: Visitor<'de>>(&mut self, visitor: V) -> Result<V::Value, DecodeError> {
        match self.reader.value()? {
            Value::Number(text) if is_integer(text) => {
                if let Ok(value) = text.parse::<u64>() {
                    visitor.visit_u64(value)
                } else if let Ok(value) = text.parse::<i64>() {
                    visitor.visit_i64(value)
                } else {
                    Err(DecodeError::OutOfRange)
                }
            }
            other => self.visit(other, None, visitor),
        }
    }
}

fn is_integer(text: &str) -> bool {
    !text.contains(['.', 'e', 'E'])
}

fn visit_number<'de, V: Visitor<'de>>(text: &str, visitor: V) -> Result<V::Value, DecodeError> {
    if is_integer(text) {
        if let Ok(value) = text.parse::<u64>() {
            return visitor.visit_u64(value);
        }
        if let Ok(value) = text.parse::<i64>() {
            return visitor.visit_i64(value);
        }
    }
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => visitor.visit_f64(value),
        _ => Err(DecodeError::OutOfRange),
    }
}

fn visit_text<'de, V: Visitor<'de>>(text: Text<'de>, visitor: V) -> Result<V::Value, DecodeError> {
    if let Some(plain) = text.plain() {
        visitor.visit_borrowed_str(plain)
    } else {
        let decoded = text
            .decode::<MAX_ESCAPED>()
            .ok_or(DecodeError::OutOfRange)?;
        visitor.visit_str(&decoded)
    }
}

impl<'de, S: Strictness> de::Deserializer<'de> for &mut Deserializer<'de, S> {
    type Error = DecodeError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        let value = self.reader.value()?;
        self.visit(value, None, visitor)
    }

    /// What has a fixed number of elements does not look for more of them itself.
    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        _: usize,
        visitor: V,
    ) -> Result<V::Value, DecodeError> {
        let value = self.reader.value()?;
        if !matches!(value, Value::Array) {
            return self.visit(value, None, visitor);
        }
        self.reader.open_array()?;
        let mut elements = Elements {
            de: self,
            first: true,
        };
        let value = visitor.visit_seq(&mut elements)?;
        if elements.de.reader.element(elements.first)? {
            return Err(DecodeError::OutOfRange);
        }
        Ok(value)
    }

    fn deserialize_u8<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        self.integer(visitor)
    }

    fn deserialize_u16<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        self.integer(visitor)
    }

    fn deserialize_u32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        self.integer(visitor)
    }

    fn deserialize_u64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        self.integer(visitor)
    }

    fn deserialize_i8<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        self.integer(visitor)
    }

    fn deserialize_i16<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        self.integer(visitor)
    }

    fn deserialize_i32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        self.integer(visitor)
    }

    fn deserialize_i64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        self.integer(visitor)
    }

    /// Read as what it becomes, because rounding twice may round wrong.
    fn deserialize_f32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        match self.reader.value()? {
            Value::Number(text) => match text.parse::<f32>() {
                Ok(value) if value.is_finite() => visitor.visit_f32(value),
                _ => Err(DecodeError::OutOfRange),
            },
            other => self.visit(other, None, visitor),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        let before = self.reader.clone();
        if let Value::Null = self.reader.value()? {
            visitor.visit_none()
        } else {
            self.reader = before;
            visitor.visit_some(self)
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, DecodeError> {
        visitor.visit_newtype_struct(self)
    }

    /// Enums of this contract are words.
    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, DecodeError> {
        match self.reader.value()? {
            Value::Text(text) => {
                let word = text
                    .decode::<MAX_ESCAPED>()
                    .ok_or(DecodeError::OutOfRange)?;
                visitor.visit_enum(word.as_str().into_deserializer())
            }
            _ => Err(DecodeError::WrongType),
        }
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        self.skip()?;
        visitor.visit_unit()
    }

    /// An array of the values of its fields is no struct.
    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, DecodeError> {
        match self.reader.value()? {
            Value::Array => Err(DecodeError::WrongType),
            value => self.visit(value, Some(fields), visitor),
        }
    }

    forward_to_deserialize_any! {
        bool i128 u128 f64 char str string bytes byte_buf unit unit_struct seq tuple_struct
        map identifier
    }
}

struct Members<'a, 'de, S> {
    de: &'a mut Deserializer<'de, S>,
    fields: Fields,
    first: bool,
}

impl<'de, S: Strictness> de::MapAccess<'de> for Members<'_, 'de, S> {
    type Error = DecodeError;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, DecodeError> {
        while let Some(name) = self.de.reader.member(self.first)? {
            self.first = false;
            if S::TOLERANT && !is_one_of(self.fields, name) {
                self.de.skip()?;
                self.de.strictness.passed_over();
                continue;
            }
            return seed.deserialize(Key(name)).map(Some);
        }
        Ok(None)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(
        &mut self,
        seed: V,
    ) -> Result<V::Value, DecodeError> {
        seed.deserialize(&mut *self.de)
    }
}

/// Whether a struct has a field of this name; a map has any.
fn is_one_of(fields: Fields, name: Text<'_>) -> bool {
    let Some(fields) = fields else {
        return true;
    };
    match name.plain() {
        Some(plain) => fields.contains(&plain),
        None => name
            .decode::<MAX_ESCAPED>()
            .is_some_and(|decoded| fields.contains(&decoded.as_str())),
    }
}

struct Elements<'a, 'de, S> {
    de: &'a mut Deserializer<'de, S>,
    first: bool,
}

impl<'de, S: Strictness> de::SeqAccess<'de> for Elements<'_, 'de, S> {
    type Error = DecodeError;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, DecodeError> {
        if self.de.reader.element(self.first)? {
            self.first = false;
            seed.deserialize(&mut *self.de).map(Some)
        } else {
            Ok(None)
        }
    }
}

/// The name of a member. One too long to decode is no name of this contract.
struct Key<'de>(Text<'de>);

impl<'de> de::Deserializer<'de> for Key<'de> {
    type Error = DecodeError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, DecodeError> {
        if let Some(plain) = self.0.plain() {
            return visitor.visit_borrowed_str(plain);
        }
        let decoded = self
            .0
            .decode::<MAX_ESCAPED>()
            .ok_or(DecodeError::UnknownField)?;
        visitor.visit_str(&decoded)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, DecodeError> {
        self.deserialize_any(visitor)
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option
        unit unit_struct seq tuple tuple_struct map struct enum identifier ignored_any
    }
}
