//! What calls stand on. A handler asks for the parts that it needs, and sees no others.

use std::sync::{Arc, OnceLock};

use axum::extract::FromRef;
use crawler_records::Records;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::audit::Audit;
use super::problem::{Code, Problem};
use crawler_accounts::Accounts;
use crawler_broker::{BrokerHandle, Kind};
use crawler_calibrations::Calibrations;
use crawler_cluster::ClusterMembership;
use crawler_commands::CommandCenter;
use crawler_counterfactuals::Counterfactuals;
use crawler_experiments::Experiments;
use crawler_fleet::SharedFleet;
use crawler_fleet::bus::Bus;
use crawler_fleet::feed::Feed;
use crawler_fleet::maps::Maps;
use crawler_history::HistoryStore;
use crawler_metrics::Metrics;
use crawler_records::audit_log::AuditLog;
use crawler_release::PublicKey;
use crawler_rollouts::Rollouts;
use crawler_simulations::Simulation;
use crawler_system::address::BrokerUrl;
use crawler_twins::Twins;

/// What a server has that the API serves.
pub struct Parts {
    /// What is known of the robots.
    pub fleet: Arc<SharedFleet>,
    /// Commands, from acceptance to outcome.
    pub commands: Arc<CommandCenter>,
    /// What robots know of their surroundings.
    pub maps: Arc<Maps>,
    /// Models that follow the robots.
    pub twins: Arc<Twins>,
    /// Calibrations of robots where they stand.
    pub calibrations: Arc<Calibrations>,
    /// The session with the broker.
    pub bus: Arc<Bus>,
    /// The numbers of the server.
    pub metrics: Arc<Metrics>,
    /// What changes, for those who watch.
    pub feed: Arc<Feed>,
    /// The embedded broker, when it is ours.
    pub broker: Option<BrokerHandle>,
    /// The simulation in this process, once there is one.
    pub simulation: Arc<OnceLock<Arc<Simulation>>>,
    /// What must survive a restart.
    pub records: Records,
    /// What the robots measured.
    pub history: HistoryStore,
    /// What if a recorded moment had had another command in it.
    pub counterfactuals: Arc<Counterfactuals>,
    /// Scenarios on many seeds.
    pub experiments: Arc<Experiments>,
    /// Updates on their way to robots.
    pub rollouts: Arc<Rollouts>,
    /// Who is who.
    pub accounts: Arc<Accounts>,
    /// Who did what.
    pub audit: Arc<AuditLog>,
    /// Where the broker is, as this machine reaches it.
    pub mqtt: BrokerUrl,
    /// The other servers of the fleet, where there may be any.
    pub membership: Option<Arc<ClusterMembership>>,
    /// The keys by which releases are believed.
    pub release_keys: Arc<[PublicKey]>,
    /// Readers that the live feed has room for.
    pub readers: usize,
    /// What requests have begun and goes on without them.
    pub tasks: TaskTracker,
    /// Ends the API: what reads the live feed, and requests.
    pub stop: CancellationToken,
}

/// The state of the router: every part once, and a clone is another handle of the same.
#[derive(Clone)]
pub(super) struct ApiState(Arc<Shared>);

struct Shared {
    fleet: Arc<SharedFleet>,
    commands: Arc<CommandCenter>,
    maps: Arc<Maps>,
    twins: Arc<Twins>,
    calibrations: Arc<Calibrations>,
    bus: Arc<Bus>,
    metrics: Arc<Metrics>,
    feed: Arc<Feed>,
    broker: Broker,
    world: World,
    records: Records,
    history: HistoryStore,
    counterfactuals: Arc<Counterfactuals>,
    experiments: Arc<Experiments>,
    rollouts: Arc<Rollouts>,
    accounts: Arc<Accounts>,
    audit: Audit,
    mqtt: BrokerUrl,
    membership: Option<Arc<ClusterMembership>>,
    release_keys: Arc<[PublicKey]>,
    readers: Readers,
    drawing: Drawing,
    uploads: Uploads,
    tasks: TaskTracker,
    stop: CancellationToken,
}

