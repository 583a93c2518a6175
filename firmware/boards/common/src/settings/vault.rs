//! Where settings are kept: two records that are written in turn.
//!
//! Each record has an erase block of its own and says in which order it was written. A new one
//! replaces the older of the two, so that a power cut at any byte leaves the newer one as it was:
//! a record either passes its checksum or does not count. Noise in the flash is no record, needs
//! no repair and costs the settings at worst, never the boot. Settings change a few times in the
//! life of a robot, which is why wear needs no care.
//!
//! Passwords lie in the flash as they are: whoever holds the chip can read them. Encrypting them
//! with a key that lies beside them would only look safer.

use core::fmt;

use crc::{CRC_32_ISO_HDLC, Crc, NoTable};
use embedded_storage_async::nor_flash::NorFlash;

use super::codec::{DecodeError, ENCODED_MAX, decode, encode};
use super::{AccessPointPassword, Settings};

/// "Terracrawler settings".
const MAGIC: [u8; 4] = *b"TCST";
/// Form of the record.
const VERSION: u8 = 1;
/// Magic, version, a spare byte, length, sequence number.
const HEADER: usize = 12;
const CHECKSUM: usize = 4;
/// A record, rounded up to any word of flash. Always written whole.
const RECORD: usize = 512;
/// Bit by bit: 1 KB of table would be a high price for half a kilobyte at boot.
const CRC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

const _: () = assert!(HEADER + ENCODED_MAX + CHECKSUM <= RECORD);

/// What the vault holds.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Kept {
    /// What a person told the robot; `None` before that, and after a reset to factory state.
    pub settings: Option<Settings>,
    /// Password of the robot's own access point. Outlives a reset to factory state, because it
    /// stands on the label.
    pub access_point: Option<AccessPointPassword>,
}

/// Why the vault did not serve. Each variant calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum VaultError {
    /// The region has fewer than two erase blocks, or blocks or words of an unusable size: a
    /// mistake in the board's program.
    Unfit,
    /// The flash reports an error.
    Refused,
    /// The flash keeps something else than was written: it is worn.
    Worn,
}

impl fmt::Display for VaultError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unfit => "flash region is unfit for settings",
            Self::Refused => "flash refused",
            Self::Worn => "flash is worn",
        })
    }
}

impl core::error::Error for VaultError {}

/// One of the two places.
#[derive(Debug, Clone)]
struct Place {
    sequence: u32,
    content: Result<Kept, DecodeError>,
}

/// Settings in flash: two records that take turns, each with a checksum.
///
/// Uses the first two erase blocks of the region.
#[derive(Debug)]
pub struct Vault<F> {
    flash: F,
}

impl<F: NorFlash> Vault<F> {
    /// A vault in `flash`. Does no I/O.
    pub const fn new(flash: F) -> Self {
        Self { flash }
    }

    /// Gives the flash back.
    pub fn into_inner(self) -> F {
        self.flash
    }

    /// Lends the flash, for a vault that lives for a while only.
    pub const fn flash(&mut self) -> &mut F {
        &mut self.flash
    }

    fn fits(&self) -> bool {
        let divides = |word: usize| word > 0 && RECORD.is_multiple_of(word);
        divides(F::READ_SIZE)
            && divides(F::WRITE_SIZE)
            && F::ERASE_SIZE >= RECORD
            && u32::try_from(F::ERASE_SIZE).is_ok_and(|size| size.checked_mul(2).is_some())
            && self.flash.capacity() / 2 >= F::ERASE_SIZE
    }

    async fn read(&mut self, place: usize) -> Result<Option<Place>, VaultError> {
        let mut record = [0; RECORD];
        let at = (place * F::ERASE_SIZE) as u32;
        let read = self.flash.read(at, &mut record).await;
        read.map_err(|_| VaultError::Refused)?;
        Ok(open(&record))
    }

    /// The newest of the readable records, and the number of its place.
    async fn newest(&mut self) -> Result<Option<(usize, Place)>, VaultError> {
        if !self.fits() {
            return Err(VaultError::Unfit);
        }
        Ok(match (self.read(0).await?, self.read(1).await?) {
            (None, None) => None,
            (Some(only), None) => Some((0, only)),
            (None, Some(only)) => Some((1, only)),
            (Some(first), Some(second)) => {
                if is_newer(second.sequence, first.sequence) {
                    Some((1, second))
                } else {
                    Some((0, first))
                }
            }
        })
    }

