//! The emulated robot.
#![no_std]
#![no_main]

use chacha20::ChaCha20Rng;
use crawler_app::policy::SPREAD;
use crawler_app::{Config, Inline, NoEyes, Robot};
use crawler_board::arguments::{Arguments, Faults};
use crawler_board::model::{Bench, GEOMETRY, Line, LineFault, ModelEcho, Side, seed};
use crawler_board::network::Cable;
use crawler_board::{EmbassyClock, StackNetwork};
use crawler_hal::{Clock, MotorPort, RangerPort, ResetCause, SlotPort, System};
use crawler_protocol::Kind;
use crawler_stack::OnOwnStack;
use crawler_tls::{Authority, Buffers, Secured, Security};
use crawler_virt::ethernet::Ethernet;
use crawler_virt::flash::{ParameterFlash, Programs};
use crawler_virt::machine::{self, Description, ExitCode};
use crawler_virt::system::VirtSystem;
use crawler_virt::update::SharedUpdates;
use crawler_virt::{executor, log, provision, stack, system, time, update};
use embassy_executor::Spawner;
use embassy_net::{DhcpConfig, Runner, StackResources};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Ticker, Timer};
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg32;
use static_cell::{ConstStaticCell, StaticCell};

type Context = Robot<CriticalSectionRawMutex>;
type Body = Bench<CriticalSectionRawMutex>;
type Network = StackNetwork<'static, Cable>;

/// Bytes under way in each direction of the one connection.
const SOCKET_BUFFER: usize = 2_048;
/// Period of the report on the stack.
const REPORT_EVERY: Duration = Duration::from_secs(60);
/// Each task is spawned once.
const FIRST: &str = "the first of its kind";
/// Period of the model's steps.
const MODEL_EVERY: Duration = Duration::from_millis(10);

static ROBOT: StaticCell<Context> = StaticCell::new();
static BODY: StaticCell<Body> = StaticCell::new();
static RESOURCES: ConstStaticCell<StackResources<3>> = ConstStaticCell::new(StackResources::new());
static RECEIVE: ConstStaticCell<[u8; SOCKET_BUFFER]> = ConstStaticCell::new([0; SOCKET_BUFFER]);
/// Of the one connection, when it is encrypted.
static TLS: ConstStaticCell<Buffers> = ConstStaticCell::new(Buffers::new());
static TRANSMIT: ConstStaticCell<[u8; SOCKET_BUFFER]> = ConstStaticCell::new([0; SOCKET_BUFFER]);

#[riscv_rt::entry]
fn main(_hart: usize, tree: usize, started: usize) -> ! {
    stack::paint();
    log::init();
    time::init();
    system::init();
    update::guard(started);
    // SAFETY: what the firmware handed over; the tree lies above all our memory.
    let description = unsafe { Description::at(tree) }.unwrap_or_else(|error| {
        defmt::error!("the command line cannot be told: {}", error);
        machine::exit(ExitCode::Arguments)
    });
    let tasks = executor::prepare_tasks();
    launch(description, tasks.spawner());
    executor::run_tasks(tasks)
}

/// Spawns whatever the boot arguments ask for. What that takes of the stack is free again when
/// the tasks run.
#[inline(never)]
fn launch(description: Description, spawner: Spawner) {
    let mut arguments = read_arguments(description);
    if arguments.provision && !provision::adopt(&mut arguments) {
        set_up(&arguments, description, spawner);
    } else {
        start(&arguments, description, spawner);
    }
}

#[inline(never)]
fn read_arguments(description: Description) -> Arguments {
    let line = description.arguments().unwrap_or_else(|error| {
        defmt::error!("the command line cannot be told: {}", error);
        machine::exit(ExitCode::Arguments)
    });
    Arguments::parse(line).unwrap_or_else(|error| {
        defmt::error!("boot arguments: {}", defmt::Display2Format(&error));
        machine::exit(ExitCode::Arguments)
    })
}

