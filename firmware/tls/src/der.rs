//! DER (X.690), in as far as certificates need it: definite lengths of at most two bytes.

use crate::error::TlsError;

pub(crate) const BOOLEAN: u8 = 0x01;
pub(crate) const INTEGER: u8 = 0x02;
pub(crate) const BIT_STRING: u8 = 0x03;
pub(crate) const OCTET_STRING: u8 = 0x04;
pub(crate) const OID: u8 = 0x06;
pub(crate) const UTC_TIME: u8 = 0x17;
pub(crate) const GENERALIZED_TIME: u8 = 0x18;
pub(crate) const SEQUENCE: u8 = 0x30;

const WRONG: TlsError = TlsError::BadCertificate;

/// One value.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Value<'a> {
    pub(crate) tag: u8,
    pub(crate) content: &'a [u8],
    /// With tag and length.
    pub(crate) whole: &'a [u8],
}

/// Takes values off the front of some bytes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Der<'a>(pub(crate) &'a [u8]);

impl<'a> Der<'a> {
    pub(crate) const fn is_empty(self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn next(&mut self) -> Result<Value<'a>, TlsError> {
        let (&tag, after) = self.0.split_first().ok_or(WRONG)?;
        // Numbers above thirty: none of them is in a certificate.
        if tag & 0x1F == 0x1F {
            return Err(WRONG);
        }
        let (length, header) = match after {
            [short @ 0..=0x7F, ..] => (usize::from(*short), 2),
            // The shortest form alone is DER.
            [0x81, length @ 0x80..=0xFF, ..] => (usize::from(*length), 3),
            [0x82, high @ 1..=0xFF, low, ..] => (usize::from(u16::from_be_bytes([*high, *low])), 4),
            _ => return Err(WRONG),
        };
        let (whole, rest) = self.0.split_at_checked(header + length).ok_or(WRONG)?;
        let content = whole.get(header..).ok_or(WRONG)?;
        self.0 = rest;
        Ok(Value {
            tag,
            content,
            whole,
        })
    }

    /// The content of the next value, which has this tag.
    pub(crate) fn expect(&mut self, tag: u8) -> Result<&'a [u8], TlsError> {
        let value = self.next()?;
        if value.tag == tag {
            Ok(value.content)
        } else {
            Err(WRONG)
        }
    }

    /// The values of the next one, which is a sequence.
    pub(crate) fn sequence(&mut self) -> Result<Self, TlsError> {
        self.expect(SEQUENCE).map(Self)
    }

    /// The content of the next value if it has this tag.
    pub(crate) fn optional(&mut self, tag: u8) -> Result<Option<&'a [u8]>, TlsError> {
        if self.0.first() == Some(&tag) {
            self.expect(tag).map(Some)
        } else {
            Ok(None)
        }
    }

    pub(crate) const fn end(self) -> Result<(), TlsError> {
        if self.0.is_empty() {
            Ok(())
        } else {
            Err(WRONG)
        }
    }
}

/// The bytes of a bit string without bits left over.
pub(crate) fn whole_bits(content: &[u8]) -> Result<&[u8], TlsError> {
    match content {
        [0, bytes @ ..] => Ok(bytes),
        _ => Err(WRONG),
    }
}

/// A positive integer of at most 32 bytes, with zeros before it.
pub(crate) fn scalar(content: &[u8]) -> Result<[u8; 32], TlsError> {
    let digits = match content {
        // A zero before a digit that would read as a sign; no other.
        [0, rest @ ..] if rest.first() >= Some(&0x80) => rest,
        [0x01..=0x7F, ..] => content,
        _ => return Err(WRONG),
    };
    let mut scalar = [0; 32];
    let from = scalar.len().checked_sub(digits.len()).ok_or(WRONG)?;
    scalar.get_mut(from..).ok_or(WRONG)?.copy_from_slice(digits);
    Ok(scalar)
}
