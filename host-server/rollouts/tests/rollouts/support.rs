//! What several tests need.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crawler_metrics::Metrics;
use crawler_protocol::{Fleet, Kind, Models, RobotId};
use crawler_records::{NewRelease, Records, Withdrawal};
use crawler_release::{Chip, Kind as ReleaseKind, Requires};
use crawler_rollouts::{GateDemand, NewPlan, Parts, RobotView, Robots, Rollouts};
use crawler_updates::release::{SecretKey, SignOptions};
use crawler_updates::rollout::Busy;
use rumqttc::v5::MqttOptions;
use serde_json::json;
use sqlx::Connection as _;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// What the manifest of [`add_release`] comes to.
pub(crate) const RELEASE: &str = "5401b7e2a08617eb";
/// A wait that is in vain ends then.
const LIMIT: Duration = Duration::from_mins(1);

/// Three robots that are there, the build that they run, and why they could take nothing.
pub(crate) struct Three(
    pub(crate) Mutex<&'static str>,
    pub(crate) Mutex<Option<Busy>>,
);

impl Robots for Three {
    fn each(&self, show: &mut dyn FnMut(RobotView<'_>)) {
        let build = *self.0.lock().expect("a build");
        let busy = *self.1.lock().expect("a reason");
        for name in ["a", "b", "c"] {
            let robot: RobotId = name.parse().expect("a robot");
            show(RobotView {
                robot: &robot,
                board: "virt",
                kind: Kind::Emulated,
                vision: false,
                policies: false,
                build,
                models: &Models::new(),
                boot: 1,
                online: true,
                busy,
            });
        }
    }
}

/// One of several.
pub(crate) struct Server {
    pub(crate) rollouts: Arc<Rollouts>,
    pub(crate) robots: Arc<Three>,
    stop: CancellationToken,
    running: JoinHandle<()>,
    pub(crate) told: Arc<Mutex<Vec<String>>>,
}

impl Server {
    /// A server without a broker: what it sends is lost. It takes nothing over from others by itself.
    pub(crate) fn start(name: &str, records: &Records) -> Self {
        Self::with_lease(name, records, Duration::from_hours(1))
    }

    /// One for which others are gone that are silent for as long as `lease`.
    pub(crate) fn with_lease(name: &str, records: &Records, lease: Duration) -> Self {
        let told = Arc::new(Mutex::new(Vec::new()));
        let heard = Arc::clone(&told);
        let robots = Arc::new(Three(Mutex::new("old"), Mutex::new(None)));
        let parts = Parts {
            records: records.clone(),
            server: name.to_owned(),
            fleet: "swarm".parse::<Fleet>().expect("a fleet"),
            robots: robots.clone(),
            session: MqttOptions::new("updates", "127.0.0.1", 1),
            lease,
            gates: GateDemand::None,
            tell: Box::new(move |_, _, text| heard.lock().expect("a list").push(text)),
        };
        let (rollouts, runner) = Rollouts::new(parts).expect("a name");
        let stop = CancellationToken::new();
        let running = tokio::spawn(runner.run(stop.clone()));
        Self {
            rollouts,
            robots,
            stop,
            running,
            told,
        }
    }

    pub(crate) async fn stop(self) {
        self.stop.cancel();
        self.running.await.expect("it ends in order");
    }

    /// A metric: the line that begins so.
    pub(crate) fn metric(&self, name: &str) -> f64 {
        let mut out = Metrics::new().exposition();
        self.rollouts.write_metrics(&mut out);
        let text = out.finish();
        let value = text.lines().find_map(|line| line.strip_prefix(name));
        let value = value.unwrap_or_else(|| panic!("no {name} in {text}"));
        value.trim().parse().expect("a number")
    }

    /// How many rollouts this server has at work that run.
    pub(crate) fn running(&self) -> f64 {
        self.metric(r#"terracrawler_rollouts{state="running"}"#)
    }

    /// How often something is said of a rollout in its log.
    pub(crate) async fn said(&self, id: i64, what: &str) -> usize {
        let view = self.rollouts.one(id).await.expect("a rollout");
        let log = view.log.expect("a log");
        log.iter().filter(|line| line.what == what).count()
    }

    pub(crate) async fn owner(&self, id: i64) -> (String, &'static str) {
        let view = self.rollouts.one(id).await.expect("a rollout");
        (view.server, view.state)
    }
}

pub(crate) async fn with_release() -> Records {
    let records = Records::in_memory().await.expect("records");
    add_release(&records).await;
    records
}

pub(crate) async fn add_release(records: &Records) {
    let options = SignOptions {
        kind: ReleaseKind::Program,
        name: None,
        board: "virt",
        chip: Some(Chip::NONE),
        version: "1",
        build: Some("new"),
        sequence: 4,
        floor: 0,
        expires: None,
        requires: Requires::default(),
    };
    let image = [7; 3_000];
    let key = SecretKey::generate().expect("random numbers");
    let envelope = options.sign(&image, &key).expect("signed");
    let new = NewRelease::of(&envelope, &image, "ada", 1).expect("a release");
    // It goes by its manifest, whoever has signed it.
    assert_eq!(new.id, RELEASE);
    records.releases().add(new).await.expect("kept");
}

/// Withdraws the release, and tells nobody.
pub(crate) async fn withdraw(records: &Records) {
    let withdrawal = Withdrawal {
        by: "ada".into(),
        at: 1,
        why: "it is bad".into(),
    };
    let done = records.releases().withdraw(RELEASE, withdrawal).await;
    done.expect("withdrawn");
}

/// Records in a directory of their own, which is gone with the value.
pub(crate) struct OnDisk {
    path: PathBuf,
    pub(crate) records: Records,
}

impl OnDisk {
    pub(crate) async fn with_release(name: &str) -> Self {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let path = path.join(format!("rollouts-{name}-{}", std::process::id()));
        // A run before may have had the same process id.
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).expect("a directory");
        let records = Records::open(&path).await.expect("records");
        add_release(&records).await;
        Self { path, records }
    }

    /// What somebody does who goes past the program.
    pub(crate) async fn tamper(&self, sql: &'static str) {
        let file = self.path.join(crawler_records::RECORDS_FILE);
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(file);
        let connection = sqlx::SqliteConnection::connect_with(&options).await;
        let mut connection = connection.expect("a connection");
        let done = sqlx::raw_sql(sql).execute(&mut connection).await;
        done.expect("it is done");
        connection.close().await.expect("closed");
    }
}

impl Drop for OnDisk {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.path);
    }
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
