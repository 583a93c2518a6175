//! One robot of a bare world: its sensors, its motor driver, and who steers.

use crawler_app::control::Wheels;
use crawler_app::controller::Tuning;
use crawler_app::neighbours::name_of;
use crawler_app::order::{Halt, Order, Sender, Task};
use crawler_app::perception::{Battery, Reading};
use crawler_app::power::{self, Monitor};
use crawler_app::sense::{self, Jitter, RangeMonitor};
use crawler_drivers::us100::{
    RangeError, SILENCE, TRIGGER, TemperatureError, echo_range, parse_range, parse_temperature,
};
use crawler_hal::{Duration, Instant, Millimeters, MotorPort};
use crawler_protocol::{ResponseStatus, RobotState, Source};
use rand_core::Rng;
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use super::pins::{Level, Pin};
use super::steering::{Drive, Known, Senses, Steering, SteeringState};
use super::{BareWorld, Settings};
use crate::devices::{BURST, BYTE_TIME, Meter, RangeSensor, ranger_after, senses};
use crate::run::robot_id;
use crate::world::{Bridge, Power, Presence, Purpose, RobotIndex, Space, Wiring, stream};

/// Name under which orders are given.
const SOURCE: &str = "bare";

/// A measurement that is under way.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Pending {
    /// When the program knows.
    at: Instant,
    /// What the sensor says over its line, millimetres.
    says_mm: u16,
    /// How long the echo pin is high, microseconds.
    width_us: u64,
}

/// See the [module](self). Times are those of the world, unless they go into the program's code.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct BareRobot {
    boot: Instant,
    life: u32,
    wiring: WiringState,
    sensor: RangeSensor,
    meter: Meter,
    rng: Pcg32,
    range_monitor: RangeMonitor,
    reading: Reading,
    /// When the next measurement begins.
    measure_at: Instant,
    /// When the one after it is due, but for the jitter.
    due: Instant,
    jitter: Jitter,
    pending: Option<Pending>,
    monitor: Monitor,
    battery: Battery,
    power_at: Instant,
    wheels: Wheels<Level, Pin>,
    last_step: Instant,
    steering_state: SteeringState,
    /// Without power, or just back.
    down: bool,
}

/// [`Wiring`], stored by number: its own form is for text.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
enum WiringState {
    Uart,
    Pulse,
}

impl BareRobot {
    pub(super) fn new(
        world: &mut BareWorld,
        robot: RobotIndex,
        wiring: Wiring,
        steering: Steering,
    ) -> Self {
        let spread = world.space.parameters.spread;
        let (sensor, meter) = senses(world.seed, robot, &spread);
        let wiring = match wiring {
            Wiring::Uart => WiringState::Uart,
            Wiring::Pulse => WiringState::Pulse,
        };
        Self::start(world, robot, 0, wiring, sensor, meter, steering)
    }

    /// A robot that is switched on now.
    fn start(
        world: &BareWorld,
        robot: RobotIndex,
        life: u32,
        wiring: WiringState,
        sensor: RangeSensor,
        meter: Meter,
        steering: Steering,
    ) -> Self {
        // As `BodyParts` and the start of a program draw them.
        let seed = world.seed ^ u64::from(life) << 32;
        let mut rng = stream(seed, robot.get(), Purpose::Program);
        let _ = rng.next_u64();
        let latest_ms = world.space.parameters.spread.ranger_start_ms;
        let first = ranger_after(seed, robot, latest_ms);
        let port = || MotorPort {
            enable: Level::default(),
            in1: Pin::default(),
            in2: Pin::default(),
        };
        let mut body = Self {
            boot: world.now,
            life,
            wiring,
            sensor,
            meter,
            rng,
            range_monitor: RangeMonitor::new(Instant::BOOT + first),
            reading: Reading::default(),
            measure_at: world.now + first,
            due: world.now + first + sense::PERIOD,
            jitter: Jitter::new(name_of(&robot_id(robot.get() as usize))),
            pending: None,
            monitor: Monitor::new(&world.settings),
            battery: Battery::default(),
            power_at: world.now,
            wheels: Wheels::new(port(), port()),
            last_step: world.now,
            steering_state: SteeringState::new(steering, world.tuning),
            down: false,
        };
        body.weigh(&world.space, robot.get() as usize, world.now);
        body
    }

    /// The same robot after its supply has come back.
    pub(super) fn booted_again(&self, world: &BareWorld, robot: RobotIndex) -> Self {
        let (sensor, meter) = (self.sensor.clone(), self.meter.clone());
        let steering = self.steering_state.steering();
        let life = self.life.wrapping_add(1);
        Self::start(world, robot, life, self.wiring, sensor, meter, steering)
    }

    pub(super) fn power_changed(&mut self, power: Power) {
        if power == Power::Lost {
            self.life = self.life.wrapping_add(1);
            self.down = true;
        }
    }

