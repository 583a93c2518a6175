//! Counts instructions of what the robot program does again and again.
//!
//! Polls the real activities with a clock that is moved by hand, interrupts off, and reads the
//! counter of retired instructions around each poll. Under `-icount shift=0` the figures are exact
//! and the same in every run. Prints lines `count NAME INSTRUCTIONS` as plain text on the serial
//! line and ends with code 0; with any other when something did not come to its end.
#![no_std]
#![no_main]

#[path = "counts/handshake.rs"]
mod handshake;
#[path = "counts/swarm.rs"]
mod swarm;

use core::cell::{Cell, UnsafeCell};
use core::convert::Infallible;
use core::fmt::Write;
use core::pin::{Pin, pin};
use core::task::{Context, Poll, Waker};

use crawler_app::perception::LinkHealth;
use crawler_app::policy::SPREAD;
use crawler_app::{Config, Robot};
use crawler_board::model::{Bench, GEOMETRY, Line, LineFault, ModelEcho, Side};
use crawler_hal::{Clock, Instant, MotorPort, RangerPort, ResetCause, System};
use crawler_protocol::{
    Action, Battery, BehaviourName, BehaviourSpec, Command, Direction, Fleet, Kind, RobotId,
    RobotState, Source, Telemetry, Wheels,
};
use crawler_virt::machine::{self, ExitCode};
use crawler_virt::{log, system, time};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embedded_io_async::{Read, Write as Send};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use rand_pcg::Pcg32;
use riscv::register::minstret;

/// Never: a time that no clock reaches.
const NEVER: u64 = u64::MAX;

/// A clock moved by hand, which notes when its activity wants to be polled next.
#[derive(Clone)]
struct HandClock<'a> {
    now_us: &'a Cell<u64>,
    wake_us: &'a Cell<u64>,
}

impl Clock for HandClock<'_> {
    fn now(&self) -> Instant {
        Instant::from_micros(self.now_us.get())
    }

    async fn sleep_until(&self, at: Instant) {
        core::future::poll_fn(|_| {
            if self.now() >= at {
                return Poll::Ready(());
            }
            self.wake_us.set(self.wake_us.get().min(at.as_micros()));
            Poll::Pending
        })
        .await;
    }
}

/// A microcontroller that cannot be reset.
struct NoSystem;

impl System for NoSystem {
    fn reset_cause(&self) -> ResetCause {
        ResetCause::PowerOn
    }

    fn last_panic(&self) -> Option<&str> {
        None
    }

    fn feed_watchdog(&mut self) {}

    async fn reset(&mut self) -> Infallible {
        fail("the program asked for a reset")
    }
}

/// What asks the ranger for the range, on its line.
const RANGE: u8 = 0x55;

/// The line to the ranger, which notes when the range is asked for.
struct Asking<'a, U> {
    uart: U,
    asked: &'a Cell<bool>,
}

impl<U: embedded_io_async::ErrorType> embedded_io_async::ErrorType for Asking<'_, U> {
    type Error = U::Error;
}

impl<U: Read> Read for Asking<'_, U> {
    async fn read(&mut self, bytes: &mut [u8]) -> Result<usize, U::Error> {
        self.uart.read(bytes).await
    }
}

impl<U: Send> Send for Asking<'_, U> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, U::Error> {
        self.asked.set(self.asked.get() || bytes.contains(&RANGE));
        self.uart.write(bytes).await
    }

    async fn flush(&mut self) -> Result<(), U::Error> {
        self.uart.flush().await
    }
}

const FLASH_BYTES: usize = 8_192;

/// Flash in RAM, so that the store activity finds its parameters.
struct RamFlash<'a>(&'a mut [u8; FLASH_BYTES]);

impl ErrorType for RamFlash<'_> {
    type Error = NorFlashErrorKind;
}

impl RamFlash<'_> {
    fn part(&mut self, at: u32, len: usize) -> Result<&mut [u8], NorFlashErrorKind> {
        let start = at as usize;
        self.0
            .get_mut(start..start + len)
            .ok_or(NorFlashErrorKind::OutOfBounds)
    }
}

impl ReadNorFlash for RamFlash<'_> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        bytes.copy_from_slice(self.part(at, bytes.len())?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        FLASH_BYTES
    }
}

impl NorFlash for RamFlash<'_> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4_096;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.part(from, (to - from) as usize)?.fill(0xFF);
        Ok(())
    }

    async fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        self.part(at, bytes.len())?.copy_from_slice(bytes);
        Ok(())
    }
}

