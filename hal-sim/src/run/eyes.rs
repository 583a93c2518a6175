//! Eyes of simulated robots: one detector for all that one thread runs.
//!
//! Robots of a thread take turns, so one arena serves them all. The detector runs at once, and a
//! frame is in memory from its exposure to its inference; the time that a chip would take for it
//! passes afterwards. A world that does not look holds the arena and nothing else, and one whose
//! scenario has no detector not even that.
//!
//! A robot may be given another model than that of the scenario, by an update: [`SimModel`]. That one takes as
//! much longer as it has more multiplications.
//!
//! Frames of several robots are not computed as one batch: the weights, 44 KB, stay in the cache from
//! one to the next, and the channels of one frame fill the vectors of the processor.

use std::cell::{Cell, RefCell};
use std::rc::{Rc, Weak};

use crawler_app::vision::{
    Detector, DetectorError, Eyes, Finder, Lens, Look, Picture, PictureError, Spots,
};
use crawler_app::{LoadError, ModelHost, ModelLooks};
use crawler_hal::{Clock as _, Duration, FrameFormat, ModelRegion};
use crawler_protocol::ModelName;
use embedded_storage_async::nor_flash::ReadNorFlash;

use crate::devices::{MODELS, WRITE_BYTES};
use crate::sched::SimClock;
use crate::world;

/// Time that a look takes behind its frame: about 40 million instructions at 240 MHz.
const THINKING: Duration = Duration::from_millis(170);

/// Bytes of memory that a model may run in at least: half as much again as the shipped one needs.
const ARENA_BYTES: usize = 48 * 1_024;
/// What the model of a detector is called.
const NAME: &str = "eyes";

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
    /// Models that robots were given, each once.
    given: RefCell<Vec<Weak<[u8]>>>,
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
            arena: RefCell::new(vec![0; detector.arena_bytes().max(ARENA_BYTES)]),
            looks: Cell::default(),
            given: RefCell::default(),
        }))
    }

    /// The same bytes, shared with the other robots that have them.
    fn share(&self, blob: &[u8]) -> Rc<[u8]> {
        let mut given = self.given.borrow_mut();
        given.retain(|blob| blob.strong_count() > 0);
        let known = given.iter().filter_map(Weak::upgrade);
        let known = known.into_iter().find(|known| **known == *blob);
        known.unwrap_or_else(|| {
            let new: Rc<[u8]> = Rc::from(blob);
            given.push(Rc::downgrade(&new));
            new
        })
    }

    /// Time that a look takes with this model behind its frame.
    fn thinking(&self, detector: &Detector<'_>) -> Duration {
        let (own, its) = (self.detector.multiplications(), detector.multiplications());
        Duration::from_micros(THINKING.as_micros().saturating_mul(its) / own.max(1))
    }

    pub(crate) fn looks(&self) -> Looks {
        self.looks.get()
    }
}

/// The models of one robot.
#[derive(Debug, Default)]
struct Models {
    /// The one in use; without one that of the scenario.
    used: Option<Rc<[u8]>>,
    /// The one that was loaded last.
    at_hand: Option<Rc<[u8]>>,
    looks: ModelLooks,
}

/// What loads models for the eyes of one robot.
#[derive(Debug)]
pub(super) struct SimModel {
    name: ModelName,
    instance: Rc<DetectorInstance>,
    models: Rc<RefCell<Models>>,
}

impl ModelHost for SimModel {
    fn name(&self) -> &ModelName {
        &self.name
    }

    fn region(&self) -> ModelRegion {
        MODELS
    }

    async fn load<F: ReadNorFlash>(
        &mut self,
        flash: &mut F,
        at: u32,
        bytes: u32,
    ) -> Result<(), LoadError<F::Error>> {
        self.models.borrow_mut().at_hand = None;
        let bytes = bytes as usize;
        // Whole words are read, of which the last may be in part behind the model.
        let mut blob = vec![0; bytes.next_multiple_of(WRITE_BYTES)];
        let read = flash.read(at, &mut blob).await;
        read.map_err(LoadError::Flash)?;
        blob.truncate(bytes);
        let detector = Detector::new(&blob).map_err(LoadError::Unfit)?;
        let mut arena = self.instance.arena.borrow_mut();
        detector.run_in(&mut arena).map_err(LoadError::Unfit)?;
        self.models.borrow_mut().at_hand = Some(self.instance.share(&blob));
        Ok(())
    }

