//! Robots with hidden bodies, calibrated in virtual time by what they tell and what a tracker sees of them.

use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use crawler_protocol::open::{Response, Telemetry};
use crawler_protocol::{Pose as Place, PoseFix, RobotId, RobotState, open};
use crawler_twin::body::{Parameters, Pose, Wheels, wrap};
use crawler_twin::course::Limits;
use crawler_twin::rehearsal::Sweep;
use crawler_twins::Twins;
use proptest::prelude::*;
use serde_json::json;
use tokio::time::Instant;

use crate::course::{Driving, Next, Seen};
use crate::ground::{Border, Ground, Room, Solid, Square, are_apart};
use crate::permit::{Refusal, of_drive, of_place, of_robot};
use crate::record::{Calibration, State};
use crate::robots::{Fleet, RobotView};
use crate::{BeginError, Calibrations, Clock, Free, NewCalibration, Parts, StopError};

/// Unix milliseconds at which the virtual time begins.
const BEGUN_MS: u64 = 1_700_000_000_000;
/// Radius of a robot, metres.
const RADIUS_M: f64 = 0.12;

fn id(name: &str) -> RobotId {
    RobotId::new(name).expect("a name")
}

fn well() -> RobotView {
    RobotView {
        is_online: true,
        is_doubled: false,
        drives: true,
        state: Some(RobotState::Idle),
        behaviour: None,
        boot: 3,
        firmware: "0.1.0".to_owned(),
        max_speed: Some(0.5),
        max_turn: Some(3.0),
        telemetry_hz: Some(5.0),
    }
}

/// A hidden body under the program that a robot has.
#[derive(Debug, Clone)]
struct Body {
    parameters: Parameters,
    wheels: Wheels,
    pose: Pose,
    duty: [f64; 2],
    word: (f64, f64),
    /// How long ago the word came, seconds.
    word_s: f64,
    /// Numbers for noise.
    state: u64,
}

impl Body {
    /// As the ranges are in which robots differ; `shares` say where in them, each −1 to 1.
    fn new(pose: Pose, shares: [f64; 6]) -> Self {
        let nominal = Parameters::NOMINAL;
        let [speed, left, right, friction, track, lag] = shares;
        let rim = |own: f64| 0.128 * (1.0 + 0.15 * speed) * (1.0 + 0.05 * own);
        let parameters = Parameters {
            speed_per_volt: [rim(left), rim(right)],
            friction_v: [0.7 * (1.0 + 0.3 * friction); 2],
            track_m: 0.14 * (1.0 + 0.05 * track),
            lag_straight_s: nominal.lag_straight_s * (1.0 + 0.3 * lag),
            lag_turn_s: nominal.lag_turn_s * (1.0 + 0.3 * lag),
            ..nominal
        };
        Self {
            parameters,
            wheels: Wheels::default(),
            pose,
            duty: [0.0; 2],
            word: (0.0, 0.0),
            word_s: 1e9,
            state: 0x9e37_79b9 ^ (speed.to_bits() >> 7),
        }
    }

    fn noise(&mut self) -> f64 {
        let mut sum = 0.0;
        for _ in 0..12 {
            self.state = self
                .state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            sum += (self.state >> 33) as f64 / (1_u64 << 31) as f64;
        }
        sum - 6.0
    }

    /// 20 ms. The words of whoever drives hold for half a second.
    fn step(&mut self) {
        self.word_s += 0.02;
        let (v, w) = if self.word_s < 0.5 {
            self.word
        } else {
            (0.0, 0.0)
        };
        let p = Parameters::NOMINAL;
        for (k, speed) in [v - 0.07 * w, v + 0.07 * w].into_iter().enumerate() {
            let motor = p.friction_v[0] + speed.abs().min(0.5) / p.speed_per_volt[0];
            let goal = if speed == 0.0 {
                0.0
            } else {
                motor / 6.2 * speed.signum()
            };
            let goal = if self.duty[k] * goal < 0.0 { 0.0 } else { goal };
            self.duty[k] += (goal - self.duty[k]).clamp(-0.05, 0.05);
        }
        for _ in 0..2 {
            let before = self.wheels;
            self.wheels.step(&self.parameters, self.duty, 7.6);
            let motion = self.wheels.motion(before, self.parameters.track_m);
            self.pose = self.pose.then(motion);
        }
    }

