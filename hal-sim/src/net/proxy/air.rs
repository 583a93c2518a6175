//! What all connections of a proxy share: the radio, and who is on it.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rand_pcg::Pcg32;
use tokio::sync::{Notify, watch};
use tokio::time::Instant;

use super::{ProxyConfig, ProxyMetrics};
use crate::net::lockstep::{Cut, LinkModel};
use crate::net::radio::{Airtime, Direction, LOOK_PERIOD_US, Medium, Reach};
use crate::world::Fingerprint;
use crate::world::mix;

/// Robots told apart. Whoever comes later shares one link.
const MOST_STATIONS: usize = 16_384;
/// Name of that link; no client can have it.
const OTHERS: &str = "\n";

/// What a robot can know of its link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Signal {
    /// What is wrong with it.
    pub cut: Cut,
    /// Strength of the signal, dBm; means nothing while there is no access point.
    pub rssi_dbm: i8,
}

#[derive(Debug)]
struct Station {
    cut: Cut,
    reach: Reach,
    place: Option<(f32, f32)>,
    rng: Pcg32,
    signal: watch::Sender<Signal>,
}

impl Station {
    const fn state(&self) -> Cut {
        self.reach.and(self.cut)
    }
}

#[derive(Debug)]
struct Air {
    link: LinkModel,
    seed: u64,
    medium: Option<Medium>,
    stations: Vec<Station>,
    by_name: BTreeMap<String, usize>,
    /// Of all that are not known yet.
    cut: Cut,
    sums: Vec<Airtime>,
}

/// See the [module](self).
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) broker: Vec<std::net::SocketAddr>,
    most_connections: usize,
    started: Instant,
    air: Mutex<Air>,
    pub(super) connections: AtomicUsize,
    accepted: AtomicU64,
    refused: AtomicU64,
    bytes: [AtomicU64; 2],
    stopping: AtomicBool,
    stop: Notify,
    patience_ms: AtomicU64,
}

impl Shared {
    pub(super) fn new(config: &ProxyConfig) -> Self {
        let setup = &config.setup;
        let radio = setup.radio.as_ref();
        Self {
            broker: config.broker.clone(),
            // As many as a semaphore can be asked for at once, at the very most.
            most_connections: config.most_connections.clamp(1, 1 << 24),
            started: Instant::now(),
            air: Mutex::new(Air {
                link: setup.link,
                seed: setup.seed,
                medium: radio.map(|radio| Medium::new(setup, radio.clone())),
                stations: Vec::new(),
                by_name: BTreeMap::new(),
                cut: Cut::None,
                sums: Vec::new(),
            }),
            connections: AtomicUsize::new(0),
            accepted: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            bytes: [AtomicU64::new(0), AtomicU64::new(0)],
            stopping: AtomicBool::new(false),
            stop: Notify::new(),
            patience_ms: AtomicU64::new(0),
        }
    }

    fn air(&self) -> MutexGuard<'_, Air> {
        // Nothing that can panic leaves it half changed.
        self.air.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Microseconds since the beginning.
    pub(super) fn now_us(&self) -> u64 {
        self.started.elapsed().as_micros() as u64
    }

    /// When that is.
    pub(super) fn at(&self, us: u64) -> Instant {
        self.started + Duration::from_micros(us)
    }

    pub(super) const fn most_connections(&self) -> usize {
        self.most_connections
    }

    pub(super) fn station(&self, name: &str) -> usize {
        self.air().station(name)
    }

    pub(super) fn signal(&self, name: &str) -> watch::Receiver<Signal> {
        let mut air = self.air();
        let station = air.station(name);
        air.stations[station].signal.subscribe()
    }

    /// News of the link of a station.
    pub(super) fn news(&self, station: usize) -> watch::Receiver<Signal> {
        self.air().stations[station].signal.subscribe()
    }

