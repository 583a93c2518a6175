//! Rollouts carried out by a server.
//!
//! What is decided is decided by the engine ([`crawler_updates::rollout`]). Here its steps are stored, and only
//! then what they send goes out; robots are heard, and get the chunks that they ask for. A rollout belongs to one
//! server at a time. When that has not been heard of for five seconds another one of the fleet takes it over, and
//! so does a server that is asked to do something with it.
//!
//! Two things do not wait for each other: what is stored, and chunks. The engines stand behind one lock that is
//! held for a moment; [`Runner`] alone changes them, and stores what comes of it. Chunks go out from a task of
//! their own, over the same MQTT session as offers, which is not the one of commands: a `stop` never waits behind
//! a chunk.
//!
//! Reading order: `plan`, what people ask for; `gate`, what must be known of releases before; `image`, what robots get,
//! and `patches`, what some get in its place, made by `making`; `active`, the rollouts of this server;
//! `step`, what is stored of a step; `report`, what robots say; `pulls`, who asks for which chunks, and `sender`,
//! which sends them; `link`, the session; `runner`, which has all of it, with `lease` and `robots`; `control` and
//! `view`, what the API asks for; `numbers`, the metrics.

mod active;
mod control;
mod gate;
mod image;
mod lease;
mod link;
mod making;
mod numbers;
mod patches;
mod plan;
mod pulls;
mod report;
mod robots;
mod runner;
mod sender;
mod step;
mod view;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crawler_protocol::{Fleet, RobotId};
use crawler_records::{EventLevel, Records};
use crawler_system::clock::unix_ms;
use crawler_updates::rollout::{NameError, Now, ServerId};
use rumqttc::v5::{AsyncClient, MqttOptions};
use tokio::sync::{Notify, mpsc};

use crate::active::ActiveRollouts;
use control::Request;
use numbers::Numbers;
use patches::Patches;
use pulls::Pulls;

pub use control::{Action, RolloutError};
pub use gate::GateDemand;
pub use lease::LEASE;
pub use plan::{Asked, NewPlan};
pub use robots::{RobotView, Robots};
pub use runner::Runner;
pub use view::{LogLine, Robot, RobotDetail, RobotLine, RolloutPage, RolloutView};

/// Requests of people that wait.
const REQUESTS: usize = 64;

/// Tells those who watch the fleet what becomes of a rollout.
pub type Tell = Box<dyn Fn(EventLevel, Option<RobotId>, String) + Send + Sync>;

/// What rollouts of a server stand on.
pub struct Parts {
    /// Where they are kept, with the releases.
    pub records: Records,
    /// How this server is called in records that it shares with others.
    pub server: String,
    /// The fleet.
    pub fleet: Fleet,
    /// What is known of its robots.
    pub robots: Arc<dyn Robots>,
    /// The session with the broker, of rollouts alone.
    pub session: MqttOptions,
    /// After how long without a word another server counts as gone: [`LEASE`].
    pub lease: Duration,
    /// Of which releases a gate is demanded.
    pub gates: GateDemand,
    /// Tells what happens.
    pub tell: Tell,
}

/// The rollouts of a fleet, as a server has them.
pub struct Rollouts {
    records: Records,
    server: ServerId,
    fleet: Fleet,
    robots: Arc<dyn Robots>,
    gates: GateDemand,
    tell: Tell,
    began: Instant,
    active: Mutex<ActiveRollouts>,
    pulls: Mutex<Pulls>,
    patches: Mutex<Patches>,
    /// There is something to send, or leave to.
    pulled: Notify,
    client: Mutex<Option<AsyncClient>>,
    requests: mpsc::Sender<Request>,
    numbers: Numbers,
}

impl Rollouts {
    /// Rollouts, and what carries them out for as long as it runs.
    ///
    /// # Errors
    /// [`NameError`] for a server whose name cannot be one.
    pub fn new(parts: Parts) -> Result<(Arc<Self>, Runner), NameError> {
        let (requests, waiting) = mpsc::channel(REQUESTS);
        let rollouts = Arc::new(Self {
            records: parts.records,
            server: ServerId::new(&parts.server)?,
            fleet: parts.fleet,
            robots: parts.robots,
            gates: parts.gates,
            tell: parts.tell,
            began: Instant::now(),
            active: Mutex::default(),
            pulls: Mutex::default(),
            patches: Mutex::default(),
            pulled: Notify::new(),
            client: Mutex::new(None),
            requests,
            numbers: Numbers::default(),
        });
        let runner = Runner::new(Arc::clone(&rollouts), parts.session, parts.lease, waiting);
        Ok((rollouts, runner))
    }

    /// The rollouts of this server, for a moment: whoever holds it waits for nothing.
    fn active(&self) -> MutexGuard<'_, ActiveRollouts> {
        self.active.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What robots have asked for. Taken behind [`Rollouts::active`] where both are.
    fn pulls(&self) -> MutexGuard<'_, Pulls> {
        self.pulls.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What robots get in place of images. Taken behind [`Rollouts::active`] and [`Rollouts::pulls`] where those are.
    fn patches(&self) -> MutexGuard<'_, Patches> {
        self.patches.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn client(&self) -> Option<AsyncClient> {
        let client = self.client.lock();
        client.unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn set_client(&self, client: Option<AsyncClient>) {
        *self.client.lock().unwrap_or_else(PoisonError::into_inner) = client;
    }

    fn now(&self) -> Now {
        let passed = self.began.elapsed().as_millis();
        Now {
            unix_ms: unix_ms(),
            monotonic_ms: u64::try_from(passed).unwrap_or(u64::MAX),
        }
    }
}
