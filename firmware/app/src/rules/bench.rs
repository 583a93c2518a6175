//! A robot on a bench, and an observer with a book of its own.

use std::collections::HashMap;
use std::format;
use std::string::String;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{
    Action, CellDigest, Command, Neighbour, ParameterValue, Pose, PoseFix, ResponseStatus, RobotId,
    RobotState, Says,
};
use proptest::prelude::*;
use rand_core::Rng;

use super::happening::{Happening, Number, Sensor};
use super::meaning::{Meaning, Sent};
use crate::control::ControlLoop;
use crate::controller::{CALM, Note, Outputs};
use crate::motion::DEAD_TIME;
use crate::navigation::{Guide, Way};
use crate::neighbours::cell_at;
use crate::order::Halt;
use crate::parameters::{Parameter, Parameters};
use crate::perception::{Battery, Charge, LinkHealth, Reading, SensorHealth, Sight};
use crate::policy::decisions::named;
use crate::policy::{Decision, Installed};
use crate::testing::{TestRng, TestRobot, robot, source};

/// Unix time at boot.
const BOOTED_MS: u64 = 1_700_000_000_000;
const PERIOD: Duration = Duration::from_millis(20);
const EPSILON: f32 = 1e-5;

// Each is one thing the observer knows.
#[allow(clippy::struct_excessive_bools)]
pub(super) struct Bench {
    pub(super) robot: TestRobot,
    control_loop: ControlLoop,
    rng: TestRng,
    now: Instant,
    sensor: Sensor,
    motor_fault: bool,
    avoidance: bool,
    reading: Reading,
    // The observer's book.
    before: [f32; 2],
    last_turn: Instant,
    direction: [f32; 2],
    zero_since: [Instant; 2],
    /// Until when the robot may move; `None` while only a new command may move it.
    until: Option<Instant>,
    /// Whether that is the end of continuous driving, at which the wheels stand.
    continuous: bool,
    estopped: bool,
    halted: bool,
    /// Whether the last that was asked for is a behaviour, which may be taken up again after the ranger
    /// or the link interrupted it.
    wanted: bool,
    /// When something was in the way of any motion last.
    hindered: Instant,
    highest: HashMap<u8, u64>,
    sent: HashMap<(String, u64), Sent>,
}

impl Bench {
    pub(super) fn new(seed: u64) -> Self {
        let robot = robot("rules");
        robot.time.observe(BOOTED_MS, Instant::BOOT);
        robot.store_handle().set_loaded();
        let installed = Installed::Policy(named("trained"));
        robot.policy_handle().install(installed);
        let control_loop = ControlLoop::new(&robot);
        let mut bench = Self {
            robot,
            control_loop,
            rng: TestRng(seed | 1),
            now: Instant::BOOT,
            sensor: Sensor::Sees(Sight::Clear),
            motor_fault: false,
            avoidance: true,
            reading: Reading::default(),
            before: [0.0; 2],
            last_turn: Instant::BOOT,
            direction: [0.0; 2],
            zero_since: [Instant::BOOT; 2],
            until: None,
            continuous: false,
            estopped: false,
            halted: false,
            wanted: false,
            hindered: Instant::BOOT,
            highest: HashMap::new(),
            sent: HashMap::new(),
        };
        bench.happen(&Happening::Run(3)).expect("a quiet start");
        bench
    }

    /// Has a release bring the policy that came with the program before.
    pub(super) fn bring_policy(&mut self) {
        let name = named("trained");
        self.robot.policy_handle().install(Installed::None);
        let brought = Installed::Policy(name);
        self.robot.update_handle().bring(brought, Installed::None);
    }

    pub(super) fn now(&self) -> Instant {
        self.now
    }

    pub(super) fn state(&self) -> RobotState {
        self.robot.snapshot().state
    }

    pub(super) fn happen(&mut self, happening: &Happening) -> Result<(), TestCaseError> {
        match happening {
            Happening::Run(periods) => {
                for _ in 0..*periods {
                    self.turn(PERIOD, None)?;
                }
            }
            Happening::Starve(ms) => {
                self.turn(Duration::from_millis(u64::from(*ms)), None)?;
            }
            Happening::Send {
                action,
                source,
                number,
                age,
            } => self.send(action, *source, *number, *age)?,
            Happening::Bytes(bytes) => self.robot.submit(bytes, self.now),
            Happening::Sensor(sensor) => self.sensor = *sensor,
            Happening::Link(link) => self.robot.set_link_health(*link),
            Happening::Charge(charge) => self.robot.power_handle().publish(Battery {
                charge: *charge,
                ..Battery::default()
            }),
            Happening::Avoidance(on) => self.set_avoidance(*on),
            Happening::MotorFault(fault) => self.motor_fault = *fault,
            Happening::Fix { pose, age } => self.see(*pose, *age),
            Happening::Guide(to, own) => self.guide(*to, *own),
            Happening::Neighbour(there, says) => self.meet(*there, *says),
        }
        Ok(())
    }