    fn stands(&self) -> bool {
        self.wheels.rims == [0.0; 2]
    }

    fn seen(&mut self) -> Place {
        let (x, y, theta) = (self.noise(), self.noise(), self.noise());
        Place {
            x: (self.pose.x + 0.01 * x) as f32,
            y: (self.pose.y + 0.01 * y) as f32,
            theta: wrap(self.pose.theta + 0.02 * theta) as f32,
            sigma: 0.01,
        }
    }
}

/// A robot, and what can happen to it.
struct Robot {
    id: RobotId,
    view: RobotView,
    body: Body,
    is_silent: bool,
    is_unseen: bool,
    /// Somebody pushes it, metres per second.
    pushed: f64,
    seq: u64,
    farthest: f64,
}

#[derive(Default)]
struct World {
    robots: Vec<Robot>,
    rates: Vec<f32>,
    told: Vec<(bool, String)>,
    ground: Ground,
    is_deaf: bool,
}

/// The fleet of a world.
#[derive(Default)]
struct Toy(Mutex<World>);

impl Toy {
    fn lock(&self) -> MutexGuard<'_, World> {
        self.0.lock().expect("no panic")
    }

    fn with<T>(&self, robot: &RobotId, change: impl FnOnce(&mut Robot) -> T) -> T {
        let mut world = self.lock();
        let robot = world.robots.iter_mut().find(|one| one.id == *robot);
        change(robot.expect("known"))
    }
}

impl Fleet for Toy {
    fn robot(&self, robot: &RobotId) -> Option<RobotView> {
        let world = self.lock();
        let found = world.robots.iter().find(|one| one.id == *robot)?;
        Some(found.view.clone())
    }

    fn others(&self, robot: &RobotId, _: [f64; 2]) -> Vec<(RobotId, [f64; 2])> {
        let world = self.lock();
        let others = world.robots.iter().filter(|one| one.id != *robot);
        others
            .map(|one| (one.id.clone(), [one.body.pose.x, one.body.pose.y]))
            .collect()
    }

    fn ground(&self, _: &RobotId, _: [f64; 2]) -> Ground {
        self.lock().ground.clone()
    }

    fn drive(&self, robot: &RobotId, v: f64, w: f64) -> bool {
        if self.lock().is_deaf {
            return false;
        }
        self.with(robot, |robot| {
            (robot.body.word, robot.body.word_s) = ((v, w), 0.0);
        });
        true
    }

    fn stop(&self, robot: &RobotId) {
        self.with(robot, |robot| robot.body.word_s = 1e9);
    }

    fn set_rate(&self, robot: &RobotId, hz: f32) {
        self.lock().rates.push(hz);
        self.with(robot, |robot| robot.view.telemetry_hz = Some(hz));
    }

    fn tell(&self, _: &RobotId, is_bad: bool, text: String) {
        self.lock().told.push((is_bad, text));
    }
}

/// A folder of its own, which goes with this.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("crawler-calibrations-{}-{number}", std::process::id());
        Self(std::env::temp_dir().join(name))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

struct Site {
    folder: Folder,
    toy: Arc<Toy>,
    twins: Arc<Twins>,
    calibrations: Arc<Calibrations>,
    clock: Clock,
}

fn room(side: f64) -> Room {
    Room {
        sides: [side; 2],
        solids: Vec::new(),
    }
}

