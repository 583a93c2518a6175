//! What a world and the devices of one robot share.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use crawler_hal::{Clock as _, Instant, ResetCause};
use rand_pcg::Pcg32;

use super::boot::{self, DefectDraw, Started};
use super::{Chip, Meter, Pages, RangeSensor, Sonar};
use crate::faults::{Faults, RangerFault};
use crate::render::Frame;
use crate::sched::SimClock;
use crate::world::{Build, Inputs, Presence, Purpose, RobotIndex, Space, Spread, Wiring, stream};

/// What all robots of a world share.
pub(crate) struct Shared {
    pub(crate) space: RefCell<Space>,
    pub(crate) clock: SimClock,
    pub(crate) seed: u64,
    /// At most one entry for each change of a robot's life, drained by the runner.
    pub(crate) events: RefCell<Vec<BodyEvent>>,
    /// What cameras draw into: one picture is taken at a time.
    pub(crate) frame: RefCell<Option<Frame>>,
    /// What is alike in the slots of robots.
    pub(crate) pages: Rc<RefCell<Pages>>,
}

/// Something that happened to a robot and concerns whoever runs its program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BodyEvent {
    /// The supply fell below the brown-out voltage: drop the program, do not start it yet.
    PowerLost(RobotIndex),
    /// The program has to start anew, with the parts that [`super::World::boot`] hands out.
    Reset(RobotIndex, ResetCause),
}

/// The watchdog timer of one robot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Watchdog {
    /// Armed by the first feeding.
    pub(crate) fed: Option<Instant>,
    /// How often it bit.
    pub(crate) bites: u32,
    /// Longest time between two feedings, microseconds.
    pub(crate) longest_us: u64,
}

/// What one robot's devices share with the world.
pub(crate) struct Ports {
    pub(crate) shared: Rc<Shared>,
    pub(crate) robot: RobotIndex,
    /// How its ranger is wired: soldered, so it outlives every boot.
    pub(crate) wiring: Wiring,
    /// What the body is when nothing is broken.
    pub(crate) sound: Build,
    /// Which boot this is; devices of an earlier one are disconnected.
    pub(crate) life: Cell<u32>,
    /// A reset was asked for and not carried out yet.
    pub(crate) resetting: Cell<bool>,
    pub(crate) cause: Cell<ResetCause>,
    pub(crate) watchdog: Cell<Watchdog>,
    pub(crate) faults: Cell<Faults>,
    /// What the program that runs makes of the ranger, worse than it is.
    pub(crate) ranger_defect: Cell<Option<RangerFault>>,
    /// What the program said when it panicked last, until the next boot has taken it.
    pub(crate) panic: RefCell<Option<String>>,
    pub(crate) sonar: RefCell<Sonar>,
    pub(crate) meter: RefCell<Meter>,
    pub(crate) camera_rng: RefCell<Pcg32>,
    pub(crate) chip: Rc<RefCell<Chip>>,
}

/// The sensors of a robot, each with its own errors.
pub(crate) fn senses(seed: u64, robot: RobotIndex, spread: &Spread) -> (RangeSensor, Meter) {
    let rng = |purpose| stream(seed, robot.get(), purpose);
    let build = &mut rng(Purpose::Senses);
    let sensor = RangeSensor::new(rng(Purpose::Ranger), build, spread.thermometer_c);
    let meter = Meter::new(rng(Purpose::Battery), build, spread);
    (sensor, meter)
}

