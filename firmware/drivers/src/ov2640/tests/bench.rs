//! A sensor made of registers and frames, on a bus and a port.

use core::cell::{Cell, RefCell};
use core::pin::pin;
use core::task::Context;
use std::rc::Rc;
use std::task::Waker;
use std::vec::Vec;

use crawler_hal::{Clock, Duration, FrameFormat, Instant};
use embedded_hal_async::i2c::{Error as BusError, ErrorKind, ErrorType, I2c, Operation};

use super::super::registers::{ADDRESS, BANK, BANK_DSP, BANK_SENSOR, COM7, COM7_RESET};
use super::super::{Ov2640, Overrun, PixelPort};
use crate::testing::TestClock;

/// A JPEG with FF D9 inside a segment, stuffing and a restart marker in its scan.
pub(super) const JPEG: &[u8] = &[
    0xFF, 0xD8, 0xFF, 0xDB, 0x00, 0x06, 0xFF, 0xD9, 0x01, 0x02, 0xFF, 0xDA, 0x00, 0x03, 0x01, 0x11,
    0xFF, 0x00, 0x22, 0xFF, 0xD3, 0x33, 0xFF, 0xD9,
];

/// Between the ends of two frames.
const FRAME_TIME: Duration = Duration::from_millis(40);

/// What the sensor does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scene {
    Good,
    /// Nobody acknowledges.
    Absent,
    /// Somebody else does.
    Stranger,
    /// The bus is held down: transactions never end.
    Stuck,
    /// No pixel, no end.
    Silent,
    /// Pixels and no end.
    Endless,
    /// Every frame lacks its last bytes.
    Torn,
    EveryOtherTorn,
    /// Every frame has bytes too many, and its JPEG no end.
    Overlong,
    /// The port loses bytes all the time.
    Overrun,
}

struct Inside {
    scene: Cell<Scene>,
    bank: Cell<u8>,
    window_mode: Cell<u8>,
    pointer: Cell<u8>,
    writes: RefCell<Vec<(u8, u8, u8)>>,
    resets: Cell<u32>,
    frames: Cell<u32>,
    listening: Cell<bool>,
    next_end: Cell<Instant>,
}

/// See the [module](self).
#[derive(Clone)]
pub(super) struct Bench {
    pub(super) clock: TestClock,
    inside: Rc<Inside>,
}

impl Bench {
    pub(super) fn new(scene: Scene) -> Self {
        Self {
            clock: TestClock::default(),
            inside: Rc::new(Inside {
                scene: Cell::new(scene),
                bank: Cell::new(0x5A),
                window_mode: Cell::new(0),
                pointer: Cell::new(0),
                writes: RefCell::default(),
                resets: Cell::new(0),
                frames: Cell::new(0),
                listening: Cell::new(false),
                next_end: Cell::new(Instant::BOOT),
            }),
        }
    }

    pub(super) fn camera(&self, format: FrameFormat) -> Ov2640<Self, Self, TestClock> {
        Ov2640::new(self.clone(), self.clone(), self.clock.clone(), format)
    }

    pub(super) fn set(&self, scene: Scene) {
        self.inside.scene.set(scene);
    }

    pub(super) fn run<F: Future>(&self, work: F) -> F::Output {
        self.clock.block_on(work)
    }

    /// Polls `work` as often, a millisecond apart, and drops it.
    pub(super) fn poll_and_drop<F: Future>(&self, work: F, polls: u32) {
        let mut work = pin!(work);
        for _ in 0..polls {
            let mut context = Context::from_waker(Waker::noop());
            if work.as_mut().poll(&mut context).is_ready() {
                return;
            }
            self.clock.pass(Duration::from_millis(1));
        }
    }

    pub(super) fn writes(&self) -> Vec<(u8, u8, u8)> {
        self.inside.writes.borrow().clone()
    }

    pub(super) fn forget(&self) {
        self.inside.writes.borrow_mut().clear();
    }

    pub(super) fn resets(&self) -> u32 {
        self.inside.resets.get()
    }

    /// Frames that ended while somebody listened.
    pub(super) fn frames(&self) -> u32 {
        self.inside.frames.get()
    }

    pub(super) fn is_listening(&self) -> bool {
        self.inside.listening.get()
    }

