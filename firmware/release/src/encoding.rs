//! A manifest in bytes: CBOR (RFC 8949), a map with small integers as keys.
//!
//! | key | field | type |
//! |---|---|---|
//! | 0 | format | 1 |
//! | 1 | kind | 0 program, 1 model, 2 policy |
//! | 2 | name | text; models and policies alone |
//! | 3 | board | text |
//! | 4 | chip | unsigned, 16 bits |
//! | 5 | version | text |
//! | 6 | build | text |
//! | 7 | sequence | unsigned, 32 bits |
//! | 8 | floor | unsigned, 32 bits |
//! | 9 | expires | unsigned, 64 bits; may be missing |
//! | 10 | size | unsigned, 32 bits |
//! | 11 | sha256 | 32 bytes |
//! | 12 | block size | 65536 or 131072 |
//! | 13 | block hashes | 16 bytes for each block |
//! | 14 | delta | array of base's SHA-256, base's build, size of the patch; may be missing |
//! | 15 | requires | array of sequence and protocol; missing when both are 0 |
//!
//! There is one encoding of a manifest, the deterministic one of section 4.2.1: what was decoded is the
//! bytes that encoding it gives, so that what was signed and what is believed are the same.

use core::fmt;

use minicbor::encode::write::{Cursor, Write};
use minicbor::encode::{self, Encoder};

use crate::cbor::{Reader, Type};
use crate::manifest::{Chip, Delta, FORMAT, HASH, Kind, MANIFEST_MAX, Manifest, Requires};

const KEY_FORMAT: u8 = 0;
const KEY_KIND: u8 = 1;
const KEY_NAME: u8 = 2;
const KEY_BOARD: u8 = 3;
const KEY_CHIP: u8 = 4;
const KEY_VERSION: u8 = 5;
const KEY_BUILD: u8 = 6;
const KEY_SEQUENCE: u8 = 7;
const KEY_FLOOR: u8 = 8;
const KEY_EXPIRES: u8 = 9;
const KEY_SIZE: u8 = 10;
const KEY_SHA256: u8 = 11;
const KEY_BLOCK_SIZE: u8 = 12;
const KEY_BLOCKS: u8 = 13;
const KEY_DELTA: u8 = 14;
const KEY_REQUIRES: u8 = 15;

/// Fields that are always there.
const ALWAYS: u64 = 12;

/// Why bytes are no manifest, or no envelope.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Malformed {
    /// More bytes than a manifest or an envelope may have.
    Oversize,
    /// The envelope does not begin as one does, or ends in its signature.
    Envelope,
    /// A format of a later version.
    Format(u8),
    /// Cut off, or no CBOR.
    Cbor,
    /// A field of another type.
    WrongType,
    /// A field that manifests of this format do not have.
    UnknownField,
    /// The field of this key is missing.
    MissingField(u8),
    /// The field of this key stands in the wrong place, or twice.
    FieldOrder(u8),
    /// The field of this name is outside of its limits, or contradicts another.
    OutOfRange(&'static str),
    /// Bytes behind the manifest.
    Trailing,
    /// The same could be said in other, shorter bytes.
    NotCanonical,
}

impl fmt::Display for Malformed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Oversize => f.write_str("too many bytes"),
            Self::Envelope => f.write_str("it does not begin as a signed release does"),
            Self::Format(format) => write!(f, "format {format} is not known, only {FORMAT}"),
            Self::Cbor => f.write_str("cut off, or not CBOR"),
            Self::WrongType => f.write_str("a field of another type"),
            Self::UnknownField => f.write_str("an unknown field"),
            Self::MissingField(key) => write!(f, "field {key} is missing"),
            Self::FieldOrder(key) => write!(f, "field {key} stands twice or in the wrong place"),
            Self::OutOfRange(field) => write!(f, "`{field}` is outside of its limits"),
            Self::Trailing => f.write_str("bytes behind the manifest"),
            Self::NotCanonical => f.write_str("not in the shortest encoding"),
        }
    }
}

impl core::error::Error for Malformed {}

