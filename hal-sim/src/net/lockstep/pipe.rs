//! One direction of a connection: an ordered stream of bytes, each with its time of arrival.

use std::collections::VecDeque;
use std::task::Waker;

/// Segments whose room an empty pipe keeps: so many are under way at a time, nearly always.
const KEPT_SEGMENTS: usize = 4;

/// Never, while the link is cut.
pub(crate) const HELD: u64 = u64::MAX;

/// A stream of bytes under way.
#[derive(Debug, Default)]
pub(crate) struct Pipe {
    bytes: VecDeque<u8>,
    /// Time of arrival and length of what was written at once, in order.
    segments: VecDeque<(u64, usize)>,
    /// When the newest segment arrives: nothing overtakes.
    last: u64,
    /// Nothing more will be written.
    pub(crate) ended: bool,
    pub(crate) reader: Option<Waker>,
    pub(crate) writer: Option<Waker>,
}

impl Pipe {
    /// Bytes under way or waiting to be read.
    pub(crate) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Sends `bytes`, to arrive at `arrival` or when all before has arrived. Returns when.
    pub(crate) fn write(&mut self, bytes: &[u8], arrival: u64) -> u64 {
        self.last = self.last.max(arrival);
        self.bytes.extend(bytes);
        match self.segments.back_mut() {
            Some((at, len)) if *at == self.last => *len += bytes.len(),
            _ => self.segments.push_back((self.last, bytes.len())),
        }
        wake(&mut self.reader);
        self.last
    }

    /// When the newest byte arrives.
    pub(crate) fn last(&self) -> u64 {
        self.last
    }

    /// When the next byte arrives.
    pub(crate) fn next_arrival(&self) -> Option<u64> {
        self.segments.front().map(|&(at, _)| at)
    }

    /// Moves what has arrived into `buf`; returns how much.
    pub(crate) fn read(&mut self, now: u64, buf: &mut [u8]) -> usize {
        let mut taken = 0;
        while taken < buf.len() {
            let Some((_, len)) = self.segments.front_mut().filter(|(at, _)| *at <= now) else {
                break;
            };
            let part = (*len).min(buf.len() - taken);
            let (front, back) = self.bytes.as_slices();
            let first = part.min(front.len());
            buf[taken..taken + first].copy_from_slice(&front[..first]);
            buf[taken + first..taken + part].copy_from_slice(&back[..part - first]);
            self.bytes.drain(..part);
            taken += part;
            *len -= part;
            if *len == 0 {
                self.segments.pop_front();
            }
        }
        self.give_back();
        if taken > 0 {
            wake(&mut self.writer);
        }
        taken
    }

    /// Moves all that has arrived to the end of `out`.
    pub(crate) fn read_to(&mut self, now: u64, out: &mut Vec<u8>) {
        let mut len = 0;
        while let Some(&(at, part)) = self.segments.front() {
            if at > now {
                break;
            }
            len += part;
            self.segments.pop_front();
        }
        if len > 0 {
            let (front, back) = self.bytes.as_slices();
            let part = len.min(front.len());
            out.extend_from_slice(&front[..part]);
            out.extend_from_slice(&back[..len - part]);
            self.bytes.drain(..len);
            self.give_back();
            wake(&mut self.writer);
        }
    }

    /// Most pipes are empty most of the time, and a fleet has two for each robot.
    fn give_back(&mut self) {
        if self.bytes.is_empty() && self.bytes.capacity() > 0 {
            self.bytes = VecDeque::new();
            if self.segments.capacity() > KEPT_SEGMENTS {
                self.segments = VecDeque::new();
            }
        }
    }

    /// What would arrive at `from` or later does not until [`Pipe::release`].
    pub(crate) fn hold(&mut self, from: u64) {
        for (at, _) in &mut self.segments {
            if *at >= from {
                *at = HELD;
            }
        }
        if self.segments.back().is_some_and(|&(at, _)| at == HELD) {
            self.last = HELD;
        }
    }

    /// What was held arrives at `arrival`. Returns whether there is any.
    pub(crate) fn release(&mut self, arrival: u64) -> bool {
        let mut any = false;
        for (at, _) in &mut self.segments {
            if *at == HELD {
                *at = arrival;
                any = true;
            }
        }
        if self.last == HELD {
            self.last = arrival;
        }
        wake(&mut self.reader);
        any
    }

    /// Ends the stream, and tells both ends.
    pub(crate) fn end(&mut self) {
        self.ended = true;
        wake(&mut self.reader);
        wake(&mut self.writer);
    }
}

fn wake(waker: &mut Option<Waker>) {
    if let Some(waker) = waker.take() {
        waker.wake();
    }
}
