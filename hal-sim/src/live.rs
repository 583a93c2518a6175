//! A world in real time, on a thread of its own, whose robots talk to a real broker.
//!
//! Virtual time follows real time. When the machine is too slow for the fleet, the world does not
//! try to catch up for ever: what lies further behind than [`MAX_BATCH`] is given up, virtual
//! time falls behind, and [`LiveMetrics::real_time_factor`] says how fast it runs.

mod bookmarks;
mod control;
mod driver;
mod error;
mod log;
mod obey;
mod pacer;
mod radio;
mod scene;

use std::net::{SocketAddr, ToSocketAddrs};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration as StdDuration;

use crawler_app::Credentials;
use crawler_hal::{Duration, Instant};
use crawler_protocol::Fleet;
use crawler_release::PublicKeys;
use crawler_sim_protocol::SimulatorCommand;
use tokio::sync::{Notify, mpsc, oneshot, watch};

use crate::net::live::Gateway;
use crate::net::proxy::Proxy;
use crate::run::SimulationError;
use crate::run::simulation::{BrokerAddress, Simulation, Way};
use crate::scenario::Scenario;
use crate::sched::SimClock;
use crate::world::Arena;
use pacer::Pacer;

pub use bookmarks::{Bookmark, MAX_BOOKMARKS};
pub use control::{ControlError, LiveDone, LiveState};
pub use crawler_tls::Authority;
pub use error::LiveError;
pub use scene::LiveScene;

use bookmarks::Bookmarks;
use control::{MAX_ORDERS, Order, Watch};
use driver::{Beginning, Driver};
use log::{Log, RecordTo};

/// Most virtual time that is run at once, and most that is made up for.
pub const MAX_BATCH: Duration = Duration::from_millis(100);
/// Least real time from one turn of the world to the next. A control period has ten of them.
const TURN: StdDuration = StdDuration::from_millis(2);
/// Longest rest: physics goes on when no program does anything.
const LONGEST_REST: StdDuration = StdDuration::from_millis(50);
/// Descriptors that everything but the robots may need.
const SPARE_DESCRIPTORS: u64 = 256;
/// How often the radio is told where robots are.
const PLACE_PERIOD: Duration = Duration::from_millis(100);
/// For the last words of robots to reach the broker over a radio.
const LAST_WORDS: StdDuration = StdDuration::from_millis(500);
/// Slower than this counts as standing, metres per second.
const STANDING: f32 = 0.005;
/// What a world takes to end beyond the time its robots are given.
const STOP_GRACE: StdDuration = StdDuration::from_secs(2);

/// What a live world is made of.
#[derive(Debug, Clone)]
pub struct LiveConfig {
    /// Fleet all robots belong to.
    pub fleet: Fleet,
    /// Host name or address of the broker, at most 64 bytes. Resolved once, at the start.
    pub broker_host: String,
    /// TCP port of the broker.
    pub broker_port: u16,
    /// Who has signed the broker's certificate: robots speak TLS to it with the program's own client.
    pub authority: Option<Authority>,
    /// What the broker asks for; see [`credentials`](crate::run::credentials).
    pub credentials: Option<Credentials>,
    /// By which keys robots believe releases; without one they take no updates. Robots of a world that is
    /// recorded take none in any case.
    pub release_keys: Option<PublicKeys>,
    /// Scenario; its number of robots counts.
    pub scenario: Scenario,
    /// Seed of everything that is left to chance.
    pub seed: u64,
    /// Where others than the simulated robots can join the radio; see
    /// [`proxy`](crate::net::proxy). A scenario with `[radio]` or `[link]` has one without it.
    pub radio_proxy: Option<SocketAddr>,
    /// Files that a connection takes at its other ends in this process: 1 where the broker is in it, 2 where something in it carries the
    /// connection on, else 0.
    pub other_ends: u64,
}

impl LiveConfig {
    /// Files that a robot takes in this process.
    fn files_each(&self) -> u64 {
        // A radio has both ends of its own.
        let radio = if radio::is_wanted(self) { 2 } else { 0 };
        1 + self.other_ends + radio
    }
}

