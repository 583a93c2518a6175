//! One robot's program in its body.

mod defects;
#[cfg(feature = "recording")]
mod either;

use std::pin::Pin;
use std::rc::Rc;

use crawler_app::policy::{SPREAD, Shelf};
use crawler_app::{Blank, Config, Geometry, Hold, ImageSlot, PolicyHost, Robot, Room, Updates};
use crawler_hal::{Body, Clock as _, Duration, Parts};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use rand_core::Rng;
use rand_pcg::Pcg32;

#[cfg(feature = "recording")]
use super::event_log::{EventLog, What, tap};
use super::eyes::{DetectorInstance, SimEyes};
#[cfg(feature = "recording")]
use super::journal::Payload;
use crate::devices::{BodyParts, POLICIES};
use crate::net::network::SimNetwork;
use crate::scenario::Trained;
use crate::sched::{Scheduler, SimClock, TaskId};
use crate::world::Chassis;

#[cfg(feature = "recording")]
pub(crate) use either::{Either, EitherBody};

pub(crate) use defects::Extras;
use defects::{Faulty, Launcher};

/// The shared context of a simulated robot: everything runs on one thread.
pub type SimRobot = Robot<NoopRawMutex>;

/// What its link and its updates share, which may bring a model for its detector, and a policy.
pub(crate) type SimUpdates = Updates<NoopRawMutex, 2>;

/// Control steps a robot takes in a second.
pub(crate) const CONTROL_HZ: u64 = 50;

/// Bytes for a still: several times what one of 320 × 240 grey pixels takes, and as much as a
/// board gives it.
const IMAGE_BUFFER: usize = 16 * 1024;

/// Keeps rare steps of activities on the heap while they are taken: ten thousand robots seldom
/// take them at the same time.
enum Heap {}

/// A value that is on the heap while it is needed.
struct HeapRoom<T>(Option<Box<T>>);

impl<T: Blank> Room<T> for HeapRoom<T> {
    const EMPTY: Self = Self(None);

    fn get(&self) -> Option<&T> {
        self.0.as_deref()
    }

    fn enter(&mut self) -> &mut T {
        self.0.get_or_insert_with(|| Box::new(T::BLANK))
    }

    fn leave(&mut self) {
        self.0 = None;
    }
}

impl Hold for Heap {
    type Held<F: Future> = Pin<Box<F>>;
    type Room<T: Blank> = HeapRoom<T>;

    fn hold<F: Future>(step: F) -> Pin<Box<F>> {
        Box::pin(step)
    }
}

/// Voltage for which odometry is calibrated: a 2S pack in the middle of its charge.
const NOMINAL_V: f32 = 7.4;

/// What programs are told of the shape of their drive.
pub(crate) fn geometry(chassis: &Chassis) -> Geometry {
    Geometry {
        wheel_base_m: chassis.track_m,
        top_speed_mps: chassis.speed_at(NOMINAL_V),
        time_constant_s: chassis.time_constant(),
        // What a turning wheel settles by. A standing one starts a little later; that is over
        // within a step or two of the ramp.
        stiction_duty: chassis.dead_band(NOMINAL_V),
        nominal_v: NOMINAL_V,
        bridge_drop_v: chassis.bridge_drop_v,
    }
}

/// A running program. Its tasks are numbered like the activities below.
#[derive(Debug)]
pub(crate) struct Program {
    /// Time since this boot.
    pub(crate) clock: SimClock,
    tasks: Vec<TaskId>,
    #[cfg(feature = "recording")]
    event_log: Option<Rc<EventLog>>,
}

