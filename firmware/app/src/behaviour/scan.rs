//! One turn in place, collecting ranges by heading.

use core::f32::consts::PI;
use core::fmt;

use crate::motion::wrap;
use crate::perception::Sight;
use crate::vision::{Class, Classes};

/// Sectors of a scan: 15° each, about the width of the ranger's cone.
pub const SECTORS: usize = 24;

/// What was seen in one sector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Sector {
    /// No reading fell into it.
    #[default]
    Unseen,
    /// Nothing in reach.
    Clear,
    /// Nearest range, in centimetres.
    At(u16),
}

/// What a scan found. Sector 0 begins at heading 0 of odometry, counter-clockwise from there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ScanResult {
    /// The sectors.
    pub sectors: [Sector; SECTORS],
    /// What the camera recognised in each.
    pub classes: [Classes; SECTORS],
}

impl ScanResult {
    /// The first or the second half turn, so that each fits into one log record.
    pub fn halves(&self) -> [HalfScan<'_>; 2] {
        let (first, second) = self.sectors.split_at(SECTORS / 2);
        [
            HalfScan {
                degrees: 0,
                sectors: first,
            },
            HalfScan {
                degrees: 180,
                sectors: second,
            },
        ]
    }

    /// What was recognised in the first and the second half turn, where that is anything.
    pub fn recognised(&self) -> impl Iterator<Item = HalfRecognised<'_>> {
        let (first, second) = self.classes.split_at(SECTORS / 2);
        [(0, first), (180, second)]
            .into_iter()
            .filter(|(_, classes)| classes.iter().any(|classes| !classes.is_empty()))
            .map(|(degrees, classes)| HalfRecognised { degrees, classes })
    }
}

/// Half a turn of a [`ScanResult`], for people to read.
#[derive(Debug, Clone, Copy)]
pub struct HalfScan<'a> {
    degrees: u16,
    sectors: &'a [Sector],
}

impl fmt::Display for HalfScan<'_> {
    /// Centimetres per 15° from the given heading on, `-` for clear and `?` for unseen: at most
    /// 73 bytes.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cm per 15 deg from {} deg:", self.degrees)?;
        for sector in self.sectors {
            match sector {
                Sector::Unseen => f.write_str(" ?")?,
                Sector::Clear => f.write_str(" -")?,
                Sector::At(cm) => write!(f, " {cm}")?,
            }
        }
        Ok(())
    }
}

/// What was recognised in half a turn of a [`ScanResult`], for people to read.
#[derive(Debug, Clone, Copy)]
pub struct HalfRecognised<'a> {
    degrees: u16,
    classes: &'a [Classes],
}

impl fmt::Display for HalfRecognised<'_> {
    /// Letters of the classes per 15° from the given heading on, see [`Classes`]: at most 77 bytes.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "seen per 15 deg from {} deg:", self.degrees)?;
        for classes in self.classes {
            write!(f, " {classes}")?;
        }
        Ok(())
    }
}

/// A scan under way.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Scan {
    heading: f32,
    turned: f32,
    sectors: [Sector; SECTORS],
    classes: [Classes; SECTORS],
}

impl Scan {
    /// Begins at `heading`.
    pub fn new(heading: f32) -> Self {
        Self {
            heading,
            turned: 0.0,
            sectors: [Sector::Unseen; SECTORS],
            classes: [Classes::default(); SECTORS],
        }
    }

    /// Takes in where the robot now heads and what it sees there; the result, once around.
    pub fn observe(&mut self, heading: f32, sight: Option<Sight>) -> Option<ScanResult> {
        self.turned += wrap(heading - self.heading);
        self.heading = heading;
        if let Some(sight) = sight {
            self.note(heading, sight);
        }
        (libm::fabsf(self.turned) >= 2.0 * PI).then_some(ScanResult {
            sectors: self.sectors,
            classes: self.classes,
        })
    }

    /// Takes in that the camera has recognised something in this direction.
    pub fn recognise(&mut self, direction: f32, class: Class) {
        if let Some(classes) = self.classes.get_mut(sector(wrap(direction))) {
            classes.insert(class);
        }
    }

    fn note(&mut self, heading: f32, sight: Sight) {
        let index = sector(heading);
        let seen = match sight {
            Sight::Range(mm) => Sector::At(mm.0 / 10),
            Sight::Touching => Sector::At(0),
            Sight::Clear => Sector::Clear,
        };
        if let Some(sector) = self.sectors.get_mut(index) {
            *sector = match (*sector, seen) {
                (Sector::At(old), Sector::At(new)) => Sector::At(old.min(new)),
                (Sector::At(old), Sector::Clear | Sector::Unseen) => Sector::At(old),
                (Sector::Clear | Sector::Unseen, seen) => seen,
            };
        }
    }
}

/// The sector that a heading from −π to π falls into.
fn sector(heading: f32) -> usize {
    let from_zero = if heading < 0.0 {
        heading + 2.0 * PI
    } else {
        heading
    };
    // Saturating cast: NaN and rounding at the seam end up in sector 0.
    (from_zero * (SECTORS as f32 / (2.0 * PI))) as usize % SECTORS
}
