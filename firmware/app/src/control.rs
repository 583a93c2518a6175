//! The control activity: motors and watchdog.

use core::convert::Infallible;
use core::ops::Deref;

use crawler_drivers::l298n::{Config, Duty, L298n, MotorError, Trim};
use crawler_hal::{Clock, Duration, Instant, MotorPort, System, Ticker};
use crawler_protocol::Level;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;
use rand_core::Rng;

use crate::behaviour::MissionNews;
use crate::context::handles::ControlHandle;
use crate::context::{Robot, Snapshot};
use crate::controller::{Controller, Inputs, Note, Outputs, PERIOD, Tuning};
use crate::neighbours::{Near, name_of};
use crate::order::Halt;
use crate::parameters::Parameters;
use crate::perception::{Charge, LinkHealth};
use crate::state::{Fault, State};

/// A step that comes later than this after the one before it is not a healthy loop: the watchdog
/// is not fed for it.
pub const HEALTHY_WITHIN: Duration = Duration::from_millis(100);
/// How long `identify` blinks.
pub const IDENTIFY_FOR: Duration = Duration::from_secs(5);
/// How long `reboot` waits for its answer to reach the broker.
pub const REBOOT_PATIENCE: Duration = Duration::from_millis(2_000);
/// How long it waits in any case, so that the motors have come to rest.
pub const REBOOT_REST: Duration = Duration::from_millis(500);

/// Runs the control loop: takes a [`Controller::step`] every [`PERIOD`], and at once when a halt
/// is requested.
///
/// Alone owns the motors, and feeds the watchdog, only after a step in time whose duties the
/// motor driver took. When a wheel can no longer be stopped, restarts the program, which resets
/// the pins.
///
/// # Cancellation Safety
/// Dropping the activity leaves the motors as they are: coast them first, or reset.
pub fn control<M, P, O, S, C, R>(
    robot: impl Deref<Target = Robot<M>>,
    left: MotorPort<P, O>,
    right: MotorPort<P, O>,
    mut system: S,
    mut rng: R,
    clock: C,
) -> impl Future<Output = Infallible>
where
    M: RawMutex,
    P: SetDutyCycle,
    O: OutputPin,
    S: System,
    C: Clock,
    R: Rng,
{
    let mut wheels = Wheels::new(left, right);
    async move {
        let robot = robot.control_handle();
        robot.set_boot_cause(system.reset_cause(), system.last_panic(), clock.now());
        let mut control_loop = ControlLoop::new(&robot);
        let mut last_step = clock.now();
        let mut ticker = Ticker::every(PERIOD, last_step);
        loop {
            let woken = select(robot.halt_asked(), ticker.tick(&clock)).await;
            let halted = matches!(woken, Either::First(()));
            if halted && !robot.halt_waits() {
                // Taken already, with the period.
                continue;
            }
            let now = clock.now();
            let done = turn_wheels(robot, &mut control_loop, &mut wheels, halted, &mut rng, now);
            if let Err(error) = done {
                robot.log(Level::Error, "motor", format_args!("{error}"), now);
                if let MotorError::Runaway(_) = error {
                    system.reset().await;
                }
            }
            if now - last_step <= HEALTHY_WITHIN && !wheels.refused {
                system.feed_watchdog();
            }
            robot.count_missed(now - last_step);
            last_step = now;
            if control_loop.may_reboot(&robot, now) || robot.injected.restart_is_due(now) {
                system.reset().await;
            }
        }
    }
}

/// One turn, to the wheels and all. A function of its own: what is large about it lies on the stack
/// and not in the future, for as long as it takes.
fn turn_wheels<M: RawMutex, P: SetDutyCycle, O: OutputPin, R: Rng>(
    robot: ControlHandle<'_, M>,
    control_loop: &mut ControlLoop,
    wheels: &mut Wheels<P, O>,
    halted: bool,
    rng: &mut R,
    now: Instant,
) -> Result<(), MotorError> {
    let woken_by = halted.then(|| robot.take_halt()).flatten();
    let mut outputs = Outputs::default();
    control_loop.turn_into(
        robot,
        woken_by.as_ref(),
        wheels.refused,
        rng,
        now,
        &mut outputs,
    );
    let duties = robot.injected.weaken(outputs.duties, now);
    wheels.apply(duties, control_loop.controller().trims(), now)
}

/// The control loop between two looks at the clock, without the motors: what the activity and the
/// tests of the safety rules share.
#[derive(Debug)]
pub struct ControlLoop {
    controller: Controller,
    /// Of the parameters in `controller`.
    version: u32,
    shown: Option<Look>,
    reboot_asked: Option<Instant>,
    /// Whether the camera was asked to look.
    looking: bool,
    /// The robot itself, as neighbours have it.
    own: u32,
    near: Near,
    /// Whether it has looked around since it took a position reference.
    looked: bool,
    /// Whether the step before took an order or a halt.
    told: bool,
}