impl Site {
    /// Robots of hidden bodies in the places of `starts`, followed by twins.
    async fn new(starts: &[Pose]) -> Self {
        let folder = Folder::new();
        let toy = Arc::new(Toy::default());
        toy.lock().ground.room = Some(room(8.0));
        for (number, start) in starts.iter().enumerate() {
            let share = |k: usize| ((number * 5 + k * 7) % 11) as f64 / 5.0 - 1.0;
            toy.lock().robots.push(Robot {
                id: id(&format!("ada-{}", number + 1)),
                view: well(),
                body: Body::new(*start, [0, 1, 2, 3, 4, 5].map(share)),
                is_silent: false,
                is_unseen: false,
                pushed: 0.0,
                seq: 0,
                farthest: 0.0,
            });
        }
        let begun = Instant::now();
        let now_ms = move || BEGUN_MS + begun.elapsed().as_millis() as u64;
        let clock: Clock = Arc::new(now_ms);
        let (twins, mut worker) = Twins::new(
            10,
            folder.0.join("twins"),
            (begun.into_std(), BEGUN_MS),
            |_: &RobotId| None,
        );
        let (world, heard) = (Arc::clone(&toy), Arc::clone(&twins));
        tokio::spawn(async move {
            let mut ticks = tokio::time::interval(Duration::from_millis(20));
            let mut tick = 0_u64;
            loop {
                ticks.tick().await;
                let now = Instant::now().into_std();
                for robot in &mut world.lock().robots {
                    robot.tick(tick, now_ms(), |told| match told {
                        Told::Telemetry(sample) => heard.telemetry(&sample, now).expect("room"),
                        Told::Fix(fix) => heard.fix(&fix, now).expect("room"),
                    });
                }
                tick += 1;
            }
        });
        tokio::spawn(async move {
            loop {
                worker.step(Instant::now().into_std(), now_ms());
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        });
        let calibrations = Self::open(&folder, &twins, &toy, &clock);
        let site = Self {
            folder,
            toy,
            twins,
            calibrations,
            clock,
        };
        for number in 1..=starts.len() {
            site.until("it is known where a robot is", || {
                let robot = id(&format!("ada-{number}"));
                let now = Instant::now().into_std();
                let state = site.twins.state(&robot, now, now_ms());
                state.is_ok_and(|state| {
                    let now = state.view.now;
                    of_place(now.sigma_m, now.sigma_rad, state.view.v).is_none()
                })
            })
            .await;
        }
        site
    }

    fn open(
        folder: &Folder,
        twins: &Arc<Twins>,
        toy: &Arc<Toy>,
        clock: &Clock,
    ) -> Arc<Calibrations> {
        Calibrations::open(Parts {
            folder: folder.0.join("calibrations"),
            twins: Arc::clone(twins),
            fleet: Arc::clone(toy) as Arc<dyn Fleet>,
            clock: Arc::clone(clock),
        })
    }

    /// Lets virtual time pass until it holds.
    async fn until(&self, what: &str, mut holds: impl FnMut() -> bool) {
        for _ in 0..20_000 {
            if holds() {
                return;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        panic!("never: {what}");
    }

    async fn begin(&self, robot: &RobotId) -> Result<Calibration, BeginError> {
        let asked = NewCalibration {
            by: "ada".to_owned(),
            floor: "lino".to_owned(),
            free: None,
        };
        self.calibrations.begin(robot, asked).await
    }

    fn now(&self, of: &Calibration) -> Calibration {
        self.calibrations.get(&of.robot, of.id).expect("kept")
    }

    /// Waits until a robot may begin.
    async fn ready(&self, robot: &RobotId) {
        for _ in 0..1_000 {
            let preview = self.calibrations.preview(robot, None).await.expect("known");
            if preview.refusal.is_none() {
                return;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        panic!("{robot} is never ready");
    }

    async fn over(&self, of: &Calibration) -> Calibration {
        self.until("it is over", || self.now(of).ended.is_some())
            .await;
        self.now(of)
    }

    fn has_certificate(&self, robot: &RobotId) -> bool {
        self.folder.0.join(format!("twins/{robot}.json")).exists()
    }
}

enum Told {
    Telemetry(Box<Telemetry>),
    Fix(Box<PoseFix>),
}

impl Robot {
    fn tick(&mut self, tick: u64, now_ms: u64, tell: impl Fn(Told)) {
        self.body.step();
        self.body.pose.x += self.pushed * 0.02;
        self.farthest = self.farthest.max(self.body.pose.x.hypot(self.body.pose.y));
        let hz = self.view.telemetry_hz.unwrap_or(5.0);
        let every = (50.0 / hz).ceil() as u64;
        if !self.is_silent && tick.is_multiple_of(every) {
            self.seq += 1;
            let [left, right] = self.body.duty;
            let sample = json!({
                "robot": self.id, "seq": self.seq, "timestamp": now_ms, "state": "IDLE", "behaviour": "manual",
                "pose": {"x": 0, "y": 0, "theta": 0, "sigma": 1}, "range_mm": null, "temperature_c": null,
                "wheels": {"left": left, "right": right}, "battery": {"mv": 7_600 + self.seq % 3, "percent": 80},
                "rssi_dbm": -50,
            });
            let sample = open::read::<Telemetry>(sample.to_string().as_bytes());
            tell(Told::Telemetry(Box::new(
                sample.expect("telemetry").message,
            )));
        }
        if !self.is_unseen && tick % 5 == 2 {
            tell(Told::Fix(Box::new(PoseFix {
                robot: self.id.clone(),
                timestamp: now_ms,
                pose: self.body.seen(),
            })));
        }
    }
}

fn answer(robot: &RobotId, source: &str, status: &str, reason: Option<&str>) -> Response {
    let text = json!({
        "robot": robot, "seq": 7, "status": status, "reason": reason, "timestamp": 1, "source": source,
    });
    let read = open::read::<Response>(text.to_string().as_bytes());
    read.expect("a response").message
}

#[tokio::test(start_paused = true)]
async fn a_robot_gets_a_certificate_that_its_twin_goes_on_with() {
    let site = Site::new(&[Pose::default()]).await;
    let robot = id("ada-1");
    let preview = site
        .calibrations
        .preview(&robot, None)
        .await
        .expect("known");
    assert_eq!(preview.refusal, None);
    let begun = site.begin(&robot).await.expect("permitted");
    assert_eq!((begun.state, begun.by.as_str()), (State::Preparing, "ada"));
    assert_eq!(begun.area, preview.area);
    let again = site.begin(&robot).await;
    assert!(
        matches!(again, Err(BeginError::Refused(Refusal::Busy))),
        "{again:?}"
    );
    let began = Instant::now();
    let mut states = vec![begun.state];
    site.until("it is over", || {
        let now = site.now(&begun);
        if states.last() != Some(&now.state) {
            states.push(now.state);
        }
        now.ended.is_some()
    })
    .await;
    let took = began.elapsed();
    let over = site.now(&begun);
    assert_eq!(over.state, State::Certified, "{over:?}");
    assert_eq!(
        states[..3],
        [State::Preparing, State::Baseline, State::HeldOut],
        "{states:?}"
    );
    assert!(took <= Duration::from_secs(90), "{took:?}");
    assert_eq!(over.legs[0], over.legs[1]);
    let [_, ten] = &over.errors[..] else {
        panic!("{over:?}");
    };
    assert!(
        ten.own[0] < 0.06 && ten.own[0] < ten.nominal[0] / 2.0,
        "{ten:?}"
    );
    assert!(ten.previous.is_none());
    // What was found is the hidden body, and the twin has it.
    let find = || site.twins.certificate(&robot, 1);
    site.until("the twin has it", || find().is_some()).await;
    let found = find().and_then(|found| found.certificate).expect("whole");
    assert_eq!(Some(found.id()), over.certificate.as_deref());
    assert_eq!(
        (found.about.floor.as_str(), found.about.build.as_str()),
        ("lino", "0.1.0")
    );
    let hidden = site.toy.with(&robot, |robot| robot.body.parameters);
    for duty in [0.4, 0.6, 0.8] {
        let (own, truth) = (
            found.parameters.settled(duty, 7.4),
            hidden.settled(duty, 7.4),
        );
        for k in 0..2 {
            assert!((own[k] / truth[k] - 1.0).abs() < 0.02, "{own:?}, {truth:?}");
        }
    }
    assert_eq!(site.toy.lock().rates, [20.0, 5.0]);
    let farthest = site.toy.with(&robot, |robot| robot.farthest);
    assert!(farthest < 1.0, "{farthest} m");
    assert!(site.toy.with(&robot, |robot| robot.body.stands()));
    let told = site.toy.lock().told.clone();
    assert!(
        matches!(&told[..], [(false, text)] if text.starts_with("calibrated: certificate ")),
        "{told:?}"
    );

    // The same robot once more is not better than itself: what there was stays.
    site.ready(&robot).await;
    let again = site.begin(&robot).await.expect("permitted");
    let again = site.over(&again).await;
    assert_eq!(again.state, State::Refused, "{again:?}");
    let reason = again.reason.expect("a reason");
    assert_eq!(reason.code, "not_better_than_previous");
    assert!(again.errors[0].previous.is_some() && again.certificate.is_none());
    assert_eq!(
        find()
            .and_then(|found| found.certificate)
            .expect("whole")
            .id(),
        found.id()
    );
    let list = site.calibrations.list(&robot);
    assert_eq!(list.iter().map(|one| one.id).collect::<Vec<_>>(), [2, 1]);
    assert_eq!(site.calibrations.active(), 0);
}

#[tokio::test(start_paused = true)]
async fn whatever_should_not_be_ends_it_and_the_robot_stands() {
    type Happens = fn(&Site, &RobotId);
    let cases: [(&str, Happens); 12] = [
        ("stopped", |site, robot| {
            let id = site.calibrations.list(robot)[0].id;
            site.calibrations
                .stop(robot, id, "eve")
                .expect("it goes on");
        }),
        ("other_command", |site, robot| {
            site.toy.stop(robot);
            site.calibrations
                .answer(&answer(robot, "operator:eve", "completed", None));
        }),
        ("other_command", |site, robot| {
            site.toy.with(robot, |robot| {
                robot.view.behaviour = Some("wander".to_owned());
            });
        }),
        ("robot_refused", |site, robot| {
            site.calibrations
                .answer(&answer(robot, "calibration", "rejected", Some("blocked")));
        }),
        ("left_area", |site, robot| {
            site.toy.with(robot, |robot| robot.pushed = 0.6);
        }),
        ("jumped", |site, robot| {
            site.toy.with(robot, |robot| robot.body.pose.y += 1.0);
        }),
        ("tracker_lost", |site, robot| {
            site.toy.with(robot, |robot| robot.is_unseen = true);
        }),
        ("link_lost", |site, robot| {
            site.toy.with(robot, |robot| robot.is_silent = true);
        }),
        ("link_lost", |site, _| site.toy.lock().is_deaf = true),
        ("halted", |site, robot| {
            site.toy
                .with(robot, |robot| robot.view.state = Some(RobotState::Error));
        }),
        ("restarted", |site, robot| {
            site.toy.with(robot, |robot| robot.view.boot += 1);
        }),
        ("robot_near", |site, robot| {
            let at = site.toy.with(robot, |robot| robot.body.pose);
            site.toy.with(&id("ada-2"), |other| {
                other.body.pose = Pose {
                    x: at.x + 0.5,
                    ..at
                }
            });
        }),
    ];
    for (reason, happens) in cases {
        let far = Pose {
            x: 3.0,
            ..Pose::default()
        };
        let site = Site::new(&[Pose::default(), far]).await;
        let robot = id("ada-1");
        let begun = site.begin(&robot).await.expect("permitted");
        // In the middle of a leg.
        site.until("it drives", || {
            let now = site.now(&begun);
            now.legs[0] > 4 && !site.toy.with(&robot, |robot| robot.body.stands())
        })
        .await;
        // What moves nobody is in nobody's way.
        for harmless in ["map", "settings", "calibration"] {
            site.calibrations
                .answer(&answer(&robot, harmless, "completed", None));
        }
        site.calibrations
            .answer(&answer(&robot, "operator:eve", "rejected", Some("busy")));
        happens(&site, &robot);
        let over = site.over(&begun).await;
        assert_eq!(over.state, State::BrokenOff, "{reason}: {over:?}");
        assert_eq!(over.reason.expect("a reason").code, reason);
        let at = Instant::now();
        site.until("it stands", || {
            site.toy.with(&robot, |robot| robot.body.stands())
        })
        .await;
        assert!(
            at.elapsed() <= Duration::from_secs(1),
            "{reason}: {:?}",
            at.elapsed()
        );
        assert!(!site.has_certificate(&robot), "{reason}");
        assert_eq!(site.toy.lock().rates, [20.0, 5.0], "{reason}");
        assert_eq!(
            site.calibrations.stop(&robot, begun.id, "eve"),
            Err(StopError::Over)
        );
        assert_eq!(
            site.calibrations.stop(&robot, 99, "eve"),
            Err(StopError::Unknown)
        );
        let told = site.toy.lock().told.clone();
        assert!(
            matches!(&told[..], [(true, text)] if text.starts_with("calibration broken off: ")),
            "{told:?}"
        );
    }
}

#[tokio::test(start_paused = true)]
async fn too_little_to_see_begins_nothing() {
    let site = Site::new(&[Pose::default()]).await;
    let robot = id("ada-1");
    let begun = site.begin(&robot).await.expect("permitted");
    // It does not obey the quicker rate.
    site.until("it is told", || !site.toy.lock().rates.is_empty())
        .await;
    site.toy
        .with(&robot, |robot| robot.view.telemetry_hz = Some(5.0));
    let over = site.over(&begun).await;
    assert_eq!(over.reason.expect("a reason").code, "too_little");
    assert_eq!(over.legs[0], 0);
    assert!(site.toy.with(&robot, |robot| robot.farthest) < 0.01);
}

#[tokio::test(start_paused = true)]
async fn a_robot_that_is_held_gets_no_certificate() {
    let site = Site::new(&[Pose::default()]).await;
    let robot = id("ada-1");
    let begun = site.begin(&robot).await.expect("permitted");
    // Somebody's hand: its wheels are told to turn, and do not.
    site.toy
        .with(&robot, |robot| robot.body.parameters.friction_v = [9.0; 2]);
    let over = site.over(&begun).await;
    assert_eq!(over.state, State::Refused, "{over:?}");
    let reason = over.reason.expect("a reason").code;
    assert!(
        ["unidentified", "tracker_doubted", "nothing_held_out"].contains(&reason.as_str()),
        "{reason}"
    );
    assert!(!site.has_certificate(&robot));
}

#[tokio::test(start_paused = true)]
async fn a_server_that_was_killed_says_so_when_it_is_back() {
    let site = Site::new(&[Pose::default()]).await;
    let robot = id("ada-1");
    let begun = site.begin(&robot).await.expect("permitted");
    site.until("it drives", || site.now(&begun).legs[0] > 2)
        .await;
    // Another one on the same folder finds what the first would have left behind.
    let later = Site::open(&site.folder, &site.twins, &site.toy, &site.clock);
    let found = later.get(&robot, begun.id).expect("kept");
    assert_eq!(found.state, State::BrokenOff);
    assert_eq!(found.reason.expect("a reason").code, "server_ended");
    assert!(found.ended.is_some());
    assert_eq!(site.toy.lock().rates, [20.0, 5.0], "its rate is set back");
    assert_eq!(later.active(), 0);
    assert!(!site.has_certificate(&robot));
    // One that is told to end stops its robots first.
    site.calibrations.end().await;
    let over = site.now(&begun);
    assert_eq!(over.reason.expect("a reason").code, "server_ended");
    site.until("it stands", || {
        site.toy.with(&robot, |robot| robot.body.stands())
    })
    .await;
    let refused = site.begin(&robot).await;
    assert!(matches!(refused, Err(BeginError::Stopping)), "{refused:?}");
}

#[tokio::test(start_paused = true)]
async fn robots_that_are_clear_of_each_other_go_at_the_same_time() {
    let at = |x: f64, y: f64| Pose { x, y, theta: 0.3 };
    let site = Site::new(&[at(-1.5, 0.0), at(1.5, 0.0), at(0.0, 0.2)]).await;
    let [one, two, middle] = ["ada-1", "ada-2", "ada-3"].map(id);
    let first = site.begin(&one).await.expect("permitted");
    let second = site.begin(&two).await.expect("permitted");
    let third = site.begin(&middle).await;
    assert!(
        matches!(&third, Err(BeginError::Refused(why)) if why.is_for_now()),
        "{third:?}"
    );
    assert_eq!(site.calibrations.active(), 2);
    for begun in [first, second] {
        let over = site.over(&begun).await;
        assert_eq!(over.state, State::Certified, "{over:?}");
    }
    site.ready(&middle).await;
    let third = site.begin(&middle).await.expect("its turn");
    assert_eq!(site.over(&third).await.state, State::Certified);
}

#[tokio::test(start_paused = true)]
async fn what_is_against_it_is_told_by_name() {
    let site = Site::new(&[Pose::default()]).await;
    let robot = id("ada-1");
    let refused = async || {
        let preview = site
            .calibrations
            .preview(&robot, None)
            .await
            .expect("known");
        preview.refusal.map(|refusal| refusal.name())
    };
    assert_eq!(refused().await, None);
    site.toy
        .with(&robot, |robot| robot.view.max_speed = Some(0.2));
    assert_eq!(refused().await, Some("too_slow"));
    site.toy.with(&robot, |robot| robot.view = well());
    site.toy.lock().ground.room = None;
    assert_eq!(refused().await, Some("no_area"));
    let free = |half: f64| {
        let (calibrations, robot) = (Arc::clone(&site.calibrations), robot.clone());
        async move {
            let free = Free::Around(half);
            let preview = calibrations
                .preview(&robot, Some(&free))
                .await
                .expect("known");
            preview.refusal.map(|refusal| refusal.name())
        }
    };
    assert_eq!(free(1.5).await, None);
    assert_eq!(free(0.8).await, Some("leaves"));
    site.toy.lock().robots.push(Robot {
        id: id("bob-1"),
        view: well(),
        body: Body::new(
            Pose {
                x: 0.9,
                ..Pose::default()
            },
            [0.0; 6],
        ),
        is_silent: true,
        is_unseen: true,
        pushed: 0.0,
        seq: 0,
        farthest: 0.0,
    });
    assert_eq!(free(1.5).await, Some("near_robot"));
    let nobody = site.begin(&id("eve-1")).await;
    assert!(
        matches!(nobody, Err(BeginError::UnknownRobot)),
        "{nobody:?}"
    );
    let unfollowed = site.begin(&id("bob-1")).await;
    assert!(
        matches!(&unfollowed, Err(BeginError::Refused(Refusal::NoTwin(_)))),
        "{unfollowed:?}"
    );
}

#[test]
fn what_is_against_a_robot() {
    let with = |change: fn(&mut RobotView)| {
        let mut view = well();
        change(&mut view);
        of_robot(&view).map(|refusal| refusal.name())
    };
    assert_eq!(with(|_| {}), None);
    assert_eq!(with(|view| view.is_online = false), Some("offline"));
    assert_eq!(with(|view| view.is_doubled = true), Some("doubled"));
    assert_eq!(with(|view| view.drives = false), Some("cannot_drive"));
    assert_eq!(
        with(|view| view.state = Some(RobotState::Error)),
        Some("halted")
    );
    assert_eq!(
        with(|view| view.state = Some(RobotState::Moving)),
        Some("not_idle")
    );
    assert_eq!(
        with(|view| view.state = Some(RobotState::Updating)),
        Some("not_idle")
    );
    assert_eq!(with(|view| view.state = None), Some("not_idle"));
    assert_eq!(
        with(|view| view.behaviour = Some("goto".to_owned())),
        Some("not_idle")
    );
    assert_eq!(with(|view| view.max_turn = Some(1.0)), Some("too_slow"));
    assert_eq!(
        with(|view| (view.max_speed, view.max_turn) = (None, None)),
        None
    );
    assert!(of_place(0.01, 0.02, 0.0).is_none());
    for (sigma_m, sigma_rad, speed) in [
        (0.2, 0.02, 0.0),
        (0.01, 0.5, 0.0),
        (0.01, 0.02, 0.3),
        (f64::NAN, 0.02, 0.0),
    ] {
        assert_eq!(of_place(sigma_m, sigma_rad, speed), Some(Refusal::Unsure));
    }
}

fn fence(keeps_in: bool, x: f64, y: f64, half: f64) -> Border {
    let middle = [x, y];
    Border {
        name: "yard".to_owned(),
        keeps_in,
        region: Arc::new(Square { middle, half }),
    }
}

fn square(x: f64, y: f64, half: f64) -> [[f64; 2]; 4] {
    [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(a, b)| [x + a * half, y + b * half])
}

#[test]
fn ground_is_what_fences_walls_and_posts_leave() {
    let bounded = |ground: &Ground| ground.is_bounded();
    let mut ground = Ground::default();
    assert!(!bounded(&ground));
    ground.fences = vec![fence(false, 5.0, 0.0, 1.0)];
    assert!(!bounded(&ground), "a fence to stay out of keeps nobody in");
    ground.fences.push(fence(true, 0.0, 0.0, 8.0));
    assert!(bounded(&ground));
    let against = |ground: &Ground, x: f64, y: f64| ground.against([x, y]);
    assert_eq!(against(&ground, 0.0, 0.0), None);
    assert!(against(&ground, 3.8, 0.0).is_some_and(|what| what.contains("yard")));
    assert!(against(&ground, 7.8, 7.0).is_some());
    ground.room = Some(Room {
        sides: [4.0, 4.0],
        solids: vec![Solid {
            at: [1.0, 1.0],
            half: [0.5, 0.05],
            theta: std::f64::consts::FRAC_PI_2,
            radius: 0.0,
        }],
    });
    assert_eq!(against(&ground, 1.8, 0.0).as_deref(), Some("a wall"));
    assert_eq!(
        against(&ground, 1.3, 1.4).as_deref(),
        Some("what stands at 1.00, 1.00")
    );
    assert_eq!(against(&ground, 1.45, 1.0), None);
    assert!(are_apart(
        &square(0.0, 0.0, 1.0),
        &square(3.0, 0.0, 1.0),
        0.9
    ));
    assert!(!are_apart(
        &square(0.0, 0.0, 1.0),
        &square(3.0, 0.0, 1.0),
        1.1
    ));
    assert!(!are_apart(
        &square(0.0, 0.0, 1.0),
        &square(0.5, 0.2, 0.1),
        0.0
    ));
}

/// A robot drives a whole course by what [`Driving`] says; the first place that is against the ground, and the last word.
fn drive(body: &mut Body, ground: &Ground, limits: Limits, seed: u64) -> (Option<String>, Next) {
    let sweep = Arc::new(Sweep::of(limits, (0.025, 0.075)));
    let mut driving = Driving::new(body.pose, sweep, limits, (seed, 3), 0.0);
    let mut fix = None;
    for tick in 0_u64.. {
        let now_s = tick as f64 * 0.02;
        body.step();
        if tick % 5 == 0 {
            let place = body.seen();
            fix = Some(crawler_twin::evidence::Fix {
                at_s: now_s,
                arrived_s: Some(now_s),
                x: place.x.into(),
                y: place.y.into(),
                theta: place.theta.into(),
                sigma_m: 0.01,
            });
        }
        let mut room = ground.clone();
        // The body itself must be within, not what it is kept clear by.
        for side in room.room.iter_mut().flat_map(|room| &mut room.sides) {
            *side += 2.0 * (crate::ground::CLEAR_M - RADIUS_M);
        }
        if let Some(what) = room.against([body.pose.x, body.pose.y]) {
            return (Some(what), Next::Wait);
        }
        let next = driving.step(&Seen {
            now_s,
            fix,
            told_s: Some(now_s),
            recent: (40, 20),
            robot: Some(well()),
            others: Vec::new(),
        });
        match next {
            Next::Drive { v, w } => (body.word, body.word_s) = ((v, w), 0.0),
            Next::Stand => body.word_s = 1e9,
            Next::Wait => {}
            Next::Driven { .. } | Next::Broken(_) => return (None, next),
        }
    }
    unreachable!("it ends");
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..crawler_properties::cases(24) })]

    /// Wherever it is permitted, no robot gets to the edge of what it is permitted in, nor has it to be stopped there.
    #[test]
    fn whoever_is_permitted_stays_within(
        shares in proptest::array::uniform6(-1.0..1.0_f64),
        side in 2.0..3.2_f64,
        (x, y, theta) in (-0.6..0.6_f64, -0.6..0.6_f64, -3.0..3.0_f64),
        seed in any::<u64>(),
    ) {
        let limits = Limits { v: 0.5, w: 3.0 };
        let start = Pose { x, y, theta };
        let ground = Ground { room: Some(room(side)), ..Ground::default() };
        let sweep = Sweep::of(limits, (0.025, 0.075));
        if let Some(refusal) = of_drive(&sweep, start, &ground, &[]) {
            // And where it is not, the place that is named is swept, and too near to a wall.
            let at = refusal.at().expect("a place");
            prop_assert!(sweep.holds(start, at, 1e-6) && ground.against(at).is_some());
            return Ok(());
        }
        let (left, last) = drive(&mut Body::new(start, shares), &ground, limits, seed);
        prop_assert_eq!(left, None);
        prop_assert!(matches!(last, Next::Driven { .. }), "{:?}", last);
    }
}
