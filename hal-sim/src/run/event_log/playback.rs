//! What the devices of a robot are going to say, and when.

use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::future::pending;
use std::rc::Rc;

use crawler_hal::{Clock, Instant, LinkState, NetError};

use super::{Event, EventLog, Flash, Lens, Net, What, Writer};
use crate::sched::SimClock;

/// Things to say, each with its moment.
type Lines<T> = VecDeque<(u64, T)>;

/// When something that the program gave a device was taken, and how much of it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Taken {
    begun: u64,
    /// `None`: never, as long as the program waited.
    done: Option<u64>,
    pub(crate) bytes: usize,
    pub(crate) broken: bool,
}

/// Something that comes past the network.
#[derive(Debug)]
pub(crate) enum Word {
    Command(Vec<u8>),
    Time(u64),
    ClockStep(i64),
}

#[derive(Debug, Default)]
pub(crate) struct Script {
    pub(crate) heard: Lines<Option<Vec<u8>>>,
    pub(crate) echo: Lines<()>,
    pub(crate) echo_level: Lines<bool>,
    pub(crate) battery: Lines<Option<u16>>,
    pub(crate) picture: Lines<Result<Vec<u8>, Lens>>,
    pub(crate) joined: Lines<Option<Net>>,
    pub(crate) connected: Lines<Option<Net>>,
    pub(crate) received: Lines<Option<Vec<u8>>>,
    links: Lines<LinkState>,
    link: Option<LinkState>,
    asked: VecDeque<Taken>,
    flushed: VecDeque<Taken>,
    sent: VecDeque<Taken>,
    refused: BTreeMap<u64, Flash>,
    /// What came past the network.
    pub(crate) told: Lines<Word>,
}

impl Script {
    /// Everything that a program hears, out of what is on its event log.
    pub(crate) fn of(events: &[Event]) -> Self {
        let mut script = Self::default();
        for Event(at, what) in events {
            let at = *at;
            match what {
                What::Heard(bytes) => {
                    let bytes = bytes.as_ref().map(|bytes| bytes.bytes().to_vec());
                    script.heard.push_back((at, bytes));
                }
                What::Echo => script.echo.push_back((at, ())),
                What::EchoLevel(level) => script.echo_level.push_back((at, *level)),
                What::Battery(voltage) => script.battery.push_back((at, *voltage)),
                What::Picture(picture) => {
                    let picture = picture.as_ref().map(|bytes| bytes.bytes().to_vec());
                    script
                        .picture
                        .push_back((at, picture.map_err(|error| *error)));
                }
                What::FlashRefused(number, error) => {
                    script.refused.insert(*number, *error);
                }
                What::Joined(error) => script.joined.push_back((at, *error)),
                What::Connected(error) => script.connected.push_back((at, *error)),
                What::Received(bytes) => {
                    let bytes = bytes.as_ref().map(|bytes| bytes.bytes().to_vec());
                    script.received.push_back((at, bytes));
                }
                What::Link(link) => {
                    let state = match *link {
                        None => LinkState::Down,
                        Some((address, rssi_dbm)) => LinkState::Up { address, rssi_dbm },
                    };
                    script.links.push_back((at, state));
                }
                What::Told(bytes) => {
                    let word = Word::Command(bytes.bytes().to_vec());
                    script.told.push_back((at, word));
                }
                What::ClockStep(ms) => script.told.push_back((at, Word::ClockStep(*ms))),
                What::Time(unix_ms) => script.told.push_back((at, Word::Time(*unix_ms))),
                What::Asked {
                    bytes,
                    done_us,
                    broken,
                } => script.asked.push_back(Taken {
                    begun: at,
                    done: Some(done_us.unwrap_or(at)),
                    bytes: bytes.len(),
                    broken: *broken,
                }),
                What::Flushed(done) => script.flushed.push_back(Taken {
                    begun: at,
                    done: Some(*done),
                    bytes: 0,
                    broken: false,
                }),
                What::Sent {
                    bytes,
                    done_us,
                    broken,
                } => script.sent.push_back(Taken {
                    begun: at,
                    done: Some(done_us.unwrap_or(at)),
                    bytes: *bytes as usize,
                    broken: *broken,
                }),
                What::GivenUp(writer) => {
                    let never = Taken {
                        begun: at,
                        done: None,
                        bytes: 0,
                        broken: false,
                    };
                    script.writes(*writer).push_back(never);
                }
                What::Trigger(_)
                | What::Set(..)
                | What::State(..)
                | What::Published { .. }
                | What::Delivered { .. }
                | What::Reset => {}
            }
        }
        script
    }