impl<'a> Manifest<'a> {
    /// Writes the manifest to the front of `buf` and returns its length, at most [`MANIFEST_MAX`].
    ///
    /// # Errors
    /// [`Malformed::OutOfRange`] when it is not valid, [`Malformed::Oversize`] when `buf` is too short.
    pub fn encode(&self, buf: &mut [u8]) -> Result<usize, Malformed> {
        self.validate()?;
        let mut out = Encoder::new(Cursor::new(buf));
        write(self, &mut out).map_err(|_| Malformed::Oversize)?;
        let length = out.writer().position();
        if length <= MANIFEST_MAX {
            Ok(length)
        } else {
            Err(Malformed::Oversize)
        }
    }

    /// Reads a manifest from the whole of `bytes`. Says nothing on who wrote it: what arrives from outside
    /// goes through [`Signed::authenticate`](crate::Signed::authenticate).
    ///
    /// # Errors
    /// [`Malformed`] names what is wrong. What is accepted is what [`Manifest::encode`] writes, to the bit.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, Malformed> {
        if bytes.len() > MANIFEST_MAX {
            return Err(Malformed::Oversize);
        }
        let mut reader = Reader::new(bytes);
        let (manifest, is_shortest) = read(&mut reader)?;
        if !reader.is_empty() {
            return Err(Malformed::Trailing);
        }
        manifest.validate()?;
        if is_shortest && reader.is_shortest() {
            Ok(manifest)
        } else {
            Err(Malformed::NotCanonical)
        }
    }
}

/// A key and a number. All of them go through one function for the largest, which writes the same bytes as
/// those for smaller ones and is there once.
fn number<W: Write>(
    out: &mut Encoder<W>,
    key: u8,
    value: impl Into<u64>,
) -> Result<(), encode::Error<W::Error>> {
    out.u64(key.into())?.u64(value.into())?;
    Ok(())
}

fn text<W: Write>(
    out: &mut Encoder<W>,
    key: u8,
    value: &str,
) -> Result<(), encode::Error<W::Error>> {
    out.u64(key.into())?.str(value)?;
    Ok(())
}

fn write<W: Write>(
    manifest: &Manifest<'_>,
    out: &mut Encoder<W>,
) -> Result<(), encode::Error<W::Error>> {
    let requires = Some(manifest.requires).filter(|requires| *requires != Requires::default());
    let optional = [
        manifest.name.is_some(),
        manifest.expires.is_some(),
        manifest.delta.is_some(),
        requires.is_some(),
    ];
    out.map(ALWAYS + optional.iter().filter(|there| **there).count() as u64)?;
    number(out, KEY_FORMAT, FORMAT)?;
    number(out, KEY_KIND, manifest.kind as u8)?;
    if let Some(name) = manifest.name {
        text(out, KEY_NAME, name)?;
    }
    text(out, KEY_BOARD, manifest.board)?;
    number(out, KEY_CHIP, manifest.chip.0)?;
    text(out, KEY_VERSION, manifest.version)?;
    text(out, KEY_BUILD, manifest.build)?;
    number(out, KEY_SEQUENCE, manifest.sequence)?;
    number(out, KEY_FLOOR, manifest.floor)?;
    if let Some(expires) = manifest.expires {
        number(out, KEY_EXPIRES, expires)?;
    }
    number(out, KEY_SIZE, manifest.size)?;
    out.u64(KEY_SHA256.into())?.bytes(manifest.sha256)?;
    number(out, KEY_BLOCK_SIZE, manifest.block_size)?;
    out.u64(KEY_BLOCKS.into())?.bytes(manifest.blocks)?;
    if let Some(delta) = manifest.delta {
        out.u64(KEY_DELTA.into())?.array(3)?.bytes(delta.base)?;
        out.str(delta.build)?.u64(delta.size.into())?;
    }
    if let Some(requires) = requires {
        out.u64(KEY_REQUIRES.into())?.array(2)?;
        out.u64(requires.sequence.into())?
            .u64(requires.protocol.into())?;
    }
    Ok(())
}

