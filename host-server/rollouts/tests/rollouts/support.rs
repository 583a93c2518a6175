//! What several tests need.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crawler_protocol::{Fleet, Kind, RobotId};
use crawler_records::{NewRelease, Records};
use crawler_rollouts::{NewPlan, Parts, RobotView, Robots, Rollouts};
use rumqttc::v5::MqttOptions;
use serde_json::json;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

pub(crate) const RELEASE: &str = "9f2c1ab034d5e6f7";
/// A wait that is in vain ends then.
const LIMIT: Duration = Duration::from_mins(1);

/// Three robots that are there.
struct Three;

impl Robots for Three {
    fn each(&self, show: &mut dyn FnMut(RobotView<'_>)) {
        for name in ["a", "b", "c"] {
            let robot: RobotId = name.parse().expect("a robot");
            show(RobotView {
                robot: &robot,
                board: "sim",
                kind: Kind::Simulated,
                build: "old",
                boot: 1,
                online: true,
                busy: None,
            });
        }
    }
}

/// One of several.
pub(crate) struct Server {
    pub(crate) rollouts: Arc<Rollouts>,
    stop: CancellationToken,
    running: JoinHandle<()>,
    pub(crate) told: Arc<Mutex<Vec<String>>>,
}

impl Server {
    /// A server without a broker: what it sends is lost.
    pub(crate) fn start(name: &str, records: &Records) -> Self {
        let told = Arc::new(Mutex::new(Vec::new()));
        let heard = Arc::clone(&told);
        let parts = Parts {
            records: records.clone(),
            server: name.to_owned(),
            fleet: "swarm".parse::<Fleet>().expect("a fleet"),
            robots: Arc::new(Three),
            session: MqttOptions::new("updates", "127.0.0.1", 1),
            tell: Box::new(move |_, _, text| heard.lock().expect("a list").push(text)),
        };
        let (rollouts, runner) = Rollouts::new(parts).expect("a name");
        let stop = CancellationToken::new();
        let running = tokio::spawn(runner.run(stop.clone()));
        Self {
            rollouts,
            stop,
            running,
            told,
        }
    }

    pub(crate) async fn stop(self) {
        self.stop.cancel();
        self.running.await.expect("it ends in order");
    }

    pub(crate) async fn owner(&self, id: i64) -> (String, &'static str) {
        let view = self.rollouts.one(id).await.expect("a rollout");
        (view.server, view.state)
    }
}

pub(crate) async fn with_release() -> Records {
    let records = Records::in_memory().await.expect("records");
    let new = NewRelease {
        id: RELEASE.into(),
        kind: "program".into(),
        name: None,
        board: "sim".into(),
        version: "1".into(),
        build: "new".into(),
        sequence: 4,
        floor: 0,
        expires: None,
        envelope: vec![1; 90],
        image: vec![7; 3_000],
        by: "ada".into(),
        added: 1,
    };
    records.releases().add(new).await.expect("kept");
    records
}

pub(crate) fn plan() -> NewPlan {
    let plan = json!({"releases": [{"release": RELEASE}], "phases": [{"select": {"share": 100}}]});
    serde_json::from_value(plan).expect("a plan")
}

pub(crate) async fn eventually(what: &str, mut holds: impl AsyncFnMut() -> bool) {
    let end = Instant::now() + LIMIT;
    while !holds().await {
        assert!(Instant::now() < end, "not within {LIMIT:?}: {what}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}