/// Instructions that `work` retires.
#[inline(never)]
fn count<T>(work: impl FnOnce() -> T) -> (u64, T) {
    let before = minstret::read64();
    let done = work();
    let after = minstret::read64();
    (after - before, done)
}

fn fail(why: &str) -> ! {
    // The line is plain text here; a failure to write has nowhere to go.
    let _ = writeln!(log::Text, "failed: {why}");
    machine::exit(ExitCode::Measurement)
}

fn tell(name: &str, instructions: u64) {
    let _ = writeln!(log::Text, "count {name} {instructions}");
}

type Activity<'a> = Pin<&'a mut dyn Future<Output = Infallible>>;

/// One activity under measurement.
struct Subject<'a> {
    activity: Activity<'a>,
    wake_us: &'a Cell<u64>,
    overhead: u64,
}

impl Subject<'_> {
    /// Polls once; instructions it took.
    fn poll(&mut self) -> u64 {
        self.wake_us.set(NEVER);
        let activity = &mut self.activity;
        let (instructions, polled) = count(|| {
            let mut context = Context::from_waker(Waker::noop());
            activity.as_mut().poll(&mut context)
        });
        match polled {
            Poll::Pending => instructions - self.overhead,
            Poll::Ready(never) => match never {},
        }
    }
}

/// Indices of the subjects.
const CONTROL: usize = 0;
const SENSE: usize = 1;
const POWER: usize = 2;
const STORE: usize = 3;
const LAMP: usize = 4;
const DECIDE: usize = 5;
/// How many there are.
const SUBJECTS: usize = 6;
/// How often the activity of a policy goes on for a decision: once for each layer of the network, and once more.
const LAYERS: u32 = 4;

/// Readings of sense whose middle is told.
const READINGS: usize = 25;

/// Everything that is measured.
struct Rig<'a, 'b> {
    now_us: &'a Cell<u64>,
    body: &'b Bench<CriticalSectionRawMutex>,
    subjects: [Subject<'a>; SUBJECTS],
    /// Most instructions of one poll, by subject, since last asked.
    most: [u64; SUBJECTS],
    /// Policy: how often it goes on yet, instructions of this decision, and of the dearest one.
    layers: u32,
    decision: u64,
    decisions: u64,
    /// Sense: whether it asked for the range, its instructions since it did, and those of past readings.
    asked: &'a Cell<bool>,
    reading: u64,
    readings: [u64; READINGS],
    taken: usize,
}

impl Rig<'_, '_> {
    /// Lets `ms` of time pass, polling whoever is due.
    fn run(&mut self, ms: u64) {
        let end = self.now_us.get() + ms * 1_000;
        loop {
            let due = (0..self.subjects.len())
                .min_by_key(|i| self.subjects[*i].wake_us.get())
                .unwrap_or(0);
            let at = self.subjects[due].wake_us.get();
            if at > end {
                break;
            }
            self.now_us.set(self.now_us.get().max(at));
            self.body.advance(Instant::from_micros(self.now_us.get()));
            self.step(due);
        }
        self.now_us.set(end);
    }

    fn step(&mut self, which: usize) {
        let instructions = self.subjects[which].poll();
        if which == SENSE && self.subjects[SENSE].wake_us.get() == NEVER {
            // It has let others run between two slices of its plan, and goes on at once.
            self.subjects[SENSE].wake_us.set(self.now_us.get());
        }
        self.most[which] = self.most[which].max(instructions);
        if which == CONTROL {
            // It may have asked for a decision.
            self.layers = LAYERS;
            self.decision = 0;
        } else if which == DECIDE {
            self.layers -= 1;
            self.decision += instructions;
            self.decisions = self.decisions.max(self.decision);
        }
        if which == CONTROL || which == DECIDE {
            let again = if self.layers > 0 {
                self.now_us.get()
            } else {
                NEVER
            };
            self.subjects[DECIDE].wake_us.set(again);
        }
        if which == SENSE {
            self.reading += instructions;
            if self.asked.take() {
                // The poll that asks, with what the model of the ranger makes of it, is no part of the reading.
                let past = self.reading - instructions;
                if let Some(room) = self.readings.get_mut(self.taken) {
                    *room = past;
                    self.taken += 1;
                }
                self.reading = 0;
            }
        }
    }

