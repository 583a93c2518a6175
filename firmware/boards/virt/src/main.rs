//! The emulated robot.
#![no_std]
#![no_main]

use crawler_app::{Config, Robot};
use crawler_board::arguments::{Arguments, Faults};
use crawler_board::model::{Bench, GEOMETRY, Line, LineFault, ModelEcho, Side, seed};
use crawler_board::network::Cable;
use crawler_board::{EmbassyClock, StackNetwork};
use crawler_hal::{MotorPort, RangerPort, ResetCause, System};
use crawler_protocol::Kind;
use crawler_virt::ethernet::Ethernet;
use crawler_virt::flash::ParameterFlash;
use crawler_virt::machine::{self, Description, ExitCode};
use crawler_virt::system::VirtSystem;
use crawler_virt::{executor, log, stack, system, time};
use embassy_net::{DhcpConfig, Runner, StackResources};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Ticker, Timer};
use rand_core::Rng;
use rand_pcg::Pcg32;
use static_cell::{ConstStaticCell, StaticCell};

type Context = Robot<CriticalSectionRawMutex>;
type Body = Bench<CriticalSectionRawMutex>;
type Port = MotorPort<
    crawler_board::model::ModelPwm<'static, CriticalSectionRawMutex>,
    crawler_board::model::ModelPin<'static, CriticalSectionRawMutex>,
>;
type Network = StackNetwork<'static, Cable>;

/// Bytes under way in each direction of the one connection.
const SOCKET_BUFFER: usize = 2_048;
/// Period of the report on the stack.
const REPORT_EVERY: Duration = Duration::from_secs(60);
/// Period of the model's steps.
const MODEL_EVERY: Duration = Duration::from_millis(10);

static ROBOT: StaticCell<Context> = StaticCell::new();
static BODY: StaticCell<Body> = StaticCell::new();
static RESOURCES: StaticCell<StackResources<3>> = StaticCell::new();
static RECEIVE: ConstStaticCell<[u8; SOCKET_BUFFER]> = ConstStaticCell::new([0; SOCKET_BUFFER]);
static TRANSMIT: ConstStaticCell<[u8; SOCKET_BUFFER]> = ConstStaticCell::new([0; SOCKET_BUFFER]);

#[riscv_rt::entry]
fn main(_hart: usize, tree: usize) -> ! {
    stack::paint();
    log::init();
    time::init();
    system::init();
    // SAFETY: what the firmware handed over; the tree lies above all our memory.
    let description = unsafe { Description::at(tree) };
    let line = description.and_then(|description| description.arguments());
    let line = line.unwrap_or_else(|error| {
        defmt::error!("the command line cannot be told: {}", error);
        machine::exit(ExitCode::Arguments)
    });
    let arguments = Arguments::parse(line).unwrap_or_else(|error| {
        defmt::error!("boot arguments: {}", defmt::Display2Format(&error));
        machine::exit(ExitCode::Arguments)
    });
    let system = VirtSystem::new();
    let cause = system.reset_cause();
    defmt::info!(
        "robot {} of fleet {}, broker {}:{}, started by {}",
        arguments.id.as_str(),
        arguments.fleet.as_str(),
        arguments.broker_host.as_str(),
        arguments.broker_port,
        defmt::Debug2Format(&cause),
    );
    if let Some(text) = system.last_panic() {
        defmt::warn!("the program before panicked at {}", text);
    }
    let ethernet = Ethernet::find().unwrap_or_else(|error| {
        defmt::error!("network card: {}", error);
        machine::exit(ExitCode::NoNetworkCard)
    });
    let entropy = description
        .ok()
        .and_then(|description| description.entropy());
    // Without the host's randomness robots still differ from each other and from boot to boot.
    let entropy = entropy.unwrap_or_else(|| seed(arguments.id.as_str()) ^ time::raw_ticks());
    start(&arguments, system, ethernet, entropy)
}

