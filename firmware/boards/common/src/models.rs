//! Models of a detector that are changed while it runs, on another core perhaps.
//!
//! Three buffers, each with room for one model, go to and fro between the update activity, which loads ([`ModelLoader`]),
//! and the camera activity, which looks ([`ChangingEyes`]): by way of [`Models`], and never copied. Whoever has a buffer
//! owns it, so nobody writes to a model that a look goes by. Eyes change between looks: the look that has begun ends
//! with the model that it has begun with. One buffer is with the eyes, one waits for their next look, and one is loaded:
//! that many are enough, however seldom anybody looks.

use core::cell::RefCell;

use crawler_app::vision::{
    Detector, DetectorError, Eyes, Look, ModelError, Picture, PictureError, Spots,
};
use crawler_app::{LoadError, ModelHost, ModelLooks};
use crawler_hal::{Clock, FrameFormat, ModelRegion};
use crawler_protocol::ModelName;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::ReadNorFlash;
use heapless::Vec;

#[cfg(test)]
mod tests;

/// Bytes that are read at a time. They come by way of this much memory of the processor's own: flash is not read into
/// memory that is itself behind the flash's cache, as PSRAM is.
const READ_BYTES: usize = 256;

/// How many buffers there are.
pub const BUFFERS: usize = 3;

/// A buffer with a model in it.
#[derive(Debug)]
struct Loaded<'b> {
    buffer: &'b mut [u8],
    bytes: usize,
}

impl Loaded<'_> {
    fn blob(&self) -> &[u8] {
        &self.buffer[..self.bytes]
    }
}

/// What the next look is to go by.
#[derive(Debug)]
enum Use<'b> {
    /// The model of the program.
    Own,
    /// This one.
    Given(Loaded<'b>),
}

/// What both sides share.
#[derive(Debug)]
struct Shared<'b> {
    /// What the eyes have not taken up yet.
    next: Option<Use<'b>>,
    /// Buffers that nobody uses.
    spare: Vec<&'b mut [u8], BUFFERS>,
    /// Which change `looks` is about: each has a number of its own.
    change: u32,
    looks: ModelLooks,
}

impl<'b> Shared<'b> {
    fn give_back(&mut self, buffer: &'b mut [u8]) {
        // There is room for all that there are.
        let _ = self.spare.push(buffer);
    }

    /// Has the next look go by this.
    fn change(&mut self, next: Use<'b>) {
        if let Some(Use::Given(never_used)) = self.next.replace(next) {
            self.give_back(never_used.buffer);
        }
        self.change = self.change.wrapping_add(1);
        self.looks = ModelLooks::default();
    }
}

/// Buffers for models, between who loads and who looks.
#[derive(Debug)]
pub struct Models<'b, M: RawMutex>(Mutex<M, RefCell<Shared<'b>>>);

impl<'b, M: RawMutex> Models<'b, M> {
    /// Models in these buffers. One that is larger than a buffer is refused when it is loaded.
    pub fn new(buffers: [&'b mut [u8]; BUFFERS]) -> Self {
        Self(Mutex::new(RefCell::new(Shared {
            next: None,
            spare: Vec::from(buffers),
            change: 0,
            looks: ModelLooks::default(),
        })))
    }

    fn with<T>(&self, f: impl FnOnce(&mut Shared<'b>) -> T) -> T {
        self.0.lock(|shared| f(&mut shared.borrow_mut()))
    }
}

/// Loads models for [`ChangingEyes`]. There may be one for each [`Models`]; a second one would take its buffers.
#[derive(Debug)]
pub struct ModelLoader<'s, 'b, M: RawMutex> {
    models: &'s Models<'b, M>,
    name: ModelName,
    region: ModelRegion,
    arena_bytes: usize,
    at_hand: Option<Loaded<'b>>,
}

impl<'s, 'b, M: RawMutex> ModelLoader<'s, 'b, M> {
    /// Loads what is called `name` and lies in `region`, for eyes with an arena of `arena_bytes`.
    pub const fn new(
        models: &'s Models<'b, M>,
        name: ModelName,
        region: ModelRegion,
        arena_bytes: usize,
    ) -> Self {
        Self {
            models,
            name,
            region,
            arena_bytes,
            at_hand: None,
        }
    }

    /// A buffer that no eyes look with.
    fn free_buffer(&mut self) -> Option<&'b mut [u8]> {
        match self.at_hand.take() {
            Some(loaded) => Some(loaded.buffer),
            None => self.models.with(|shared| shared.spare.pop()),
        }
    }
}

/// Whether this is a detector that runs in so much memory.
fn judge(blob: &[u8], arena_bytes: usize) -> Result<(), DetectorError> {
    let needed = Detector::new(blob)?.arena_bytes();
    if needed > arena_bytes {
        return Err(ModelError::Arena { needed }.into());
    }
    Ok(())
}

impl<M: RawMutex> ModelHost for ModelLoader<'_, '_, M> {
    fn name(&self) -> &ModelName {
        &self.name
    }

    fn region(&self) -> ModelRegion {
        self.region
    }

