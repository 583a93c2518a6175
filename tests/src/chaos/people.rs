//! Whoever gives commands, over HTTP, and writes down every 202.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::judge::{Given, Kind};

/// Pause between two words to a robot that is steered.
const STEER_EVERY: Duration = Duration::from_millis(200);
/// Robots that are steered, at most: one address may make 200 requests a second.
const MOST_STEERED: usize = 10;
/// Pause between two other commands to the same robot.
const EACH_EVERY: Duration = Duration::from_secs(4);
/// Other commands in a second, at most.
const MOST_OTHER: f64 = 50.0;
/// For an answer of the server.
const PATIENCE: Duration = Duration::from_secs(5);

#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    given: Mutex<Vec<(Given, Instant)>>,
}

/// Somebody at work, on two threads: one steers, the other does the rest.
pub(super) struct People {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl People {
    pub(super) fn start(url: &str, robots: usize) -> Self {
        let shared = Arc::new(Shared::default());
        let steered = robots.div_ceil(5).min(MOST_STEERED);
        let steer = STEER_EVERY / steered as u32;
        let others = Duration::from_secs_f64(
            (EACH_EVERY.as_secs_f64() / robots as f64).max(1.0 / MOST_OTHER),
        );
        let threads =
            [(steered, steer, true), (robots, others, false)].map(|(robots, pause, steers)| {
                let (shared, url) = (Arc::clone(&shared), url.to_owned());
                std::thread::spawn(move || work(&shared, &url, robots, pause, steers))
            });
        Self {
            shared,
            threads: threads.into(),
        }
    }

    /// Ids of commands that must not be lost and were acknowledged in the last `span`.
    pub(super) fn owed(&self, span: Duration) -> Vec<String> {
        let given = self.shared.given.lock();
        let given = given.unwrap_or_else(PoisonError::into_inner);
        let recent = given.iter().rev();
        recent
            .take_while(|(_, at)| at.elapsed() < span)
            .filter(|(given, _)| matches!(given.kind, Kind::Set | Kind::Identify))
            .filter_map(|(given, _)| given.id.clone())
            .collect()
    }

    /// Kinds of commands of which at least one was acknowledged after `moment`.
    pub(super) fn acknowledged(&self, moment: Instant) -> BTreeSet<Kind> {
        let given = self.shared.given.lock();
        let given = given.unwrap_or_else(PoisonError::into_inner);
        given
            .iter()
            .filter(|(given, at)| *at > moment && given.id.is_some())
            .map(|(given, _)| given.kind)
            .collect()
    }

    /// Gives no more commands; tells which were given.
    pub(super) fn stop(self) -> Vec<Given> {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads {
            thread.join().expect("whoever gives commands");
        }
        let given = std::mem::take(
            &mut *self
                .shared
                .given
                .lock()
                .unwrap_or_else(PoisonError::into_inner),
        );
        given.into_iter().map(|(given, _)| given).collect()
    }
}

fn work(shared: &Shared, url: &str, robots: usize, pause: Duration, steers: bool) {
    let agent: ureq::Agent = ureq::Agent::config_builder()
        .timeout_global(Some(PATIENCE))
        // 4xx and 5xx are answers here, not errors.
        .http_status_as_error(false)
        .build()
        .into();
    let mut numbers: BTreeMap<(Kind, usize), u64> = BTreeMap::new();
    let mut due = Instant::now();
    let mut turn = 0_usize;
    while !shared.stop.load(Ordering::Relaxed) {
        let now = Instant::now();
        if now < due {
            std::thread::sleep(due - now);
        }
        // What could not be done in time is not made up for.
        due = due.max(now) + pause;
        let kind = if steers {
            Kind::Drive
        } else {
            // As often as in a fleet that is steered, set and asked; no two rounds are alike.
            match (turn / robots + turn) % 10 {
                0..4 => Kind::Set,
                4..6 => Kind::Identify,
                6..9 => Kind::Move,
                _ => Kind::Behave,
            }
        };
        let robot = turn % robots;
        turn += 1;
        let number = numbers.entry((kind, robot)).or_default();
        let given = give(&agent, url, &format!("sim-{:04}", robot + 1), kind, *number);
        *number += 1;
        let mut all = shared.given.lock().unwrap_or_else(PoisonError::into_inner);
        all.push((given, Instant::now()));
    }
}

fn give(agent: &ureq::Agent, url: &str, robot: &str, kind: Kind, number: u64) -> Given {
    let mut body = json!({ "command": kind.name() });
    let parameters = kind.parameters(number);
    if !parameters.is_null() {
        body["parameters"] = parameters;
    }
    let answer = agent
        .post(format!("{url}/api/v1/robots/{robot}/commands"))
        .send_json(&body);
    let mut given = Given {
        robot: robot.to_owned(),
        kind,
        mark: kind.mark(number),
        id: None,
        refused: false,
    };
    match answer {
        Ok(mut answer) if answer.status() == 202 => {
            // Acknowledged, whether or not the rest of the answer arrives.
            let view: Option<Value> = answer.body_mut().read_json().ok();
            let id = view.and_then(|view| Some(view["id"].as_str()?.to_owned()));
            given.id = Some(id.unwrap_or_default());
        }
        // Refused, or nobody listens: the server has not taken it.
        Ok(_) | Err(ureq::Error::ConnectionFailed) => given.refused = true,
        Err(ureq::Error::Io(error)) if error.kind() == std::io::ErrorKind::ConnectionRefused => {
            given.refused = true;
        }
        Err(_) => {}
    }
    given
}
