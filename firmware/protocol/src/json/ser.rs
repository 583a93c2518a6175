//! A serde serializer into a slice.

use core::fmt::{self, Write as _};

use serde::ser::{self, Serialize};

use super::EncodeError;

impl ser::Error for EncodeError {
    /// The only thing our own types object to is a number that is not finite.
    fn custom<T: fmt::Display>(_: T) -> Self {
        Self::NotFinite
    }
}

/// Writes JSON without white space.
pub(super) struct Serializer<'b> {
    buf: &'b mut [u8],
    at: usize,
}

impl<'b> Serializer<'b> {
    pub(super) const fn new(buf: &'b mut [u8]) -> Self {
        Self { buf, at: 0 }
    }

    pub(super) const fn written(&self) -> usize {
        self.at
    }

    fn push(&mut self, text: &str) -> Result<(), EncodeError> {
        let end = self.at + text.len();
        self.buf
            .get_mut(self.at..end)
            .ok_or(EncodeError::TooLarge)?
            .copy_from_slice(text.as_bytes());
        self.at = end;
        Ok(())
    }

    fn display(&mut self, value: impl fmt::Display) -> Result<(), EncodeError> {
        write!(self, "{value}").map_err(|_| EncodeError::TooLarge)
    }

    fn string(&mut self, text: &str) -> Result<(), EncodeError> {
        self.push("\"")?;
        for character in text.chars() {
            match character {
                '"' => self.push("\\\"")?,
                '\\' => self.push("\\\\")?,
                '\u{8}' => self.push("\\b")?,
                '\u{c}' => self.push("\\f")?,
                '\n' => self.push("\\n")?,
                '\r' => self.push("\\r")?,
                '\t' => self.push("\\t")?,
                '\0'..='\u{1f}' => self.display(format_args!("\\u{:04x}", u32::from(character)))?,
                other => self.push(other.encode_utf8(&mut [0; 4]))?,
            }
        }
        self.push("\"")
    }

    fn open<'a>(
        &'a mut self,
        open: &str,
        close: &'static str,
    ) -> Result<Compound<'a, 'b>, EncodeError> {
        self.push(open)?;
        Ok(Compound {
            serializer: self,
            first: true,
            close,
        })
    }

    fn variant(&mut self, variant: &str) -> Result<(), EncodeError> {
        self.push("{")?;
        self.string(variant)?;
        self.push(":")
    }
}

impl fmt::Write for Serializer<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.push(text).map_err(|_| fmt::Error)
    }
}

/// An object or array that is open.
pub(super) struct Compound<'a, 'b> {
    serializer: &'a mut Serializer<'b>,
    first: bool,
    close: &'static str,
}

impl Compound<'_, '_> {
    fn comma(&mut self) -> Result<(), EncodeError> {
        if core::mem::replace(&mut self.first, false) {
            Ok(())
        } else {
            self.serializer.push(",")
        }
    }

    fn element<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), EncodeError> {
        self.comma()?;
        value.serialize(&mut *self.serializer)
    }

    fn member<T: Serialize + ?Sized>(&mut self, name: &str, value: &T) -> Result<(), EncodeError> {
        self.comma()?;
        self.serializer.string(name)?;
        self.serializer.push(":")?;
        value.serialize(&mut *self.serializer)
    }

    fn close(self) -> Result<(), EncodeError> {
        self.serializer.push(self.close)
    }
}

macro_rules! numbers {
    ($($function:ident($type:ty))+) => {
        $(fn $function(self, value: $type) -> Result<(), EncodeError> {
            self.display(value)
        })+
    };
}

macro_rules! floats {
    ($($function:ident($type:ty))+) => {
        $(fn $function(self, value: $type) -> Result<(), EncodeError> {
            if value.is_finite() {
                self.push(ryu::Buffer::new().format_finite(value))
            } else {
                Err(EncodeError::NotFinite)
            }
        })+
    };
}

impl<'a, 'b> ser::Serializer for &'a mut Serializer<'b> {
    type Ok = ();
    type Error = EncodeError;
    type SerializeSeq = Compound<'a, 'b>;
    type SerializeTuple = Compound<'a, 'b>;
    type SerializeTupleStruct = Compound<'a, 'b>;
    type SerializeTupleVariant = Compound<'a, 'b>;
    type SerializeMap = Compound<'a, 'b>;
    type SerializeStruct = Compound<'a, 'b>;
    type SerializeStructVariant = Compound<'a, 'b>;