    /// # Cancellation Safety
    /// A dropped call leaves nothing at hand, and keeps the buffer.
    async fn load<F: ReadNorFlash>(
        &mut self,
        flash: &mut F,
        at: u32,
        bytes: u32,
    ) -> Result<(), LoadError<F::Error>> {
        let bytes = bytes as usize;
        let full = LoadError::Unfit(ModelError::Full.into());
        let Some(buffer) = self.free_buffer() else {
            return Err(full);
        };
        // At hand as an empty one from the beginning: whatever ends this call, the buffer stays.
        let loaded = self.at_hand.insert(Loaded { buffer, bytes: 0 });
        let Some(place) = loaded.buffer.get_mut(..bytes) else {
            return Err(full);
        };
        for (from, part) in (at..).step_by(READ_BYTES).zip(place.chunks_mut(READ_BYTES)) {
            let mut words = [0; READ_BYTES];
            // Whole words are read, of which the last may be in part behind the model.
            let whole = &mut words[..part.len().next_multiple_of(F::READ_SIZE)];
            let read = flash.read(from, whole).await;
            read.map_err(LoadError::Flash)?;
            part.copy_from_slice(&whole[..part.len()]);
        }
        judge(place, self.arena_bytes).map_err(LoadError::Unfit)?;
        loaded.bytes = bytes;
        Ok(())
    }

    fn adopt(&mut self) {
        match self.at_hand.take() {
            Some(loaded) if loaded.bytes > 0 => {
                self.models.with(|shared| shared.change(Use::Given(loaded)));
            }
            // What was not loaded changes nothing.
            nothing => self.at_hand = nothing,
        }
    }

    fn use_own(&mut self) {
        let loaded = self.at_hand.take();
        self.models.with(|shared| {
            if let Some(loaded) = loaded {
                shared.give_back(loaded.buffer);
            }
            shared.change(Use::Own);
        });
    }

    fn looks(&self) -> ModelLooks {
        self.models.with(|shared| shared.looks)
    }
}

/// Eyes whose model [`ModelLoader`] changes. They look with that of the program until then.
#[derive(Debug)]
pub struct ChangingEyes<'s, 'b, M: RawMutex, C> {
    models: &'s Models<'b, M>,
    own: Detector<'static>,
    used: Option<Loaded<'b>>,
    arena: &'b mut [i8],
    frame: &'b mut [u8],
    clock: C,
}

impl<'s, 'b, M: RawMutex, C: Clock> ChangingEyes<'s, 'b, M, C> {
    /// Eyes that look with the model `own` of the program, and run in `arena` whatever they look with. A camera whose
    /// frames are larger than `frame` shows them nothing.
    ///
    /// # Errors
    /// When `own` is no detector, or needs more memory than there is.
    pub fn new(
        models: &'s Models<'b, M>,
        own: &'static [u8],
        arena: &'b mut [i8],
        frame: &'b mut [u8],
        clock: C,
    ) -> Result<Self, DetectorError> {
        let own = Detector::new(own)?;
        own.run_in(arena)?;
        Ok(Self {
            models,
            own,
            used: None,
            arena,
            frame,
            clock,
        })
    }
}

impl<'b, M: RawMutex, C: Clock> Eyes for ChangingEyes<'_, 'b, M, C> {
    type Look<'e>
        = ChangingLook<'e, 'b, M, C>
    where
        Self: 'e;

    fn open(&mut self, bytes: usize) -> Option<ChangingLook<'_, 'b, M, C>> {
        let used = &mut self.used;
        let change = self.models.with(|shared| {
            if let Some(next) = shared.next.take() {
                let given = match next {
                    Use::Own => None,
                    Use::Given(loaded) => Some(loaded),
                };
                if let Some(before) = core::mem::replace(used, given) {
                    shared.give_back(before.buffer);
                }
            }
            shared.change
        });
        // What was loaded was found to be a detector before.
        let given = self.used.as_ref();
        let given = given.and_then(|loaded| Detector::new(loaded.blob()).ok());
        Some(ChangingLook {
            detector: given.unwrap_or(self.own),
            frame: self.frame.get_mut(..bytes)?,
            arena: self.arena,
            clock: &self.clock,
            models: self.models,
            change,
        })
    }
}

/// A look of [`ChangingEyes`].
#[derive(Debug)]
pub struct ChangingLook<'e, 'b, M: RawMutex, C> {
    detector: Detector<'e>,
    frame: &'e mut [u8],
    arena: &'e mut [i8],
    clock: &'e C,
    models: &'e Models<'b, M>,
    change: u32,
}

impl<M: RawMutex, C: Clock> Look for ChangingLook<'_, '_, M, C> {
    fn frame(&mut self) -> &mut [u8] {
        self.frame
    }

    async fn find(self, size: (u16, u16), format: FrameFormat) -> Result<Spots, PictureError> {
        let picture = Picture::new(self.frame, size, format)?;
        let began = self.clock.now();
        // The arena was found to be large enough when the model was loaded.
        let Ok(mut finder) = self.detector.run_in(self.arena) else {
            return Ok(Spots::new());
        };
        let spots = finder.find_gently(&picture).await;
        let took = self.clock.now().saturating_since(began);
        self.models.with(|shared| {
            if shared.change == self.change {
                shared.looks.taken = shared.looks.taken.saturating_add(1);
                shared.looks.slowest = shared.looks.slowest.max(took);
            }
        });
        Ok(spots)
    }
}