impl Ports {
    pub(crate) fn new(shared: Rc<Shared>, robot: RobotIndex, wiring: Wiring) -> Self {
        let seed = shared.seed;
        let rng = |purpose| stream(seed, robot.get(), purpose);
        let (sectors, sound, spread) = {
            let space = shared.space.borrow();
            (
                usize::from(space.parameters.surroundings.flash_sectors),
                space.bodies.build[robot.get() as usize],
                space.parameters.spread,
            )
        };
        let (sensor, meter) = senses(seed, robot, &spread);
        Self {
            sound,
            life: Cell::new(0),
            resetting: Cell::new(false),
            cause: Cell::new(ResetCause::PowerOn),
            watchdog: Cell::new(Watchdog {
                fed: None,
                bites: 0,
                longest_us: 0,
            }),
            faults: Cell::new(Faults::NONE),
            ranger_defect: Cell::new(None),
            panic: RefCell::new(None),
            sonar: RefCell::new(Sonar::new(sensor, rng(Purpose::Serial))),
            meter: RefCell::new(meter),
            camera_rng: RefCell::new(rng(Purpose::Camera)),
            chip: Rc::new(RefCell::new(
                Chip::new(sectors, rng(Purpose::Flash)).sharing(&shared.pages),
            )),
            shared,
            robot,
            wiring,
        }
    }

    pub(crate) const fn index(&self) -> usize {
        self.robot.get() as usize
    }

    /// Asks for a reset, unless one is asked for already.
    pub(crate) fn ask_reset(&self, cause: ResetCause) {
        if !self.resetting.replace(true) {
            self.cause.set(cause);
            self.shared
                .events
                .borrow_mut()
                .push(BodyEvent::Reset(self.robot, cause));
        }
    }

    /// How the ranger is broken, or how the program breaks it.
    pub(crate) fn ranger_fault(&self) -> Option<RangerFault> {
        self.faults.get().ranger.or(self.ranger_defect.get())
    }

    /// Starts a program from the slots. `None` when there is none left to start.
    pub(crate) fn start(&self, cause: ResetCause) -> Option<Started> {
        let draw = DefectDraw {
            seed: self.shared.seed,
            robot: self.robot,
        };
        let started = boot::start(&mut self.chip.borrow_mut(), cause, draw)?;
        self.cause.set(started.cause);
        self.ranger_defect.set(started.ranger_defect());
        if started.bundle.is_some() {
            // A boot stage arms it for a program that may hang before it feeds it.
            let mut watchdog = self.watchdog.get();
            watchdog.fed = Some(self.shared.clock.now());
            self.watchdog.set(watchdog);
        }
        Some(started)
    }

    /// The watchdog's view of the present moment.
    pub(crate) fn check_watchdog(&self, now: Instant, limit_us: u64) {
        let mut watchdog = self.watchdog.get();
        let Some(fed) = watchdog.fed else { return };
        let gap = now.saturating_since(fed).as_micros();
        watchdog.longest_us = watchdog.longest_us.max(gap);
        if limit_us > 0 && gap > limit_us {
            watchdog.bites = watchdog.bites.saturating_add(1);
            watchdog.fed = None;
            self.watchdog.set(watchdog);
            self.ask_reset(ResetCause::Watchdog);
        } else {
            self.watchdog.set(watchdog);
        }
    }
}

/// A device's connection to its body. It breaks when the robot is reset: whatever an old program
/// still does then reaches nothing.
#[derive(Clone)]
pub(crate) struct Wire {
    pub(crate) ports: Rc<Ports>,
    life: u32,
}

impl Wire {
    pub(crate) fn new(ports: &Rc<Ports>) -> Self {
        Self {
            ports: Rc::clone(ports),
            life: ports.life.get(),
        }
    }

    /// Whether the program behind this device is the one that runs now, on a powered body.
    pub(crate) fn is_live(&self) -> bool {
        self.life == self.ports.life.get()
            && self.ports.shared.space.borrow().bodies.published.presence[self.ports.index()]
                == Presence::Present
    }

    /// Changes the levels the program drives.
    pub(crate) fn drive(&self, change: impl FnOnce(&mut Inputs)) {
        if self.life != self.ports.life.get() {
            return;
        }
        let index = self.ports.index();
        let bodies = &mut self.ports.shared.space.borrow_mut().bodies;
        if bodies.published.presence[index] == Presence::Present {
            change(&mut bodies.inputs[index]);
        }
    }

    pub(crate) fn clock(&self) -> &SimClock {
        &self.ports.shared.clock
    }
}

impl core::fmt::Debug for Wire {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Wire")
            .field("robot", &self.ports.robot)
            .field("life", &self.life)
            .finish_non_exhaustive()
    }
}