    fn see(&mut self, pose: Pose, age: i64) {
        let unix = BOOTED_MS + self.now.as_millis();
        let fix = PoseFix {
            robot: self.robot.config().id.clone(),
            timestamp: unix.saturating_add_signed(-age),
            pose,
        };
        let mut buffer = [0; 256];
        let len = fix.to_json(&mut buffer).expect("fits");
        // Whether it is taken or refused, the rules hold.
        let _ = self.robot.observe_fix(&buffer[..len], self.now);
    }

    fn meet(&mut self, [x, y, v]: [f32; 3], says: Option<Says>) {
        let Some((column, row)) = cell_at(x, y) else {
            return;
        };
        let other = Neighbour {
            id: RobotId::new("other").expect("legal"),
            x,
            y,
            theta: 0.5,
            v,
            w: 0.0,
            says,
        };
        let digest = CellDigest {
            x: column,
            y: row,
            timestamp: BOOTED_MS + self.now.as_millis(),
            count: 1,
            robots: core::iter::once(other).collect(),
        };
        let mut buffer = [0; 256];
        let len = digest.to_json(&mut buffer).expect("fits");
        self.robot
            .observe_cell((column, row), &buffer[..len], self.now);
    }

    fn guide(&self, to: Option<[i32; 2]>, own: bool) {
        let number = self.robot.going().map_or(0, |going| going.number);
        self.robot.sense_handle().guide_to(Guide {
            number: if own { number } else { number.wrapping_sub(1) },
            way: to.map_or(Way::Nowhere, Way::To),
        });
    }

    fn set_avoidance(&mut self, on: bool) {
        self.set("avoidance", ParameterValue::Bool(on));
        self.avoidance = on;
    }

    /// Notes that the robot may take up what it was at before it restarted.
    pub(super) fn expect_resumption(&mut self) {
        self.wanted = true;
    }

    pub(super) fn set(&mut self, name: &str, value: ParameterValue) {
        let values = [(name.try_into().expect("short"), value)];
        let values = values.into_iter().collect();
        let next = self.robot.with_parameters(|all| all.with(&values));
        self.robot
            .store_handle()
            .set_parameters(next.expect("legal"));
    }

    /// Change of duty per period that the ramp allows.
    fn ramp_step(&self) -> f32 {
        let parameters = self.robot.with_parameters(Parameters::clone);
        parameters.number(Parameter::RampStep) * 0.01
    }

    pub(super) fn send(
        &mut self,
        action: &Action,
        from: u8,
        number: Number,
        age: i64,
    ) -> Result<(), TestCaseError> {
        let halt = matches!(action, Action::Stop | Action::Estop);
        // Halts come from a source of their own: they are obeyed with any number, and their
        // answers shall not be taken for those of a motion command with that number.
        let from = if halt { from + 100 } else { from };
        let known = self.highest.get(&from).copied();
        // Of a source never heard before, any number is new.
        let number = if known.is_none() {
            Number::Next
        } else {
            number
        };
        let highest = known.unwrap_or(100);
        let seq = match number {
            Number::Next => highest + 1,
            Number::Repeated => highest,
            Number::Older => highest - 1,
        };
        let name = format!("operator:{from}");
        self.highest.insert(from, highest.max(seq));
        let timestamp = (BOOTED_MS + self.now.as_millis()).saturating_add_signed(-age);
        if number == Number::Next {
            let sent = Sent {
                meaning: Meaning::of(action, self.now),
                legitimate: !action.is_motion() || (-2_000..=2_000).contains(&age),
                begun: 0,
                finals: 0,
            };
            self.sent.insert((name.clone(), seq), sent);
        }
        let command = Command {
            action: action.clone(),
            timestamp,
            seq,
            source: source(&name),
        };
        let mut buffer = [0; 1024];
        let len = command.to_json(&mut buffer).expect("fits");
        self.robot.submit(&buffer[..len], self.now);
        if halt {
            // What still waits is taken back: it must neither move the robot nor release it.
            for sent in self.sent.values_mut() {
                sent.legitimate &= sent.begun > 0 || sent.finals > 0;
            }
            self.halted = true;
            self.wanted = false;
            self.until = None;
            self.estopped |= matches!(action, Action::Estop);
            // A halt wakes the loop: sometimes before, sometimes with the next period.
            if self.now.as_micros().is_multiple_of(3) {
                let halt = self
                    .robot
                    .control_handle()
                    .take_halt()
                    .expect("halts are never refused");
                self.turn(Duration::from_millis(3), Some(&halt))?;
            }
        }
        Ok(())
    }

