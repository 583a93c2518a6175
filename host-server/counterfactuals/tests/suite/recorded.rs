//! A reality with bodies that nobody can look into, and what a server records of it.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use crawler_counterfactuals::answer::Answer;
use crawler_counterfactuals::{
    Certificates, Counterfactual, Counterfactuals, Parts, Question, State,
};
use crawler_history::{HistoryStore, Sample};
use crawler_protocol::{Action, RobotId};
use crawler_records::{Entry, Records};
use crawler_sim::run::{Duration, Simulation};
use crawler_sim::scenario::Scenario;
use crawler_system::clock::now_ms;
use serde_json::{Value, json};

/// Robots tell where they are so often, milliseconds.
const TELL_MS: u64 = 100;

/// A command: when it is given, milliseconds, to whom, and what.
pub(crate) type Order = (u64, &'static str, Value);

/// A folder that goes with the test.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("crawler-what-if-{}-{number}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// What was recorded of a reality.
pub(crate) struct Recorded {
    /// Who is asked.
    pub(crate) counterfactuals: Arc<Counterfactuals>,
    /// Unix milliseconds of its beginning.
    began: i64,
    _folder: Scratch,
}

impl Recorded {
    /// Lets a reality pass, and records what a server would.
    pub(crate) async fn of(
        scenario: &str,
        seed: u64,
        seconds: u64,
        orders: &[Order],
        certificates: Arc<Certificates>,
    ) -> Self {
        let folder = Scratch::new();
        let records = Records::open(&folder.0).await.expect("records");
        let history = records.history().clone();
        // Points of the history are at multiples of their step: so they are the same whenever this runs.
        let began = now_ms() / 60_000 * 60_000 - 600_000;
        let scenario = Scenario::parse(scenario).expect("a scenario");
        let mut world = Simulation::lockstep(scenario, seed).expect("a world");
        let arena = serde_json::to_string(&world.world().arena()).expect("an arena");
        records
            .arenas()
            .add(began, Some(arena))
            .await
            .expect("it is kept");
        let mut orders = orders.iter().peekable();
        for at in (0..seconds * 1_000).step_by(TELL_MS as usize) {
            while let Some((_, target, request)) = orders.next_if(|order| order.0 <= at) {
                let action = Action::parse(request.to_string().as_bytes()).expect("a command");
                for robot in 0..world.robots() {
                    let id = world.id(robot).expect("it has a name").as_str();
                    if *target == "swarm" || *target == id {
                        world.submit(robot, action.clone());
                    }
                }
                let entry = Entry {
                    at: began + at as i64,
                    who: "somebody".to_owned(),
                    from: String::new(),
                    action: "command.send".to_owned(),
                    target: (*target).to_owned(),
                    detail: json!({ "id": "1", "request": request }),
                    outcome: "ok".to_owned(),
                };
                records.audit().append(entry).await.expect("it is kept");
            }
            world.run_for(Duration::from_millis(TELL_MS));
            for robot in 0..world.robots() {
                let own = world.robot(robot).expect("a robot").snapshot();
                let sample = Sample {
                    robot: world.id(robot).expect("it has a name").clone(),
                    at: began + (at + TELL_MS) as i64,
                    x: own.pose.x,
                    y: own.pose.y,
                    theta: own.pose.theta,
                    range_mm: None,
                    battery_mv: own.battery.voltage.map_or(0, |voltage| voltage.0),
                    battery_percent: match own.battery.percent {
                        Some(percent) => percent.get(),
                        None => 0,
                    },
                    rssi: None,
                    left: own.wheels[0],
                    right: own.wheels[1],
                    state: own.state,
                };
                history.push(sample).expect("it is taken");
            }
        }
        history.flush().await.expect("it is kept");
        let parts = Parts {
            history: HistoryStore::Local(history),
            records,
            certificates,
        };
        Self {
            counterfactuals: Counterfactuals::new(parts),
            began,
            _folder: folder,
        }
    }

    /// A question of eight seconds in eight draws.
    pub(crate) fn question(
        &self,
        at_ms: i64,
        robots: Option<&[&str]>,
        command: &Value,
    ) -> Question {
        let robots = robots.map(|names| names.iter().map(|name| id(name)).collect());
        Question {
            at_ms: self.began + at_ms,
            seconds: 8,
            draws: 8,
            robots,
            action: Action::parse(command.to_string().as_bytes()).expect("a command"),
        }
    }

    /// Asks it.
    pub(crate) async fn ask(&self, question: Question) -> Counterfactual {
        let asked = self
            .counterfactuals
            .ask("somebody", question, now_ms() as u64);
        asked.await.expect("it is asked")
    }

    /// Waits until somebody has worked it out.
    pub(crate) async fn wait(&self, asked: &Counterfactual) -> Counterfactual {
        eventually("it is worked out", || {
            let found = self.counterfactuals.get(asked.id).expect("it is kept");
            std::future::ready((found.state != State::Running).then_some(found))
        })
        .await
    }

    /// The answer to a question.
    pub(crate) async fn answer(&self, question: Question) -> Arc<Answer> {
        let asked = self.ask(question).await;
        match self.wait(&asked).await {
            Counterfactual {
                state: State::Done(answer),
                ..
            } => answer,
            other => panic!("{other:?}"),
        }
    }
}

/// Looks again and again until there is something.
///
/// # Panics
/// When there is nothing for a minute and a half.
pub(crate) async fn eventually<T, F: Future<Output = Option<T>>>(
    what: &str,
    mut look: impl FnMut() -> F,
) -> T {
    let looking = async {
        loop {
            if let Some(found) = look().await {
                return found;
            }
            tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        }
    };
    let limit = std::time::Duration::from_secs(90);
    let found = tokio::time::timeout(limit, looking).await;
    found.unwrap_or_else(|_| panic!("not within {limit:?}: {what}"))
}

/// A robot.
pub(crate) fn id(name: &str) -> RobotId {
    RobotId::new(name).expect("a name")
}