#[inline(never)]
fn start(arguments: &Arguments, description: Description, spawner: Spawner) {
    let system = VirtSystem::new();
    let cause = system.reset_cause();
    defmt::info!(
        "robot {} of fleet {}, broker {}:{}{}, started by {}",
        arguments.id.as_str(),
        arguments.fleet.as_str(),
        arguments.broker_host.as_str(),
        arguments.broker_port,
        if arguments.authority.is_some() {
            " with TLS"
        } else {
            ""
        },
        defmt::Debug2Format(&cause),
    );
    if let Some(text) = system.last_panic() {
        defmt::warn!("the program before panicked at {}", text);
    }
    // Without the host's randomness robots still differ from each other and from boot to boot.
    let entropy = description
        .entropy()
        .unwrap_or_else(|| seed(arguments.id.as_str()) ^ time::raw_ticks());
    let mut rng = Pcg32::new(entropy, 0x7669_7274);
    let robot = make_context(arguments);
    let body = make_body(arguments);
    // Two activities want randomness; neither may depend on how much the other draws.
    let link_rng = Pcg32::new(rng.next_u64(), 0x6C69_6E6B);
    let noise_rng = Pcg32::new(rng.next_u64(), 1);
    let update_rng = Pcg32::new(rng.next_u64(), 0x7570_6474);
    let updates = update::updates();
    let (network, runner) = make_network(rng.next_u64());
    let policy_rng = Pcg32::new(rng.next_u64(), 0x706F_6C69);
    let secret = arguments
        .authority
        .map(|authority| (authority, secret_rng(description)));
    let flash = ParameterFlash::new(arguments.faults.flash_refuses);
    let noise = arguments.faults.flash_noise.then_some(noise_rng);

    spawner.spawn(model(body).expect(FIRST));
    spawner.spawn(sense(robot, body).expect(FIRST));
    spawner.spawn(power(robot, body).expect(FIRST));
    spawner.spawn(lamp(robot, body).expect(FIRST));
    spawner.spawn(store(robot, flash, noise).expect(FIRST));
    spawner.spawn(decide(robot, policy_rng).expect(FIRST));
    spawner.spawn(net(runner).expect(FIRST));
    spawner.spawn(link(robot, updates, network, link_rng, secret).expect(FIRST));
    if let Some(slots) = update::slots() {
        updates.expect_models();
        spawner.spawn(take_updates(robot, updates, slots, update_rng).expect(FIRST));
    }
    // On a bench somebody waits for it.
    let every = if arguments.bench {
        Duration::from_secs(10)
    } else {
        REPORT_EVERY
    };
    spawner.spawn(report(robot, body, every).expect(FIRST));
    // Of the first start alone, or of trials alone: after the reset that they lead to, the robot is to go on.
    let first = cause == ResetCause::PowerOn;
    let faults = Faults {
        panic_s: arguments.faults.panic_s.filter(|_| first),
        hang_s: arguments.faults.hang_s.filter(|_| first),
        trial_panic_s: arguments
            .faults
            .trial_panic_s
            .filter(|_| update::is_on_trial()),
        ..arguments.faults
    };
    spawner.spawn(strike(faults).expect(FIRST));
    let above = executor::start_control();
    above.spawn(control(robot, body, system, rng).expect(FIRST));
}

/// What keys are drawn from. Without the host's randomness somebody could guess them: then there is
/// no connection rather than one that only looks secret.
#[inline(never)]
fn secret_rng(description: Description) -> ChaCha20Rng {
    let mut seed = description.secret_entropy().unwrap_or_else(|| {
        defmt::error!("no randomness for keys: TLS needs 32 bytes of rng-seed");
        machine::exit(ExitCode::Arguments)
    });
    // The emulator draws anew at each reset. One that did not would repeat keys: never exactly, then.
    for (byte, tick) in seed.iter_mut().zip(time::raw_ticks().to_le_bytes()) {
        *byte ^= tick;
    }
    ChaCha20Rng::from_seed(seed)
}

/// Serves the page in place of the robot.
#[inline(never)]
fn set_up(arguments: &Arguments, description: Description, spawner: Spawner) {
    let entropy = description.entropy().unwrap_or_else(time::raw_ticks);
    provision::spawn(arguments, find_ethernet(), entropy, spawner).expect(FIRST);
}

#[inline(never)]
fn make_context(arguments: &Arguments) -> &'static Context {
    ROBOT.init_with(|| {
        let mut robot = Robot::new(Config {
            id: arguments.id.clone(),
            fleet: arguments.fleet.clone(),
            broker_host: arguments.broker_host.clone(),
            broker_port: arguments.broker_port,
            kind: Kind::Emulated,
            board: "virt",
            firmware: env!("CARGO_PKG_VERSION"),
            build: Some(update::build()),
            geometry: GEOMETRY,
            credentials: arguments.credentials.clone(),
            camera: false,
            eyes: None,
            faults: arguments.bench,
        });
        // The serial line tells what the broker is told, also while there is none.
        robot.set_echo(crawler_virt::log::echo);
        robot
    })
}