    pub(super) fn turn(
        &mut self,
        after: Duration,
        woken_by: Option<&Halt>,
    ) -> Result<Outputs, TestCaseError> {
        self.now += after;
        match self.sensor {
            Sensor::Sees(sight) => {
                self.reading.sight = Some((sight, self.now));
                self.reading.health = SensorHealth::Good;
            }
            Sensor::Silent => {}
            Sensor::Broken(health) => self.reading.health = health,
        }
        self.robot.sense_handle().publish(&self.reading);
        self.decide();
        let fault = self.motor_fault;
        let out = self
            .control_loop
            .turn(&self.robot, woken_by, fault, &mut self.rng, self.now);
        self.judge(&out)?;
        Ok(out)
    }

    /// Whatever a network may do: any action or none at all, in turn or for another observation, now and then
    /// nothing for a while.
    fn decide(&mut self) {
        let (asked, chance) = (self.robot.policy_asked(), self.rng.next_u32());
        if chance & 0x300 == 0 {
            return;
        }
        let number = match asked {
            Some(asked) => asked.number,
            None if chance & 0xF000 == 0 => (chance >> 16) as u16,
            None => return,
        };
        self.robot.policy_handle().decide(Decision {
            action: (chance & 0xF) as u8 % 9,
            number,
        });
    }

    fn judge(&mut self, out: &Outputs) -> Result<(), TestCaseError> {
        let snapshot = self.robot.snapshot();
        let ramp = self.ramp_step() * ((self.now - self.last_turn).as_secs_f32() / 0.02).min(1.0);
        let standing = out.duties == [0.0, 0.0];
        self.judge_answers(out)?;
        self.judge_resumption(out)?;
        let expired = self.until.is_none_or(|until| self.now >= until);
        // Its last 200 ms may be steeper than the ramp.
        let soon = self.now + Duration::from_millis(200);
        let braking = self.continuous && self.until.is_some_and(|until| soon >= until);
        // 1. A halt stops both wheels within the period, and only a new command moves them.
        if core::mem::take(&mut self.halted) {
            prop_assert!(standing, "not halted: {:?}", out.duties);
        }
        if self.until.is_none() {
            prop_assert!(standing, "moves without a command: {:?}", out.duties);
        }
        if self.estopped {
            prop_assert_eq!(snapshot.state, RobotState::Error);
        }
        // 2. Range, ramp, and a rest before a reversal.
        for wheel in 0..2 {
            let (before, after) = (self.before[wheel], out.duties[wheel]);
            prop_assert!((-1.0..=1.0).contains(&after), "duty {}", after);
            prop_assert!(before * after >= 0.0, "jumps from {} to {}", before, after);
            prop_assert!(
                after == 0.0
                    || (after - before).abs() <= ramp + EPSILON
                    || braking && after.abs() < before.abs(),
                "{} to {} in {:?}",
                before,
                after,
                self.now - self.last_turn
            );
            if after == 0.0 && before != 0.0 {
                self.zero_since[wheel] = self.now;
            }
            if after != 0.0 {
                if after * self.direction[wheel] < 0.0 {
                    prop_assert!(self.now - self.zero_since[wheel] >= DEAD_TIME);
                }
                self.direction[wheel] = after;
            }
            // 3. What has expired only slows down, as fast as the ramp goes; of continuous driving
            // nothing is left.
            if expired && self.continuous {
                prop_assert_eq!(after, 0.0, "after the end of continuous driving");
            } else if expired {
                let slower = (before.abs() - ramp).max(0.0) + EPSILON;
                prop_assert!(
                    after.abs() <= slower,
                    "expired, and {} after {}",
                    after,
                    before
                );
            }
        }
        // 3. Nothing moves on a lost link.
        if self.robot.link_health() == LinkHealth::Lost {
            prop_assert!(standing, "moves on a lost link");
            self.until = None;
        }
        // 4. No motion on an old reading, or one of a broken sensor, where avoidance counts.
        let autonomous = snapshot.behaviour != crawler_protocol::BehaviourName::Manual
            || snapshot.state == RobotState::Scanning;
        if self.avoidance || autonomous {
            let sight = self.reading.sight.filter(|(_, at)| {
                self.reading.health == SensorHealth::Good
                    && self.now - *at <= Duration::from_millis(300)
            });
            match sight {
                None => prop_assert!(standing, "moves blind: {:?}", self.reading),
                Some((sight, _)) if sight.distance_mm() < 250 => prop_assert!(
                    out.duties[0] + out.duties[1] <= EPSILON,
                    "drives into an obstacle: {:?}",
                    out.duties
                ),
                Some(_) => {}
            }
        }
        // 5. An empty battery, and motors that do not obey.
        let critical = self.robot.battery().charge == Charge::Critical;
        if critical || self.motor_fault {
            self.wanted = false;
            prop_assert!(standing, "moves with a fault");
            prop_assert_eq!(snapshot.state, RobotState::Error);
        }
        if snapshot.state == RobotState::Error {
            prop_assert!(standing, "moves in ERROR");
            self.until = None;
        }
        prop_assert!(snapshot.pose.x.is_finite() && snapshot.pose.y.is_finite());
        prop_assert!(snapshot.pose.sigma.is_finite() && snapshot.pose.sigma >= 0.0);
        let theta = snapshot.pose.theta;
        prop_assert!(theta > -core::f32::consts::PI && theta <= core::f32::consts::PI);
        self.before = out.duties;
        self.last_turn = self.now;
        Ok(())
    }