impl ControlLoop {
    /// A loop that has not taken a turn.
    pub fn new<M: RawMutex>(robot: &Robot<M>) -> Self {
        Self {
            controller: Controller::new(tuning_of(robot)),
            version: robot.with_parameters(Parameters::version),
            shown: None,
            reboot_asked: None,
            looking: false,
            own: name_of(&robot.config().id),
            near: Near::new(),
            looked: false,
            told: false,
        }
    }

    /// The controller.
    pub const fn controller(&self) -> &Controller {
        &self.controller
    }

    /// Takes one turn: gathers what the other activities left, steps the controller, answers,
    /// reports and publishes. The caller hands the duties to the motors.
    ///
    /// `woken_by` is a halt that did not wait for the period; `None` is a period that has passed.
    pub fn turn<M: RawMutex, R: Rng>(
        &mut self,
        robot: &Robot<M>,
        woken_by: Option<&Halt>,
        motor_fault: bool,
        rng: &mut R,
        now: Instant,
    ) -> Outputs {
        let mut outputs = Outputs::default();
        self.turn_into(
            robot.control_handle(),
            woken_by,
            motor_fault,
            rng,
            now,
            &mut outputs,
        );
        outputs
    }

    /// As [`Self::turn`], into `outputs`, which are empty. They are too large to be handed about
    /// fifty times a second.
    fn turn_into<M: RawMutex, R: Rng>(
        &mut self,
        robot: ControlHandle<'_, M>,
        woken_by: Option<&Halt>,
        motor_fault: bool,
        rng: &mut R,
        now: Instant,
        outputs: &mut Outputs,
    ) {
        let (mut taken, mut order) = (None, None);
        if woken_by.is_none() {
            // In this order: an order that is there after the halt was taken came after it.
            if robot.halt_waits() {
                taken = robot.take_halt();
            }
            if robot.order_waits() {
                order = robot.take_order();
            }
        }
        let has_eyes = robot.config.eyes.is_some();
        let view = if has_eyes { robot.take_view() } else { None };
        let newest = robot.with_parameters(Parameters::version);
        let retuned = newest != self.version;
        if retuned {
            self.version = newest;
            self.controller.set_tuning(tuning_of(&robot));
        }
        let battery = robot.battery();
        // A step that is told to do something has enough to do; but not one after the other, or whoever floods it with
        // orders would make it blind.
        let is_told = woken_by.is_some() || taken.is_some() || order.is_some();
        let has_time = !is_told || self.told;
        self.told = is_told;
        let takes_fix = has_time && self.controller.takes_fix() && robot.fix_waits();
        let by_others = self.controller.wants_neighbours();
        // A reference and a look around are too much for one step: they take turns.
        let looks =
            by_others && has_time && self.controller.looks_around() && !(takes_fix && self.looked);
        if !by_others {
            self.near.forget();
        } else if looks {
            robot.look_around(&mut self.near, now);
        }
        let fix = if takes_fix && !looks {
            robot.take_fix()
        } else {
            None
        };
        if looks || fix.is_some() {
            self.looked = looks;
        }
        if let Some(goal) = robot.take_goal_before_restart()
            && robot.boot().was_asked_for()
        {
            self.controller.was_at(goal, now);
        }
        let inputs = Inputs {
            reading: robot.reading(),
            charge: battery.charge,
            voltage: battery.voltage,
            fix,
            view: view.as_ref(),
            near: self.near.as_slice(),
            own: self.own,
            guide: robot.guide(),
            leeway: robot.leeway(),
            link: robot.link_health(),
            loaded: robot.is_loaded(),
            motor_fault,
            halt: woken_by.or(taken.as_ref()),
            order: order.as_ref(),
            update: robot.update_wish(),
            policies: robot.policies(),
            decision: robot.take_decision(),
        };
        self.controller.step_into(&inputs, rng, now, outputs);
        robot.go(self.controller.going());
        if let Some((asked, name)) = self.controller.asked() {
            robot.ask_policy(asked, name);
        }
        let state = self.controller.state();
        robot.publish(&Snapshot {
            state: state.reported(),
            behaviour: self.controller.behaviour(),
            fault: state.fault(),
            pose: self.controller.pose(),
            wheels: outputs.duties,
            says: self.controller.says(),
            reading: inputs.reading,
            battery,
        });
        if outputs.identify {
            robot.identify(now + IDENTIFY_FOR);
        }
        let look = Some(Look::new(state, &inputs));
        if look != self.shown || outputs.identify {
            self.shown = look;
            robot.wake_lamp();
        }
        if has_eyes {
            let wanted = self.controller.wants_eyes();
            if wanted != self.looking || retuned {
                self.looking = wanted;
                robot.want_views(wanted);
            }
        }
        report(&robot, outputs, now);
        if let Some(goal) = outputs.unfinished {
            robot.keep_goal(goal);
        }
        if outputs.reboot {
            self.reboot_asked.get_or_insert(now);
        }
    }

