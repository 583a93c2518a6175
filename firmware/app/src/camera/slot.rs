//! The one buffer that camera and link share.

use core::cell::RefCell;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::signal::Signal;

/// A JPEG in the buffer it was taken into.
#[derive(Debug)]
pub struct Image<B> {
    buffer: B,
    len: usize,
    frame: u32,
    timestamp: u64,
}

impl<B: AsRef<[u8]>> Image<B> {
    pub(crate) const fn new(buffer: B, len: usize, frame: u32, timestamp: u64) -> Self {
        Self {
            buffer,
            len,
            frame,
            timestamp,
        }
    }

    /// The JPEG.
    pub fn jpeg(&self) -> &[u8] {
        let bytes = self.buffer.as_ref();
        bytes.get(..self.len).unwrap_or(bytes)
    }

    /// Its number: counts the images of this boot, from 1.
    pub const fn frame(&self) -> u32 {
        self.frame
    }

    /// When it was taken, in Unix milliseconds; 0 while the clock was not synchronised.
    pub const fn timestamp(&self) -> u64 {
        self.timestamp
    }

    pub(crate) fn into_buffer(self) -> B {
        self.buffer
    }
}

/// What became of an image that was handed over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The broker has it.
    Delivered,
    /// It is larger than the broker's largest packet.
    TooLarge,
    /// The broker does not want it.
    Refused,
}

#[derive(Debug)]
enum Place<B> {
    /// The buffer waits for a picture.
    Free(B),
    /// Camera or link has it.
    Lent,
    /// An image waits for the link.
    Ready(Image<B>),
}

/// Hands one buffer to and fro between camera and link. What moves is the handle `B`, a `&mut
/// [u8]` on a board: the bytes stay where they are, and have one owner at a time.
///
/// A board keeps the slot in a static beside its [`Robot`](crate::Robot), with a buffer of its
/// own choosing: a still of 320 × 240 pixels takes 6 to 14 KB.
pub struct ImageSlot<M: RawMutex, B> {
    place: Mutex<M, RefCell<Place<B>>>,
    outcome: Signal<M, Outcome>,
}

impl<M: RawMutex, B> ImageSlot<M, B> {
    /// A slot around `buffer`.
    pub const fn new(buffer: B) -> Self {
        Self {
            place: Mutex::new(RefCell::new(Place::Free(buffer))),
            outcome: Signal::new(),
        }
    }

    /// Takes the buffer out, if it is free.
    pub(crate) fn lend(&self) -> Option<B> {
        self.place.lock(|place| {
            let mut place = place.borrow_mut();
            match core::mem::replace(&mut *place, Place::Lent) {
                Place::Free(buffer) => Some(buffer),
                other => {
                    *place = other;
                    None
                }
            }
        })
    }

    /// Puts the buffer back without an image.
    pub(crate) fn give_back(&self, buffer: B) {
        self.put(Place::Free(buffer));
    }

    /// Puts the buffer back with an image, for the link.
    pub(crate) fn hand_over(&self, image: Image<B>) {
        self.outcome.reset();
        self.put(Place::Ready(image));
    }

    /// Takes the image that waits.
    pub(crate) fn collect(&self) -> Option<Image<B>> {
        self.place.lock(|place| {
            let mut place = place.borrow_mut();
            match core::mem::replace(&mut *place, Place::Lent) {
                Place::Ready(image) => Some(image),
                other => {
                    *place = other;
                    None
                }
            }
        })
    }

    /// Puts the buffer back and tells the camera what became of the image.
    pub(crate) fn settle(&self, buffer: B, outcome: Outcome) {
        self.put(Place::Free(buffer));
        self.outcome.signal(outcome);
    }

    /// Waits for what becomes of the image handed over last.
    pub(crate) async fn settled(&self) -> Outcome {
        self.outcome.wait().await
    }

    fn put(&self, what: Place<B>) {
        // The old value is dropped outside of the lock.
        let _old = self
            .place
            .lock(|place| core::mem::replace(&mut *place.borrow_mut(), what));
    }
}
