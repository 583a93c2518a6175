//! Finds a JPEG in a stream of bytes: from SOI to EOI, segment by segment.
//!
//! A sensor pads its frames, and the bytes FF D9 may stand inside a segment without being the end,
//! so segments are walked by their lengths (ISO/IEC 10918-1, annex B). Nothing is decoded.

/// Where in the JPEG the next byte belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// Before SOI; the flag says that the last byte was FF.
    Before(bool),
    /// At the FF of a marker.
    Marker,
    /// After the FF of a marker, outside of a scan.
    Code,
    /// In the two bytes of a segment's length: which marker, and the first byte if it was read.
    Length(u8, Option<u8>),
    /// In a segment: which marker, and bytes left.
    Segment(u8, u16),
    /// In entropy-coded data; the flag says that the last byte was FF.
    Scan(bool),
    /// After EOI.
    After,
}

/// What one byte made of the JPEG.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// It goes on.
    More,
    /// This byte ended it.
    End,
    /// This is no JPEG: begin again.
    Broken,
    /// The byte does not belong to it: padding before or after.
    Outside,
}

/// Follows a JPEG byte by byte. Keeps no bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Walker {
    place: Place,
}

const SOI: u8 = 0xD8;
const EOI: u8 = 0xD9;
const SOS: u8 = 0xDA;

impl Default for Walker {
    fn default() -> Self {
        Self::new()
    }
}

impl Walker {
    /// Before the first byte.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            place: Place::Before(false),
        }
    }

    /// Takes the next byte. The first [`Step::More`] is for the D8 of SOI, whose FF came before.
    pub const fn step(&mut self, byte: u8) -> Step {
        let (place, step) = match (self.place, byte) {
            (Place::Before(true), SOI) => (Place::Marker, Step::More),
            (Place::Before(_), _) => (Place::Before(byte == 0xFF), Step::Outside),
            // After the first FF they are fill bytes (section B.1.1.2).
            (Place::Marker | Place::Code, 0xFF) => (Place::Code, Step::More),
            // Markers without a segment have no place here but EOI.
            (Place::Code | Place::Scan(true), EOI) => (Place::After, Step::End),
            (Place::Code, 0xC0..=0xCF | 0xDA..=0xFE) => (Place::Length(byte, None), Step::More),
            (Place::Length(marker, None), high) => (Place::Length(marker, Some(high)), Step::More),
            (Place::Length(marker, Some(high)), low) => {
                // The length counts its own two bytes.
                match u16::from_be_bytes([high, low]).checked_sub(2) {
                    Some(left) => (after_segment(marker, left), Step::More),
                    None => (Place::Before(false), Step::Broken),
                }
            }
            (Place::Segment(marker, left), _) => {
                (after_segment(marker, left.saturating_sub(1)), Step::More)
            }
            (Place::Scan(_), 0xFF) => (Place::Scan(true), Step::More),
            // Data, stuffing, and restart markers (sections B.1.1.5 and B.2.1).
            (Place::Scan(false), _) | (Place::Scan(true), 0x00 | 0xD0..=0xD7) => {
                (Place::Scan(false), Step::More)
            }
            // Tables between scans, or the next scan.
            (Place::Scan(true), 0xC0..=0xCF | 0xDA..=0xFE) => {
                (Place::Length(byte, None), Step::More)
            }
            (Place::Marker | Place::Code | Place::Scan(true), _) => {
                (Place::Before(byte == 0xFF), Step::Broken)
            }
            (Place::After, _) => (Place::After, Step::Outside),
        };
        self.place = place;
        step
    }
}

const fn after_segment(marker: u8, left: u16) -> Place {
    match (left, marker) {
        (0, SOS) => Place::Scan(false),
        (0, _) => Place::Marker,
        (left, marker) => Place::Segment(marker, left),
    }
}