/// Runs the activities of `robot` on `parts`, as a board does at boot; `policy` in place of the one that comes with it.
pub(crate) fn start(
    sched: &mut Scheduler,
    robot: &Rc<SimRobot>,
    parts: BodyParts,
    network: SimNetwork,
    detector: Option<&Rc<DetectorInstance>>,
    (updates, policy): (Option<Rc<SimUpdates>>, Option<Trained>),
    #[cfg(feature = "recording")] event_log: Option<Rc<EventLog>>,
) -> Program {
    let ranger_after = parts.ranger_after;
    let faulty = Faulty::of(&parts.started, parts.system.resetter());
    let parts = parts.with_network(network);
    let extras = Extras {
        faulty: faulty.as_ref(),
        updates,
        policy,
    };
    #[cfg(feature = "recording")]
    {
        let parts = tap::tap(parts, event_log.as_ref());
        let mut program = launch(sched, robot, parts, ranger_after, detector, extras);
        program.event_log = event_log;
        program
    }
    #[cfg(not(feature = "recording"))]
    launch(sched, robot, parts, ranger_after, detector, extras)
}

/// What a program runs on. There is one type of it, whatever the devices and the network are: the
/// program is compiled once for each.
#[cfg(feature = "recording")]
type ProgramBody = EitherBody;
#[cfg(not(feature = "recording"))]
type ProgramBody = crate::devices::SimBody<SimNetwork>;

/// Runs the activities of `robot` on a body in virtual time, the one of the ranger `ranger_after`
/// the others.
pub(crate) fn launch(
    sched: &mut Scheduler,
    robot: &Rc<SimRobot>,
    parts: Parts<ProgramBody>,
    ranger_after: Duration,
    detector: Option<&Rc<DetectorInstance>>,
    extras: Extras<'_>,
) -> Program {
    let Parts {
        clock,
        left,
        right,
        ranger,
        lamp,
        battery,
        camera,
        flash,
        slots,
        network,
        system,
        mut rng,
    } = parts;
    // Two activities want randomness; neither may depend on how much the other draws.
    let link_rng = Pcg32::new(rng.next_u64(), 0x6C69_6E6B);
    // Nothing is drawn for it from what the others share: robots that drive by no policy do as they always did.
    let policy_rng = Pcg32::new(link_rng.clone().next_u64(), 0x706F_6C69);
    // Each is given what it needs and nothing around it: a task that awaited it would keep it all a
    // second time.
    let (own, now) = (|| Rc::clone(robot), || clock.clone());
    let Extras {
        faulty,
        updates,
        policy,
    } = extras;
    // Without updates nothing is drawn for them.
    let updates = updates.zip(slots).map(|(updates, slots)| {
        let rng = Pcg32::new(rng.next_u64(), 0x7570_6461);
        (updates, slots, rng)
    });
    let mut launcher = Launcher {
        sched,
        faulty,
        updates: updates.as_ref().map(|(updates, ..)| Rc::clone(updates)),
    };
    let mut tasks = vec![
            launcher.control(crawler_app::control(own(), left, right, system, rng, now())),
            launcher.other({
                let (robot, clock) = (own(), now());
                async move {
                    clock.sleep(ranger_after).await;
                    match crawler_app::sense_held::<Heap, _, _, _, _, _>(&*robot, ranger, clock)
                        .await {}
                }
            }),
            launcher.other(crawler_app::power(own(), battery, now())),
            launcher.other(crawler_app::lamp(own(), lamp, now())),
            launcher.other(crawler_app::store_held::<Heap, _, _, _>(
                own(),
                flash,
                now(),
            )),
        ];
    tasks.reserve_exact(2 + usize::from(updates.is_some()));
    if let Some(updates) = &launcher.updates {
        updates.expect_models();
    }
    let mut model = None;
    if robot.config().camera {
        let pair = {
            let eyes = detector.map(|detector| SimEyes::new(detector, &clock));
            model = eyes.as_ref().and_then(SimEyes::model);
            start_camera(
                &mut launcher,
                robot,
                camera,
                eyes,
                network,
                link_rng,
                &clock,
            )
        };
        tasks.extend(pair);
    } else {
        let clock = now();
        tasks.push(match launcher.updates.clone() {
            None => {
                let link = crawler_app::link_held::<Heap, _, _, _, _>;
                launcher.other(link(own(), network, link_rng, clock))
            }
            Some(updates) => {
                let robot = own();
                launcher.other(async move {
                    updates.models_known().await;
                    let link = crawler_app::link_with_updates_held::<Heap, _, _, _, _, _>;
                    match link(robot, updates, network, link_rng, clock).await {}
                })
            }
        });
    }
    let shelf: Rc<Shelf<NoopRawMutex, Heap>> = Rc::new(Shelf::new());
    if let Some((updates, slots, rng)) = updates {
        let policies = PolicyHost::new(Rc::clone(&shelf), Some(POLICIES));
        let update = crawler_app::update_with_policies_held::<Heap, _, _, _, _, _, _, 2>;
        tasks.push(launcher.other(update(own(), updates, slots, (model, policies), rng, now())));
    }
    tasks.push(launcher.other({
        let robot = own();
        async move {
            let policy = policy.as_ref().map_or(SPREAD, Trained::named);
            match crawler_app::decide_with_shelf(robot, policy, shelf, policy_rng).await {}
        }
    }));
    if let Some(faulty) = faulty {
        tasks.extend(faulty.spawn(sched, robot, &clock));
    }
    Program {
        clock,
        tasks,
        #[cfg(feature = "recording")]
        event_log: None,
    }
}