    /// Most instructions of one poll of `which` in the next `ms`.
    fn most_of(&mut self, which: usize, ms: u64) -> u64 {
        self.most = [0; SUBJECTS];
        self.run(ms);
        self.most[which]
    }
}

/// The dearest steps in which a robot is told what to do.
#[derive(Default)]
struct Told {
    order: u64,
    halt: u64,
}

impl Told {
    /// Lets the control loop take the order that waits.
    fn order(&mut self, rig: &mut Rig<'_, '_>) {
        self.order = self.order.max(rig.most_of(CONTROL, 20));
    }

    /// Lets the control loop take the halt that waits, for which it is woken at once.
    fn halt(&mut self, rig: &mut Rig<'_, '_>) {
        rig.subjects[CONTROL].wake_us.set(rig.now_us.get());
        self.halt = self.halt.max(rig.most_of(CONTROL, 0));
    }
}

struct Memory(UnsafeCell<[u8; FLASH_BYTES]>);

// SAFETY: used by `main` alone, which runs once.
unsafe impl Sync for Memory {}

static FLASH: Memory = Memory(UnsafeCell::new([0xFF; FLASH_BYTES]));

#[riscv_rt::entry]
fn main(_hart: usize, _tree: usize) -> ! {
    log::init();
    time::init();
    system::end_on_panic();
    let now_us = Cell::new(0);
    let wakes = [const { Cell::new(0) }; SUBJECTS];
    let clock = |which: usize| HandClock {
        now_us: &now_us,
        wake_us: &wakes[which],
    };
    let robot = Robot::<CriticalSectionRawMutex>::new(config());
    let body = Bench::<CriticalSectionRawMutex>::new("counts", LineFault::None);
    let port = |side| MotorPort {
        enable: body.pwm(side),
        in1: body.pin(Line::In1(side)),
        in2: body.pin(Line::In2(side)),
    };
    // SAFETY: nobody else uses it, and this runs once.
    let memory = unsafe { &mut *FLASH.0.get() };
    let (left, right) = (port(Side::Left), port(Side::Right));
    let rng = Pcg32::new(1, 2);
    let asked = Cell::new(false);
    let ranger: RangerPort<_, ModelEcho, ModelEcho> = RangerPort::Uart(Asking {
        uart: body.uart(clock(SENSE)),
        asked: &asked,
    });
    let (overhead, ()) = count(|| ());

    let control = pin!(crawler_app::control(
        &robot,
        left,
        right,
        NoSystem,
        rng,
        clock(CONTROL)
    ));
    let sense = pin!(crawler_app::sense(&robot, ranger, clock(SENSE)));
    let power = pin!(crawler_app::power(&robot, body.gauge(), clock(POWER)));
    let store = pin!(crawler_app::store(&robot, RamFlash(memory), clock(STORE)));
    let lamp = pin!(crawler_app::lamp(&robot, body.pin(Line::Lamp), clock(LAMP)));
    let decide = pin!(crawler_app::decide(&robot, SPREAD, Pcg32::new(3, 4)));
    let activities: [Activity<'_>; SUBJECTS] = [control, sense, power, store, lamp, decide];
    let mut number = 0;
    let subjects = activities.map(|activity| {
        number += 1;
        Subject {
            activity,
            wake_us: &wakes[number - 1],
            overhead,
        }
    });
    let mut rig = Rig {
        now_us: &now_us,
        body: &body,
        subjects,
        most: [0; SUBJECTS],
        layers: LAYERS,
        decision: 0,
        decisions: 0,
        asked: &asked,
        reading: 0,
        readings: [0; READINGS],
        taken: 0,
    };
    measure(&robot, &mut rig);
    handshake::measure();
    let _ = writeln!(log::Text, "done");
    machine::exit(ExitCode::Done)
}

fn config() -> Config {
    let name = |text| RobotId::new(text).unwrap_or_else(|_| fail("id"));
    Config {
        id: name("counts"),
        fleet: Fleet::new("swarm").unwrap_or_else(|_| fail("fleet")),
        broker_host: heapless::String::new(),
        broker_port: 1_883,
        kind: Kind::Emulated,
        board: "virt",
        firmware: env!("CARGO_PKG_VERSION"),
        build: None,
        geometry: GEOMETRY,
        credentials: None,
        camera: false,
        eyes: None,
        faults: false,
    }
}

fn measure(robot: &Robot<CriticalSectionRawMutex>, rig: &mut Rig<'_, '_>) {
    let mut seq = 0;
    let mut order = |rig: &Rig<'_, '_>, action| {
        seq += 1;
        let command = Command {
            action,
            timestamp: 0,
            seq,
            source: Source::new("counts").unwrap_or_else(|_| fail("source")),
        };
        let now = Instant::from_micros(rig.now_us.get());
        if robot.route(&command, now, |_| ()).is_err() {
            fail("a command was not taken");
        }
    };
    let expect = |state: RobotState, what: &str| {
        if robot.snapshot().state != state {
            fail(what);
        }
    };
    // The start: parameters are read, the ranger is believed, the battery is known.
    robot.set_link_health(LinkHealth::Up);
    rig.run(2_000);
    expect(RobotState::Idle, "the robot did not get ready");
    tell("control_idle", rig.most_of(CONTROL, 1_000));

    let mut told = Told::default();
    order(
        rig,
        Action::Move {
            direction: Direction::Left,
            speed: 60,
            duration_ms: 3_000,
        },
    );
    told.order(rig);
    rig.run(80);
    swarm::locate(robot, rig);
    tell("control_driving", rig.most_of(CONTROL, 1_000));
    expect(RobotState::Moving, "the robot did not move");
    rig.run(3_000);

    order(rig, Action::Behave(BehaviourSpec::Wander { speed: 60 }));
    told.order(rig);
    rig.run(80);
    let mut met_a_wall = false;
    let mut most = 0;
    for _ in 0..60 {
        swarm::locate(robot, rig);
        most = most.max(rig.most_of(CONTROL, 500));
        let state = robot.snapshot().state;
        met_a_wall |= matches!(state, RobotState::Caution | RobotState::Avoiding);
    }
    if !met_a_wall {
        fail("the robot wandered for half a minute without meeting a wall");
    }
    tell("control_wandering", most);
    order(rig, Action::Stop);
    told.halt(rig);
    rig.run(1_000);
    swarm::measure(robot, rig, &mut told, &mut order);

    order(rig, Action::Goto { x: 4.0, y: 3.0 });
    told.order(rig);
    rig.run(80);
    let (mut most, mut slice) = (0, 0);
    for _ in 0..16 {
        swarm::locate(robot, rig);
        most = most.max(rig.most_of(CONTROL, 500));
        slice = slice.max(rig.most[SENSE]);
        if robot.snapshot().behaviour != BehaviourName::Goto {
            fail("the robot did not stay on its way");
        }
    }
    tell("control_going", most);
    tell("navigate_slice", slice);
    order(rig, Action::Stop);
    told.halt(rig);
    rig.run(1_000);
    tell("control_told", told.order);
    tell("control_halted", told.halt);

    rig.taken = 0;
    rig.run(READINGS as u64 * 200);
    if rig.taken < READINGS {
        fail("sense did not take its readings");
    }
    rig.readings.sort_unstable();
    tell("sense_reading", rig.readings[READINGS / 2]);
    tell("power_measurement", rig.most_of(POWER, 3_000));
    messages(robot);
}

/// What the link does for one message, without the way to the broker.
fn messages(robot: &Robot<CriticalSectionRawMutex>) {
    let snapshot = robot.snapshot();
    let [left, right] = snapshot.wheels;
    let telemetry = Telemetry {
        robot: robot.config().id.clone(),
        seq: 901,
        timestamp: 1_648_372_966_004,
        state: snapshot.state,
        behaviour: snapshot.behaviour,
        pose: snapshot.pose,
        range_mm: Some(812),
        temperature_c: Some(22.5),
        wheels: Wheels { left, right },
        battery: Battery {
            mv: 7_610,
            percent: 71,
        },
        rssi_dbm: Some(-61),
        says: None,
    };
    let mut buffer = [0; crawler_protocol::MAX_MESSAGE];
    let (instructions, encoded) = count(|| telemetry.to_json(&mut buffer));
    if encoded.is_err() {
        fail("telemetry does not fit");
    }
    tell("telemetry_encode", instructions);
    let payload = br#"{"command": "move", "parameters": {"direction": "forward", "speed": 80, "duration": 2000}, "timestamp": 1648372964000, "seq": 17, "source": "operator:ada"}"#;
    let (instructions, parsed) = count(|| Command::parse(payload));
    if parsed.is_err() {
        fail("the command does not parse");
    }
    tell("command_parse", instructions);
}
