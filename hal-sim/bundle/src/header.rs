//! What a bundle says.

use crate::defect::{Defect, DefectKind};
use crate::{
    BUILD_MAX, BundleFault, DEFECTS_MAX, DIGEST_BYTES, HEADER_MAX, MAGIC, NAME_MAX, PARAMETERS_MAX,
    SIZE_MAX, VERSION_MAX,
};

/// The version of the format.
const FORMAT: u8 = 1;
/// Bytes of the checksum that ends the header.
const CRC_BYTES: usize = 4;

/// What the program in a bundle pretends to be.
#[derive(Debug, Clone, PartialEq)]
pub struct Bundle {
    /// Version, as `status` tells it.
    pub version: String,
    /// Build id, as `status` tells it.
    pub build: String,
    /// Parameters with the values that override what is stored; sorted by name.
    pub parameters: Vec<(String, f32)>,
    /// What is wrong with it; sorted by kind, each kind at most once.
    pub defects: Vec<Defect>,
}

/// The beginning of a bundle, which says everything about it.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// What it says.
    pub bundle: Bundle,
    /// Bytes of the whole image.
    pub size: u32,
}

impl Bundle {
    /// One with nothing wrong with it.
    #[must_use]
    pub fn new(version: &str, build: &str) -> Self {
        Self {
            version: version.to_owned(),
            build: build.to_owned(),
            parameters: Vec::new(),
            defects: Vec::new(),
        }
    }

    fn check(&self) -> Result<(), BundleFault> {
        if !is_word(&self.version, VERSION_MAX) {
            return Err(BundleFault::Malformed("version"));
        }
        if !is_word(&self.build, BUILD_MAX) {
            return Err(BundleFault::Malformed("build"));
        }
        let parameters = &self.parameters;
        let sound = |(name, value): &(String, f32)| is_name(name) && value.is_finite();
        if parameters.len() > PARAMETERS_MAX
            || !parameters.iter().all(sound)
            || !parameters.is_sorted_by(|one, next| one.0 < next.0)
        {
            return Err(BundleFault::Malformed("parameters"));
        }
        let defects = &self.defects;
        if defects.len() > DEFECTS_MAX
            || !defects.iter().all(Defect::is_sound)
            || !defects.is_sorted_by(|one, next| one.kind < next.kind)
        {
            return Err(BundleFault::Malformed("defects"));
        }
        Ok(())
    }
}

impl Header {
    /// Its bytes.
    ///
    /// # Errors
    /// [`BundleFault::Malformed`] names what cannot be so.
    pub fn encode(&self) -> Result<Vec<u8>, BundleFault> {
        let Self { bundle, size } = self;
        bundle.check()?;
        let mut out = MAGIC.to_vec();
        out.extend([FORMAT, 0, 0]);
        out.extend(size.to_le_bytes());
        put_text(&mut out, &bundle.version);
        put_text(&mut out, &bundle.build);
        out.push(bundle.parameters.len() as u8);
        for (name, value) in &bundle.parameters {
            put_text(&mut out, name);
            out.extend(value.to_le_bytes());
        }
        out.push(bundle.defects.len() as u8);
        for defect in &bundle.defects {
            out.extend([defect.kind.number(), defect.percent]);
            out.extend(defect.value.to_le_bytes());
        }
        let length = out.len() + CRC_BYTES;
        out[5..7].copy_from_slice(&(length as u16).to_le_bytes());
        let crc = crc32(&out);
        out.extend(crc.to_le_bytes());
        check_size(*size, length)?;
        Ok(out)
    }

