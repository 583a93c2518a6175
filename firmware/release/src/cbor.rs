//! Reads as much of CBOR (RFC 8949) as a manifest is made of: numbers from zero on, and text, bytes, arrays and maps
//! whose lengths are told. A robot has no room for what reads any CBOR there may be.

use crate::encoding::Malformed;

/// What a value is (RFC 8949, section 3.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Type {
    Unsigned = 0,
    Bytes = 2,
    Text = 3,
    Array = 4,
    Map = 5,
}

/// The least argument that needs its number of bytes: 1, 2, 4 or 8 of them.
const LEAST: [u64; 4] = [24, 1 << 8, 1 << 16, 1 << 32];

/// Takes one value after the other off the front of bytes.
#[derive(Debug)]
pub(crate) struct Reader<'a> {
    rest: &'a [u8],
    is_shortest: bool,
}

impl<'a> Reader<'a> {
    pub(crate) const fn new(bytes: &'a [u8]) -> Self {
        Self {
            rest: bytes,
            is_shortest: true,
        }
    }

    /// Whether everything was taken.
    pub(crate) const fn is_empty(&self) -> bool {
        self.rest.is_empty()
    }

    /// Whether every argument so far was in as few bytes as it needs (section 4.2.1).
    pub(crate) const fn is_shortest(&self) -> bool {
        self.is_shortest
    }

    /// The argument of a value of this type: the number, or how many bytes or values follow.
    ///
    /// # Errors
    /// [`Malformed::Cbor`] for what ends before it does or is none, [`Malformed::WrongType`] for another type,
    /// [`Malformed::NotCanonical`] for a length that is not told.
    pub(crate) fn argument(&mut self, of: Type) -> Result<u64, Malformed> {
        let (first, rest) = self.rest.split_first().ok_or(Malformed::Cbor)?;
        if first >> 5 != of as u8 {
            return Err(Malformed::WrongType);
        }
        let (argument, rest) = match first & 0x1F {
            argument @ 0..24 => (u64::from(argument), rest),
            width @ 24..28 => {
                let width = usize::from(width - 24);
                let (bytes, rest) = rest.split_at_checked(1 << width).ok_or(Malformed::Cbor)?;
                let argument = bytes
                    .iter()
                    .fold(0, |high, byte| high << 8 | u64::from(*byte));
                self.is_shortest &= argument >= LEAST[width];
                (argument, rest)
            }
            31 if of != Type::Unsigned => return Err(Malformed::NotCanonical),
            _ => return Err(Malformed::Cbor),
        };
        self.rest = rest;
        Ok(argument)
    }

    /// A number of a type that it fits.
    ///
    /// # Errors
    /// Those of [`Self::argument`], and [`Malformed::OutOfRange`].
    pub(crate) fn integer<T: TryFrom<u64>>(&mut self) -> Result<T, Malformed> {
        T::try_from(self.argument(Type::Unsigned)?).map_err(|_| Malformed::OutOfRange("value"))
    }