    pub(super) fn place<'a>(&self, robots: impl IntoIterator<Item = (&'a str, (f32, f32))>) {
        let air = &mut *self.air();
        for (name, place) in robots {
            if !(place.0.is_finite() && place.1.is_finite()) {
                continue;
            }
            let station = air.station(name);
            let first = air.stations[station].place.replace(place).is_none();
            if first && let Some(medium) = &mut air.medium {
                medium.begin(station, place);
                let reach = medium.reach(station);
                air.stations[station].reach = reach;
                air.tell(station);
            }
        }
    }

    pub(super) fn cut(&self, name: &str, cut: Cut) {
        let air = &mut *self.air();
        let station = air.station(name);
        air.stations[station].cut = cut;
        air.tell(station);
    }

    pub(super) fn cut_all(&self, cut: Cut) {
        let air = &mut *self.air();
        air.cut = cut;
        for station in 0..air.stations.len() {
            air.stations[station].cut = cut;
            air.tell(station);
        }
    }

    /// Moves the radio on to the end of a window.
    pub(super) fn turn(&self, now_us: u64) {
        let air = &mut *self.air();
        let Some(medium) = &mut air.medium else {
            return;
        };
        medium.close_window(now_us, &mut air.sums);
        medium.open_window(&air.sums);
        if !now_us.is_multiple_of(LOOK_PERIOD_US) {
            return;
        }
        let stations = &air.stations;
        medium.look(now_us, |index| stations[index].place, |_, _| {});
        for (index, station) in air.stations.iter_mut().enumerate() {
            station.reach = medium.reach(index);
        }
        for station in 0..air.stations.len() {
            air.tell(station);
        }
    }

    /// When `len` bytes sent now arrive; `None` while the link is cut.
    pub(super) fn transit(
        &self,
        station: usize,
        direction: Direction,
        len: usize,
        now_us: u64,
    ) -> Option<u64> {
        let air = &mut *self.air();
        let known = &mut air.stations[station];
        if known.state() != Cut::None {
            return None;
        }
        let rng = &mut known.rng;
        Some(match &mut air.medium {
            Some(medium) => {
                let sent = medium.send(station, direction, len, now_us);
                sent + air.link.draw(medium.loss(station), rng) + medium.spike(rng)
            }
            None => now_us + air.link.draw(air.link.loss, rng),
        })
    }

    pub(super) fn count(&self, direction: Direction, len: usize) {
        let place = usize::from(direction == Direction::Down);
        self.bytes[place].fetch_add(len as u64, Ordering::Relaxed);
    }

    pub(super) fn accept(&self) {
        self.accepted.fetch_add(1, Ordering::Relaxed);
        self.connections.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn refuse(&self) {
        self.refused.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn metrics(&self) -> ProxyMetrics {
        ProxyMetrics {
            connections: self.connections.load(Ordering::Relaxed),
            accepted: self.accepted.load(Ordering::Relaxed),
            refused: self.refused.load(Ordering::Relaxed),
            stations: self.air().stations.len(),
            up_bytes: self.bytes[0].load(Ordering::Relaxed),
            down_bytes: self.bytes[1].load(Ordering::Relaxed),
        }
    }

    pub(super) fn ask_stop(&self, patience: Duration) {
        if !self.stopping.swap(true, Ordering::AcqRel) {
            let millis = u64::try_from(patience.as_millis()).unwrap_or(u64::MAX);
            self.patience_ms.store(millis, Ordering::Release);
        }
        self.stop.notify_one();
    }

    pub(super) async fn asked_to_stop(&self) {
        self.stop.notified().await;
    }

    pub(super) fn patience(&self) -> Duration {
        Duration::from_millis(self.patience_ms.load(Ordering::Acquire))
    }
}

impl Air {
    fn station(&mut self, name: &str) -> usize {
        if let Some(&known) = self.by_name.get(name) {
            return known;
        }
        let name = if self.stations.len() >= MOST_STATIONS {
            OTHERS
        } else {
            name
        };
        if let Some(&known) = self.by_name.get(name) {
            return known;
        }
        let mut print = Fingerprint::new();
        print.bytes(name.as_bytes());
        let number = print.value();
        let mut station = Station {
            cut: self.cut,
            reach: Reach::Up,
            place: None,
            rng: Pcg32::new(mix(self.seed ^ mix(number)), number),
            signal: watch::Sender::new(Signal {
                cut: self.cut,
                rssi_dbm: self.link.rssi_dbm,
            }),
        };
        if let Some(medium) = &mut self.medium {
            let index = medium.add(number as u32);
            station.reach = medium.reach(index);
        }
        self.stations.push(station);
        let index = self.stations.len() - 1;
        self.by_name.insert(name.to_owned(), index);
        self.tell(index);
        index
    }

    /// Tells whoever listens how a link is now.
    fn tell(&mut self, station: usize) {
        let known = &self.stations[station];
        let now = Signal {
            cut: known.state(),
            rssi_dbm: match &self.medium {
                Some(medium) => medium.rssi_dbm(station),
                None => self.link.rssi_dbm,
            },
        };
        known.signal.send_if_modified(|last| {
            let differs = *last != now;
            *last = now;
            differs
        });
    }
}
