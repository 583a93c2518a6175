//! A world in real time, on a thread of its own, whose robots talk to a real broker.
//!
//! Virtual time follows real time. When the machine is too slow for the fleet, the world does not
//! try to catch up for ever: what lies further behind than [`MAX_BATCH`] is given up, virtual
//! time falls behind, and [`LiveMetrics::real_time_factor`] says how fast it runs.

mod error;
mod pacer;

use std::future::poll_fn;
use std::net::ToSocketAddrs;
use std::pin::pin;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::Poll;
use std::time::Duration as StdDuration;

use crawler_app::Credentials;
use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, Fleet};
use tokio::sync::Notify;
use tokio::time::Instant as RealInstant;

use super::simulation::{BrokerAddress, Simulation, Way};
use crate::net::live::Gateway;
use crate::scenario::Scenario;
use crate::sched::SimClock;
use crate::world::Arena;
use pacer::Pacer;

pub use error::LiveError;

/// Most virtual time that is run at once, and most that is made up for.
pub const MAX_BATCH: Duration = Duration::from_millis(100);
/// Least real time from one turn of the world to the next. A control period has ten of them.
const TURN: StdDuration = StdDuration::from_millis(2);
/// Longest rest: physics goes on when no program does anything.
const LONGEST_REST: StdDuration = StdDuration::from_millis(50);
/// Descriptors that everything but the robots may need.
const SPARE_DESCRIPTORS: u64 = 256;
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
    /// What the broker asks for; see [`credentials`](super::credentials).
    pub credentials: Option<Credentials>,
    /// Scenario; its number of robots counts.
    pub scenario: Scenario,
    /// Seed of everything that is left to chance.
    pub seed: u64,
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
}

