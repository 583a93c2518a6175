//! A bridge that knows its own truth table and keeps the record of its wheels.

use std::cell::RefCell;
use std::rc::Rc;
use std::vec::Vec;

use crawler_hal::{Duration, Instant, MotorPort};
use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;
use embedded_hal::{digital, pwm};

use super::{SIDES, ms};
use crate::l298n::{Config, Duty, Fault, L298n, Output, Side};

/// One half of an L298N, and what its wheel went through.
#[derive(Debug, Clone, Default)]
pub(super) struct Bridge {
    max_duty: u16,
    duty: u16,
    in1: bool,
    in2: bool,
    now: Instant,
    /// Every duty at which the motor was driven, signed, with the moment it began.
    pub(super) driven: Vec<(Instant, i32)>,
    /// Moment the motor was last taken off the supply.
    off_since: Instant,
    /// Shortest time off the supply between driving one way and driving the other.
    pub(super) shortest_gap: Option<Duration>,
    pub(super) writes: usize,
}

impl Bridge {
    /// The truth table of the data sheet.
    pub(super) fn drive(&self) -> i32 {
        match (self.in1, self.in2) {
            (true, false) => i32::from(self.duty),
            (false, true) => -i32::from(self.duty),
            (true, true) | (false, false) => 0,
        }
    }

    pub(super) fn brakes(&self) -> bool {
        self.in1 == self.in2 && self.duty == self.max_duty
    }

    /// The enable is full and the inputs are at `in1` and `in2`, none of it by the driver.
    pub(super) fn found_at(&mut self, in1: bool, in2: bool) {
        (self.duty, self.in1, self.in2) = (self.max_duty, in1, in2);
    }

    fn write(&mut self, change: impl FnOnce(&mut Self)) {
        let before = self.drive();
        change(self);
        self.writes += 1;
        let after = self.drive();
        if after == before {
            return;
        }
        if after == 0 {
            self.off_since = self.now;
            return;
        }
        if let Some(&(_, last)) = self.driven.last()
            && last.signum() != after.signum()
        {
            let gap = if before == 0 {
                self.now - self.off_since
            } else {
                Duration::ZERO
            };
            self.shortest_gap = Some(self.shortest_gap.map_or(gap, |short| short.min(gap)));
        }
        self.driven.push((self.now, after));
    }
}

#[derive(Debug, Clone)]
pub(super) struct Bench {
    sides: [Rc<RefCell<Bridge>>; 2],
    broken: Rc<RefCell<Vec<Fault>>>,
}

pub(super) struct Pin {
    bench: Bench,
    fault: Fault,
}

#[derive(Debug)]
pub(super) struct Refused;

impl digital::Error for Refused {
    fn kind(&self) -> digital::ErrorKind {
        digital::ErrorKind::Other
    }
}

impl pwm::Error for Refused {
    fn kind(&self) -> pwm::ErrorKind {
        pwm::ErrorKind::Other
    }
}

impl Pin {
    fn write(&self, change: impl FnOnce(&mut Bridge)) -> Result<(), Refused> {
        if self.bench.broken.borrow().contains(&self.fault) {
            return Err(Refused);
        }
        self.bench.side(self.fault.side).borrow_mut().write(change);
        Ok(())
    }

    fn set(&self, level: bool) -> Result<(), Refused> {
        self.write(|bridge| match self.fault.output {
            Output::In1 => bridge.in1 = level,
            Output::In2 => bridge.in2 = level,
            Output::Enable => panic!("a level on the PWM channel"),
        })
    }
}

impl digital::ErrorType for Pin {
    type Error = Refused;
}

impl OutputPin for Pin {
    fn set_low(&mut self) -> Result<(), Refused> {
        self.set(false)
    }
    fn set_high(&mut self) -> Result<(), Refused> {
        self.set(true)
    }
}

pub(super) struct Channel(Pin);

impl pwm::ErrorType for Channel {
    type Error = Refused;
}

impl SetDutyCycle for Channel {
    fn max_duty_cycle(&self) -> u16 {
        self.0.bench.side(self.0.fault.side).borrow().max_duty
    }
    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Refused> {
        assert!(duty <= self.max_duty_cycle(), "duty {duty} out of range");
        self.0.write(|bridge| bridge.duty = duty)
    }
}

impl Bench {
    pub(super) fn new(max_duty: u16, config: Config) -> (Self, L298n<Channel, Pin>) {
        let side = || {
            Rc::new(RefCell::new(Bridge {
                max_duty,
                ..Bridge::default()
            }))
        };
        let bench = Self {
            sides: [side(), side()],
            broken: Rc::default(),
        };
        let port = |side| {
            let pin = |output| Pin {
                bench: bench.clone(),
                fault: Fault { side, output },
            };
            MotorPort {
                enable: Channel(pin(Output::Enable)),
                in1: pin(Output::In1),
                in2: pin(Output::In2),
            }
        };
        let motors = L298n::new(port(Side::Left), port(Side::Right), config);
        (bench, motors)
    }

    pub(super) fn side(&self, side: Side) -> &RefCell<Bridge> {
        match side {
            Side::Left => &self.sides[0],
            Side::Right => &self.sides[1],
        }
    }

    pub(super) fn at(&self, now: Instant) -> Instant {
        for side in &self.sides {
            side.borrow_mut().now = now;
        }
        now
    }

    pub(super) fn drives(&self) -> [i32; 2] {
        SIDES.map(|side| self.side(side).borrow().drive())
    }

    pub(super) fn break_outputs(&self, faults: &[Fault]) {
        *self.broken.borrow_mut() = faults.to_vec();
    }

    /// Both wheels past their first dead time and driving at `share`.
    pub(super) fn driving(share: f32) -> (Self, L298n<Channel, Pin>, Instant) {
        let (bench, mut motors) = Self::new(255, Config::new());
        let duty = Duty::new(share);
        motors.apply(duty, duty, bench.at(ms(0))).unwrap();
        let now = bench.at(ms(40));
        motors.apply(duty, duty, now).unwrap();
        assert_eq!(bench.drives(), [i32::from(duty.steps()); 2]);
        (bench, motors, now)
    }
}