fn start(arguments: &Arguments, system: VirtSystem, ethernet: Ethernet, entropy: u64) -> ! {
    let faults = arguments.faults;
    let mut rng = Pcg32::new(entropy, 0x7669_7274);
    let robot: &'static Context = ROBOT.init(Robot::new(Config {
        id: arguments.id.clone(),
        fleet: arguments.fleet.clone(),
        broker_host: arguments.broker_host.clone(),
        broker_port: arguments.broker_port,
        kind: Kind::Emulated,
        board: "virt",
        firmware: env!("CARGO_PKG_VERSION"),
        geometry: GEOMETRY,
        credentials: arguments.credentials.clone(),
        camera: false,
    }));
    let line_fault = match faults {
        Faults {
            uart_stuck: true, ..
        } => LineFault::Stuck,
        Faults {
            ranger_absent: true,
            ..
        } => LineFault::Absent,
        _ => LineFault::None,
    };
    let body: &'static Body = BODY.init(Bench::new(arguments.id.as_str(), line_fault));
    let config = embassy_net::Config::dhcpv4(DhcpConfig::default());
    let resources = RESOURCES.init(StackResources::new());
    let (stack, runner) = embassy_net::new(ethernet, config, resources, rng.next_u64());
    let network = StackNetwork::new(stack, Cable, RECEIVE.take(), TRANSMIT.take());
    // Two activities want randomness; neither may depend on how much the other draws.
    let link_rng = Pcg32::new(rng.next_u64(), 0x6C69_6E6B);
    // SAFETY: the only one.
    let flash = unsafe { ParameterFlash::new(faults.flash_refuses) };
    let noise = faults.flash_noise.then(|| Pcg32::new(rng.next_u64(), 1));
    let after_power_on = system.reset_cause() == ResetCause::PowerOn;
    let port = |side| MotorPort {
        enable: body.pwm(side),
        in1: body.pin(Line::In1(side)),
        in2: body.pin(Line::In2(side)),
    };

    let above = executor::start_control();
    let (left, right) = (port(Side::Left), port(Side::Right));
    above.spawn(control(robot, left, right, system, rng).expect("the first"));
    executor::run_tasks(|spawner| {
        spawner.spawn(model(body).expect("the first"));
        spawner.spawn(sense(robot, body).expect("the first"));
        spawner.spawn(power(robot, body).expect("the first"));
        spawner.spawn(lamp(robot, body).expect("the first"));
        spawner.spawn(store(robot, flash, noise).expect("the first"));
        spawner.spawn(net(runner).expect("the first"));
        spawner.spawn(link(robot, network, link_rng).expect("the first"));
        spawner.spawn(report(robot, body).expect("the first"));
        // A fault of the first start alone: after the reset it leads to, the robot is to go on.
        if after_power_on {
            spawner.spawn(strike(faults).expect("the first"));
        }
    })
}

#[embassy_executor::task]
async fn control(
    robot: &'static Context,
    left: Port,
    right: Port,
    system: VirtSystem,
    rng: Pcg32,
) -> ! {
    match crawler_app::control(robot, left, right, system, rng, EmbassyClock).await {}
}

#[embassy_executor::task]
async fn sense(robot: &'static Context, body: &'static Body) -> ! {
    let uart = body.uart(EmbassyClock);
    let port: RangerPort<_, ModelEcho, ModelEcho> = RangerPort::Uart(uart);
    match crawler_app::sense(robot, port, EmbassyClock).await {}
}

#[embassy_executor::task]
async fn power(robot: &'static Context, body: &'static Body) -> ! {
    match crawler_app::power(robot, body.gauge(), EmbassyClock).await {}
}

#[embassy_executor::task]
async fn lamp(robot: &'static Context, body: &'static Body) -> ! {
    match crawler_app::lamp(robot, body.pin(Line::Lamp), EmbassyClock).await {}
}

#[embassy_executor::task]
async fn store(robot: &'static Context, mut flash: ParameterFlash, noise: Option<Pcg32>) -> ! {
    if let Err(error) = flash.probe() {
        // The program finds out by itself, and goes on without.
        defmt::error!("flash: {}", defmt::Display2Format(&error));
    }
    if let Some(mut rng) = noise {
        match flash.scribble(&mut rng).await {
            Ok(()) => defmt::warn!("flash: filled with noise, as asked for"),
            Err(error) => defmt::error!("flash: no noise, {}", defmt::Display2Format(&error)),
        }
    }
    match crawler_app::store(robot, flash, EmbassyClock).await {}
}

#[embassy_executor::task]
async fn net(mut runner: Runner<'static, Ethernet>) -> ! {
    runner.run().await
}

#[embassy_executor::task]
async fn link(robot: &'static Context, network: Network, rng: Pcg32) -> ! {
    match crawler_app::link(robot, network, rng, EmbassyClock).await {}
}

/// Lets time pass for the body.
#[embassy_executor::task]
async fn model(body: &'static Body) -> ! {
    let mut ticker = Ticker::every(MODEL_EVERY);
    loop {
        ticker.next().await;
        let now = embassy_time::Instant::now().as_ticks();
        body.advance(crawler_hal::Instant::from_micros(now));
    }
}

/// Tells what no sensor tells, for whoever reads the log.
#[embassy_executor::task]
async fn report(robot: &'static Context, body: &'static Body) -> ! {
    // The start is over by then, and its depth is known.
    Timer::after(Duration::from_secs(5)).await;
    loop {
        let truth = body.truth();
        let [x, y, theta] = truth.pose;
        defmt::debug!("stack: {} bytes used at most", stack::used());
        defmt::debug!(
            "body: boot {}, at {} {} {}, pack {} mV, lamp {}",
            robot.boot().count,
            x,
            y,
            theta,
            truth.pack_mv,
            truth.lamp,
        );
        Timer::after(REPORT_EVERY).await;
    }
}

/// Provokes what a test asked for.
#[embassy_executor::task]
async fn strike(faults: Faults) {
    match faults {
        Faults {
            panic_s: Some(s), ..
        } => {
            Timer::after(Duration::from_secs(s.into())).await;
            panic!("as asked for by fault=panic@{s}");
        }
        Faults {
            hang_s: Some(s), ..
        } => {
            Timer::after(Duration::from_secs(s.into())).await;
            defmt::warn!("hanging from now on, as asked for");
            executor::hang_control();
        }
        _ => {}
    }
}