#[inline(never)]
fn make_body(arguments: &Arguments) -> &'static Body {
    let fault = match arguments.faults {
        Faults {
            line_stuck: true, ..
        } => LineFault::Stuck,
        Faults {
            ranger_dead: true, ..
        } => LineFault::Absent,
        _ => LineFault::None,
    };
    BODY.init_with(|| Bench::new(arguments.id.as_str(), fault))
}

#[inline(never)]
fn make_network(seed: u64) -> (Network, Runner<'static, Ethernet>) {
    let ethernet = find_ethernet();
    let config = embassy_net::Config::dhcpv4(DhcpConfig::default());
    let (stack, runner) = embassy_net::new(ethernet, config, RESOURCES.take(), seed);
    let network = StackNetwork::new(stack, Cable, RECEIVE.take(), TRANSMIT.take());
    (network, runner)
}

fn find_ethernet() -> Ethernet {
    Ethernet::find().unwrap_or_else(|error| {
        defmt::error!("network card: {}", error);
        machine::exit(ExitCode::NoNetworkCard)
    })
}

#[embassy_executor::task]
async fn control(
    robot: &'static Context,
    body: &'static Body,
    system: VirtSystem,
    rng: Pcg32,
) -> ! {
    let port = |side| MotorPort {
        enable: body.pwm(side),
        in1: body.pin(Line::In1(side)),
        in2: body.pin(Line::In2(side)),
    };
    let (left, right) = (port(Side::Left), port(Side::Right));
    let control = crawler_app::control(robot, left, right, system, rng, EmbassyClock);
    match OnOwnStack::new(control).await {}
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
    if let Err(error) = flash.probe().await {
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
async fn decide(robot: &'static Context, rng: Pcg32) -> ! {
    match crawler_app::decide_with_shelf(robot, SPREAD, &update::SHELF, rng).await {}
}

#[embassy_executor::task]
async fn net(mut runner: Runner<'static, Ethernet>) -> ! {
    runner.run().await
}

#[embassy_executor::task]
async fn take_updates(
    robot: &'static Context,
    updates: &'static SharedUpdates,
    slots: SlotPort<Programs>,
    rng: Pcg32,
) -> ! {
    let update = crawler_app::update_with_policies_held::<Inline, _, _, _, _, NoEyes, Inline, 1>;
    let models = (None, update::policies());
    match update(robot, updates, slots, models, rng, EmbassyClock).await {}
}

#[embassy_executor::task]
async fn link(
    robot: &'static Context,
    updates: &'static SharedUpdates,
    network: Network,
    rng: Pcg32,
    secret: Option<(Authority, ChaCha20Rng)>,
) -> ! {
    let security = secret.map(|(authority, rng)| Security {
        authority,
        rng,
        buffers: TLS.take(),
        clock: || robot.unix_ms(EmbassyClock.now()).map(|ms| ms / 1_000),
    });
    let network = Secured::new(network, security);
    updates.models_known().await;
    let link = crawler_app::link_with_updates_held::<Inline, _, _, _, _, _>(
        robot,
        updates,
        network,
        rng,
        EmbassyClock,
    );
    match link.await {}
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
async fn report(robot: &'static Context, body: &'static Body, every: Duration) -> ! {
    // The start is over by then, and its depth is known.
    Timer::after(Duration::from_secs(5)).await;
    loop {
        let truth = body.truth();
        let [x, y, theta] = truth.pose;
        defmt::debug!(
            "stack: {} bytes used at most, and {} by control on its own",
            stack::used(),
            crawler_stack::used(),
        );
        defmt::debug!(
            "body: boot {}, at {} {} {}, pack {} mV, lamp {}",
            robot.boot().count,
            x,
            y,
            theta,
            truth.pack_mv,
            truth.lamp,
        );
        Timer::after(every).await;
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
            trial_panic_s: Some(s),
            ..
        } => {
            Timer::after(Duration::from_secs(s.into())).await;
            panic!("as asked for by fault=trial-panic@{s}");
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