    numbers! {
        serialize_i8(i8) serialize_i16(i16) serialize_i32(i32) serialize_i64(i64)
        serialize_u8(u8) serialize_u16(u16) serialize_u32(u32) serialize_u64(u64)
    }
    floats! { serialize_f32(f32) serialize_f64(f64) }

    fn serialize_bool(self, value: bool) -> Result<(), EncodeError> {
        self.push(if value { "true" } else { "false" })
    }

    fn serialize_char(self, value: char) -> Result<(), EncodeError> {
        self.string(value.encode_utf8(&mut [0; 4]))
    }

    fn serialize_str(self, value: &str) -> Result<(), EncodeError> {
        self.string(value)
    }

    fn serialize_bytes(self, value: &[u8]) -> Result<(), EncodeError> {
        let mut array = self.open("[", "]")?;
        for byte in value {
            array.element(byte)?;
        }
        array.close()
    }

    fn serialize_none(self) -> Result<(), EncodeError> {
        self.push("null")
    }

    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<(), EncodeError> {
        value.serialize(self)
    }

    fn serialize_unit(self) -> Result<(), EncodeError> {
        self.push("null")
    }

    fn serialize_unit_struct(self, _: &'static str) -> Result<(), EncodeError> {
        self.push("null")
    }

    fn serialize_unit_variant(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
    ) -> Result<(), EncodeError> {
        self.string(variant)
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        value: &T,
    ) -> Result<(), EncodeError> {
        value.serialize(self)
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        value: &T,
    ) -> Result<(), EncodeError> {
        self.variant(variant)?;
        value.serialize(&mut *self)?;
        self.push("}")
    }

    fn serialize_seq(self, _: Option<usize>) -> Result<Compound<'a, 'b>, EncodeError> {
        self.open("[", "]")
    }

    fn serialize_tuple(self, _: usize) -> Result<Compound<'a, 'b>, EncodeError> {
        self.open("[", "]")
    }

    fn serialize_tuple_struct(
        self,
        _: &'static str,
        _: usize,
    ) -> Result<Compound<'a, 'b>, EncodeError> {
        self.open("[", "]")
    }

    fn serialize_tuple_variant(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        _: usize,
    ) -> Result<Compound<'a, 'b>, EncodeError> {
        self.variant(variant)?;
        self.open("[", "]}")
    }

    fn serialize_map(self, _: Option<usize>) -> Result<Compound<'a, 'b>, EncodeError> {
        self.open("{", "}")
    }

    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Compound<'a, 'b>, EncodeError> {
        self.open("{", "}")
    }

    fn serialize_struct_variant(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        _: usize,
    ) -> Result<Compound<'a, 'b>, EncodeError> {
        self.variant(variant)?;
        self.open("{", "}}")
    }

    fn collect_str<T: fmt::Display + ?Sized>(self, value: &T) -> Result<(), EncodeError> {
        // Through a bounded copy, because the text may need escapes.
        let mut text = heapless::String::<{ crate::MAX_MESSAGE }>::new();
        write!(text, "{value}").map_err(|_| EncodeError::TooLarge)?;
        self.string(&text)
    }
}

macro_rules! elements {
    ($($kind:ident::$function:ident)+) => {
        $(impl ser::$kind for Compound<'_, '_> {
            type Ok = ();
            type Error = EncodeError;

            fn $function<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), EncodeError> {
                self.element(value)
            }

            fn end(self) -> Result<(), EncodeError> {
                self.close()
            }
        })+
    };
}
elements! {
    SerializeSeq::serialize_element
    SerializeTuple::serialize_element
    SerializeTupleStruct::serialize_field
    SerializeTupleVariant::serialize_field
}

macro_rules! fields {
    ($($kind:ident)+) => {
        $(impl ser::$kind for Compound<'_, '_> {
            type Ok = ();
            type Error = EncodeError;

            fn serialize_field<T: Serialize + ?Sized>(
                &mut self,
                name: &'static str,
                value: &T,
            ) -> Result<(), EncodeError> {
                self.member(name, value)
            }

            fn end(self) -> Result<(), EncodeError> {
                self.close()
            }
        })+
    };
}
fields! { SerializeStruct SerializeStructVariant }

impl ser::SerializeMap for Compound<'_, '_> {
    type Ok = ();
    type Error = EncodeError;

    /// Keys of our maps are strings.
    fn serialize_key<T: Serialize + ?Sized>(&mut self, key: &T) -> Result<(), EncodeError> {
        self.element(key)
    }

    fn serialize_value<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), EncodeError> {
        self.serializer.push(":")?;
        value.serialize(&mut *self.serializer)
    }

    fn end(self) -> Result<(), EncodeError> {
        self.close()
    }
}
