//! One robot's program in its body.

use std::rc::Rc;

use crawler_app::{Config, ImageSlot, Robot};
use crawler_hal::Network;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use rand_core::Rng;
use rand_pcg::Pcg32;

use crate::devices::{BodyParts, SimCamera};
use crate::sched::{Scheduler, SimClock, TaskId};

/// The shared context of a simulated robot: everything runs on one thread.
pub type SimRobot = Robot<NoopRawMutex>;

/// Bytes for a still: several times what one of 320 × 240 grey pixels takes, and as much as a
/// board gives it.
const IMAGE_BUFFER: usize = 16 * 1024;

/// A running program. Its tasks are numbered like the activities below.
#[derive(Debug)]
pub(super) struct Program {
    /// Time since this boot.
    pub(super) clock: SimClock,
    tasks: Vec<TaskId>,
}

/// Runs the activities of `robot` on `parts`, as a board does at boot.
pub(super) fn start<N: Network + 'static>(
    sched: &mut Scheduler,
    robot: &Rc<SimRobot>,
    parts: BodyParts,
    network: N,
) -> Program {
    let BodyParts {
        clock,
        left,
        right,
        ranger,
        lamp,
        battery,
        camera,
        flash,
        system,
        mut rng,
    } = parts;
    // Two activities want randomness; neither may depend on how much the other draws.
    let link_rng = Pcg32::new(rng.next_u64(), 0x6C69_6E6B);
    let mut tasks = vec![
            sched.spawn({
                let (robot, clock) = (Rc::clone(robot), clock.clone());
                async move {
                    match crawler_app::control(&robot, left, right, system, rng, clock).await {}
                }
            }),
            sched.spawn({
                let (robot, clock) = (Rc::clone(robot), clock.clone());
                async move { match crawler_app::sense(&robot, ranger, clock).await {} }
            }),
            sched.spawn({
                let (robot, clock) = (Rc::clone(robot), clock.clone());
                async move { match crawler_app::power(&robot, battery, clock).await {} }
            }),
            sched.spawn({
                let (robot, clock) = (Rc::clone(robot), clock.clone());
                async move { match crawler_app::lamp(&robot, lamp, clock).await {} }
            }),
            sched.spawn({
                let (robot, clock) = (Rc::clone(robot), clock.clone());
                async move { match crawler_app::store(&robot, flash, clock).await {} }
            }),
        ];
    if robot.config().camera {
        let pair = start_camera(sched, robot, camera, network, link_rng, &clock);
        tasks.extend(pair);
    } else {
        tasks.push(sched.spawn({
            let (robot, clock) = (Rc::clone(robot), clock.clone());
            async move { match crawler_app::link(&robot, network, link_rng, clock).await {} }
        }));
    }
    Program { clock, tasks }
}

/// Runs the link and the camera activity, which share a buffer.
fn start_camera<N: Network + 'static>(
    sched: &mut Scheduler,
    robot: &Rc<SimRobot>,
    camera: SimCamera,
    network: N,
    rng: Pcg32,
    clock: &SimClock,
) -> [TaskId; 2] {
    let buffer = vec![0; IMAGE_BUFFER].into_boxed_slice();
    let images: Rc<ImageSlot<NoopRawMutex, Box<[u8]>>> = Rc::new(ImageSlot::new(buffer));
    let link = sched.spawn({
        let (robot, images, clock) = (Rc::clone(robot), Rc::clone(&images), clock.clone());
        async move {
            let link = crawler_app::link_with_images(&robot, &images, network, rng, clock);
            match link.await {}
        }
    });
    let camera = sched.spawn({
        let (robot, clock) = (Rc::clone(robot), clock.clone());
        async move { match crawler_app::camera(&robot, camera, &images, clock).await {} }
    });
    [link, camera]
}

impl Program {
    /// Drops the program where it stands, as a reset or a power cut does.
    pub(super) fn stop(self, sched: &mut Scheduler) {
        for task in self.tasks {
            sched.remove(task);
        }
    }
}

/// A context as it is before boot.
pub(super) fn context(config: &Config) -> Rc<SimRobot> {
    Rc::new(Robot::new(config.clone()))
}
