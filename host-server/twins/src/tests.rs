//! Twins in virtual time: robots of the reference reality, heard as a server hears them.

#[path = "../../twin/tests/suite/reference.rs"]
mod reference;

use std::fs;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crawler_protocol::{Pose, RobotId};
use crawler_twin::certificate::{About, Certificate, certify};
use crawler_twin::detect::FaultName;
use crawler_twin::evidence::{Duty, Fix, Row, Supply};
use proptest::prelude::*;

use crate::folder::Refusal;
use crate::inbox::{Evidence, MOST_WAITING};
use crate::notice::Notice;
use crate::{Fleet, NoTwin, Room, Solid, Twins, Worker};
use reference::{CALIBRATING, Hidden, Random, Rates, anyhow, calibration, drive};

/// Unix milliseconds at which a test begins.
const EPOCH_MS: u64 = 1_800_000_000_000;
const RATES: Rates = Rates {
    telemetry: 5,
    fixes: 2,
};

/// A folder of its own, which goes with it.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path =
            std::env::temp_dir().join(format!("crawler-twins-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.0.join(name), text).expect("written");
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Twins, and what they told so far, with the second at which they did.
struct Stage {
    twins: Arc<Twins>,
    worker: Worker,
    begun: Instant,
    program: Arc<Mutex<Option<String>>>,
    told: Vec<(f64, Notice)>,
    now_s: f64,
    mv: u16,
}

impl Stage {
    fn new(most: usize, folder: PathBuf) -> Self {
        let program = Arc::new(Mutex::new(None));
        let known = Arc::clone(&program);
        let fleet = move |_: &RobotId| known.lock().expect("a program").clone();
        Self {
            program,
            ..Self::of(most, folder, fleet)
        }
    }

    fn of(most: usize, folder: PathBuf, fleet: impl Fleet) -> Self {
        let begun = Instant::now();
        let (twins, worker) = Twins::new(most, folder, (begun, EPOCH_MS), fleet);
        Self {
            twins,
            worker,
            begun,
            program: Arc::default(),
            told: Vec::new(),
            now_s: 0.0,
            mv: 0,
        }
    }

    /// Without a folder for certificates.
    fn bare(most: usize) -> Self {
        Self::new(most, PathBuf::from("/nonexistent/twins"))
    }

    fn at(&self, second: f64) -> Instant {
        self.begun + Duration::from_secs_f64(second)
    }

    /// Lets rounds pass, a quarter of a second each.
    fn until(&mut self, second: f64) {
        while self.now_s + 0.25 <= second {
            self.now_s += 0.25;
            let now_s = self.now_s;
            let notices = self.worker.step(self.at(now_s), unix_ms(now_s));
            let told = notices.into_iter().map(|notice| (now_s, notice));
            self.told.extend(told);
        }
    }

    fn hear(&mut self, robot: &RobotId, row: &Row) {
        let arrived_s = row.arrived_s().expect("an arrival");
        self.until(arrived_s);
        let (at_s, evidence) = match row {
            Row::Duty(Duty { at_s, duty, .. }) => {
                let (duty, mv) = (duty.map(|duty| duty as f32), self.mv);
                (at_s, Evidence::Sample { duty, mv })
            }
            Row::Supply(Supply { volts, .. }) => {
                self.mv = (volts * 1e3) as u16;
                return;
            }
            Row::Fix(fix) => (&fix.at_s, Evidence::Fix(pose(fix))),
        };
        let put = self
            .twins
            .put(robot, unix_ms(*at_s), self.at(arrived_s), evidence);
        put.expect("room");
    }

    /// Where a robot is, as fixes and telemetry of somebody who stands.
    fn stands(&mut self, robot: &RobotId, second: f64, x: f64) {
        let at = self.at(second);
        let sample = Evidence::Sample {
            duty: [0.0; 2],
            mv: 7_400,
        };
        let place = Pose {
            x: x as f32,
            y: 0.0,
            theta: 0.0,
            sigma: 0.01,
        };
        for evidence in [sample, Evidence::Fix(place)] {
            let put = self.twins.put(robot, unix_ms(second), at, evidence);
            put.expect("room");
        }
    }

    fn texts(&self) -> Vec<&str> {
        self.told
            .iter()
            .map(|(_, notice)| notice.text.as_str())
            .collect()
    }
}

fn unix_ms(second: f64) -> u64 {
    (EPOCH_MS as f64 + second * 1e3).round() as u64
}

fn pose(fix: &Fix) -> Pose {
    Pose {
        x: fix.x as f32,
        y: fix.y as f32,
        theta: fix.theta as f32,
        sigma: fix.sigma_m as f32,
    }
}

fn id(name: &str) -> RobotId {
    RobotId::new(name).expect("an id")
}

/// The certificate of a robot whose calibration drive was heard.
fn certificate(robot: &RobotId, hidden: &Hidden, build: &str) -> Certificate {
    let evidence = calibration(hidden, CALIBRATING).evidence();
    let about = About {
        robot: robot.as_str().to_owned(),
        build: build.to_owned(),
        ..About::default()
    };
    certify(&evidence, about, None).expect("a certificate")
}

#[test]
fn a_motor_that_is_weakened_is_told_of_within_seconds() {
    for seed in [9_001, 9_007, 9_011, 9_013] {
        weakened(seed);
    }
}

fn weakened(seed: u64) {
    let (scratch, robot) = (Scratch::new("weak"), id("sim-0001"));
    let hidden = Hidden {
        weak: Some((1, 60.0, 0.85)),
        ..Hidden::draw(seed, 0.0)
    };
    let made = certificate(&robot, &hidden, "0.3.0");
    scratch.write("sim-0001.json", &made.write());
    let mut stage = Stage::new(10, scratch.0.clone());
    *stage.program.lock().expect("a program") = Some("0.3.0".to_owned());
    let story = drive(&hidden, &anyhow(80.0, &mut Random::new(4)), RATES);
    let mut off = Vec::new();
    for row in story.rows() {
        stage.hear(&robot, &row);
        let now_s = stage.now_s;
        if let Ok(state) = stage.twins.state(&robot, stage.at(now_s), unix_ms(now_s)) {
            assert!(state.age < Duration::from_millis(800), "{:?}", state.age);
            let age_ms = state.age.as_millis() as u64;
            assert_eq!(state.time_ms + age_ms, unix_ms(now_s));
            let truth = story.truth[(state.view.at_s * 1e3) as usize];
            off.push(state.view.now.pose.distance(truth));
            assert_eq!(
                state.body.map(|body| body.id().to_owned()).as_deref(),
                Some(made.id())
            );
        }
    }
    stage.until(80.0);
    let [(told_s, notice)] = &stage.told[..] else {
        panic!("{:?}", stage.told);
    };
    assert!((61.0..66.0).contains(told_s), "{told_s}");
    assert_eq!(notice.robot.as_ref(), Some(&robot));
    assert!(
        notice.is_bad && notice.text.starts_with("twin: right_weak: "),
        "{notice:?}"
    );
    off.sort_by(f64::total_cmp);
    assert!(
        off.len() > 300 && off[off.len() / 2] < 0.012,
        "{}",
        off[off.len() / 2]
    );

    let now = stage.at(stage.now_s);
    let state = stage
        .twins
        .state(&robot, now, unix_ms(stage.now_s))
        .expect("a state");
    let (fault, since_ms) = state.faults[0];
    assert_eq!(fault.fault, FaultName::RightWeak);
    assert_eq!(since_ms, unix_ms(told_s - 1.0));
    let ahead = stage
        .twins
        .forecast(&robot, now, unix_ms(stage.now_s))
        .expect("forecasts");
    let sigmas: Vec<f64> = ahead
        .forecasts
        .iter()
        .map(|ahead| ahead.at.sigma_m)
        .collect();
    assert!(sigmas.len() == 2 && sigmas[0] < sigmas[1], "{sigmas:?}");
    assert!(
        ahead.errors[0].count > 50 && ahead.errors[0].median_m < 0.05,
        "{:?}",
        ahead.errors
    );
}

/// All robots run one program, in one room.
struct Hall(Arc<Room>);

impl Fleet for Hall {
    fn program(&self, _: &RobotId) -> Option<String> {
        Some("0.3.0".to_owned())
    }

    fn rooms(&self, robots: &[RobotId]) -> Vec<Option<Arc<Room>>> {
        vec![Some(Arc::clone(&self.0)); robots.len()]
    }
}

#[test]
fn a_robot_that_rubs_along_something_that_is_known_has_no_fault() {
    let (scratch, robot, other) = (Scratch::new("rubs"), id("sim-0001"), id("sim-0002"));
    let hidden = Hidden::draw(9_021, 0.0);
    scratch.write(
        "sim-0001.json",
        &certificate(&robot, &hidden, "0.3.0").write(),
    );
    let story = drive(&hidden, &anyhow(60.0, &mut Random::new(4)), RATES);
    // For some seconds it comes only half as far as its wheels.
    let rubs = |at_s: f64| (35.0..50.0).contains(&at_s);
    let (mut lost, mut before) = ([0.0; 2], None);
    let mut rows = story.rows();
    for row in &mut rows {
        let Row::Fix(fix) = row else { continue };
        let place = [fix.x, fix.y];
        let from = before.replace(place).unwrap_or(place);
        for k in 0..2 {
            lost[k] += if rubs(fix.at_s) { 0.5 } else { 0.0 } * (place[k] - from[k]);
        }
        (fix.x, fix.y) = (fix.x - lost[0], fix.y - lost[1]);
    }
    let solids = rows.iter().filter_map(|row| match row {
        Row::Fix(fix) if rubs(fix.at_s) => Some(Solid {
            at: [fix.x, fix.y + 0.2],
            radius: 0.1,
            ..Solid::default()
        }),
        _ => None,
    });
    let sides = [20.0; 2];
    let empty = Room {
        sides,
        solids: Vec::new(),
    };
    let full = Room {
        sides,
        solids: solids.collect(),
    };
    let told = |room: &Room, is_beside: bool| {
        let hall = Hall(Arc::new(room.clone()));
        let mut stage = Stage::of(10, scratch.0.clone(), hall);
        for row in &rows {
            stage.hear(&robot, row);
            if let Row::Fix(fix) = row
                && is_beside
            {
                let y = if rubs(fix.at_s) { fix.y + 0.2 } else { 9.0 };
                stage.hear(&other, &Row::Fix(Fix { y, ..*fix }));
            }
        }
        stage.until(60.0);
        stage.texts().join("\n")
    };
    let unknown = told(&empty, false);
    assert!(unknown.starts_with("twin: both_weak: "), "{unknown}");
    assert_eq!(told(&full, false), "");
    assert_eq!(told(&empty, true), "");
}

#[test]
fn a_certificate_that_does_not_hold_any_more_is_stale_until_there_is_another() {
    let (scratch, robot) = (Scratch::new("stale"), id("sim-0001"));
    let hidden = Hidden {
        fades: Some((0, 30.0, 0.01 / 60.0)),
        ..Hidden::draw(9_031, 0.0)
    };
    let healthy = Hidden {
        fades: None,
        ..hidden.clone()
    };
    scratch.write("sim-0001.json", &certificate(&robot, &healthy, "").write());
    let mut stage = Stage::new(10, scratch.0.clone());
    let mut first = None;
    for row in drive(&hidden, &anyhow(540.0, &mut Random::new(6)), RATES).rows() {
        stage.hear(&robot, &row);
        let now = stage.at(stage.now_s);
        let state = stage.twins.state(&robot, now, unix_ms(stage.now_s));
        let since_ms = state.ok().and_then(|state| state.stale_since_ms);
        first = first.or(since_ms.map(|since_ms| (since_ms, unix_ms(stage.now_s))));
    }
    let (since_ms, told_ms) = first.expect("stale");
    assert!(since_ms > unix_ms(90.0) && since_ms <= told_ms && told_ms - since_ms < 5_000);
    // It is no fault, and nobody is called for it.
    assert!(stage.told.is_empty(), "{:?}", stage.told);
    // With another one the twin begins anew.
    let faded = Hidden {
        gain: [hidden.gain[0] * 0.92, hidden.gain[1]],
        fades: None,
        ..hidden
    };
    scratch.write("sim-0001.json", &certificate(&robot, &faded, "").write());
    for tick in 0..60 {
        let second = 545.0 + f64::from(tick) * 0.5;
        stage.stands(&robot, second, 0.0);
        stage.until(second);
    }
    let now = stage.at(stage.now_s);
    let state = stage.twins.state(&robot, now, unix_ms(stage.now_s));
    assert_eq!(state.expect("a state").stale_since_ms, None);
}

#[test]
fn of_a_body_that_nobody_knows_weakness_is_not_told() {
    let robot = id("wild");
    let mut stage = Stage::bare(10);
    let hidden = Hidden {
        weak: Some((0, 40.0, 0.85)),
        ..Hidden::draw(9_002, 0.0)
    };
    for row in drive(&hidden, &anyhow(80.0, &mut Random::new(5)), RATES).rows() {
        stage.hear(&robot, &row);
    }
    let now = stage.at(stage.now_s);
    let state = stage
        .twins
        .state(&robot, now, unix_ms(stage.now_s))
        .expect("a state");
    assert!(state.body.is_none() && state.view.fixes > 100, "{state:?}");
    assert!(stage.told.is_empty(), "{:?}", stage.told);
}

#[test]
fn a_tracker_that_errs_is_told_of_and_that_it_is_over() {
    let mut stage = Stage::bare(100);
    let robots: Vec<RobotId> = (0..7).map(|n| id(&format!("robot-{n}"))).collect();
    // Half a second each: to and fro for a while, and then where they are.
    for tick in 1..160 {
        let second = f64::from(tick) * 0.5;
        let x = if tick < 16 && tick % 4 == 0 { 4.0 } else { 0.0 };
        for (n, robot) in robots.iter().enumerate() {
            // The last one is seen where it is.
            stage.stands(robot, second, if n == 6 { 0.0 } else { x });
        }
        stage.until(second);
    }
    let texts = stage.texts();
    assert_eq!(
        texts,
        [
            "6 robots: twin: tracker_wrong: the tracker sees it now here, now there",
            "6 robots: twin: tracker_wrong is over"
        ]
    );
    let (first, last) = (stage.told[0].0, stage.told[1].0);
    assert!(
        (4.0..9.0).contains(&first) && (35.0..50.0).contains(&last),
        "{first} {last}"
    );
    assert!(stage.told[0].1.is_bad && !stage.told[1].1.is_bad && stage.told[0].1.robot.is_none());

    // One alone is named.
    stage.told.clear();
    for tick in 0..20 {
        let second = 80.0 + f64::from(tick) * 0.5;
        stage.stands(&robots[6], second, if tick % 4 == 0 { 4.0 } else { 0.0 });
        stage.until(second);
    }
    let (_, notice) = &stage.told[0];
    assert_eq!(notice.robot.as_ref(), Some(&robots[6]));
    assert!(
        notice.text.starts_with("twin: tracker_wrong: 3 jumps"),
        "{notice:?}"
    );
}

#[test]
fn twins_are_so_many_and_who_goes_makes_room() {
    let mut stage = Stage::bare(2);
    let [a, b, c] = ["a", "b", "c"].map(id);
    let known = |stage: &Stage, robot: &RobotId| {
        let state = stage
            .twins
            .state(robot, stage.at(stage.now_s), unix_ms(stage.now_s));
        state.map(|state| state.view.fixes)
    };
    assert_eq!(known(&stage, &a), Err(NoTwin::NoFix));
    for tick in 1..120 {
        let second = f64::from(tick) * 0.5;
        // The first one goes after 10 s.
        if tick <= 20 {
            stage.stands(&a, second, 0.0);
        }
        stage.stands(&b, second, 1.0);
        stage.stands(&c, second, 2.0);
        stage.until(second);
        if tick == 20 {
            assert!(known(&stage, &a).is_ok_and(|fixes| fixes > 10));
            assert_eq!(known(&stage, &c), Err(NoTwin::NoRoom(2)));
        }
    }
    assert!(known(&stage, &c).is_ok() && known(&stage, &b).is_ok());
    assert_eq!(known(&stage, &a), Err(NoTwin::NoRoom(2)));
    // With room to spare whoever is silent is remembered for ten minutes.
    let mut stage = Stage::bare(9);
    for tick in 1..10 {
        stage.stands(&a, f64::from(tick), 0.0);
        stage.until(f64::from(tick));
    }
    stage.until(500.0);
    assert!(known(&stage, &a).is_ok());
    stage.until(700.0);
    assert_eq!(known(&stage, &a), Err(NoTwin::NoFix));

    // A fix alone says where it is, and not where it goes.
    let place = Pose::default();
    let at = stage.at(701.0);
    let put = stage
        .twins
        .put(&b, unix_ms(701.0), at, Evidence::Fix(place));
    put.expect("room");
    stage.until(702.0);
    assert_eq!(known(&stage, &b), Err(NoTwin::NoTelemetry));
    let off = Stage::bare(0);
    assert_eq!(known(&off, &a), Err(NoTwin::Off));
}

#[test]
fn what_finds_no_room_is_let_go() {
    let mut stage = Stage::bare(1);
    let (robot, at) = (id("a"), stage.begun);
    let put = |stage: &Stage| {
        stage
            .twins
            .put(&robot, EPOCH_MS, at, Evidence::Fix(Pose::default()))
    };
    for _ in 0..MOST_WAITING {
        put(&stage).expect("room");
    }
    put(&stage).expect_err("full");
    stage.until(0.25);
    put(&stage).expect("room again");
    let mut metrics = crawler_metrics::Metrics::new().exposition();
    stage.until(2.0);
    stage.twins.write_metrics(&mut metrics);
    let text = metrics.finish();
    for line in [
        "terracrawler_twins{body=\"nominal\"} 1\n".to_owned(),
        format!("terracrawler_twin_evidence_total {}\n", MOST_WAITING + 1),
        format!("terracrawler_twin_evidence_refused_total {MOST_WAITING}\n"),
        "terracrawler_twin_evidence_waiting 0\n".to_owned(),
        "terracrawler_twin_faults{fault=\"stuck\"} 0\n".to_owned(),
    ] {
        assert!(text.contains(&line), "{line} is not in {text}");
    }
}

#[test]
fn a_certificate_is_used_or_it_is_said_why_not() {
    let scratch = Scratch::new("files");
    let robot = id("sim-0001");
    let hidden = Hidden::draw(9_003, 0.0);
    let mut made = certificate(&robot, &hidden, "0.3.0");
    made.expires_ms = unix_ms(1_000.0);
    let text = made.write();
    scratch.write("good.json", &text.replace("sim-0001", "good"));
    scratch.write("other.json", &text);
    scratch.write("none.json", "{}");
    scratch.write("long.json", &format!("{text}{}", " ".repeat(300_000)));
    scratch.write(
        "newer.json",
        &text.replacen("\"format\": 1", "\"format\": 2", 1),
    );
    let wander = text.find("\"wander\": ").expect("a wander");
    let (head, tail) = text.split_at(wander + 10);
    scratch.write(
        "absurd.json",
        &format!("{head}9{tail}").replace("sim-0001", "absurd"),
    );
    scratch.write("No Robot.json", &text);
    fs::create_dir(scratch.0.join("folder.json")).expect("a folder");
    let mut stage = Stage::new(10, scratch.0.clone());
    stage.until(1.0);
    let refused = |stage: &Stage, name: &str| {
        let found = stage.twins.certificate(&id(name), unix_ms(stage.now_s));
        found.map(|found| found.refusal.map(|refusal| refusal.name()))
    };
    for (name, why) in [
        ("good", None),
        ("other", Some("other_robot")),
        ("none", Some("no_certificate")),
        ("long", Some("too_long")),
        ("newer", Some("other_format")),
        ("absurd", Some("unsound")),
        ("folder", Some("unreadable")),
    ] {
        assert_eq!(refused(&stage, name), Some(why), "{name}");
    }
    assert_eq!(refused(&stage, "sim-0001"), None);

    // What comes later is found, and the twin goes on with it; and without it when it goes.
    let body = |stage: &Stage| {
        let state = stage
            .twins
            .state(&robot, stage.at(stage.now_s), unix_ms(stage.now_s));
        state.ok().map(|state| state.body.is_some())
    };
    let follow = |stage: &mut Stage, to_s: f64| {
        while stage.now_s < to_s {
            let second = stage.now_s + 0.25;
            stage.stands(&robot, second, 0.0);
            stage.until(second);
        }
    };
    follow(&mut stage, 5.0);
    assert_eq!(body(&stage), Some(false));
    scratch.write("sim-0001.json", &text);
    follow(&mut stage, 17.0);
    assert_eq!(body(&stage), Some(true));
    *stage.program.lock().expect("a program") = Some("0.4.0".to_owned());
    follow(&mut stage, 29.0);
    assert_eq!(body(&stage), Some(false));
    let found = stage
        .twins
        .certificate(&robot, unix_ms(29.0))
        .expect("a file");
    let other = Refusal::OtherBuild {
        certificate: "0.3.0".to_owned(),
        robot: "0.4.0".to_owned(),
    };
    assert_eq!(found.refusal, Some(other));
    assert!(found.certificate.is_some());
    *stage.program.lock().expect("a program") = None;
    follow(&mut stage, 41.0);
    assert_eq!(body(&stage), Some(true));
    fs::remove_file(scratch.0.join("sim-0001.json")).expect("removed");
    follow(&mut stage, 53.0);
    assert_eq!(
        (body(&stage), refused(&stage, "sim-0001")),
        (Some(false), None)
    );
    stage.until(1_001.0);
    assert_eq!(refused(&stage, "good"), Some(Some("expired")));
}

#[test]
fn the_gap_of_a_robot_closes_when_it_is_calibrated_and_that_of_the_fleet_with_it() {
    let (scratch, names) = (Scratch::new("gap"), ["sim-0001", "sim-0002"].map(id));
    let hidden = [9_021, 9_022].map(|seed| Hidden::draw(seed, 0.0));
    let mut stage = Stage::new(10, scratch.0.clone());
    let gap = |stage: &Stage| {
        let now = stage.at(stage.now_s);
        stage.twins.gap(now, unix_ms(stage.now_s)).expect("twins")
    };
    let before = gap(&stage);
    assert!(before.robots.is_empty() && before.fleet.errors[0].value.is_none());
    // Within two seconds there is nothing new to be had.
    stage.until(1.0);
    assert!(Arc::ptr_eq(&before, &gap(&stage)));
    let stories = [0, 1].map(|n: usize| {
        let way = anyhow(120.0, &mut Random::new(n as u64));
        drive(&hidden[n], &way, RATES).rows()
    });
    let mut rows: Vec<(usize, Row)> = Vec::new();
    for (n, story) in stories.into_iter().enumerate() {
        rows.extend(story.into_iter().map(|row| (n, row)));
    }
    let at = |row: &Row| row.arrived_s().expect("an arrival");
    rows.sort_by(|a, b| at(&a.1).total_cmp(&at(&b.1)));
    for (n, row) in &rows {
        stage.hear(&names[*n], row);
    }
    stage.until(125.0);
    let open = gap(&stage);
    let [one, two] = &open.robots[..] else {
        panic!("{open:?}");
    };
    assert_eq!([&one.robot, &two.robot], [&names[0], &names[1]]);
    assert!(one.body.is_none() && open.time_ms == unix_ms(125.0));
    assert!(
        one.since_ms
            .is_some_and(|ms| (unix_ms(0.0)..unix_ms(10.0)).contains(&ms))
    );
    let ten = |gap: &crate::RobotGap| gap.measures.errors[1].value.expect("enough");
    let fleet = open.fleet.errors[1].value.expect("enough");
    let both = [ten(one), ten(two)].map(|errors| errors.own.median_m);
    assert!(
        both[0].min(both[1]) <= fleet.own.median_m && fleet.own.median_m <= both[0].max(both[1])
    );
    assert_eq!(
        open.fleet.errors[1].count,
        one.measures.errors[1].count + two.measures.errors[1].count
    );

    // With its certificate a robot begins anew, and says so until it has enough.
    let made = certificate(&names[0], &hidden[0], "");
    scratch.write("sim-0001.json", &made.write());
    stage.until(138.0);
    let [one, two] = &gap(&stage).robots[..] else {
        panic!("two");
    };
    assert!(one.body.is_some() && two.body.is_none());
    assert!(one.since_ms.is_none() && one.measures.errors[0].count == 0);
    assert!(two.measures.errors[0].value.is_some());
    for (n, row) in &rows {
        let later = |at_s: f64| at_s + 140.0;
        let row = match *row {
            Row::Duty(duty) => Row::Duty(Duty {
                at_s: later(duty.at_s),
                arrived_s: duty.arrived_s.map(later),
                ..duty
            }),
            Row::Supply(supply) => Row::Supply(supply),
            Row::Fix(fix) => Row::Fix(Fix {
                at_s: later(fix.at_s),
                arrived_s: fix.arrived_s.map(later),
                ..fix
            }),
        };
        if !matches!(row, Row::Supply(_)) || *n == 0 {
            stage.hear(&names[*n], &row);
        }
    }
    stage.until(270.0);
    let closed = gap(&stage);
    let after = ten(&closed.robots[0]);
    // An uncalibrated twin learns as well; what is held against both is the nominal body.
    assert!(after.ratio() < Some(0.6), "{after:?}");
    assert!(after.own.median_m < both[0], "{after:?} {both:?}");
    assert!(closed.robots[0].since_ms > Some(unix_ms(130.0)));
    assert_eq!(
        Stage::bare(0).twins.gap(stage.begun, 0).err(),
        Some(NoTwin::Off)
    );
}

proptest! {
    #![proptest_config(crawler_properties::cases(48))]

    #[test]
    fn whatever_is_said_what_twins_know_are_numbers(
        all in prop::collection::vec(
            (0..3_usize, any::<bool>(), prop_oneof![4 => 0..40_000_u64, 1 => any::<u64>()], 0..400_u64, any::<[f32; 4]>(), any::<u16>()),
            0..300,
        ),
    ) {
        let mut stage = Stage::bare(2);
        let robots = ["a", "b", "c"].map(id);
        for (robot, is_fix, stamp, later, [a, b, c, d], mv) in all {
            let timestamp = if stamp < 40_000 { EPOCH_MS + stamp } else { stamp };
            let evidence = if is_fix {
                Evidence::Fix(Pose { x: a, y: b, theta: c, sigma: d })
            } else {
                Evidence::Sample { duty: [a.clamp(-1.1, 1.1), b.clamp(-1.1, 1.1)], mv }
            };
            let at = stage.at(stage.now_s + later as f64 * 1e-3);
            stage.twins.put(&robots[robot], timestamp, at, evidence).expect("room");
            stage.until(stage.now_s + 0.25);
        }
        for robot in &robots {
            let now = stage.at(stage.now_s);
            if let Ok(state) = stage.twins.state(robot, now, unix_ms(stage.now_s)) {
                let now = state.view.now;
                let numbers = [now.pose.x, now.pose.y, now.pose.theta, now.sigma_m, state.view.v];
                prop_assert!(numbers.iter().all(|number| number.is_finite()), "{:?}", state);
            }
            let ahead = stage.twins.forecast(robot, now, unix_ms(stage.now_s));
            for forecast in ahead.map_or_else(|_| Vec::new(), |ahead| ahead.forecasts) {
                prop_assert!(forecast.at.pose.x.is_finite() && forecast.at.sigma_m.is_finite());
            }
        }
    }
}
