//! The robot program and its link, complete, with nothing of a board: every port ends in a function
//! that is left out of the link. It is never run; `cargo xtask size` weighs it.
//!
//! Flash: all code and constants of the program, with what it takes of `core`. RAM: the shared
//! context, and the state of all activities. Not in it: stack, drivers of a chip, network stack.
#![no_std]
#![no_main]

mod seam;

use core::future::Future;
use core::mem::MaybeUninit;
use core::pin::Pin;
use core::task::{Context, Waker};

use crawler_app::policy::SPREAD;
use crawler_app::{Config, Inline, Robot, UpdateIdentity, Updates};
use crawler_hal::{MotorPort, RangerPort, SlotPort, SlotRegion};
use crawler_protocol::{BuildId, Fleet, Kind, RobotId};
use crawler_release::{PublicKey, PublicKeys};
use embassy_futures::join::{join4, join5};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use seam::Port;

/// The context as boards keep it: shared with interrupts.
type Shared = Robot<CriticalSectionRawMutex>;
/// What link and update share.
type SharedUpdates = Updates<CriticalSectionRawMutex>;

/// Room for one value, at rest in RAM as on a board.
#[repr(align(16))]
struct Room<const SIZE: usize>(MaybeUninit<[u8; SIZE]>);

static mut ROBOT: MaybeUninit<Shared> = MaybeUninit::uninit();
static mut UPDATES: MaybeUninit<SharedUpdates> = MaybeUninit::uninit();
static mut PROGRAM: Room<{ size_of_result(program) }> = Room(MaybeUninit::uninit());

/// Bytes of what `_make` returns, which has no name.
const fn size_of_result<F>(_make: fn(&'static Shared, &'static SharedUpdates) -> F) -> usize {
    size_of::<F>()
}

/// All activities, with every port and both wirings of the ranger.
async fn program(robot: &'static Shared, updates: &'static SharedUpdates) {
    let motor = |first| MotorPort {
        enable: Port(first),
        in1: Port(first + 1),
        in2: Port(first + 2),
    };
    let ranger = if seam::footprint_level(9) {
        RangerPort::Uart(Port(10))
    } else {
        RangerPort::Pulse {
            trigger: Port(11),
            echo: Port(12),
        }
    };
    let body = join5(
        crawler_app::control(robot, motor(0), motor(3), Port(6), Port(7), Port(8)),
        crawler_app::sense(robot, ranger, Port(8)),
        crawler_app::power(robot, Port(13), Port(8)),
        crawler_app::lamp(robot, Port(14), Port(8)),
        crawler_app::store(robot, Port(15), Port(8)),
    );
    let decide = crawler_app::decide(robot, SPREAD, Port(7));
    let slot = |start| SlotRegion {
        start,
        length: 0x10_0000,
    };
    let slots = SlotPort {
        flash: Port(18),
        otadata: 0xd000,
        slots: [slot(0x1_0000), slot(0x11_0000)],
        running: u8::from(seam::footprint_level(19)),
        chip: 5,
    };
    let update = crawler_app::update(robot, updates, slots, Port(7), Port(8));
    let link = crawler_app::link_with_updates_held::<Inline, _, _, _, _, _>(
        robot,
        updates,
        Port(16),
        Port(7),
        Port(8),
    );
    join4(body, link, update, decide).await;
}

/// Where the link begins to look for what is used.
#[unsafe(no_mangle)]
extern "C" fn start() -> ! {
    let config = Config {
        id: RobotId::new(seam::footprint_text(0)).unwrap_or_else(|_| seam::footprint_end()),
        fleet: Fleet::new(seam::footprint_text(1)).unwrap_or_else(|_| seam::footprint_end()),
        broker_host: seam::footprint_text(2)
            .try_into()
            .unwrap_or_else(|_| seam::footprint_end()),
        broker_port: 1883,
        kind: Kind::Physical,
        board: "footprint",
        firmware: env!("CARGO_PKG_VERSION"),
        build: None,
        geometry: seam::geometry(),
        credentials: None,
        camera: false,
        eyes: None,
        faults: false,
    };
    let place = (&raw mut ROBOT).cast::<Shared>();
    // SAFETY: written once, here, before anything refers to it, and never again.
    let robot: &'static Shared = unsafe {
        place.write(Robot::new(config));
        &*place
    };
    let key = |number| {
        let point = seam::footprint_text(number).as_bytes();
        PublicKey::from_sec1(point).unwrap_or_else(|_| seam::footprint_end())
    };
    let identity = UpdateIdentity {
        build: BuildId::new(seam::footprint_text(3)).unwrap_or_else(|_| seam::footprint_end()),
        keys: Some(PublicKeys {
            current: key(4),
            next: Some(key(5)),
        }),
    };
    let place = (&raw mut UPDATES).cast::<SharedUpdates>();
    // SAFETY: written once, here, before anything refers to it, and never again.
    let updates: &'static SharedUpdates = unsafe {
        place.write(Updates::new(identity));
        &*place
    };
    run(program(robot, updates))
}

/// Polls for ever, as an executor would.
fn run<F: Future + 'static>(future: F) -> ! {
    let place = (&raw mut PROGRAM).cast::<F>();
    // SAFETY: the room has the size of this future and more than its alignment; nothing else
    // refers to it, and what lies in it never moves.
    let mut future = unsafe {
        place.write(future);
        Pin::new_unchecked(&mut *place)
    };
    let mut context = Context::from_waker(Waker::noop());
    loop {
        let _ = future.as_mut().poll(&mut context);
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    seam::footprint_end()
}