    /// Whether `reboot` was asked for and its time has come: the robot has come to rest, and the
    /// answers have reached the broker or will not.
    pub fn may_reboot<M: RawMutex>(&self, robot: &Robot<M>, now: Instant) -> bool {
        self.reboot_asked.is_some_and(|asked| {
            let waited = now - asked;
            waited >= REBOOT_REST && (robot.outbox.pending() == 0 || waited >= REBOOT_PATIENCE)
        })
    }
}

fn tuning_of<M: RawMutex>(robot: &Robot<M>) -> Tuning {
    robot.with_parameters(|parameters| Tuning::new(parameters, &robot.config.geometry))
}

/// What the lamp shows of control, to notice a change.
#[derive(Debug, PartialEq)]
struct Look {
    state: core::mem::Discriminant<State>,
    fault: Option<Fault>,
    charge: Charge,
    link: LinkHealth,
}

impl Look {
    fn new(state: &State, inputs: &Inputs<'_>) -> Self {
        Self {
            state: core::mem::discriminant(state),
            fault: state.fault(),
            charge: inputs.charge,
            link: inputs.link,
        }
    }
}

/// The motor driver, and whether it refused the last duties.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Wheels<P, O> {
    driver: L298n<P, O>,
    refused: bool,
}

impl<P: SetDutyCycle, O: OutputPin> Wheels<P, O> {
    /// Wheels on these ports. Does no I/O.
    pub const fn new(left: MotorPort<P, O>, right: MotorPort<P, O>) -> Self {
        Self {
            driver: L298n::new(left, right, Config::new()),
            refused: false,
        }
    }

    /// The motor driver.
    pub const fn driver(&self) -> &L298n<P, O> {
        &self.driver
    }

    /// Hands duties on. Reports a refusal once, and again only after it was gone.
    ///
    /// # Errors
    /// [`MotorError`] when an output refuses and did not before.
    pub fn apply(
        &mut self,
        duties: [f32; 2],
        [left_trim, right_trim]: [Trim; 2],
        now: Instant,
    ) -> Result<(), MotorError> {
        let config = Config::new().with_trim(left_trim, right_trim);
        if *self.driver.config() != config {
            self.driver.set_config(config);
        }
        let [left, right] = duties.map(Duty::new);
        let result = self.driver.apply(left, right, now);
        let known = core::mem::replace(&mut self.refused, result.is_err());
        match result {
            Err(error @ MotorError::Runaway(_)) => Err(error),
            Err(error) if !known => Err(error),
            Ok(_) | Err(_) => Ok(()),
        }
    }
}

fn report<M: RawMutex>(robot: &Robot<M>, outputs: &Outputs, now: Instant) {
    for answer in &outputs.answers {
        let sender = &answer.sender;
        robot.respond(
            &sender.source,
            sender.seq,
            answer.status,
            answer.reason,
            now,
        );
    }
    for note in &outputs.notes {
        match note {
            Note::Raised(fault) => {
                // Someone wanted the emergency stop; it is nothing to mend.
                let level = match fault {
                    Fault::EmergencyStop => Level::Warn,
                    Fault::Battery | Fault::Motor | Fault::Ranger => Level::Error,
                };
                robot.log(level, "fault", format_args!("{}", fault.name()), now);
            }
            Note::Cleared(fault) => {
                let text = format_args!("{} is over", fault.name());
                robot.log(Level::Info, "fault", text, now);
            }
            Note::Ended(reason) => {
                robot.log(Level::Info, "motion-ended", format_args!("{reason}"), now);
            }
            Note::Resumed(behaviour) => {
                let text = format_args!("{} goes on", behaviour.name());
                robot.log(Level::Info, "resumed", text, now);
            }
            Note::HemmedIn(attempts) => {
                let text = format_args!("no way out after {attempts} attempts");
                robot.log(Level::Warn, "hemmed-in", text, now);
            }
            Note::Relocated(pose) => {
                let text = format_args!("{:.2} {:.2}, heading {:.2}", pose.x, pose.y, pose.theta);
                robot.log(Level::Info, "relocated", text, now);
            }
            Note::Mission(MissionNews::LeaderLost) => {
                let text = format_args!("nobody near is the leader or follows it");
                robot.log(Level::Warn, "leader-lost", text, now);
            }
            Note::Mission(MissionNews::Skipped(number)) => {
                let text = format_args!("place {number} not reached in time: on to the next");
                robot.log(Level::Warn, "skipped", text, now);
            }
            Note::Scanned(result) => {
                for half in result.halves() {
                    robot.log(Level::Info, "scan", format_args!("{half}"), now);
                }
                for half in result.recognised() {
                    robot.log(Level::Info, "scan", format_args!("{half}"), now);
                }
            }
        }
    }
}