    pub(super) fn wants_boot(&self, space: &Space, i: usize) -> bool {
        self.down && space.bodies.published.presence[i] == Presence::Present
    }

    /// Whether it does anything.
    fn lives(&self, space: &Space, i: usize) -> bool {
        !self.down && space.bodies.published.presence[i] == Presence::Present
    }

    /// Time on the robot's own clock.
    fn local(&self, at: Instant) -> Instant {
        Instant::BOOT + (at - self.boot)
    }

    /// Everything the ranger does before `until`.
    pub(super) fn sense(&mut self, space: &mut Space, i: usize, until: Instant) {
        loop {
            // A measurement is over before the next one begins.
            if let Some(pending) = self.pending {
                if pending.at >= until {
                    return;
                }
                self.pending = None;
                if self.lives(space, i) {
                    self.take(space, pending);
                }
                continue;
            }
            let listens = match self.wiring {
                WiringState::Uart => self.measure_at,
                WiringState::Pulse => self.measure_at + TRIGGER,
            };
            if listens >= until {
                return;
            }
            let begun = self.measure_at;
            if self.lives(space, i) {
                self.pending = Some(self.measure(space, i, begun));
            }
            self.wait(self.pending.map_or(begun, |pending| pending.at));
        }
    }

    /// Waits for the next measurement, as a program does whose last one was over at `end`: see [`Ticker::tick_late`].
    ///
    /// [`Ticker::tick_late`]: crawler_hal::Ticker::tick_late
    fn wait(&mut self, end: Instant) {
        self.measure_at = self.due.max(end) + self.jitter.draw();
        self.due += sense::PERIOD;
        if self.due < self.measure_at {
            self.due = self.measure_at + sense::PERIOD;
        }
    }

    fn measure(&mut self, space: &mut Space, i: usize, begun: Instant) -> Pending {
        match self.wiring {
            WiringState::Uart => {
                let asked = begun + BYTE_TIME;
                let echo = self.sensor.listen(space, i, None, asked);
                Pending {
                    at: asked + echo.after + BYTE_TIME * 2 + SILENCE,
                    says_mm: echo.says_mm,
                    width_us: 0,
                }
            }
            WiringState::Pulse => {
                let asked = begun + TRIGGER;
                let echo = self.sensor.listen(space, i, None, asked);
                Pending {
                    at: asked + BURST + echo.after,
                    says_mm: 0,
                    width_us: echo.after.as_micros(),
                }
            }
        }
    }

    /// Takes a measurement in that has come.
    fn take(&mut self, space: &Space, pending: Pending) {
        let measured: Result<Millimeters, RangeError> = match self.wiring {
            WiringState::Uart => parse_range(pending.says_mm.to_be_bytes()),
            WiringState::Pulse => {
                let width = Duration::from_micros(pending.width_us);
                parse_range(echo_range(width, self.range_monitor.air()).0.to_be_bytes())
            }
        };
        let now = self.local(pending.at);
        let (wheels, heading) = (
            self.steering_state.duties(),
            self.steering_state.pose().theta,
        );
        self.reading = self.range_monitor.observe(measured, wheels, heading, now);
        if self.range_monitor.wants_temperature(measured, now) {
            let air_c = space.parameters.surroundings.air_c;
            self.range_monitor.set_air_temperature(match self.wiring {
                WiringState::Uart => parse_temperature([self.sensor.temperature_code(air_c)]),
                WiringState::Pulse => Err(TemperatureError::NotWired),
            });
        }
    }

    /// Reads the battery when its time has come.
    fn weigh(&mut self, space: &Space, i: usize, now: Instant) {
        if now >= self.power_at {
            self.power_at = now + power::PERIOD;
            let pin = self.meter.read(space, i);
            self.battery = self.monitor.observe(Some(pin));
        }
    }

    /// One control step, and the battery after it.
    pub(super) fn control(
        &mut self,
        space: &mut Space,
        i: usize,
        now: Instant,
        tuning: &Tuning,
        steer: &mut impl FnMut(RobotIndex, &Senses) -> Option<Drive>,
    ) {
        // A robot that has just started takes its first step a period later.
        if !self.lives(space, i) || now == self.boot {
            return;
        }
        match self.steering_state.steering() {
            Steering::Shipped => {
                let (known, local) = (self.known(), self.local(now));
                let rng = &mut self.rng;
                let _ = self.steering_state.steer_itself(&known, None, rng, local);
            }
            Steering::Caller => {
                let elapsed = now - self.last_step;
                let tuning = tuning.at(self.battery.voltage);
                self.steering_state.reckon(&tuning, elapsed);
                let told = steer(RobotIndex::new(i as u32), &self.senses(space, i, now));
                let local = self.local(now);
                self.steering_state.steer_by(told, &tuning, elapsed, local);
            }
        }
        self.last_step = now;
        self.drive(space, i, now, tuning);
        self.weigh(space, i, now);
    }

