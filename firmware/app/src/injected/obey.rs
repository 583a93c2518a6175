//! A program that takes faults.

use core::cell::Cell;

use crawler_drivers::us100::{FARTHEST, LinkError, NEAREST, RangeError};
use crawler_hal::{Duration, Instant, Millimeters};
use crawler_protocol::{FaultSpec, LinkCut, Reason, Wheel};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;

/// Time from the word that the supply dips to the reset: its record gets out.
const RESTART_AFTER: Duration = Duration::from_millis(300);

/// A fault and its end.
#[derive(Debug, Clone, Copy)]
struct Timed<T> {
    what: T,
    until: Instant,
}

impl<T: Copy> Timed<T> {
    fn at(self, now: Instant) -> Option<T> {
        (now < self.until).then_some(self.what)
    }
}

#[derive(Debug, Clone, Copy)]
enum RangerFault {
    Dead,
    Stuck(Millimeters),
}

/// What is left of a motor.
#[derive(Debug, Clone, Copy)]
struct Weakness {
    /// From when the wheel stands the next time.
    wanted: f32,
    /// At the moment.
    acting: f32,
}

/// A cell each: every control step asks for one of them, and would copy all.
#[derive(Debug)]
struct State {
    ranger: Cell<Option<Timed<RangerFault>>>,
    motors: [Cell<Option<Timed<Weakness>>>; 2],
    link: Cell<Option<Timed<LinkCut>>>,
    restart: Cell<Option<Instant>>,
}

/// What is broken about this robot on purpose.
pub(crate) struct Injected<M: RawMutex> {
    state: Mutex<M, State>,
}

impl<M: RawMutex> Injected<M> {
    pub(crate) const fn new() -> Self {
        Self {
            state: Mutex::new(State {
                ranger: Cell::new(None),
                motors: [const { Cell::new(None) }; 2],
                link: Cell::new(None),
                restart: Cell::new(None),
            }),
        }
    }

    /// What the ranger says, as broken as it is.
    pub(crate) fn range(
        &self,
        measured: Result<Millimeters, RangeError>,
        now: Instant,
    ) -> Result<Millimeters, RangeError> {
        let fault = self.state.lock(|state| state.ranger.get());
        match fault.and_then(|fault| fault.at(now)) {
            None => measured,
            Some(RangerFault::Dead) => Err(RangeError::Link(LinkError::Timeout)),
            Some(RangerFault::Stuck(range)) if range < NEAREST => Err(RangeError::TooNear(range)),
            Some(RangerFault::Stuck(range)) if range > FARTHEST => Err(RangeError::NoEcho(range)),
            Some(RangerFault::Stuck(range)) => Ok(range),
        }
    }

    /// What is left of the duties. A motor gets stronger only when it is told to stand, so that no
    /// duty grows faster than the ramp lets it.
    pub(crate) fn weaken(&self, duties: [f32; 2], now: Instant) -> [f32; 2] {
        self.state.lock(|state| {
            let mut left = duties;
            for (duty, motor) in left.iter_mut().zip(&state.motors) {
                let Some(mut fault) = motor.get() else {
                    continue;
                };
                let stands = *duty == 0.0;
                let Weakness { wanted, acting } = &mut fault.what;
                *acting = if stands { *wanted } else { acting.min(*wanted) };
                *duty *= *acting;
                let is_over = stands && now >= fault.until;
                motor.set((!is_over).then_some(fault));
            }
            left
        })
    }

    /// Whether to restart for a supply that dips.
    pub(crate) fn restart_is_due(&self, now: Instant) -> bool {
        let restart = self.state.lock(|state| state.restart.get());
        restart.is_some_and(|at| now >= at)
    }

    /// How the link is lost at the moment.
    pub(crate) fn link(&self, now: Instant) -> Option<LinkCut> {
        self.state.lock(|state| state.link.get())?.at(now)
    }

    /// Ends every fault.
    pub(crate) fn heal(&self, now: Instant) {
        self.state.lock(|state| {
            state.ranger.set(None);
            state.link.set(None);
            for motor in &state.motors {
                motor.set(motor.get().map(|fault| Timed {
                    until: fault.until.min(now),
                    ..fault
                }));
            }
        });
    }

    /// Begins `fault`, for so many milliseconds or until it is healed.
    ///
    /// # Errors
    /// Why not.
    pub(crate) fn inject(
        &self,
        fault: FaultSpec,
        lasting: Option<u32>,
        now: Instant,
    ) -> Result<(), Reason> {
        let until = lasting.map_or(Instant::FAR_FUTURE, |ms| {
            now + Duration::from_millis(ms.into())
        });
        let side = |wheel| usize::from(wheel == Wheel::Right);
        self.state.lock(|state| {
            match fault {
                FaultSpec::RangerDead => {
                    let what = RangerFault::Dead;
                    state.ranger.set(Some(Timed { what, until }));
                }
                FaultSpec::RangerStuck { mm } => {
                    let what = RangerFault::Stuck(Millimeters(mm));
                    state.ranger.set(Some(Timed { what, until }));
                }
                FaultSpec::MotorWeak { wheel, strength } => {
                    weaken(&state.motors[side(wheel)], strength, until);
                }
                FaultSpec::MotorDead { wheel } => {
                    weaken(&state.motors[side(wheel)], 0.0, until);
                }
                // Without an end nobody could heal it: the word would not arrive.
                FaultSpec::LinkLoss { how } if lasting.is_some() => {
                    state.link.set(Some(Timed { what: how, until }));
                }
                FaultSpec::LinkLoss { .. } => return Err(Reason::MissingField),
                FaultSpec::BrownOut => state.restart.set(Some(now + RESTART_AFTER)),
                FaultSpec::ClockStep { .. }
                | FaultSpec::RangerNoisy { .. }
                | FaultSpec::LineNoise { .. }
                | FaultSpec::LineStuck
                | FaultSpec::MotorStuckOn { .. }
                | FaultSpec::HostilePackets { .. }
                | FaultSpec::BatterySag { .. }
                | FaultSpec::BatteryAt { .. }
                | FaultSpec::FlashPowerCut { .. }
                | FaultSpec::FlashNoise { .. }
                | FaultSpec::CameraAbsent
                | FaultSpec::CameraStalled
                | FaultSpec::CameraGarbage => return Err(Reason::Unsupported),
            }
            Ok(())
        })
    }
}

fn weaken(motor: &Cell<Option<Timed<Weakness>>>, strength: f32, until: Instant) {
    let acting = motor.get().map_or(1.0, |before| before.what.acting);
    let what = Weakness {
        wanted: strength,
        acting,
    };
    motor.set(Some(Timed { what, until }));
}
