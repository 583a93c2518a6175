//! A serde serializer into a slice.

#[cfg(test)]
mod tests;

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
        self.bytes(text.as_bytes())
    }

    fn bytes(&mut self, bytes: &[u8]) -> Result<(), EncodeError> {
        self.room(bytes.len())?.copy_from_slice(bytes);
        Ok(())
    }

    fn byte(&mut self, byte: u8) -> Result<(), EncodeError> {
        *self.buf.get_mut(self.at).ok_or(EncodeError::TooLarge)? = byte;
        self.at += 1;
        Ok(())
    }

    /// Numbers are most of a message; `core::fmt` would take several times as long for them.
    fn unsigned(&mut self, value: u64) -> Result<(), EncodeError> {
        const PART: u64 = 1_000_000_000;
        let mut digits = [b'0'; 20];
        let mut at = digits.len();
        let mut rest = value;
        loop {
            // Nine digits at a time: a 32-bit processor divides 64 bits in software.
            let mut part = (rest % PART) as u32;
            rest /= PART;
            let whole = at - 9.min(at);
            while part > 0 {
                at -= 1;
                digits[at] = b'0' + (part % 10) as u8;
                part /= 10;
            }
            if rest == 0 {
                break;
            }
            at = whole;
        }
        self.bytes(&digits[at.min(digits.len() - 1)..])
    }

    fn signed(&mut self, value: i64) -> Result<(), EncodeError> {
        if value < 0 {
            self.byte(b'-')?;
        }
        self.unsigned(value.unsigned_abs())
    }

    fn display(&mut self, value: impl fmt::Display) -> Result<(), EncodeError> {
        write!(self, "{value}").map_err(|_| EncodeError::TooLarge)
    }

    fn string(&mut self, text: &str) -> Result<(), EncodeError> {
        if is_plain(text) {
            return self.quoted(text);
        }
        self.byte(b'"')?;
        self.escaped(text)?;
        self.byte(b'"')
    }

    /// A text that needs no escapes.
    fn quoted(&mut self, text: &str) -> Result<(), EncodeError> {
        let [open, middle @ .., close] = self.room(text.len() + 2)? else {
            return Err(EncodeError::TooLarge);
        };
        (*open, *close) = (b'"', b'"');
        middle.copy_from_slice(text.as_bytes());
        Ok(())
    }

    /// The name of a field, as our types call it, which is a word, and the colon behind it.
    fn name(&mut self, name: &'static str) -> Result<(), EncodeError> {
        debug_assert!(is_plain(name), "a name that needs escapes");
        self.quoted(name)?;
        self.byte(b':')
    }

    /// The next `len` bytes, to be written.
    fn room(&mut self, len: usize) -> Result<&mut [u8], EncodeError> {
        let end = self.at + len;
        let room = self.buf.get_mut(self.at..end);
        self.at = if room.is_some() { end } else { self.at };
        room.ok_or(EncodeError::TooLarge)
    }

    fn escaped(&mut self, text: &str) -> Result<(), EncodeError> {
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
        Ok(())
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

    fn variant(&mut self, variant: &'static str) -> Result<(), EncodeError> {
        self.byte(b'{')?;
        self.name(variant)
    }
}

/// Whether a text needs no escapes. Looks at all of it, which takes less than to look where to
/// stop: most texts are short, and plain.
fn is_plain(text: &str) -> bool {
    let special = |byte: &u8| matches!(byte, 0..=0x1f | b'"' | b'\\');
    text.bytes().filter(special).count() == 0
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
            self.serializer.byte(b',')
        }
    }

    fn element<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), EncodeError> {
        self.comma()?;
        value.serialize(&mut *self.serializer)
    }

    fn member<T: Serialize + ?Sized>(
        &mut self,
        name: &'static str,
        value: &T,
    ) -> Result<(), EncodeError> {
        self.comma()?;
        self.serializer.name(name)?;
        value.serialize(&mut *self.serializer)
    }

    fn close(self) -> Result<(), EncodeError> {
        self.serializer.push(self.close)
    }
}

macro_rules! numbers {
    ($how:ident: $($function:ident($type:ty))+) => {
        $(fn $function(self, value: $type) -> Result<(), EncodeError> {
            self.$how(value.into())
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
        signed: serialize_i8(i8) serialize_i16(i16) serialize_i32(i32) serialize_i64(i64)
    }
    numbers! {
        unsigned: serialize_u8(u8) serialize_u16(u16) serialize_u32(u32) serialize_u64(u64)
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
        self.serializer.byte(b':')?;
        value.serialize(&mut *self.serializer)
    }

    fn end(self) -> Result<(), EncodeError> {
        self.close()
    }
}
