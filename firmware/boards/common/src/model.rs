//! A body in software, for boards that have none.
//!
//! The program does not know: it drives the pins of a [`Bench`] as it would drive those of a
//! chip, and behind them stand small models of the L298N with its motors, of a robot in a walled
//! room of its own, of the US-100 at the far end of its serial line, and of the pack behind its
//! divider. They are simple on purpose (one robot, four walls); the simulator has the finer ones.
//!
//! Time stands still unless the board calls [`Bench::advance`].

mod drive;
mod pins;
mod ranger;
#[cfg(test)]
mod tests;

use core::cell::{Cell, RefCell};

use crawler_hal::{Duration, Instant};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use rand_core::Rng;
use rand_pcg::Pcg32;

pub use drive::{Drive, GEOMETRY, ROOM_M, Wheel};
pub use pins::{
    DutyError, Line, ModelAdc, ModelEcho, ModelPin, ModelPwm, ModelUart, NotWired, Side,
};
pub use ranger::{BYTE_TIME, Sensor};

/// One step of the model.
pub const STEP: Duration = Duration::from_millis(10);
/// Steps made up for at most when the board was held up; the rest of that time is lost.
pub const CATCH_UP: u32 = 100;

/// Levels that the program drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Levels {
    /// Inputs of the bridge, left and right.
    pub bridges: [Bridge; 2],
    /// The lamp.
    pub lamp: bool,
}

/// Inputs of one half of the L298N.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Bridge {
    /// Duty of the enable input, of 255.
    pub duty: u8,
    /// IN1 or IN3.
    pub in1: bool,
    /// IN2 or IN4.
    pub in2: bool,
}

/// What is wrong with the ranger or its line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LineFault {
    /// Nothing.
    #[default]
    None,
    /// Nobody answers.
    Absent,
    /// The line is low: bytes of zero arrive without end.
    Stuck,
}

/// Where the robot is and how it is, for a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Metres from the middle of the room, and radians.
    pub pose: [f32; 3],
    /// Voltage of the pack, in millivolts.
    pub pack_mv: u16,
    /// The lamp is lit.
    pub lamp: bool,
}

/// The body, shared by its pins and by whoever advances its time.
#[derive(Debug)]
pub struct Bench<M: RawMutex> {
    levels: Mutex<M, Cell<Levels>>,
    world: Mutex<M, RefCell<World>>,
    fault: LineFault,
}

#[derive(Debug)]
struct World {
    at: Instant,
    drive: Drive,
    sensor: Sensor,
    rng: Pcg32,
}

impl<M: RawMutex> Bench<M> {
    /// A body at rest, somewhere in its room. Equal names stand in equal places.
    pub fn new(name: &str, fault: LineFault) -> Self {
        let mut rng = Pcg32::new(seed(name), 0x0062_656E_6368);
        Self {
            levels: Mutex::new(Cell::new(Levels::default())),
            world: Mutex::new(RefCell::new(World {
                at: Instant::BOOT,
                drive: Drive::placed(&mut rng),
                sensor: Sensor::default(),
                rng,
            })),
            fault,
        }
    }

    /// Lets time pass until `now`, in steps of [`STEP`].
    pub fn advance(&self, now: Instant) {
        for _ in 0..CATCH_UP {
            let levels = self.levels.lock(Cell::get);
            // One lock for each step: an interrupt never waits longer than one.
            let behind = self.world.lock(|world| {
                let world = &mut *world.borrow_mut();
                if world.at + STEP > now {
                    return false;
                }
                world.at += STEP;
                world.drive.step(&levels.bridges);
                true
            });
            if !behind {
                return;
            }
        }
        self.world.lock(|world| world.borrow_mut().at = now);
    }

    /// How things are in truth, which no sensor tells.
    pub fn truth(&self) -> Truth {
        let lamp = self.levels.lock(Cell::get).lamp;
        self.world.lock(|world| {
            let world = world.borrow();
            Truth {
                pose: world.drive.pose(),
                pack_mv: (world.drive.pack_v() * 1e3) as u16,
                lamp,
            }
        })
    }

    fn drive_pins(&self, change: impl FnOnce(&mut Levels)) {
        self.levels.lock(|cell| {
            let mut levels = cell.get();
            change(&mut levels);
            cell.set(levels);
        });
    }

    fn with_world<T>(&self, work: impl FnOnce(&mut World) -> T) -> T {
        self.world.lock(|world| work(&mut world.borrow_mut()))
    }
}

/// FNV-1a with 64 bits.
pub fn seed(name: &str) -> u64 {
    name.bytes().fold(0xCBF2_9CE4_8422_2325, |sum, byte| {
        (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3)
    })
}

/// From 0 up to, not including, 1.
fn uniform(rng: &mut Pcg32) -> f32 {
    (rng.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Nearly normal, with a deviation of 1: the sum of four uniform draws has one of 1/√3.
fn normal(rng: &mut Pcg32) -> f32 {
    let sum: f32 = (0..4).map(|_| uniform(rng)).sum();
    (sum - 2.0) * 1.732_050_8
}
