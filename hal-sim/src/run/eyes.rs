//! Eyes of simulated robots: one detector for all that one thread runs.
//!
//! Robots of a thread take turns, so one arena serves them all. The detector runs at once, and a
//! frame is in memory from its exposure to its inference; the time that a chip would take for it
//! passes afterwards. A world that does not look holds the arena and nothing else, and one whose
//! scenario has no detector not even that.
//!
//! Frames of several robots are not computed as one batch: the weights, 44 KB, stay in the cache from
//! one to the next, and the channels of one frame fill the vectors of the processor.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use crawler_app::vision::{
    Detector, DetectorError, Eyes, Lens, Look, Picture, PictureError, Spots,
};
use crawler_hal::{Clock as _, Duration, FrameFormat};

use crate::sched::SimClock;
use crate::world;

/// Time that a look takes behind its frame: about 40 million instructions at 240 MHz.
const THINKING: Duration = Duration::from_millis(170);

/// How the programs are told that the camera of `parameters` sits.
pub(super) fn lens(camera: &world::Camera) -> Lens {
    Lens {
        half_view: camera.half_view,
        pitch: camera.pitch,
        height_m: camera.height_m,
        forward_m: camera.forward_m,
    }
}

/// What looking has come to in a world, or in the robots that one thread runs of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Looks {
    /// Frames that the detector has seen.
    pub taken: u64,
    /// Frames in memory now.
    pub open: usize,
    /// Most frames in memory at a time.
    pub most: usize,
}

/// The detector of a thread, and where it runs.
#[derive(Debug)]
pub(crate) struct DetectorInstance {
    detector: Detector<'static>,
    arena: RefCell<Vec<i8>>,
    looks: Cell<Looks>,
}

impl DetectorInstance {
    /// An instance of this model.
    ///
    /// # Errors
    /// When it is no detector.
    pub(crate) fn new(blob: &'static [u8]) -> Result<Rc<Self>, DetectorError> {
        let detector = Detector::new(blob)?;
        Ok(Rc::new(Self {
            detector,
            arena: RefCell::new(vec![0; detector.arena_bytes()]),
            looks: Cell::default(),
        }))
    }

    pub(crate) fn looks(&self) -> Looks {
        self.looks.get()
    }
}

/// The eyes of one robot.
#[derive(Debug, Clone)]
pub(super) struct SimEyes {
    instance: Rc<DetectorInstance>,
    clock: SimClock,
}

impl SimEyes {
    pub(super) fn new(instance: &Rc<DetectorInstance>, clock: &SimClock) -> Self {
        Self {
            instance: Rc::clone(instance),
            clock: clock.clone(),
        }
    }
}

impl Eyes for SimEyes {
    type Look<'e> = SimLook;

    fn open(&mut self, bytes: usize) -> Option<SimLook> {
        let mut looks = self.instance.looks.get();
        looks.open += 1;
        looks.most = looks.most.max(looks.open);
        self.instance.looks.set(looks);
        Some(SimLook {
            frame: vec![0; bytes].into_boxed_slice(),
            eyes: self.clone(),
        })
    }
}

/// One look of one robot.
#[derive(Debug)]
pub(super) struct SimLook {
    frame: Box<[u8]>,
    eyes: SimEyes,
}

impl Drop for SimLook {
    fn drop(&mut self) {
        let mut looks = self.eyes.instance.looks.get();
        looks.open -= 1;
        self.eyes.instance.looks.set(looks);
    }
}

impl SimLook {
    fn spots(&self, size: (u16, u16), format: FrameFormat) -> Result<Spots, PictureError> {
        let picture = Picture::new(&self.frame, size, format)?;
        let instance = &self.eyes.instance;
        let mut arena = instance.arena.borrow_mut();
        let mut looks = instance.looks.get();
        looks.taken += 1;
        instance.looks.set(looks);
        let finder = instance.detector.run_in(&mut arena);
        // The arena is as large as the detector asked for.
        Ok(finder.map_or_else(
            |_| Spots::new(),
            |mut finder| {
                on_vectors(
                    #[inline(always)]
                    || finder.find(&picture),
                )
            },
        ))
    }
}

/// Does work that consists of inlined functions with all vectors that the processor has: for a
/// detector half the time. A closure has to be marked as inlined too, or it is compiled for the least
/// processor and called.
#[inline]
fn on_vectors<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    return pulp::Arch::new().dispatch(work);
    #[cfg(not(target_arch = "x86_64"))]
    work()
}

impl Look for SimLook {
    fn frame(&mut self) -> &mut [u8] {
        &mut self.frame
    }

    async fn find(self, size: (u16, u16), format: FrameFormat) -> Result<Spots, PictureError> {
        let spots = self.spots(size, format);
        let clock = self.eyes.clock.clone();
        drop(self);
        clock.sleep(THINKING).await;
        spots
    }
}
