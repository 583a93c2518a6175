//! The world's thread at work: real time passes, and the world follows.

use std::future::poll_fn;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::task::Poll;
use std::time::Duration as StdDuration;

use crawler_hal::{Duration, Instant};
use crawler_protocol::Action;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant as RealInstant;

use super::bookmarks::Bookmarks;
use super::control::{Order, Watch};
use super::log::Log;
use super::obey::Stepping;
use super::pacer::Pacer;
use super::scene::LiveScene;
use super::{
    Board, LAST_WORDS, LONGEST_REST, LiveReport, MAX_BATCH, PLACE_PERIOD, STANDING, TURN, radio,
};
use crate::net::live::Gateway;
use crate::net::proxy::Proxy;
use crate::run::SimulationError;
use crate::run::simulation::{BrokerAddress, Checkpoint, Simulation};
use crate::scenario::Scenario;

/// What a world begins as.
pub(super) enum Beginning<'a> {
    /// This scenario with this seed.
    New(Box<Scenario>, u64),
    /// What was kept of another.
    Again(&'a Checkpoint),
}

/// Makes a world, and its way to the broker.
pub(super) type Make =
    Box<dyn Fn(&Beginning<'_>, BrokerAddress) -> Result<(Gateway, Simulation), SimulationError>>;

pub(super) struct Driver<'a> {
    pub(super) simulation: Simulation,
    pub(super) gateway: Gateway,
    pub(super) make: Make,
    pub(super) radio: Option<Arc<Proxy>>,
    /// Files that a robot takes in this process.
    pub(super) files_each: u64,
    /// When the radio is told next where robots are.
    pub(super) next_place: Instant,
    /// What every world of this driver is given.
    pub(super) given: BrokerAddress,
    pub(super) log: Log,
    pub(super) board: &'a Board,
    pub(super) scene: watch::Sender<LiveScene>,
    pub(super) bookmarks: Bookmarks,
    pub(super) orders: mpsc::Receiver<Order>,
    pub(super) stepping: Option<Stepping>,
    pub(super) watch: Watch,
    pub(super) pacer: Pacer,
}

impl Driver<'_> {
    /// Runs until asked to stop; returns how many robots stood at the end.
    pub(super) async fn live(&mut self) -> u32 {
        while !self.board.stop.load(Ordering::Acquire) {
            self.turn();
            self.rest().await;
        }
        // Robots cannot come to rest in a world that stands.
        self.wake_up();
        // Whoever learns the time only now, or has somewhere to go, would set out once more.
        self.simulation.end_scenario();
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

    /// Real time, as the world is to follow it.
    fn real(&self) -> Instant {
        self.watch.read(std::time::Instant::now())
    }

    /// Does what it was told, and brings the world up to the present.
    fn turn(&mut self) {
        self.obey();
        let connected = self.gateway.connected();
        self.board.connected.store(connected, Ordering::Relaxed);
        self.board
            .robots
            .store(self.simulation.present(), Ordering::Relaxed);
        if self.watch.is_paused() {
            self.board.factor_ppm.store(0, Ordering::Relaxed);
            self.step_on(MAX_BATCH);
            self.log.observe(&self.simulation, self.board);
            return;
        }
        let due = self.simulation.next_due();
        let target = self.pacer.target(self.real(), self.simulation.now(), due);
        self.simulation.run_until(target);
        self.tell_places();
        self.log.observe(&self.simulation, self.board);
        let Some(pace) = self.pacer.measure(self.real(), self.simulation.now()) else {
            return;
        };
        let board = self.board;
        for (cell, value) in [
            (
                &board.factor_ppm,
                (pace.factor * self.watch.factor() * 1e6) as u64,
            ),
            (&board.lateness_us, pace.lateness.as_micros()),
            (&board.lost_us, pace.lost.as_micros()),
            (&board.steps, self.simulation.world().steps()),
        ] {
            cell.store(value, Ordering::Relaxed);
        }
        self.tell_state();
    }

    /// Tells the radio where robots are, every now and then.
    fn tell_places(&mut self) {
        if let Some(radio) = &self.radio
            && self.simulation.now() >= self.next_place
        {
            self.next_place = self.simulation.now() + PLACE_PERIOD;
            radio::place(radio, &self.simulation);
        }
    }

    /// Lets sockets be served, and sleeps until something is due.
    async fn rest(&mut self) {
        tokio::time::sleep(TURN).await;
        if self.stepping.is_some() {
            return;
        }
        let latest = RealInstant::now() + LONGEST_REST;
        let due = self.pacer.real(self.simulation.next_due());
        let due = self
            .watch
            .when(due)
            .map_or(latest, |due| RealInstant::from_std(due).min(latest));
        let mut asleep = pin!(tokio::time::sleep_until(due));
        let mut asked = pin!(self.board.wake.notified());
        let simulation = &self.simulation;
        // What sockets bring while the world stands is left to wait.
        let paused = self.watch.is_paused();
        poll_fn(|cx| {
            let woken = !paused && !simulation.wake_when_ready(cx.waker());
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
    pub(super) fn end(mut self, runtime: &tokio::runtime::Runtime, standing: u32) -> LiveReport {
        let report = LiveReport {
            robots: self.simulation.present(),
            standing,
            connected: self.gateway.connected(),
        };
        self.log.close(&self.simulation, self.board);
        // Sockets are closed through the runtime that watches them.
        let _entered = runtime.enter();
        self.gateway.leave();
        self.empty_world();
        if let Some(radio) = &self.radio {
            // Goodbyes take their time in the air. What has not arrived then does not.
            let _ = radio.stop(LAST_WORDS);
        }
        report
    }

    /// Takes everybody out of the world, connections and all.
    pub(super) fn empty_world(&mut self) {
        self.simulation.end_tracking();
        for robot in 0..self.simulation.robots() {
            self.take_out(robot);
        }
    }

    /// Takes a robot out of the world. Its link heals first: the radio outlives the robot, and a
    /// later one may have its name.
    pub(super) fn take_out(&mut self, robot: usize) {
        self.simulation.heal(robot);
        self.simulation.remove(robot);
    }
}
