//! Where a policy lies that a release has brought.
//!
//! There is one place, of [`MAX_BYTES`] bytes. Whoever decides keeps it locked from the first layer of the network to the
//! last, so nobody writes to a policy by which is being decided; the update activity writes to it while the robot stands.
//! What is in it was read as a policy once, when it was put there.

use core::ops::Deref;

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::mutex::{Mutex, MutexGuard};
use embedded_storage_async::nor_flash::ReadNorFlash;

use super::blob::{MAX_BYTES, Policy, PolicyError};
use crate::hold::{Hold, Room};

/// Bytes that are read from flash at a time.
const SLICE: usize = 256;

/// What lies in a [`Shelf`].
struct Held<H: Hold> {
    /// Stands for the name under which it may be driven by.
    name: Option<u32>,
    length: usize,
    place: H::Room<[u8; MAX_BYTES]>,
}

impl<H: Hold> Held<H> {
    fn blob(&self) -> &[u8] {
        let place = self.place.get().map_or(&[][..], |place| &place[..]);
        place.get(..self.length).unwrap_or(&[])
    }
}

/// The place of a policy that a release has brought. A board keeps it in a static beside its [`Robot`](crate::Robot):
/// 12 KB.
pub struct Shelf<M: RawMutex, H: Hold> {
    held: Mutex<M, Held<H>>,
}

impl<M: RawMutex, H: Hold> Default for Shelf<M, H> {
    fn default() -> Self {
        Self::new()
    }
}

/// Why a policy is not put into its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unread {
    /// The flash cannot be read.
    Flash,
    /// These bytes are none.
    Policy(PolicyError),
}

impl<M: RawMutex, H: Hold> Shelf<M, H> {
    /// Nothing lies there.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            held: Mutex::new(Held {
                name: None,
                length: 0,
                place: H::Room::EMPTY,
            }),
        }
    }

    /// Puts the `bytes` bytes at `at` of `flash` there. Nobody drives by them yet, nor by what was there before.
    ///
    /// # Errors
    /// When they cannot be read, or are no policy that this program can drive by: then nothing is there.
    ///
    /// # Cancellation Safety
    /// After a dropped call nothing is there.
    pub(crate) async fn put<F: ReadNorFlash>(
        &self,
        flash: &mut F,
        at: u32,
        bytes: u32,
    ) -> Result<(), Unread> {
        let mut held = self.held.lock().await;
        let held = &mut *held;
        (held.name, held.length) = (None, 0);
        let length = bytes as usize;
        let Some(place) = held.place.enter().get_mut(..length) else {
            return Err(Unread::Policy(PolicyError::Length));
        };
        for (from, part) in (at..).step_by(SLICE).zip(place.chunks_mut(SLICE)) {
            // Whole words are read, of which the last may be in part behind the policy.
            let mut words = [0; SLICE];
            let whole = &mut words[..part.len().next_multiple_of(F::READ_SIZE)];
            let read = flash.read(from, whole).await;
            read.map_err(|_| Unread::Flash)?;
            part.copy_from_slice(&whole[..part.len()]);
        }
        Policy::new(place).map_err(Unread::Policy)?;
        held.length = length;
        Ok(())
    }

    /// Has what is there driven by under a name, or nothing.
    pub(crate) async fn allow(&self, name: Option<u32>) {
        let mut held = self.held.lock().await;
        let is_there = held.length > 0;
        held.name = name.filter(|_| is_there);
        if held.name.is_none() {
            held.length = 0;
            held.place.leave();
        }
    }
}

/// A policy that is being decided by.
pub(crate) trait Open {
    fn policy(&self) -> Option<Policy<'_>>;
}

/// Where policies lie beside the one of the program, for whoever decides.
pub(crate) trait Also {
    type Open<'s>: Open
    where
        Self: 's;

    /// The policy of this name, if it is there.
    ///
    /// # Cancellation Safety
    /// A dropped call changes nothing.
    fn open(&self, name: u32) -> impl Future<Output = Option<Self::Open<'_>>>;
}

/// The place of a policy, locked.
pub(crate) struct Opened<'s, M: RawMutex, H: Hold>(MutexGuard<'s, M, Held<H>>);

impl<M: RawMutex, H: Hold> Open for Opened<'_, M, H> {
    fn policy(&self) -> Option<Policy<'_>> {
        Policy::known(self.0.blob())
    }
}

impl<M: RawMutex + 'static, H: Hold + 'static, D: Deref<Target = Shelf<M, H>>> Also for D {
    type Open<'s>
        = Opened<'s, M, H>
    where
        Self: 's;

    async fn open(&self, name: u32) -> Option<Opened<'_, M, H>> {
        let held = self.held.lock().await;
        (held.name == Some(name)).then(|| Opened(held))
    }
}

/// No place beside that of the program.
pub(crate) struct NoShelf;

/// What lies there.
pub(crate) enum Nothing {}

impl Open for Nothing {
    fn policy(&self) -> Option<Policy<'_>> {
        match *self {}
    }
}

impl Also for NoShelf {
    type Open<'s> = Nothing;

    async fn open(&self, _: u32) -> Option<Nothing> {
        None
    }
}