    fn writes(&mut self, writer: Writer) -> &mut VecDeque<Taken> {
        match writer {
            Writer::Ask => &mut self.asked,
            Writer::Flush => &mut self.flushed,
            Writer::Send => &mut self.sent,
        }
    }
}

/// What all devices of a played body share.
#[derive(Debug)]
pub(crate) struct Playback {
    clock: SimClock,
    pub(crate) script: RefCell<Script>,
    /// What the program does this time.
    pub(crate) event_log: Rc<EventLog>,
}

impl Playback {
    pub(crate) fn new(script: Script, clock: &SimClock) -> Self {
        Self {
            clock: clock.world(),
            script: RefCell::new(script),
            event_log: Rc::new(EventLog::new(clock)),
        }
    }

    /// The next thing of its kind, when its moment has come; never, when there is none.
    pub(crate) async fn next<T>(&self, lines: impl Fn(&mut Script) -> &mut Lines<T>) -> T {
        loop {
            let at = lines(&mut self.script.borrow_mut())
                .front()
                .map(|line| line.0);
            let Some(at) = at else {
                return pending().await;
            };
            self.clock.sleep_until(Instant::from_micros(at)).await;
            if let Some((_, said)) = lines(&mut self.script.borrow_mut()).pop_front() {
                return said;
            }
        }
    }

    /// The next bytes of a stream, as many as fit `buf`; `None` when it is broken.
    pub(crate) async fn bytes(
        &self,
        buf: &mut [u8],
        lines: impl Fn(&mut Script) -> &mut Lines<Option<Vec<u8>>>,
    ) -> Option<usize> {
        let said = self.next(&lines).await?;
        let taken = said.len().min(buf.len());
        buf[..taken].copy_from_slice(&said[..taken]);
        if taken < said.len() {
            // A program with a smaller buffer gets the rest at once.
            let rest = Some(said[taken..].to_vec());
            let now = self.event_log.now();
            lines(&mut self.script.borrow_mut()).push_front((now, rest));
        }
        Some(taken)
    }

    /// Waits as long as the device took the first time to take what it is given now. Something
    /// that it was not given then is taken at once.
    pub(crate) async fn take(&self, writer: Writer, length: usize) -> Taken {
        let now = self.event_log.now();
        let known = {
            let script = &mut *self.script.borrow_mut();
            let writes = script.writes(writer);
            while writes.front().is_some_and(|taken| taken.begun < now) {
                writes.pop_front();
            }
            let now_too = writes.front().is_some_and(|taken| taken.begun == now);
            now_too.then(|| writes.pop_front()).flatten()
        };
        let Some(taken) = known else {
            return Taken {
                begun: now,
                done: Some(now),
                bytes: length,
                broken: false,
            };
        };
        let Some(done) = taken.done else {
            return pending().await;
        };
        self.clock.sleep_until(Instant::from_micros(done)).await;
        Taken {
            // One that takes nothing would be asked again and again.
            bytes: taken.bytes.min(length).max(usize::from(length > 0)),
            ..taken
        }
    }

    /// What the radio says of its access point now.
    pub(crate) fn link(&self) -> LinkState {
        let now = self.event_log.now();
        let script = &mut *self.script.borrow_mut();
        while let Some(&(at, state)) = script.links.front()
            && (at <= now || script.link.is_none())
        {
            script.link = Some(state);
            script.links.pop_front();
        }
        script.link.unwrap_or(LinkState::Down)
    }

    /// Something that came past the network, once its moment has come.
    pub(crate) fn word(&self, now: u64) -> Option<Word> {
        let told = &mut self.script.borrow_mut().told;
        told.pop_front_if(|line| line.0 <= now).map(|line| line.1)
    }

    /// When the next thing comes past the network.
    pub(crate) fn next_word(&self) -> u64 {
        let script = self.script.borrow();
        script.told.front().map_or(u64::MAX, |line| line.0)
    }

    /// Whether the echo pin is high.
    pub(crate) fn echo_level(&self) -> bool {
        let said = self.script.borrow_mut().echo_level.pop_front();
        said.is_some_and(|(_, level)| level)
    }

    /// Whether the flash refuses operation `number`.
    pub(crate) fn refuses(&self, number: u64) -> Option<Flash> {
        self.script.borrow().refused.get(&number).copied()
    }
}

/// A network error by its name in the file.
pub(crate) fn failed(error: Option<Net>) -> Result<(), NetError> {
    match error {
        None => Ok(()),
        Some(error) => Err(error.into()),
    }
}
