//! Reading a trailer from a flash, and appending to it.

use embedded_storage::nor_flash::{MultiwriteNorFlash, ReadNorFlash};
use embedded_storage_async::nor_flash::{
    MultiwriteNorFlash as AsyncMultiwriteNorFlash, ReadNorFlash as AsyncReadNorFlash,
};

use super::{Begin, ENVELOPE_AT, EnvelopeSize, Record, Scanner, Trailer, TrailerFull};
use crate::flash::{FlashError, SECTOR};

/// Bytes that are read at once.
const PIECE: usize = 64;
/// Words that a worn flash may spoil before an append is given up.
const TRIES: usize = 3;

impl Trailer {
    /// Reads the trailer that begins at `base` of `flash`: [`SECTOR`] bytes before the end of its slot.
    ///
    /// # Errors
    /// That of the flash.
    pub fn read<F: ReadNorFlash>(flash: &mut F, base: u32) -> Result<Self, F::Error> {
        let mut scanner = Scanner::new();
        let mut piece = [0; PIECE];
        for at in (base..base + SECTOR).step_by(PIECE) {
            flash.read(at, &mut piece)?;
            scanner.feed(&piece);
        }
        Ok(scanner.finish())
    }

    /// As [`Trailer::read`], where the flash is waited for.
    ///
    /// # Errors
    /// That of the flash.
    ///
    /// # Cancellation Safety
    /// Reads only.
    pub async fn read_async<F: AsyncReadNorFlash>(
        flash: &mut F,
        base: u32,
    ) -> Result<Self, F::Error> {
        let mut scanner = Scanner::new();
        let mut piece = [0; PIECE];
        for at in (base..base + SECTOR).step_by(PIECE) {
            flash.read(at, &mut piece).await?;
            scanner.feed(&piece);
        }
        Ok(scanner.finish())
    }

    /// Reads the envelope into `buffer`; what it gives are the bytes of the envelope. `None` without one.
    ///
    /// # Errors
    /// That of the flash.
    pub fn read_envelope<'b, F: ReadNorFlash>(
        &self,
        flash: &mut F,
        base: u32,
        buffer: &'b mut [u8; super::ENVELOPE_MAX],
    ) -> Result<Option<&'b [u8]>, F::Error> {
        let Some(length) = self.envelope().map(usize::from) else {
            return Ok(None);
        };
        // Whole words are read, for flashes that know nothing else.
        if let Some(words) = buffer.get_mut(..length.next_multiple_of(4)) {
            flash.read(base + ENVELOPE_AT, words)?;
        }
        Ok(buffer.get(..length))
    }

    /// As [`Trailer::read_envelope`], where the flash is waited for.
    ///
    /// # Errors
    /// That of the flash.
    ///
    /// # Cancellation Safety
    /// Reads only.
    pub async fn read_envelope_async<'b, F: AsyncReadNorFlash>(
        &self,
        flash: &mut F,
        base: u32,
        buffer: &'b mut [u8; super::ENVELOPE_MAX],
    ) -> Result<Option<&'b [u8]>, F::Error> {
        let Some(length) = self.envelope().map(usize::from) else {
            return Ok(None);
        };
        if let Some(words) = buffer.get_mut(..length.next_multiple_of(4)) {
            flash.read(base + ENVELOPE_AT, words).await?;
        }
        Ok(buffer.get(..length))
    }

    /// Begins a trailer anew with this envelope, and reads back that it is there.
    ///
    /// # Errors
    /// [`FlashError::Refused`] with [`EnvelopeSize`], before anything is erased.
    pub fn begin<F: MultiwriteNorFlash>(
        flash: &mut F,
        base: u32,
        envelope: &[u8],
    ) -> Result<Self, FlashError<F::Error, EnvelopeSize>> {
        for operation in Begin::new(envelope).map_err(FlashError::Refused)? {
            operation.execute(flash, base).map_err(FlashError::Flash)?;
        }
        let written = Self::read(flash, base).map_err(FlashError::Flash)?;
        written.begun(envelope).ok_or(FlashError::Worn)
    }

    /// As [`Trailer::begin`], where the flash is waited for.
    ///
    /// # Errors
    /// As [`Trailer::begin`].
    ///
    /// # Cancellation Safety
    /// As safe as a power cut: begin again.
    pub async fn begin_async<F: AsyncMultiwriteNorFlash>(
        flash: &mut F,
        base: u32,
        envelope: &[u8],
    ) -> Result<Self, FlashError<F::Error, EnvelopeSize>> {
        for operation in Begin::new(envelope).map_err(FlashError::Refused)? {
            let done = operation.execute_async(flash, base).await;
            done.map_err(FlashError::Flash)?;
        }
        let written = Self::read_async(flash, base)
            .await
            .map_err(FlashError::Flash)?;
        written.begun(envelope).ok_or(FlashError::Worn)
    }

    /// A trailer that holds an envelope of that length, which fits its CRC, and nothing else.
    fn begun(self, envelope: &[u8]) -> Option<Self> {
        let fresh = Self {
            envelope: Some(envelope.len() as u16),
            ..Self::EMPTY
        };
        (self == fresh).then_some(self)
    }

    /// Appends `record`, and reads back that it is there.
    ///
    /// # Errors
    /// [`FlashError::Refused`] with [`TrailerFull`].
    pub fn record<F: MultiwriteNorFlash>(
        flash: &mut F,
        base: u32,
        record: Record,
    ) -> Result<Self, FlashError<F::Error, TrailerFull>> {
        for _ in 0..TRIES {
            let present = Self::read(flash, base).map_err(FlashError::Flash)?;
            match present.append(record).map_err(FlashError::Refused)? {
                None => return Ok(present),
                Some(operation) => operation.execute(flash, base).map_err(FlashError::Flash)?,
            }
        }
        Err(FlashError::Worn)
    }

    /// As [`Trailer::record`], where the flash is waited for.
    ///
    /// # Errors
    /// As [`Trailer::record`].
    ///
    /// # Cancellation Safety
    /// As safe as a power cut: record it again.
    pub async fn record_async<F: AsyncMultiwriteNorFlash>(
        flash: &mut F,
        base: u32,
        record: Record,
    ) -> Result<Self, FlashError<F::Error, TrailerFull>> {
        for _ in 0..TRIES {
            let present = Self::read_async(flash, base)
                .await
                .map_err(FlashError::Flash)?;
            match present.append(record).map_err(FlashError::Refused)? {
                None => return Ok(present),
                Some(operation) => {
                    let done = operation.execute_async(flash, base).await;
                    done.map_err(FlashError::Flash)?;
                }
            }
        }
        Err(FlashError::Worn)
    }
}