impl ApiState {
    pub(super) fn new(parts: Parts) -> Self {
        let audit = Audit::new(parts.audit, parts.membership.clone(), parts.tasks.clone());
        Self(Arc::new(Shared {
            fleet: parts.fleet,
            commands: parts.commands,
            maps: parts.maps,
            twins: parts.twins,
            calibrations: parts.calibrations,
            bus: parts.bus,
            metrics: parts.metrics,
            feed: parts.feed,
            broker: Broker(parts.broker),
            world: World(parts.simulation),
            records: parts.records,
            history: parts.history,
            counterfactuals: parts.counterfactuals,
            experiments: parts.experiments,
            rollouts: parts.rollouts,
            accounts: parts.accounts,
            audit,
            mqtt: parts.mqtt,
            membership: parts.membership,
            release_keys: parts.release_keys,
            readers: Readers(Arc::new(Semaphore::new(parts.readers))),
            drawing: Drawing(Arc::new(Semaphore::new(1))),
            uploads: Uploads(Arc::new(Semaphore::new(UPLOADS))),
            tasks: parts.tasks,
            stop: parts.stop,
        }))
    }
}

macro_rules! parts {
    ($($name:ident: $part:ty,)*) => {
        $(impl FromRef<ApiState> for $part {
            fn from_ref(ApiState(shared): &ApiState) -> Self {
                shared.$name.clone()
            }
        })*
    };
}

parts! {
    fleet: Arc<SharedFleet>,
    commands: Arc<CommandCenter>,
    maps: Arc<Maps>,
    twins: Arc<Twins>,
    calibrations: Arc<Calibrations>,
    bus: Arc<Bus>,
    metrics: Arc<Metrics>,
    feed: Arc<Feed>,
    broker: Broker,
    world: World,
    records: Records,
    history: HistoryStore,
    counterfactuals: Arc<Counterfactuals>,
    experiments: Arc<Experiments>,
    rollouts: Arc<Rollouts>,
    accounts: Arc<Accounts>,
    audit: Audit,
    mqtt: BrokerUrl,
    membership: Option<Arc<ClusterMembership>>,
    release_keys: Arc<[PublicKey]>,
    readers: Readers,
    drawing: Drawing,
    uploads: Uploads,
    tasks: TaskTracker,
    stop: CancellationToken,
}

/// The embedded broker, when it is ours.
#[derive(Clone)]
pub(super) struct Broker(pub(super) Option<BrokerHandle>);

impl Broker {
    /// Ends what a person or a machine of that name has at the broker, where the broker is ours.
    pub(super) async fn drop_client(&self, kind: Kind, name: &str) {
        if let Some(broker) = &self.0 {
            broker.drop_client(kind, name).await;
        }
    }
}

/// The simulated world of this process, once there is one.
#[derive(Clone)]
pub(super) struct World(Arc<OnceLock<Arc<Simulation>>>);

impl World {
    /// The world, where there is one.
    pub(super) fn get(&self) -> Option<&Arc<Simulation>> {
        self.0.get()
    }

    /// The world, or what is said where there is none.
    pub(super) fn expected(&self) -> Result<&Arc<Simulation>, Problem> {
        self.get()
            .ok_or_else(|| Problem::new(Code::NoSimulator, "no world is simulated in this process"))
    }
}

/// Readers the live feed still has room for.
#[derive(Clone)]
pub(super) struct Readers(pub(super) Arc<Semaphore>);

/// Releases that may arrive at the same time: each is in memory until it is kept.
const UPLOADS: usize = 2;

/// Room for releases that arrive.
#[derive(Clone)]
pub(super) struct Uploads(pub(super) Arc<Semaphore>);

/// One world is drawn at a time for those who want to see what it would be.
#[derive(Clone)]
pub(super) struct Drawing(pub(super) Arc<Semaphore>);