    /// What was stored last, or nothing.
    ///
    /// # Errors
    /// [`VaultError`]; content that makes no sense is no error, but nothing.
    ///
    /// # Cancellation Safety
    /// Changes nothing.
    pub async fn load(&mut self) -> Result<Kept, VaultError> {
        let newest = self.newest().await?;
        Ok(newest
            .and_then(|(_, place)| place.content.ok())
            .unwrap_or_default())
    }

    /// Stores `kept` in place of the older record and reads it back.
    ///
    /// # Errors
    /// [`VaultError`]; what was stored before is then still there.
    ///
    /// # Cancellation Safety
    /// As safe as a power cut: the old settings or the new ones.
    pub async fn store(&mut self, kept: &Kept) -> Result<(), VaultError> {
        let newest = self.newest().await?;
        let (place, sequence) = match newest {
            Some((place, newest)) => (1 - place, newest.sequence.wrapping_add(1)),
            None => (0, 0),
        };
        let record = seal(kept, sequence);
        self.erase(place).await?;
        let at = (place * F::ERASE_SIZE) as u32;
        let written = self.flash.write(at, &record).await;
        written.map_err(|_| VaultError::Refused)?;
        let mut back = [0; RECORD];
        let read = self.flash.read(at, &mut back).await;
        read.map_err(|_| VaultError::Refused)?;
        if back == record {
            Ok(())
        } else {
            Err(VaultError::Worn)
        }
    }

    /// Back to factory state: forgets the settings, and leaves no older copy of them in the
    /// flash. The password of the access point stays.
    ///
    /// # Errors
    /// [`VaultError`]; call it again then.
    ///
    /// # Cancellation Safety
    /// As safe as a power cut: nothing has changed, or nothing is left, or an older copy that the
    /// program does not look at. Call it again to be sure.
    pub async fn forget(&mut self) -> Result<(), VaultError> {
        let kept = Kept {
            settings: None,
            ..self.load().await?
        };
        self.store(&kept).await?;
        if let Some((place, _)) = self.newest().await? {
            self.erase(1 - place).await?;
        }
        Ok(())
    }

    async fn erase(&mut self, place: usize) -> Result<(), VaultError> {
        let from = place * F::ERASE_SIZE;
        let erased = self
            .flash
            .erase(from as u32, (from + F::ERASE_SIZE) as u32)
            .await;
        erased.map_err(|_| VaultError::Refused)
    }
}

/// Whether `a` was written after `b`. The numbers may have run over, and two records are one
/// apart.
const fn is_newer(a: u32, b: u32) -> bool {
    (a.wrapping_sub(b) as i32) > 0
}

/// Makes a record.
fn seal(kept: &Kept, sequence: u32) -> [u8; RECORD] {
    let mut encoded = [0; ENCODED_MAX];
    let content = encode(kept, &mut encoded);
    // Erased flash is all ones: what is not needed is not written either.
    let mut record = [0xFF; RECORD];
    let end = HEADER + content.len();
    record[..4].copy_from_slice(&MAGIC);
    record[4] = VERSION;
    record[6..8].copy_from_slice(&(content.len() as u16).to_le_bytes());
    record[8..12].copy_from_slice(&sequence.to_le_bytes());
    record[HEADER..end].copy_from_slice(content);
    let checksum = CRC.checksum(&record[..end]);
    record[end..end + CHECKSUM].copy_from_slice(&checksum.to_le_bytes());
    record
}

/// Reads a record. `None` for anything that is not one, or is one of another version: a program
/// that is stepped back does not look at what a newer one wrote, and takes the older record.
fn open(record: &[u8; RECORD]) -> Option<Place> {
    let (header, rest) = record.split_first_chunk::<HEADER>()?;
    if header[..4] != MAGIC || header[4] != VERSION {
        return None;
    }
    let length = usize::from(u16::from_le_bytes([header[6], header[7]]));
    let (content, rest) = rest.split_at_checked(length)?;
    let checksum = rest.first_chunk::<CHECKSUM>()?;
    if CRC.checksum(&record[..HEADER + length]) != u32::from_le_bytes(*checksum) {
        return None;
    }
    Some(Place {
        sequence: u32::from_le_bytes([header[8], header[9], header[10], header[11]]),
        content: decode(content),
    })
}