/// Has the system allow as many files as so many robots and everything else take.
fn make_room(each: u64, robots: u32) -> Result<(), LiveError> {
    let need = each * u64::from(robots) + SPARE_DESCRIPTORS;
    let have = rlimit::increase_nofile_limit(2 * need).map_err(LiveError::Runtime)?;
    if have < need {
        return Err(LiveError::Descriptors(have, need));
    }
    Ok(())
}

/// How a live world is doing. Rates are of the last second.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct LiveMetrics {
    /// Whether the world is running.
    pub running: bool,
    /// Virtual time passed for each second of real time; 1 when the machine keeps up.
    pub real_time_factor: f64,
    /// Longest that anything ran after it was due in the last second, seconds.
    pub lateness_s: f64,
    /// Virtual time given up so far, seconds.
    pub lost_s: f64,
    /// Physics steps so far.
    pub steps: u64,
    /// Robots in the world.
    pub robots: u32,
    /// Robots with an open connection on which the broker has answered.
    pub connected: u32,
}

/// How a live world ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct LiveReport {
    /// Robots in the world.
    pub robots: u32,
    /// Robots that stood still when they left.
    pub standing: u32,
    /// Robots that were connected when they left, and said goodbye.
    pub connected: u32,
}

#[derive(Debug, Default)]
struct Board {
    running: AtomicBool,
    factor_ppm: AtomicU64,
    lateness_us: AtomicU64,
    lost_us: AtomicU64,
    steps: AtomicU64,
    robots: AtomicU32,
    connected: AtomicU32,
    stop: AtomicBool,
    /// How long robots have to come to rest, in milliseconds.
    patience_ms: AtomicU64,
    wake: Notify,
    state: Mutex<Option<LiveState>>,
    /// Why the recording ended early.
    recording: Mutex<Option<String>>,
}

impl Board {
    fn set_state(&self, state: LiveState) {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner) = Some(state);
    }
}

/// A running live world. Dropping it asks the world to stop and does not wait for it.
#[derive(Debug)]
pub struct LiveHandle {
    board: Arc<Board>,
    orders: mpsc::Sender<Order>,
    scene: watch::Receiver<LiveScene>,
    radio: Option<Arc<Proxy>>,
    ending: Mutex<Ending>,
}

/// How the world ends, or ended.
#[derive(Debug)]
struct Ending {
    from: Receiver<LiveReport>,
    report: Option<LiveReport>,
}

/// Starts a world in a thread of its own and returns when its robots are in place.
///
/// # Errors
/// See [`LiveError`]. Robots keep trying to reach a broker that is not there: that is no error.
pub fn start(config: LiveConfig) -> Result<LiveHandle, LiveError> {
    start_with(config, None)
}

/// Like [`start`], and records the world to an MCAP file until it ends or begins again. A file that
/// takes no more ends the recording and not the world: see [`LiveHandle::recording_error`].
///
/// # Errors
/// See [`LiveError`]; also when the file cannot be written at all.
#[cfg(feature = "recording")]
pub fn start_recorded(config: LiveConfig, to: RecordTo) -> Result<LiveHandle, LiveError> {
    start_with(config, Some(to))
}

fn start_with(config: LiveConfig, record: Option<RecordTo>) -> Result<LiveHandle, LiveError> {
    let host = heapless::String::<64>::try_from(config.broker_host.as_str())
        .map_err(|_| LiveError::Host(config.broker_host.clone(), None))?;
    let broker: Vec<_> = (config.broker_host.as_str(), config.broker_port)
        .to_socket_addrs()
        .map_err(|error| LiveError::Host(config.broker_host.clone(), Some(error)))?
        .collect();
    make_room(config.files_each(), config.scenario.robots)?;
    let radio = radio::start(&config, &broker)?;
    let board = Arc::new(Board::default());
    board.factor_ppm.store(1_000_000, Ordering::Relaxed);
    let (ready_to, ready) = sync_channel(1);
    let (report_to, report) = sync_channel(1);
    let (orders, orders_from) = mpsc::channel(MAX_ORDERS);
    std::thread::Builder::new()
        .name("world".into())
        .spawn({
            let board = Arc::clone(&board);
            let brokers = (broker, radio.clone());
            move || {
                let address = BrokerAddress {
                    host,
                    port: config.broker_port,
                    credentials: config.credentials.clone(),
                    release_keys: config.release_keys,
                    #[cfg(feature = "recording")]
                    event_logs: None,
                };
                let tell = (&ready_to, &report_to);
                let what = (orders_from, record);
                run(config, address, brokers, &board, what, tell);
            }
        })
        .map_err(LiveError::Runtime)?;
    let scene = ready.recv().map_err(|_| LiveError::Crashed)??;
    Ok(LiveHandle {
        board,
        orders,
        scene,
        radio,
        ending: Mutex::new(Ending {
            from: report,
            report: None,
        }),
    })
}

