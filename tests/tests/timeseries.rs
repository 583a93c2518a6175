//! History in time-series engines: it is that of the local history, survives an engine that goes away,
//! and says what is wrong.

mod samples;
mod server;

use std::collections::BTreeSet;
use std::future::Future;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crawler_history::{Frame, History, Point, Points, Recorded, Sample};
use crawler_protocol::RobotId;
use crawler_records::Records;
use crawler_tests::engines::influx::{ADMIN, Influx};
use crawler_tests::engines::victoria::Victoria;
use crawler_timeseries::{BATCH, EngineError, Product, QUEUE, Remote, SPARSE_ROWS, State, look};

use samples::{Dice, alike, sample, walk};

const PATIENCE: Duration = Duration::from_mins(2);
const MINUTE: i64 = 60_000;

fn now() -> i64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.expect("after 1970").as_millis() as i64
}

fn remote(url: &str, queue: usize) -> Remote {
    Remote::start(url.parse().expect("an address"), "swarm", queue).expect("begins")
}

/// Asks every 50 ms until there is an answer.
async fn eventually<T, F: Future<Output = Option<T>>>(what: &str, mut ask: impl FnMut() -> F) -> T {
    let asking = async {
        loop {
            if let Some(found) = ask().await {
                return found;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    let found = tokio::time::timeout(PATIENCE, asking).await;
    found.unwrap_or_else(|_| panic!("gave up: {what}"))
}

async fn flushed(remote: &Remote) {
    let flushed = tokio::time::timeout(PATIENCE, remote.flush()).await;
    let stats = remote.stats();
    flushed
        .unwrap_or_else(|_| panic!("not written: {stats:?} {:?}", remote.state()))
        .expect("it is open");
}

/// How many samples of `robot` the engine knows.
async fn count(remote: &Remote, robot: &RobotId, from: i64) -> u64 {
    let points = remote.query(robot, from, from + 24 * 60 * MINUTE, MINUTE * 60);
    points
        .await
        .map_or(0, |points| points.iter().map(|point| point.count).sum())
}

async fn counted(remote: &Remote, robot: &RobotId, from: i64, wanted: u64) {
    eventually(&format!("{wanted} samples of {robot}"), async || {
        (count(remote, robot, from).await == wanted).then_some(())
    })
    .await;
}

/// Puts `question` to an engine and to the local history. The engine answers as a fold of the samples
/// does. The local history has rounded the means of seconds and minutes, and keeps those whole: it is
/// asked where a step is made of them.
async fn compare(local: &History, remote: &Remote, lot: &Lot, (from, to, step): (i64, i64, i64)) {
    let Lot { robot, samples } = lot;
    let name = remote.engine().expect("it was there").product;
    let question = format!("{name}: {robot} {from}..{to} by {step}");
    let found = remote.query(robot, from, to, step).await;
    let mut wanted = match Points::new(from, to, step) {
        Ok(wanted) => wanted,
        Err(why) => {
            assert_eq!(
                found,
                Err(EngineError::Invalid(why.to_string())),
                "{question}"
            );
            return;
        }
    };
    for sample in samples {
        wanted.add(sample);
    }
    let found = found.unwrap_or_else(|error| panic!("{question}: {error}"));
    let same = |wanted: &[Point], by: f32| {
        let times = |points: &[Point]| points.iter().map(|point| point.at).collect::<Vec<_>>();
        assert_eq!(times(wanted), times(&found), "{question}");
        for (wanted, found) in wanted.iter().zip(&found) {
            alike(wanted, found, by)
                .unwrap_or_else(|why| panic!("{question} at {}: {why}", wanted.at));
        }
    };
    same(&wanted.finish(), 0.0);
    if step < 1_000 || step % MINUTE == 0 || step < MINUTE && step % 1_000 == 0 {
        same(
            &local.query(robot, from, to, step).await.expect("an answer"),
            1.0,
        );
    }
}

/// Samples of one robot.
struct Lot {
    robot: RobotId,
    samples: Vec<Sample>,
}

#[tokio::test(flavor = "multi_thread")]
async fn engines_answer_as_the_local_history_does() {
    let (influx, victoria) = (Influx::start(), Victoria::start());
    let records = Records::in_memory().await.expect("records");
    let local = records.history();
    let engines =
        [&influx.url("my fleet"), &victoria.url("my fleet")].map(|url| remote(url, QUEUE));
    let begin = now() - 150 * MINUTE;
    let mut lots = Vec::new();
    for seed in 1..=4 {
        let robot = RobotId::new(&format!("sim-{seed}")).expect("a robot id");
        let walk = walk(
            &robot,
            begin + seed as i64 * 777,
            20 * MINUTE,
            &mut Dice(seed),
        );
        lots.push(Lot {
            robot,
            samples: walk,
        });
    }
    // More rows than are read as they are.
    let dense = RobotId::new("dense").expect("a robot id");
    let mut dice = Dice(99);
    let samples = (0..SPARSE_ROWS as i64 + 500)
        .map(|n| sample(&dense, begin + n * 60, &mut dice))
        .collect();
    lots.push(Lot {
        robot: dense,
        samples,
    });
    // Now, where an engine may not have settled yet.
    let fresh = RobotId::new("fresh").expect("a robot id");
    let recent = walk(&fresh, now() - 20_000, 19_000, &mut Dice(7));
    let recent_from = recent[0].at - 1;
    lots.push(Lot {
        robot: fresh,
        samples: recent,
    });
    for one in lots.iter().flat_map(|lot| &lot.samples) {
        local.push(one.clone()).expect("room");
        for remote in &engines {
            remote.push(one.clone()).expect("room");
        }
    }
    local.settle().await.expect("settled");
    for remote in &engines {
        flushed(remote).await;
        for Lot { robot, samples } in &lots {
            counted(remote, robot, begin - MINUTE, samples.len() as u64).await;
        }
        let [.., dense, fresh] = lots.as_slice() else {
            panic!("there are more");
        };
        let stats = remote.stats();
        assert_eq!((stats.dropped, stats.refused), (0, 0), "{stats:?}");
        assert_eq!(stats.written, stats.accepted);
        for seed in 1..=4_u64 {
            let lot = &lots[seed as usize - 1];
            let mut dice = Dice(seed + 1_000);
            for step in [
                1, 130, 500, 999, 1_000, 1_700, 10_000, 60_000, 61_000, 3_600_000,
            ] {
                let places = (step * 1_900).min(30 * MINUTE) as u64;
                let from = begin - 5_000 + dice.below(10 * MINUTE as u64) as i64;
                let to = from + 1 + dice.below(places) as i64;
                compare(local, remote, lot, (from, to, step)).await;
            }
            // The edges: one sample, and the moment behind it.
            let at = lot.samples[lot.samples.len() / 2].at;
            compare(local, remote, lot, (at, at + 1, 1)).await;
            compare(local, remote, lot, (at + 1, at + 2, 7)).await;
            compare(local, remote, lot, (at - 1, at, 1_000)).await;
            compare(local, remote, lot, (at, at, 1)).await;
            // As far as a question can reach, with and without samples.
            compare(local, remote, lot, (0, i64::MAX, i64::MAX / 360)).await;
            compare(local, remote, lot, (0, now(), now() / 360)).await;
            compare(local, remote, lot, (i64::MAX - 5, i64::MAX, 1)).await;
            compare(local, remote, lot, (0, at, 1)).await;
            compare(local, remote, lot, (at - 10, at, 0)).await;
        }
        for step in [1_000, 7_000, 60_000] {
            compare(local, remote, dense, (begin + 3, begin + 25 * MINUTE, step)).await;
        }
        for step in [100, 1_000, 60_000] {
            compare(local, remote, fresh, (recent_from, now(), step)).await;
        }
        let nobody = Lot {
            robot: RobotId::new("nobody").expect("a robot id"),
            samples: Vec::new(),
        };
        compare(local, remote, &nobody, (begin, begin + MINUTE, 1_000)).await;
        whole(local, remote, &lots, begin).await;
        remote.close().await;
        assert_eq!(remote.state(), State::Down(EngineError::Closed));
    }
    let fleet = remote(&influx.url("my fleet"), 10);
    eventually("it is met", async || fleet.engine()).await;
    let product = fleet.engine().map(|engine| engine.product);
    assert!(
        matches!(&product, Some(Product::InfluxDb(version)) if version.starts_with("1.")),
        "{product:?}"
    );
    records.close().await;
}

/// What an engine says of all robots together is what it says of each, and what the local history has.
async fn whole(local: &History, remote: &Remote, lots: &[Lot], begin: i64) {
    let known: BTreeSet<RobotId> = lots.iter().map(|lot| lot.robot.clone()).collect();
    eventually("all robots are known", async || {
        (remote.robots().await.as_ref() == Ok(&known)).then_some(())
    })
    .await;
    let times = || lots.iter().flat_map(|lot| &lot.samples).map(|one| one.at);
    let ends = Recorded {
        from: times().min().expect("samples"),
        to: times().max().expect("samples"),
    };
    eventually("first and last sample are known", async || {
        (remote.recorded().await == Ok(Some(ends))).then_some(())
    })
    .await;
    // Some of them, and one that nobody knows.
    let nobody = RobotId::new("nobody").expect("a robot id");
    let mut some: BTreeSet<_> = known.iter().skip(1).cloned().collect();
    some.insert(nobody);
    for robots in [&known, &some, &BTreeSet::new()] {
        let (from, to, step) = (begin, begin + 25 * MINUTE, 5_000);
        let found = remote.frames(robots, from, to, step).await.expect("frames");
        let wanted = local.frames(robots, from, to, step).await.expect("frames");
        assert_eq!(found.len(), wanted.len());
        for (found, wanted) in found.iter().zip(&wanted) {
            assert_eq!(found.robot, wanted.robot);
            let at = |frames: &[Frame]| -> Vec<_> {
                frames.iter().map(|frame| (frame.at, frame.state)).collect()
            };
            assert_eq!(at(&found.frames), at(&wanted.frames), "{}", found.robot);
            for (found, wanted) in found.frames.iter().zip(&wanted.frames) {
                let off = (found.x - wanted.x).abs().max((found.y - wanted.y).abs());
                assert!(off < 0.002, "{found:?} is not {wanted:?}");
                assert!(
                    (found.theta - wanted.theta).abs() < 1e-5,
                    "{found:?} {wanted:?}"
                );
                assert_eq!(found.range_mm.is_some(), wanted.range_mm.is_some());
            }
        }
    }
    let refused = remote.frames(&known, begin, begin + 1, 0).await;
    assert!(
        matches!(refused, Err(EngineError::Invalid(_))),
        "{refused:?}"
    );
}

/// Pushes `lots` while the engine is away: what has room waits, the rest is counted.
async fn outage(remote: &Remote, robot: &RobotId, begin: i64, queue: usize) {
    let mut dice = Dice(3);
    for n in 0..queue as i64 {
        let one = sample(robot, begin + 1_000 + n, &mut dice);
        remote.push(one).expect("room");
    }
    for n in 0..500 {
        let one = sample(robot, begin + 900_000 + n, &mut dice);
        remote.push(one).expect_err("no room");
    }
    eventually("it is away", async || {
        let state = remote.state();
        matches!(state, State::Down(EngineError::Unreachable(_))).then_some(())
    })
    .await;
    let stats = remote.stats();
    assert_eq!(
        (stats.queued, stats.dropped),
        (queue as u64, 500),
        "{stats:?}"
    );
    assert!(stats.failures > 0 && !stats.up, "{stats:?}");
    let asked = remote.query(robot, begin, begin + MINUTE, 1_000).await;
    assert!(
        matches!(asked, Err(EngineError::Unreachable(_))),
        "{asked:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn what_waits_for_an_engine_is_bounded_and_arrives() {
    const QUEUE: usize = 2 * BATCH + 17;
    let (mut influx, mut victoria) = (Influx::start(), Victoria::start());
    let (one, other) = (
        remote(&influx.url("a"), QUEUE),
        remote(&victoria.url("a"), QUEUE),
    );
    let robot = RobotId::new("sim-1").expect("a robot id");
    let begin = now() - 30 * MINUTE;
    for remote in [&one, &other] {
        let mut dice = Dice(1);
        for n in 0..100 {
            remote
                .push(sample(&robot, begin + n, &mut dice))
                .expect("room");
        }
        flushed(remote).await;
        counted(remote, &robot, begin, 100).await;
    }
    influx.kill();
    victoria.stop();
    for remote in [&one, &other] {
        outage(remote, &robot, begin, QUEUE).await;
    }
    influx.resume();
    victoria.resume();
    for remote in [&one, &other] {
        flushed(remote).await;
        counted(remote, &robot, begin, 100 + QUEUE as u64).await;
        let stats = remote.stats();
        assert_eq!(
            (stats.dropped, stats.refused, stats.queued),
            (500, 0, 0),
            "{stats:?}"
        );
        assert!(stats.up, "{stats:?}");
    }
    // An engine that is away at the end: what waits is counted, and the end comes.
    influx.kill();
    let mut dice = Dice(2);
    for n in 0..10 {
        one.push(sample(&robot, begin + n, &mut dice))
            .expect("room");
    }
    one.close().await;
    assert_eq!(one.stats().dropped, 510);
    one.push(sample(&robot, begin, &mut dice))
        .expect_err("closed");
    assert_eq!(one.flush().await, Err(EngineError::Closed));
    other.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_engine_that_does_not_let_us_in_says_so() {
    let influx = Influx::start_guarded();
    let at = |login: &str| format!("influx://{login}127.0.0.1:{}/fleet", influx.port());
    let down = async |url: &str| {
        let remote = remote(url, 10);
        let robot = RobotId::new("sim-1").expect("a robot id");
        remote
            .push(sample(&robot, now(), &mut Dice(1)))
            .expect("room");
        let error = eventually("it is refused", async || match remote.state() {
            State::Down(error) => Some(error),
            _ => None,
        })
        .await;
        // Nothing is wrong with the sample: it waits for who can help.
        assert_eq!(remote.stats().queued, 1);
        error
    };
    for login in ["", "ada:wrong@", "nobody:x@"] {
        let error = down(&at(login)).await;
        assert!(matches!(error, EngineError::Denied(_)), "{login}: {error}");
        let seen = look(&at(login).parse().expect("an address")).await;
        assert!(
            matches!(seen, Err(EngineError::Denied(_))),
            "{login}: {seen:?}"
        );
    }
    let (name, password) = ADMIN;
    let admin = at(&format!("{name}:{}@", password.replace(' ', "%20")));
    let seen = look(&admin.parse().expect("an address")).await;
    assert!(matches!(seen, Err(EngineError::NoDatabase(_))), "{seen:?}");

    // The administrator makes the database, and is let in.
    let remote = remote(&admin, 10);
    eventually("it is let in", async || {
        (remote.state() == State::Up).then_some(())
    })
    .await;
    let seen = look(&admin.parse().expect("an address"))
        .await
        .expect("there");
    assert!(matches!(seen.product, Product::InfluxDb(_)), "{seen:?}");
    remote.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_batch_that_is_refused_is_counted_and_not_sent_again() {
    let influx = Influx::start();
    assert_eq!(influx.statement("CREATE DATABASE fleet").0, 200);
    // Somebody else's measurement of the same name, with another type.
    let at = now();
    let line = format!("telemetry,fleet=swarm,robot=sim-1 x=7i {at}");
    assert_eq!(influx.write("fleet", &line).0, 204);
    let remote = remote(&influx.url("fleet"), 100);
    let robot = RobotId::new("sim-1").expect("a robot id");
    for n in 0..3 {
        remote
            .push(sample(&robot, at + n, &mut Dice(1)))
            .expect("room");
    }
    flushed(&remote).await;
    let stats = remote.stats();
    assert_eq!(
        (stats.refused, stats.written, stats.queued),
        (3, 0, 0),
        "{stats:?}"
    );
    // The engine as such is well.
    assert!(stats.up && stats.failures == 0, "{stats:?}");
    remote.close().await;
}
