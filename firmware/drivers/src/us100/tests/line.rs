//! A serial line whose far end does as told.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::{pending, poll_fn};
use std::rc::Rc;
use std::task::Poll;
use std::vec::Vec;

use crawler_hal::{Clock, Duration, Instant};
use embedded_io_async::{Error, ErrorKind, ErrorType, Read, Write};

use super::BYTE;
use crate::testing::TestClock;

/// What the receiver gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Heard {
    Byte(u8),
    Error,
    /// The line is closed.
    End,
}

/// What the transmitter does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Writing {
    Works,
    Blocks,
    Closed,
    Errs,
}

#[derive(Debug)]
struct State {
    clock: TestClock,
    /// To be received, by time.
    coming: VecDeque<(Instant, Heard)>,
    /// What the next request `.0` brings, by time after it.
    script: Option<(u8, Vec<(Duration, Heard)>)>,
    always: Option<Heard>,
    babble: Option<(Duration, Instant)>,
    writing: Writing,
    sent: Vec<u8>,
    heard: Vec<u8>,
    reads: usize,
}

impl State {
    fn next(&self) -> Option<Instant> {
        let coming = self.coming.front().map(|&(at, _)| at);
        let babble = self.babble.map(|(_, at)| at);
        [coming, babble].into_iter().flatten().min()
    }

    fn take(&mut self) -> Option<Heard> {
        let now = self.clock.now();
        if self.always.is_some() {
            return self.always;
        }
        if let Some((period, at)) = &mut self.babble
            && *at <= now
        {
            *at += *period;
            return Some(Heard::Byte(0x02));
        }
        self.coming
            .pop_front_if(|&mut (at, _)| at <= now)
            .map(|(_, heard)| heard)
    }

    fn read(&mut self, buf: &mut [u8]) -> Poll<Result<usize, Broken>> {
        let mut read = 0;
        while read < buf.len() {
            // An error or the end waits behind the bytes that came before it.
            match self.take() {
                Some(Heard::Byte(byte)) => {
                    buf[read] = byte;
                    self.heard.push(byte);
                    read += 1;
                }
                Some(other) if read > 0 => {
                    self.coming.push_front((self.clock.now(), other));
                    break;
                }
                Some(Heard::Error) => return Poll::Ready(Err(Broken)),
                Some(Heard::End) => return Poll::Ready(Ok(0)),
                None => break,
            }
        }
        if read > 0 {
            return Poll::Ready(Ok(read));
        }
        if let Some(at) = self.next() {
            self.clock.wake_at(at);
        }
        Poll::Pending
    }
}

/// The far end.
#[derive(Debug, Clone)]
pub(super) struct Line(Rc<RefCell<State>>);

impl Line {
    pub(super) fn new(clock: TestClock) -> Self {
        Self(Rc::new(RefCell::new(State {
            clock,
            coming: VecDeque::new(),
            script: None,
            always: None,
            babble: None,
            writing: Writing::Works,
            sent: Vec::new(),
            heard: Vec::new(),
            reads: 0,
        })))
    }

    pub(super) fn uart(&self) -> Uart {
        Uart(self.clone())
    }

    /// The next `request` brings `script`.
    pub(super) fn script(&self, request: u8, script: &[(Duration, Heard)]) {
        self.0.borrow_mut().script = Some((request, script.to_vec()));
    }

    /// The next `request` brings `reply` as the sensor would send it, 12 ms later.
    pub(super) fn answer(&self, request: u8, reply: &[u8]) {
        let mut at = Duration::from_millis(12);
        let script: Vec<_> = reply
            .iter()
            .map(|&byte| {
                at = at + BYTE;
                (at, Heard::Byte(byte))
            })
            .collect();
        self.script(request, &script);
    }

    /// `bytes` have arrived already.
    pub(super) fn waiting(&self, bytes: &[u8]) {
        let mut state = self.0.borrow_mut();
        let now = state.clock.now();
        state
            .coming
            .extend(bytes.iter().map(|&byte| (now, Heard::Byte(byte))));
    }

    /// The receiver gets `heard` whenever it looks.
    pub(super) fn always(&self, heard: Heard) {
        self.0.borrow_mut().always = Some(heard);
    }

    /// A byte comes in every `period`, for ever.
    pub(super) fn babble(&self, period: Duration) {
        let mut state = self.0.borrow_mut();
        let now = state.clock.now();
        state.babble = Some((period, now));
    }

    pub(super) fn writing(&self, writing: Writing) {
        self.0.borrow_mut().writing = writing;
    }

    pub(super) fn sent(&self) -> Vec<u8> {
        self.0.borrow().sent.clone()
    }

    /// Bytes the receiver took, since [`Self::forget`].
    pub(super) fn heard(&self) -> Vec<u8> {
        self.0.borrow().heard.clone()
    }

    pub(super) fn forget(&self) {
        self.0.borrow_mut().heard.clear();
    }

    pub(super) fn reads(&self) -> usize {
        self.0.borrow().reads
    }
}

/// The near end.
#[derive(Debug)]
pub(super) struct Uart(Line);

#[derive(Debug)]
pub(super) struct Broken;

impl core::fmt::Display for Broken {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("broken")
    }
}

impl core::error::Error for Broken {}

impl Error for Broken {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for Uart {
    type Error = Broken;
}

impl Read for Uart {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, Broken> {
        self.0.0.borrow_mut().reads += 1;
        poll_fn(|_| self.0.0.borrow_mut().read(buf)).await
    }
}

impl Write for Uart {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Broken> {
        let writing = self.0.0.borrow().writing;
        match writing {
            Writing::Works => {}
            Writing::Blocks => pending().await,
            Writing::Closed => return Ok(0),
            Writing::Errs => return Err(Broken),
        }
        let mut state = self.0.0.borrow_mut();
        let now = state.clock.now();
        for &byte in bytes {
            state.sent.push(byte);
            if let Some((_, script)) = state.script.take_if(|(request, _)| *request == byte) {
                let script = script
                    .into_iter()
                    .map(|(after, heard)| (now + after, heard));
                state.coming.extend(script);
                state.coming.make_contiguous().sort_by_key(|&(at, _)| at);
            }
        }
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Broken> {
        Ok(())
    }
}