    /// Of what was interrupted only a behaviour goes on, when nothing has been in its way for a second, and
    /// unless somebody has said otherwise or something is wrong that does not pass by itself.
    fn judge_resumption(&mut self, out: &Outputs) -> Result<(), TestCaseError> {
        let lost = self.robot.link_health() == LinkHealth::Lost;
        let broken = self.robot.snapshot().state == RobotState::Error;
        if lost || broken {
            self.hindered = self.now;
        }
        for note in &out.notes {
            if let Note::Resumed(_) = note {
                prop_assert!(self.wanted, "takes up what nobody wants any more");
                prop_assert!(!self.estopped);
                prop_assert!(self.now - self.hindered >= CALM, "takes it up at once");
                self.until = Some(Instant::FAR_FUTURE);
                self.continuous = false;
            }
        }
        Ok(())
    }

    /// The answers tell which command is in force; the observer checks that it may be.
    fn judge_answers(&mut self, out: &Outputs) -> Result<(), TestCaseError> {
        for answer in &out.answers {
            let name = String::from(answer.sender.source.as_str());
            let key = (name, answer.sender.seq);
            let Some(sent) = self.sent.get_mut(&key) else {
                // A halt with an old number; of anything else this would be a second life.
                prop_assert!(key.0.starts_with("operator:10"), "from nowhere: {:?}", key);
                continue;
            };
            let completed = answer.status == ResponseStatus::Completed;
            if sent.meaning != Meaning::Halt {
                sent.finals += u32::from(answer.status.is_final());
                prop_assert!(sent.finals <= 1, "two final answers to {:?}", key);
            }
            match sent.meaning {
                Meaning::Motion { until, lasting } => {
                    if answer.status == ResponseStatus::Accepted || completed && !lasting {
                        sent.begun += 1;
                        prop_assert_eq!(sent.begun, 1, "carried out twice: {:?}", key);
                        prop_assert!(sent.legitimate, "of another time: {:?}", key);
                        self.until = Some(until);
                        self.continuous = !lasting && until != Instant::FAR_FUTURE;
                        self.wanted = !lasting && until == Instant::FAR_FUTURE;
                    } else if lasting && sent.begun > 0 {
                        self.until = Some(self.now);
                        self.continuous = false;
                    }
                }
                Meaning::Rest if completed => {
                    self.until = Some(self.now);
                    self.continuous = false;
                    self.wanted = false;
                }
                Meaning::Reset if completed => {
                    prop_assert!(sent.legitimate, "released by a reset before the stop");
                    self.estopped = false;
                }
                Meaning::Rest | Meaning::Reset | Meaning::Halt | Meaning::Other => {}
            }
        }
        while let Some((ticket, _)) = self.robot.outbox.next_answer() {
            self.robot.outbox.sent(ticket);
            self.robot.outbox.delivered(ticket);
        }
        Ok(())
    }
}