/// What a manifest says, and whether it says nothing that could be left out.
fn read<'a>(reader: &mut Reader<'a>) -> Result<(Manifest<'a>, bool), Malformed> {
    let mut fields = Fields {
        left: reader.argument(Type::Map)?,
        reader,
        next: None,
    };
    let format: u8 = fields.always(KEY_FORMAT)?.integer()?;
    if format != FORMAT {
        return Err(Malformed::Format(format));
    }
    let kind: u8 = fields.always(KEY_KIND)?.integer()?;
    let kind = Kind::ALL.get(usize::from(kind));
    let kind = *kind.ok_or(Malformed::OutOfRange("kind"))?;
    let name = match fields.optional(KEY_NAME)? {
        Some(reader) => Some(reader.text()?),
        None => None,
    };
    let board = fields.always(KEY_BOARD)?.text()?;
    let chip = Chip(fields.always(KEY_CHIP)?.integer()?);
    let version = fields.always(KEY_VERSION)?.text()?;
    let build = fields.always(KEY_BUILD)?.text()?;
    let sequence = fields.always(KEY_SEQUENCE)?.integer()?;
    let floor = fields.always(KEY_FLOOR)?.integer()?;
    let expires = match fields.optional(KEY_EXPIRES)? {
        Some(reader) => Some(reader.integer()?),
        None => None,
    };
    let size = fields.always(KEY_SIZE)?.integer()?;
    let sha256 = hash(fields.always(KEY_SHA256)?)?;
    let block_size = fields.always(KEY_BLOCK_SIZE)?.integer()?;
    let blocks = fields.always(KEY_BLOCKS)?.bytes(Type::Bytes)?;
    let delta = match fields.optional(KEY_DELTA)? {
        Some(reader) => Some(delta(reader)?),
        None => None,
    };
    let requires = match fields.optional(KEY_REQUIRES)? {
        Some(reader) => Some(requires(reader)?),
        None => None,
    };
    fields.end()?;
    let manifest = Manifest {
        kind,
        name,
        board,
        chip,
        version,
        build,
        sequence,
        floor,
        expires,
        size,
        sha256,
        block_size,
        blocks,
        delta,
        requires: requires.unwrap_or_default(),
    };
    Ok((manifest, requires != Some(Requires::default())))
}

/// The fields of a map, in rising order of their keys.
struct Fields<'r, 'a> {
    reader: &'r mut Reader<'a>,
    left: u64,
    /// The key that was read and whose value was not.
    next: Option<u8>,
}

impl<'a> Fields<'_, 'a> {
    /// The value of an optional field, if it comes next.
    fn optional(&mut self, key: u8) -> Result<Option<&mut Reader<'a>>, Malformed> {
        if self.next.is_none() && self.left > 0 {
            self.left -= 1;
            self.next = Some(self.reader.integer()?);
        }
        match self.next {
            Some(next) if next == key => {
                self.next = None;
                Ok(Some(self.reader))
            }
            Some(next) if next > KEY_REQUIRES => Err(Malformed::UnknownField),
            Some(next) if next < key => Err(Malformed::FieldOrder(next)),
            _ => Ok(None),
        }
    }

    fn always(&mut self, key: u8) -> Result<&mut Reader<'a>, Malformed> {
        self.optional(key)?.ok_or(Malformed::MissingField(key))
    }

    /// Nothing may be left.
    fn end(mut self) -> Result<(), Malformed> {
        // No key is so large: whatever comes is unknown, or out of order.
        match self.optional(u8::MAX)? {
            None => Ok(()),
            Some(_) => Err(Malformed::UnknownField),
        }
    }
}

fn hash<'a>(reader: &mut Reader<'a>) -> Result<&'a [u8; HASH], Malformed> {
    let bytes = reader.bytes(Type::Bytes)?;
    bytes
        .try_into()
        .map_err(|_| Malformed::OutOfRange("sha256"))
}

fn delta<'a>(reader: &mut Reader<'a>) -> Result<Delta<'a>, Malformed> {
    reader.array(3)?;
    Ok(Delta {
        base: hash(reader)?,
        build: reader.text()?,
        size: reader.integer()?,
    })
}

fn requires(reader: &mut Reader<'_>) -> Result<Requires, Malformed> {
    reader.array(2)?;
    Ok(Requires {
        sequence: reader.integer()?,
        protocol: reader.integer()?,
    })
}