    fn frame(&self) -> Vec<u8> {
        let scene = self.inside.scene.get();
        let mut bytes: Vec<u8> = match self.inside.window_mode.get() {
            0x10 => [&[0xFF, 0x00, 0xFF][..], JPEG, &[0; 40]].concat(),
            0x08 => (0..2 * 96 * 96_u32).map(|i| (i % 241) as u8).collect(),
            _ => (0..96 * 96_u32)
                .flat_map(|i| [(i % 251) as u8, 0x80])
                .collect(),
        };
        let torn = match scene {
            Scene::Torn | Scene::Overlong => true,
            Scene::EveryOtherTorn => self.inside.frames.get().is_multiple_of(2),
            _ => false,
        };
        if torn && self.inside.window_mode.get() == 0x10 {
            bytes.truncate(20);
        } else if torn && scene == Scene::Overlong {
            bytes.push(0);
        } else if torn {
            bytes.truncate(bytes.len() - 2);
        }
        bytes
    }
}

#[derive(Debug)]
pub(super) struct Nack;

impl BusError for Nack {
    fn kind(&self) -> ErrorKind {
        ErrorKind::NoAcknowledge(embedded_hal_async::i2c::NoAcknowledgeSource::Address)
    }
}

impl ErrorType for Bench {
    type Error = Nack;
}

impl I2c for Bench {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Nack> {
        let inside = &self.inside;
        match inside.scene.get() {
            Scene::Stuck => return core::future::pending().await,
            Scene::Absent => return Err(Nack),
            _ if address != ADDRESS => return Err(Nack),
            _ => {}
        }
        // The sensor takes no repeated start.
        assert_eq!(operations.len(), 1);
        // 100 kHz: three bytes with their acknowledgements.
        self.clock.sleep(Duration::from_micros(300)).await;
        for operation in operations {
            match operation {
                Operation::Write([register]) => inside.pointer.set(*register),
                Operation::Write([BANK, bank]) => {
                    inside.bank.set(*bank);
                    inside.writes.borrow_mut().push((0xFF, BANK, *bank));
                }
                Operation::Write([register, value]) => {
                    let bank = inside.bank.get();
                    inside.writes.borrow_mut().push((bank, *register, *value));
                    match (bank, *register, *value) {
                        (BANK_SENSOR, COM7, COM7_RESET) => {
                            inside.resets.set(inside.resets.get() + 1);
                            inside.window_mode.set(0);
                        }
                        (BANK_DSP, 0xDA, mode) => inside.window_mode.set(mode),
                        _ => {}
                    }
                }
                Operation::Read([value]) => {
                    assert_eq!(inside.bank.get(), BANK_SENSOR);
                    *value = match (inside.pointer.get(), inside.scene.get()) {
                        (0x0A, Scene::Stranger) => 0x77,
                        (0x0A, _) => 0x26,
                        (0x0B, _) => 0x42,
                        (other, _) => panic!("read of 0x{other:02x}"),
                    };
                }
                _ => panic!("not a transfer of SCCB"),
            }
        }
        Ok(())
    }
}

impl PixelPort for Bench {
    fn start(&mut self) {
        self.inside.listening.set(true);
        self.inside
            .next_end
            .set(self.clock.now() + Duration::from_micros(FRAME_TIME.as_micros() / 2));
    }

    fn drain(&mut self, take: &mut dyn FnMut(&[u8], bool)) -> Result<(), Overrun> {
        let inside = &self.inside;
        assert!(inside.listening.get(), "drained while it rests");
        match inside.scene.get() {
            Scene::Silent => return Ok(()),
            Scene::Endless => {
                take(&[0x33; 512], false);
                return Ok(());
            }
            Scene::Overrun => return Err(Overrun),
            _ => {}
        }
        while self.clock.now() >= inside.next_end.get() {
            inside.next_end.set(inside.next_end.get() + FRAME_TIME);
            let bytes = self.frame();
            // In pieces that have nothing to do with rows; the end sometimes on its own.
            for piece in bytes.chunks(1_000) {
                take(piece, false);
            }
            take(&[], true);
            inside.frames.set(inside.frames.get() + 1);
        }
        Ok(())
    }

    fn stop(&mut self) {
        self.inside.listening.set(false);
    }
}
