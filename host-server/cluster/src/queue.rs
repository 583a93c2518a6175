//! What waits to be told to the other servers: bounded, and the oldest goes first.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::frame::{self, OutgoingMessage};

/// Bytes that wait at most: two seconds of ten thousand robots.
pub const MOST_BYTES: usize = 32 * 1024 * 1024;
/// A frame goes when it has this size.
const FRAME: usize = 256 * 1024;

/// Frames being filled and waiting to go.
#[derive(Debug)]
pub struct Queue {
    sender: String,
    inner: Mutex<Inner>,
}

#[derive(Debug, Default)]
struct Inner {
    full: VecDeque<(Vec<u8>, u64)>,
    /// The frame that is being filled, and how many messages are in it.
    open: Option<(Vec<u8>, u64)>,
    bytes: usize,
    dropped: u64,
}

impl Queue {
    /// For what `sender` has heard.
    #[must_use]
    pub fn new(sender: &str) -> Self {
        Self {
            sender: sender.to_owned(),
            inner: Mutex::default(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes in a message. Never waits: when there is no room the oldest frame is dropped.
    pub fn push(&self, message: OutgoingMessage<'_>) {
        let mut inner = self.lock();
        let inner = &mut *inner;
        if inner.open.is_none() {
            let frame = frame::begin(&self.sender);
            inner.bytes += frame.len();
            inner.open = Some((frame, 0));
        }
        let Some((frame, messages)) = &mut inner.open else {
            return;
        };
        let before = frame.len();
        if !frame::put(frame, message) {
            inner.dropped += 1;
            return;
        }
        *messages += 1;
        inner.bytes += frame.len() - before;
        if frame.len() >= FRAME {
            inner.full.extend(inner.open.take());
        }
        while inner.bytes > MOST_BYTES {
            let Some((oldest, messages)) = inner.full.pop_front() else {
                return;
            };
            inner.bytes = inner.bytes.saturating_sub(oldest.len());
            inner.dropped += messages;
        }
    }

    /// The next frame, however full; `None` when nothing waits.
    pub fn take(&self) -> Option<Vec<u8>> {
        let mut inner = self.lock();
        let next = inner.full.pop_front();
        let (frame, _) = next.or_else(|| inner.open.take())?;
        inner.bytes = inner.bytes.saturating_sub(frame.len());
        Some(frame)
    }

    /// Messages that did not fit, ever.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.lock().dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(payload: &[u8]) -> OutgoingMessage<'_> {
        OutgoingMessage {
            topic: b"swarm/telemetry/a",
            payload,
            retained: false,
            content_type: None,
            properties: &[],
        }
    }

    #[test]
    fn it_stays_within_its_bound_and_counts_what_it_drops() {
        let queue = Queue::new("a");
        let payload = vec![7; 1_000];
        for _ in 0..60_000 {
            queue.push(of(&payload));
            assert!(queue.lock().bytes <= MOST_BYTES + FRAME);
        }
        let mut kept = 0;
        while let Some(frame) = queue.take() {
            kept += frame::read(&frame).expect("a frame").1.len() as u64;
        }
        assert!(kept > 10_000);
        assert_eq!(kept + queue.dropped(), 60_000);
        assert_eq!(queue.lock().bytes, 0);
    }

    #[test]
    fn what_comes_first_goes_first() {
        let queue = Queue::new("a");
        assert_eq!(queue.take(), None);
        for number in 0..10_u8 {
            queue.push(OutgoingMessage {
                topic: &[number],
                ..of(&[])
            });
        }
        let frame = queue.take().expect("a frame");
        let (sender, messages) = frame::read(&frame).expect("a frame");
        assert_eq!(sender, "a");
        let topics: Vec<u8> = messages.iter().map(|message| message.topic[0]).collect();
        assert_eq!(topics, (0..10).collect::<Vec<u8>>());
    }
}