impl LiveHandle {
    /// How the world is doing.
    #[must_use]
    pub fn metrics(&self) -> LiveMetrics {
        let board = &self.board;
        let seconds = |cell: &AtomicU64| cell.load(Ordering::Relaxed) as f64 * 1e-6;
        LiveMetrics {
            running: board.running.load(Ordering::Acquire),
            real_time_factor: seconds(&board.factor_ppm),
            lateness_s: seconds(&board.lateness_us),
            lost_s: seconds(&board.lost_us),
            steps: board.steps.load(Ordering::Relaxed),
            robots: board.robots.load(Ordering::Relaxed),
            connected: board.connected.load(Ordering::Relaxed),
        }
    }

    /// How the world is, as of at most a second ago.
    ///
    /// # Errors
    /// [`ControlError::Ended`] when it has ended.
    pub fn state(&self) -> Result<LiveState, ControlError> {
        let state = *self
            .board
            .state
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let running = self.board.running.load(Ordering::Acquire);
        state.filter(|_| running).ok_or(ControlError::Ended)
    }

    /// Tells the world what to do, and waits until it is done: a step for the last of the steps.
    ///
    /// While a world is paused nothing of it happens, and that is true of its robots' sessions
    /// too: they answer no ping, and after one and a half of their keep-alive intervals the
    /// broker publishes their last wills, as for robots that hang. They connect again when the
    /// world goes on.
    ///
    /// # Errors
    /// See [`ControlError`]; nothing has changed then.
    pub async fn control(&self, command: SimulatorCommand) -> Result<LiveDone, ControlError> {
        let (answer, done) = oneshot::channel();
        let order = Order { command, answer };
        self.orders.try_send(order).map_err(|error| match error {
            mpsc::error::TrySendError::Full(_) => ControlError::Busy,
            mpsc::error::TrySendError::Closed(_) => ControlError::Ended,
        })?;
        self.board.wake.notify_one();
        done.await.map_err(|_| ControlError::Ended)?
    }

    /// Why the world is not recorded any more, when it was to be.
    #[must_use]
    pub fn recording_error(&self) -> Option<String> {
        let error = self.board.recording.lock();
        error.unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The radio between robots and broker, where there is one.
    #[must_use]
    pub fn radio(&self) -> Option<&Arc<Proxy>> {
        self.radio.as_ref()
    }

    /// The arena of the world as it is now.
    #[must_use]
    pub fn arena(&self) -> Arc<Arena> {
        Arc::clone(&self.scene.borrow().arena)
    }

    /// What the world is made of now.
    #[must_use]
    pub fn scene(&self) -> LiveScene {
        self.scene.borrow().clone()
    }

    /// The same for whoever wants to hear of changes.
    #[must_use]
    pub fn watch_scene(&self) -> watch::Receiver<LiveScene> {
        self.scene.clone()
    }

    /// Stops every robot, waits up to `patience` for them to stand, says goodbye to the broker
    /// for each, and ends the world. Blocks: an async caller puts it on a thread that may. Asked
    /// again, it says the same again.
    ///
    /// # Errors
    /// [`LiveError::Crashed`] when the world has ended by itself, [`LiveError::TimedOut`] when it
    /// does not end within `patience` and two seconds; it may be asked again then.
    pub fn stop(&self, patience: StdDuration) -> Result<LiveReport, LiveError> {
        let mut ending = self.ending.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(report) = ending.report {
            return Ok(report);
        }
        let millis = u64::try_from(patience.as_millis()).unwrap_or(u64::MAX);
        self.board.patience_ms.store(millis, Ordering::Relaxed);
        self.ask_stop();
        let report = ending
            .from
            .recv_timeout(patience.saturating_add(STOP_GRACE))
            .map_err(|error| match error {
                RecvTimeoutError::Timeout => LiveError::TimedOut,
                RecvTimeoutError::Disconnected => LiveError::Crashed,
            })?;
        ending.report = Some(report);
        Ok(report)
    }

    fn ask_stop(&self) {
        self.board.stop.store(true, Ordering::Release);
        self.board.wake.notify_one();
    }
}

impl Drop for LiveHandle {
    fn drop(&mut self) {
        self.ask_stop();
    }
}

/// Says that the world is no longer running, also when its thread panics.
struct Running<'a>(&'a Board);