/// Runs the link and the camera activity, which share a buffer.
fn start_camera(
    launcher: &mut Launcher<'_>,
    robot: &Rc<SimRobot>,
    camera: <ProgramBody as Body>::Camera,
    eyes: Option<SimEyes>,
    network: <ProgramBody as Body>::Network,
    rng: Pcg32,
    clock: &SimClock,
) -> [TaskId; 2] {
    let buffer = vec![0; IMAGE_BUFFER].into_boxed_slice();
    let images: Rc<ImageSlot<NoopRawMutex, Box<[u8]>>> = Rc::new(ImageSlot::new(buffer));
    let (own, pictures, time) = (Rc::clone(robot), Rc::clone(&images), clock.clone());
    let link = match launcher.updates.clone() {
        None => launcher.other(async move {
            let link = crawler_app::link_with_images_held::<Heap, _, _, _, _, _>(
                &*own, &pictures, network, rng, time,
            );
            match link.await {}
        }),
        Some(updates) => launcher.other(async move {
            updates.models_known().await;
            let link = crawler_app::link_with_images_and_updates_held::<Heap, _, _, _, _, _, _>(
                &*own, &pictures, updates, network, rng, time,
            );
            match link.await {}
        }),
    };
    let camera = launcher.other({
        let (robot, clock) = (Rc::clone(robot), clock.clone());
        async move {
            let looking = crawler_app::camera_with_eyes(&robot, camera, &images, eyes, clock);
            match looking.await {}
        }
    });
    [link, camera]
}

impl Program {
    /// Hands the program a command that comes past the network.
    pub(crate) fn tell(&self, robot: &SimRobot, payload: &[u8]) {
        #[cfg(feature = "recording")]
        if let Some(event_log) = &self.event_log {
            event_log.note(What::Told(Payload::new(payload)));
        }
        robot.submit(payload, self.clock.now());
    }

    /// Puts the program's idea of the time off.
    pub(crate) fn step_clock(&self, robot: &SimRobot, ms: i64) {
        #[cfg(feature = "recording")]
        if let Some(event_log) = &self.event_log {
            event_log.note(What::ClockStep(ms));
        }
        robot.step_clock(ms);
    }

    /// Tells the program the time past the network.
    pub(crate) fn tell_time(&self, robot: &SimRobot, unix_ms: u64) {
        #[cfg(feature = "recording")]
        if let Some(event_log) = &self.event_log {
            event_log.note(What::Time(unix_ms));
        }
        robot.observe_time(unix_ms, self.clock.now());
    }

    /// Drops the program where it stands, as a reset or a power cut does.
    pub(crate) fn stop(self, sched: &mut Scheduler) {
        #[cfg(feature = "recording")]
        if let Some(event_log) = &self.event_log {
            event_log.end();
        }
        for task in self.tasks {
            sched.remove(task);
        }
    }
}

/// A context as it is before boot.
pub(crate) fn context(config: Config) -> Rc<SimRobot> {
    Rc::new(Robot::new(config))
}