    fn adopt(&mut self) {
        let models = &mut *self.models.borrow_mut();
        models.used = models.at_hand.take();
        models.looks = ModelLooks::default();
    }

    fn use_own(&mut self) {
        *self.models.borrow_mut() = Models::default();
    }

    fn looks(&self) -> ModelLooks {
        self.models.borrow().looks
    }
}

/// The eyes of one robot.
#[derive(Debug, Clone)]
pub(super) struct SimEyes {
    instance: Rc<DetectorInstance>,
    models: Rc<RefCell<Models>>,
    clock: SimClock,
}

impl SimEyes {
    pub(super) fn new(instance: &Rc<DetectorInstance>, clock: &SimClock) -> Self {
        Self {
            instance: Rc::clone(instance),
            models: Rc::default(),
            clock: clock.clone(),
        }
    }

    /// What gives these eyes other models.
    pub(super) fn model(&self) -> Option<SimModel> {
        Some(SimModel {
            name: ModelName::new(NAME).ok()?,
            instance: Rc::clone(&self.instance),
            models: Rc::clone(&self.models),
        })
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
    /// What it sees with this model, and how long that takes.
    fn spots(
        &self,
        model: Option<&Rc<[u8]>>,
        size: (u16, u16),
        format: FrameFormat,
    ) -> Result<(Spots, Duration), PictureError> {
        let picture = Picture::new(&self.frame, size, format)?;
        let instance = &self.eyes.instance;
        let mut arena = instance.arena.borrow_mut();
        let mut looks = instance.looks.get();
        looks.taken += 1;
        instance.looks.set(looks);
        // What was given was found to be a detector before.
        let given = model.and_then(|blob| Detector::new(blob).ok());
        let detector = given.unwrap_or(instance.detector);
        let takes = instance.thinking(&detector);
        let finder = detector.run_in(&mut arena);
        // The arena is as large as the detector asked for.
        let spots = finder.map_or_else(
            |_| Spots::new(),
            |finder| {
                on_vectors(Find {
                    finder,
                    picture: &picture,
                })
            },
        );
        Ok((spots, takes))
    }
}

/// A detector about to look.
struct Find<'m, 'a> {
    finder: Finder<'m, 'a>,
    picture: &'a Picture<'a>,
}

impl Find<'_, '_> {
    // What it is for, see `on_vectors`.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn find(mut self) -> Spots {
        self.finder.find(self.picture)
    }
}

/// A type of its own and no closure: between a closure and its caller the compiler puts a function that is
/// compiled for the least processor, whenever it likes.
#[cfg(target_arch = "x86_64")]
impl pulp::NullaryFnOnce for Find<'_, '_> {
    type Output = Spots;

    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn call(self) -> Spots {
        self.find()
    }
}

/// Looks with all vectors that the processor has, which takes a third of the instructions: all functions of a
/// look are inlined here, and compiled for it.
#[inline]
fn on_vectors(find: Find<'_, '_>) -> Spots {
    #[cfg(target_arch = "x86_64")]
    return pulp::Arch::new().dispatch(find);
    #[cfg(not(target_arch = "x86_64"))]
    find.find()
}

impl Look for SimLook {
    fn frame(&mut self) -> &mut [u8] {
        &mut self.frame
    }

    async fn find(self, size: (u16, u16), format: FrameFormat) -> Result<Spots, PictureError> {
        let model = self.eyes.models.borrow().used.clone();
        let (spots, takes) = self.spots(model.as_ref(), size, format)?;
        let (clock, models) = (self.eyes.clock.clone(), Rc::clone(&self.eyes.models));
        drop(self);
        clock.sleep(takes).await;
        let models = &mut *models.borrow_mut();
        let same = match (&models.used, &model) {
            (Some(used), Some(model)) => Rc::ptr_eq(used, model),
            (None, None) => true,
            _ => false,
        };
        if same {
            models.looks.taken = models.looks.taken.saturating_add(1);
            models.looks.slowest = models.looks.slowest.max(takes);
        }
        Ok(spots)
    }
}
