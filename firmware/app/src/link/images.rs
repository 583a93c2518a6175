//! Images on their way to the broker.
//!
//! The link takes an image out of its slot and keeps it, through any number of connections, until
//! the broker has acknowledged or refused it.

use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::camera::{Image, ImageSlot, Outcome};

/// Where the link gets images from. A trait object, so that only one link is compiled.
pub(super) trait Images {
    /// Whether there is an image to deliver.
    fn waits(&mut self) -> bool;
    /// The image to deliver: bytes, number, time.
    fn image(&self) -> Option<(&[u8], u32, u64)>;
    /// Lets go of the image.
    fn settle(&mut self, outcome: Outcome);
}

/// The images of a body without a camera.
pub(super) struct NoImages;

impl Images for NoImages {
    fn waits(&mut self) -> bool {
        false
    }

    fn image(&self) -> Option<(&[u8], u32, u64)> {
        None
    }

    fn settle(&mut self, _: Outcome) {}
}

/// The images of a camera.
pub(super) struct FromSlot<'a, M: RawMutex, B> {
    slot: &'a ImageSlot<M, B>,
    held: Option<Image<B>>,
}

impl<'a, M: RawMutex, B> FromSlot<'a, M, B> {
    pub(super) const fn new(slot: &'a ImageSlot<M, B>) -> Self {
        Self { slot, held: None }
    }
}

impl<M: RawMutex, B: AsRef<[u8]>> Images for FromSlot<'_, M, B> {
    fn waits(&mut self) -> bool {
        if self.held.is_none() {
            self.held = self.slot.collect();
        }
        self.held.is_some()
    }

    fn image(&self) -> Option<(&[u8], u32, u64)> {
        let image = self.held.as_ref()?;
        Some((image.jpeg(), image.frame(), image.timestamp()))
    }

    fn settle(&mut self, outcome: Outcome) {
        if let Some(image) = self.held.take() {
            self.slot.settle(image.into_buffer(), outcome);
        }
    }
}