impl Drop for Running<'_> {
    fn drop(&mut self) {
        self.0.connected.store(0, Ordering::Relaxed);
        self.0.running.store(false, Ordering::Release);
    }
}

type Brokers = (Vec<SocketAddr>, Option<Arc<Proxy>>);

fn run(
    config: LiveConfig,
    broker: BrokerAddress,
    (addresses, radio): Brokers,
    board: &Board,
    (orders, record): (mpsc::Receiver<Order>, Option<RecordTo>),
    (ready, report): (
        &SyncSender<Result<watch::Receiver<LiveScene>, LiveError>>,
        &SyncSender<LiveReport>,
    ),
) {
    // The other ends go away only with the handle, and then nobody wants to know.
    let runtime = match tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .build()
    {
        Ok(runtime) => runtime,
        Err(error) => {
            let _ = ready.send(Err(LiveError::Runtime(error)));
            return;
        }
    };
    let files_each = config.files_each();
    let beginning = Beginning::New(Box::new(config.scenario), config.seed);
    let log = match Log::open(record.as_ref()) {
        Ok(log) => log,
        Err(error) => {
            let _ = ready.send(Err(error));
            return;
        }
    };
    let over = radio.clone();
    let make = move |beginning: &Beginning<'_>, given| {
        let gateway = Gateway::new(addresses.clone(), over.clone(), config.authority);
        let way = (config.fleet.clone(), Way::Live(gateway.clone()));
        let simulation = match beginning {
            Beginning::New(scenario, seed) => {
                let (scenario, clock) = (scenario.as_ref().clone(), SimClock::new());
                Simulation::with(scenario, *seed, &clock, way, given, None)
            }
            Beginning::Again(kept) => Simulation::again(kept, way, given),
        };
        Ok::<_, SimulationError>((gateway, simulation?))
    };
    let (gateway, simulation) = match make(&beginning, log.given(&broker)) {
        Ok(made) => made,
        Err(error) => {
            let _ = ready.send(Err(LiveError::Simulation(error)));
            return;
        }
    };
    board
        .robots
        .store(simulation.robots() as u32, Ordering::Relaxed);
    board.running.store(true, Ordering::Release);
    let running = Running(board);
    let (scene, seen) = watch::channel(LiveScene::of(&simulation));
    let _ = ready.send(Ok(seen));
    let mut driver = Driver {
        simulation,
        gateway,
        make: Box::new(make),
        radio,
        files_each,
        next_place: Instant::BOOT,
        given: broker,
        log,
        board,
        scene,
        bookmarks: Bookmarks::default(),
        orders,
        stepping: None,
        watch: Watch::start(std::time::Instant::now()),
        pacer: Pacer::new(),
    };
    driver.tell_state();
    // One future owns all robots: the budget tokio gives to one task would starve them.
    let standing = runtime.block_on(tokio::task::unconstrained(driver.live()));
    let ended = driver.end(&runtime, standing);
    drop(running);
    let _ = report.send(ended);
}
