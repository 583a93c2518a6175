//! Several servers with one set of records: a rollout is carried out by one of them at a time.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crawler_protocol::{Fleet, Kind, RobotId};
use crawler_records::{NewRelease, Records};
use crawler_rollouts::{Action, NewPlan, Parts, RobotView, Robots, RolloutError, Rollouts};
use crawler_updates::rollout::{CommandError, UpdateState};
use rumqttc::v5::MqttOptions;
use serde_json::json;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

const RELEASE: &str = "9f2c1ab034d5e6f7";
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

struct Server {
    rollouts: Arc<Rollouts>,
    stop: CancellationToken,
    running: JoinHandle<()>,
    told: Arc<Mutex<Vec<String>>>,
}

impl Server {
    /// A server without a broker: what it sends is lost.
    fn start(name: &str, records: &Records) -> Self {
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

    async fn stop(self) {
        self.stop.cancel();
        self.running.await.expect("it ends in order");
    }

    async fn owner(&self, id: i64) -> (String, &'static str) {
        let view = self.rollouts.one(id).await.expect("a rollout");
        (view.server, view.state)
    }
}

async fn with_release() -> Records {
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

fn plan() -> NewPlan {
    let plan = json!({"releases": [{"release": RELEASE}], "phases": [{"select": {"share": 100}}]});
    serde_json::from_value(plan).expect("a plan")
}

async fn eventually(what: &str, mut holds: impl AsyncFnMut() -> bool) {
    let end = Instant::now() + LIMIT;
    while !holds().await {
        assert!(Instant::now() < end, "not within {LIMIT:?}: {what}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_is_asked_carries_it_out() {
    let records = with_release().await;
    let (one, two) = (
        Server::start("one", &records),
        Server::start("two", &records),
    );
    let id = one.rollouts.start("ada", plan()).await.expect("it begins");
    assert_eq!(one.owner(id).await, ("one".into(), "running"));
    two.rollouts
        .act(id, Action::Pause)
        .await
        .expect("it pauses");
    assert_eq!(one.owner(id).await, ("two".into(), "paused"));
    // The former owner, which may not know that it is, takes it back when it is asked.
    one.rollouts
        .act(id, Action::Resume)
        .await
        .expect("it goes on");
    assert_eq!(two.owner(id).await, ("one".into(), "running"));
    two.rollouts.act(id, Action::Abort).await.expect("it ends");
    assert_eq!(one.owner(id).await, ("two".into(), "aborted"));
    let over = one.rollouts.act(id, Action::Resume).await;
    assert!(
        matches!(over, Err(RolloutError::Command(CommandError::Over))),
        "{over:?}"
    );
    let rows = one
        .rollouts
        .robots(id, None, None, 9)
        .await
        .expect("robots");
    assert!(
        rows.iter().all(|row| row.state == UpdateState::Skipped),
        "{rows:?}"
    );
    let unknown = one.rollouts.act(99, Action::Pause).await;
    assert!(matches!(unknown, Err(RolloutError::Unknown)), "{unknown:?}");
    let log = one
        .rollouts
        .one(id)
        .await
        .expect("a rollout")
        .log
        .expect("a log");
    let count = |what: &str| log.iter().filter(|line| line.what == what).count();
    assert_eq!(
        (count("started"), count("taken_over"), count("aborted")),
        (1, 3, 1),
        "{log:?}"
    );
    records
        .audit_verify()
        .await
        .expect("the audit log is whole");
    one.stop().await;
    two.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn another_server_takes_over_from_one_that_is_gone() {
    let records = with_release().await;
    let (one, two) = (
        Server::start("one", &records),
        Server::start("two", &records),
    );
    let id = one.rollouts.start("ada", plan()).await.expect("it begins");
    let told = one.told.lock().expect("a list").clone();
    assert!(
        told.contains(&format!("rollout {id} has begun")),
        "{told:?}"
    );
    one.stop().await;
    assert_eq!(two.owner(id).await, ("one".into(), "running"));
    eventually("it is taken over", async || two.owner(id).await.0 == "two").await;
    let rows = two
        .rollouts
        .robots(id, None, Some(UpdateState::Offered), 9)
        .await;
    assert_eq!(
        rows.expect("robots").len(),
        3,
        "all three are still to answer"
    );
    // One that comes back under its name leaves it where it is, and finds what is its own.
    let one = Server::start("one", &records);
    two.stop().await;
    let two = Server::start("two", &records);
    eventually("it is back", async || {
        let log = one
            .rollouts
            .one(id)
            .await
            .expect("a rollout")
            .log
            .expect("a log");
        log.iter().filter(|line| line.what == "taken_over").count() == 2
    })
    .await;
    assert_eq!(one.owner(id).await, ("two".into(), "running"));
    one.stop().await;
    two.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_release_that_cannot_go_out_is_refused() {
    let records = with_release().await;
    let server = Server::start("one", &records);
    let mut other = plan();
    other.releases[0].release = "0000000000000000".parse().expect("an id");
    let unknown = server.rollouts.start("ada", other).await;
    assert!(
        matches!(unknown, Err(RolloutError::UnknownRelease(_))),
        "{unknown:?}"
    );
    let withdrawal = crawler_records::Withdrawal {
        by: "ada".into(),
        at: 1,
        why: "it is bad".into(),
    };
    records
        .releases()
        .withdraw(RELEASE, withdrawal)
        .await
        .expect("withdrawn");
    let withdrawn = server.rollouts.start("ada", plan()).await;
    assert!(
        matches!(withdrawn, Err(RolloutError::Release(..))),
        "{withdrawn:?}"
    );
    assert!(
        server
            .rollouts
            .list(None, 9)
            .await
            .expect("a list")
            .is_empty()
    );
    server.stop().await;
}