    /// Reads the beginning of a bundle from the front of `bytes`, which may go on as they like. With
    /// [`HEADER_MAX`] of them, or all that there are, none is missing.
    ///
    /// # Errors
    /// [`BundleFault`] names what is wrong. What is accepted is what [`Header::encode`] writes, to the bit.
    pub fn decode(bytes: &[u8]) -> Result<Self, BundleFault> {
        let mut reader = Reader(bytes);
        if reader.take(MAGIC.len()) != Ok(&MAGIC[..]) {
            return Err(BundleFault::NotBundle);
        }
        let format = reader.byte()?;
        if format != FORMAT {
            return Err(BundleFault::Format(format));
        }
        let length = usize::from(u16::from_le_bytes(reader.array()?));
        if length > HEADER_MAX {
            return Err(BundleFault::Malformed("length"));
        }
        let whole = bytes.get(..length).ok_or(BundleFault::Short)?;
        let (said, crc) = whole
            .split_last_chunk::<CRC_BYTES>()
            .ok_or(BundleFault::Malformed("length"))?;
        if crc32(said) != u32::from_le_bytes(*crc) {
            return Err(BundleFault::Checksum);
        }
        // Past what was read above; a header that is shorter than that has no fields.
        let read = bytes.len() - reader.0.len();
        let mut reader = Reader(said.get(read..).ok_or(BundleFault::Malformed("length"))?);
        let size = u32::from_le_bytes(reader.array()?);
        check_size(size, length)?;
        let version = reader.text("version", VERSION_MAX)?;
        let build = reader.text("build", BUILD_MAX)?;
        let mut bundle = Bundle {
            version,
            build,
            parameters: Vec::new(),
            defects: Vec::new(),
        };
        for _ in 0..reader.count("parameters", PARAMETERS_MAX)? {
            let name = reader.text("parameters", NAME_MAX)?;
            let value = f32::from_le_bytes(reader.array()?);
            bundle.parameters.push((name, value));
        }
        for _ in 0..reader.count("defects", DEFECTS_MAX)? {
            let [kind, percent] = reader.array()?;
            let kind = DefectKind::from_number(kind).ok_or(BundleFault::Malformed("defects"))?;
            bundle.defects.push(Defect {
                kind,
                percent,
                value: u32::from_le_bytes(reader.array()?),
            });
        }
        if !reader.0.is_empty() {
            return Err(BundleFault::Malformed("length"));
        }
        bundle.check()?;
        Ok(Self { bundle, size })
    }
}

/// Whether an image of this size has room for its header and digest, and a slot for it.
const fn check_size(size: u32, header: usize) -> Result<(), BundleFault> {
    if size as usize >= header + DIGEST_BYTES && size <= SIZE_MAX {
        Ok(())
    } else {
        Err(BundleFault::Malformed("size"))
    }
}

fn is_word(text: &str, most: usize) -> bool {
    let known = |byte: u8| byte.is_ascii_alphanumeric() || b".+-_".contains(&byte);
    (1..=most).contains(&text.len()) && text.bytes().all(known)
}

fn is_name(text: &str) -> bool {
    let known = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_';
    (1..=NAME_MAX).contains(&text.len()) && text.bytes().all(known)
}

/// Texts were checked: none is longer than a byte counts.
fn put_text(out: &mut Vec<u8>, text: &str) {
    out.push(text.len() as u8);
    out.extend(text.as_bytes());
}

/// What is left of the bytes.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], BundleFault> {
        let (taken, rest) = self.0.split_at_checked(length).ok_or(BundleFault::Short)?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], BundleFault> {
        let (taken, rest) = self.0.split_first_chunk().ok_or(BundleFault::Short)?;
        self.0 = rest;
        Ok(*taken)
    }

    fn byte(&mut self) -> Result<u8, BundleFault> {
        self.array::<1>().map(|[byte]| byte)
    }

    fn count(&mut self, what: &'static str, most: usize) -> Result<usize, BundleFault> {
        let count = usize::from(self.byte()?);
        if count > most {
            return Err(BundleFault::Malformed(what));
        }
        Ok(count)
    }

    fn text(&mut self, what: &'static str, most: usize) -> Result<String, BundleFault> {
        let length = self.count(what, most)?;
        let text = std::str::from_utf8(self.take(length)?);
        text.map(str::to_owned)
            .map_err(|_| BundleFault::Malformed(what))
    }
}

/// CRC-32 (ISO-HDLC), bit by bit: headers are short.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| (crc >> 1) ^ (0xEDB8_8320 * (crc & 1));
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), step)
    })
}

#[cfg(test)]
mod tests {
    use super::crc32;

    #[test]
    fn the_checksum_is_the_usual_one() {
        // The check value of CRC-32/ISO-HDLC.
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }
}