    /// The bytes of a value of bytes, or of text.
    ///
    /// # Errors
    /// Those of [`Self::argument`].
    pub(crate) fn bytes(&mut self, of: Type) -> Result<&'a [u8], Malformed> {
        let length = usize::try_from(self.argument(of)?).map_err(|_| Malformed::Cbor)?;
        let (bytes, rest) = self.rest.split_at_checked(length).ok_or(Malformed::Cbor)?;
        self.rest = rest;
        Ok(bytes)
    }

    /// A text.
    ///
    /// # Errors
    /// Those of [`Self::argument`], and [`Malformed::OutOfRange`] for what is no UTF-8.
    pub(crate) fn text(&mut self) -> Result<&'a str, Malformed> {
        str::from_utf8(self.bytes(Type::Text)?).map_err(|_| Malformed::OutOfRange("value"))
    }

    /// Begins an array of that many values.
    ///
    /// # Errors
    /// Those of [`Self::argument`], and [`Malformed::WrongType`] for another number of them.
    pub(crate) fn array(&mut self, length: u64) -> Result<(), Malformed> {
        if self.argument(Type::Array)? == length {
            Ok(())
        } else {
            Err(Malformed::WrongType)
        }
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use minicbor::encode::write::Cursor;
    use minicbor::{Decoder, Encoder};
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn arguments_have_a_shortest_form() {
        let unsigned = |bytes: &[u8]| {
            let mut reader = Reader::new(bytes);
            let value = reader.integer::<u64>();
            (value, reader.is_shortest(), reader.is_empty())
        };
        for (bytes, value, shortest) in [
            (&[0x17][..], 23, true),
            (&[0x18, 23], 23, false),
            (&[0x18, 24], 24, true),
            (&[0x19, 0, 255], 255, false),
            (&[0x19, 1, 0], 256, true),
            (&[0x1A, 0, 0, 255, 255], 65_535, false),
            (&[0x1A, 0, 1, 0, 0], 65_536, true),
            (
                &[0x1B, 0, 0, 0, 0, 255, 255, 255, 255],
                4_294_967_295,
                false,
            ),
            (&[0x1B, 0, 0, 0, 1, 0, 0, 0, 0], 4_294_967_296, true),
            (
                &[0x1B, 255, 255, 255, 255, 255, 255, 255, 255],
                u64::MAX,
                true,
            ),
        ] {
            assert_eq!(unsigned(bytes), (Ok(value), shortest, true), "{bytes:?}");
            for length in 0..bytes.len() {
                assert_eq!(unsigned(&bytes[..length]).0, Err(Malformed::Cbor));
            }
        }
        for reserved in 0x1C..=0x1F {
            assert_eq!(unsigned(&[reserved]).0, Err(Malformed::Cbor));
        }
        assert_eq!(unsigned(&[0x20]).0, Err(Malformed::WrongType));
    }

    #[test]
    fn lengths_are_told_and_kept() {
        let told = [0x44, 1, 2, 3];
        assert_eq!(Reader::new(&told).bytes(Type::Bytes), Err(Malformed::Cbor));
        let huge = [0x5B, 255, 255, 255, 255, 255, 255, 255, 255, 0];
        assert_eq!(Reader::new(&huge).bytes(Type::Bytes), Err(Malformed::Cbor));
        let open = [0x5F, 0x41, 1, 0xFF];
        let read = Reader::new(&open).bytes(Type::Bytes);
        assert_eq!(read, Err(Malformed::NotCanonical));
        let broken = [0x62, 0xC3, 0x28];
        let read = Reader::new(&broken).text();
        assert_eq!(read, Err(Malformed::OutOfRange("value")));
        assert_eq!(Reader::new(&[0x83]).array(2), Err(Malformed::WrongType));
        assert_eq!(Reader::new(&[24, 255]).integer(), Ok(255_u8));
        let read = Reader::new(&[25, 1, 0]).integer::<u8>();
        assert_eq!(read, Err(Malformed::OutOfRange("value")));
    }

    proptest! {
        /// What an encoder that others wrote writes is read as that, and what their decoder reads of anything.
        #[test]
        fn it_reads_what_others_write(number: u64, text in ".{0,300}", bytes: Vec<u8>, other: Vec<u8>) {
            let mut page = [0; 4_096];
            let mut encoder = Encoder::new(Cursor::new(&mut page[..]));
            let written = encoder.map(2).and_then(|more| more.u64(number)?.str(&text)?.array(1)?.bytes(&bytes));
            prop_assert!(written.is_ok());
            let length = encoder.writer().position();
            let mut reader = Reader::new(&page[..length]);
            prop_assert_eq!(reader.argument(Type::Map), Ok(2));
            prop_assert_eq!(reader.integer(), Ok(number));
            prop_assert_eq!(reader.text(), Ok(&*text));
            prop_assert_eq!(reader.array(1), Ok(()));
            prop_assert_eq!(reader.bytes(Type::Bytes), Ok(&*bytes));
            prop_assert!(reader.is_empty() && reader.is_shortest());

            let theirs = |read: &mut dyn FnMut(&mut Decoder<'_>) -> bool| {
                let mut decoder = Decoder::new(&other);
                read(&mut decoder).then(|| decoder.position())
            };
            let ours = |read: &mut dyn FnMut(&mut Reader<'_>) -> bool| {
                let mut reader = Reader::new(&other);
                read(&mut reader).then(|| other.len() - reader.rest.len())
            };
            prop_assert_eq!(ours(&mut |r| r.integer::<u64>().is_ok()), theirs(&mut |d| d.u64().is_ok()));
            prop_assert_eq!(ours(&mut |r| r.text().is_ok()), theirs(&mut |d| d.str().is_ok()));
            prop_assert_eq!(
                ours(&mut |r| r.bytes(Type::Bytes).is_ok()),
                theirs(&mut |d| d.bytes().is_ok())
            );
            prop_assert_eq!(
                ours(&mut |r| r.argument(Type::Map).is_ok()),
                theirs(&mut |d| d.map().is_ok_and(|length| length.is_some()))
            );
        }
    }
}