    /// Hands the duties to the motors.
    fn drive(&mut self, space: &mut Space, i: usize, now: Instant, tuning: &Tuning) {
        let local = self.local(now);
        // Outputs of memory refuse nothing.
        let _ = self
            .wheels
            .apply(self.steering_state.duties(), tuning.trims(), local);
        let [left, right] = self.wheels.driver().ports().map(|port| Bridge {
            duty: port.enable.0,
            in1: port.in1.0,
            in2: port.in2.0,
        });
        let inputs = &mut space.bodies.inputs[i];
        inputs.left = left;
        inputs.right = right;
    }

    const fn known(&self) -> Known {
        Known {
            reading: self.reading,
            battery: self.battery,
        }
    }

    pub(super) fn order(&mut self, task: Task, now: Instant) -> bool {
        let arrived = self.local(now);
        let SteeringState::Shipped { orders, answer, .. } = &mut self.steering_state else {
            return false;
        };
        *answer = None;
        let sender = sender();
        let order = Order {
            task,
            sender,
            arrived,
        };
        orders.push_back(order).is_ok()
    }

    pub(super) fn halt(
        &mut self,
        space: &mut Space,
        i: usize,
        emergency: bool,
        now: Instant,
        tuning: &Tuning,
    ) -> bool {
        let SteeringState::Shipped { orders, .. } = &mut self.steering_state else {
            return false;
        };
        // Orders that would undo the halt are taken back.
        for _ in 0..orders.len() {
            if let Some(order) = orders.pop_front()
                && !order.task.yields_to_halt()
            {
                let _ = orders.push_back(order);
            }
        }
        let mut halt = Halt {
            emergency,
            ..Halt::default()
        };
        let _ = halt.senders.push(sender());
        if self.lives(space, i) {
            let (known, local) = (self.known(), self.local(now));
            let rng = &mut self.rng;
            let _ = self
                .steering_state
                .steer_itself(&known, Some(&halt), rng, local);
            self.last_step = now;
            self.drive(space, i, now, tuning);
        }
        true
    }

    pub(super) const fn answer(&self) -> Option<ResponseStatus> {
        match &self.steering_state {
            SteeringState::Shipped { answer, .. } => *answer,
            SteeringState::Caller { .. } => None,
        }
    }

    pub(super) const fn state(&self) -> Option<RobotState> {
        match &self.steering_state {
            SteeringState::Shipped { controller, .. } => Some(controller.state().reported()),
            SteeringState::Caller { .. } => None,
        }
    }

    pub(super) fn senses(&self, space: &Space, i: usize, now: Instant) -> Senses {
        Senses {
            now: self.local(now),
            reading: self.reading,
            pose: self.steering_state.pose(),
            duties: self.steering_state.duties(),
            battery: self.battery,
            contacts: space.bodies.contacts[i],
        }
    }

    /// Puts back what is not part of a stored state.
    pub(super) fn settle(&mut self, settings: &Settings, tuning: Tuning) {
        self.monitor.adjust(settings);
        self.steering_state.set_tuning(tuning);
    }

    /// Whether a stored state can be gone on with at `now`.
    pub(super) fn is_sound(&self, now: Instant) -> bool {
        let pose = self.steering_state.pose();
        let duties = self.steering_state.duties();
        self.boot <= now
            && self.last_step <= now
            && self.measure_at <= now + LONGEST_WAIT
            && self.measure_at + sense::PERIOD >= now
            && self.pending.is_none_or(|p| p.at <= now + LONGEST_WAIT)
            && [pose.x, pose.y, pose.theta, pose.sigma]
                .iter()
                .all(|v| v.is_finite())
            && duties.iter().all(|duty| (-1.0..=1.0).contains(duty))
            && self.sensor.is_sound()
            && self.meter.is_sound()
    }

    pub(super) fn fingerprint(&self, mut word: impl FnMut(u64)) {
        self.sensor.fingerprint(&mut word);
        self.meter.fingerprint(&mut word);
        word(self.rng.clone().next_u64());
        word(self.boot.as_micros());
        word(self.measure_at.as_micros());
        word(self.due.as_micros());
        let pose = self.steering_state.pose();
        for value in [pose.x, pose.y, pose.theta, pose.sigma] {
            word(u64::from(value.to_bits()));
        }
        for duty in self.steering_state.duties() {
            word(u64::from(duty.to_bits()));
        }
        word(
            self.reading
                .range_mm(self.local(self.measure_at))
                .map_or(0, u64::from),
        );
        word(
            self.battery
                .voltage
                .map_or(0, |voltage| u64::from(voltage.0)),
        );
    }
}

/// Nothing of a ranger lies further ahead: the longest time to its first measurement.
const LONGEST_WAIT: Duration = Duration::from_millis(1_100);

fn sender() -> Sender {
    Sender {
        source: Source::new(SOURCE).unwrap_or_else(|_| unreachable!("{SOURCE} is valid")),
        seq: 0,
    }
}