/// A running live world. Dropping it asks the world to stop and does not wait for it.
#[derive(Debug)]
pub struct LiveHandle {
    board: Arc<Board>,
    arena: Arena,
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
    let host = heapless::String::<64>::try_from(config.broker_host.as_str())
        .map_err(|_| LiveError::Host(config.broker_host.clone(), None))?;
    let broker: Vec<_> = (config.broker_host.as_str(), config.broker_port)
        .to_socket_addrs()
        .map_err(|error| LiveError::Host(config.broker_host.clone(), Some(error)))?
        .collect();
    // A broker in the same process needs as many again.
    let need = u64::from(config.scenario.robots) + SPARE_DESCRIPTORS;
    let have = rlimit::increase_nofile_limit(2 * need).map_err(LiveError::Runtime)?;
    if have < need {
        return Err(LiveError::Descriptors(have, need));
    }
    let board = Arc::new(Board::default());
    board.factor_ppm.store(1_000_000, Ordering::Relaxed);
    let (ready_to, ready) = sync_channel(1);
    let (report_to, report) = sync_channel(1);
    std::thread::Builder::new()
        .name("world".into())
        .spawn({
            let board = Arc::clone(&board);
            let address = BrokerAddress {
                host,
                port: config.broker_port,
                credentials: config.credentials.clone(),
            };
            move || run(config, (address, broker), &board, &ready_to, &report_to)
        })
        .map_err(LiveError::Runtime)?;
    let arena = ready.recv().map_err(|_| LiveError::Crashed)??;
    Ok(LiveHandle {
        board,
        arena,
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

    /// The arena of the world.
    #[must_use]
    pub fn arena(&self) -> &Arena {
        &self.arena
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

type Broker = (BrokerAddress, Vec<std::net::SocketAddr>);

fn run(
    config: LiveConfig,
    (broker, addresses): Broker,
    board: &Board,
    ready: &SyncSender<Result<Arena, LiveError>>,
    report: &SyncSender<LiveReport>,
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
    let clock = SimClock::new();
    let gateway = Gateway::new(addresses);
    let simulation = Simulation::with(
        config.scenario,
        config.seed,
        &clock,
        config.fleet,
        Way::Live(gateway.clone()),
        broker,
    );
    let simulation = match simulation {
        Ok(simulation) => simulation,
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
    let _ = ready.send(Ok(simulation.world().arena()));
    let mut driver = Driver {
        simulation,
        gateway,
        board,
        started: RealInstant::now(),
        pacer: Pacer::new(),
    };
    // One future owns all robots: the budget tokio gives to one task would starve them.
    let standing = runtime.block_on(tokio::task::unconstrained(driver.live()));
    let ended = driver.end(&runtime, standing);
    drop(running);
    let _ = report.send(ended);
}

struct Driver<'a> {
    simulation: Simulation,
    gateway: Gateway,
    board: &'a Board,
    started: RealInstant,
    pacer: Pacer,
}

impl Driver<'_> {
    /// Runs until asked to stop; returns how many robots stood at the end.
    async fn live(&mut self) -> u32 {
        while !self.board.stop.load(Ordering::Acquire) {
            self.turn();
            self.rest().await;
        }
        self.simulation.submit_all(Action::Stop);
        let patience = StdDuration::from_millis(self.board.patience_ms.load(Ordering::Relaxed));
        let deadline = RealInstant::now().checked_add(patience);
        // At least two control periods, so that the word has arrived and its answer left.
        let least = self.simulation.now() + Duration::from_millis(60);
        loop {
            self.turn();
            let standing = self.standing();
            let all = standing == self.simulation.present();
            let late = deadline.is_some_and(|deadline| RealInstant::now() >= deadline);
            if (all && self.simulation.now() >= least) || late {
                return standing;
            }
            self.rest().await;
        }
    }

    /// Real time since the world began.
    fn real(&self) -> Instant {
        Instant::from_micros(self.started.elapsed().as_micros() as u64)
    }

    /// Brings the world up to the present.
    fn turn(&mut self) {
        let due = self.simulation.next_due();
        let target = self.pacer.target(self.real(), self.simulation.now(), due);
        self.simulation.run_until(target);
        let board = self.board;
        let connected = self.gateway.connected();
        board.connected.store(connected, Ordering::Relaxed);
        let Some(pace) = self.pacer.measure(self.real(), self.simulation.now()) else {
            return;
        };
        for (cell, value) in [
            (&board.factor_ppm, (pace.factor * 1e6) as u64),
            (&board.lateness_us, pace.lateness.as_micros()),
            (&board.lost_us, pace.lost.as_micros()),
            (&board.steps, self.simulation.world().steps()),
        ] {
            cell.store(value, Ordering::Relaxed);
        }
    }

    /// Lets sockets be served, and sleeps until something is due.
    async fn rest(&mut self) {
        tokio::time::sleep(TURN).await;
        let latest = RealInstant::now() + LONGEST_REST;
        let due = self.pacer.real(self.simulation.next_due());
        let due = self
            .started
            .checked_add(StdDuration::from_micros(due.as_micros()))
            .map_or(latest, |due| due.min(latest));
        let mut asleep = pin!(tokio::time::sleep_until(due));
        let mut asked = pin!(self.board.wake.notified());
        let simulation = &self.simulation;
        poll_fn(|cx| {
            let woken = !simulation.wake_when_ready(cx.waker());
            let due = asleep.as_mut().poll(cx).is_ready();
            let asked = asked.as_mut().poll(cx).is_ready();
            if woken || due || asked {
                Poll::Ready(())
            } else {
                Poll::Pending
            }
        })
        .await;
    }

    fn standing(&self) -> u32 {
        (0..self.simulation.robots())
            .filter_map(|robot| self.simulation.observe(robot))
            .filter(|seen| {
                let still = seen.speed.abs() < STANDING && seen.turn.abs() < STANDING * 10.0;
                seen.present && still && (seen.duty == [0, 0] || !seen.powered)
            })
            .count() as u32
    }

    /// Says goodbye for every robot, and ends the world.
    fn end(mut self, runtime: &tokio::runtime::Runtime, standing: u32) -> LiveReport {
        let report = LiveReport {
            robots: self.simulation.present(),
            standing,
            connected: self.gateway.connected(),
        };
        self.gateway.leave();
        // Sockets are closed through the runtime that watches them.
        let _entered = runtime.enter();
        self.simulation.end_tracking();
        for robot in 0..self.simulation.robots() {
            self.simulation.remove(robot);
        }
        report
    }
}
