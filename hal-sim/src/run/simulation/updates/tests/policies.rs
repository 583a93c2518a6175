//! Policies from offer to outcome, and what a robot does by them.

use crawler_app::policy::{
    ACTIONS_VERSION, Action as Motion, FORMAT_VERSION, LAYERS, MAGIC, MAX_BYTES,
    OBSERVATION_VERSION, SHIELD_VERSION, SPREAD, STEPS, WIDTH,
};
use crawler_detector::BLOB;
use crawler_hal::{Duration, ResetCause};
use crawler_micromodel::blob::checksum;
use crawler_micromodel::vector::Dense;
use crawler_protocol::{Action, BehaviourSpec, PolicyName};
use serde_json::{Value, json};

use super::server::{Release, Server, Signer};
use super::{LATE, SOON, confirmed, cuts, robot, rolled_back};
use crate::devices::{ERASE_BYTES, Operation, POLICIES};
use crate::run::Simulation;
use crate::scenario::Scenario;

/// A policy that prefers this motion, whatever it sees, with these versions.
fn policy_of(versions: [u8; 3], motion: Motion) -> Vec<u8> {
    let count = Motion::COUNT;
    let padded = count.next_multiple_of(4);
    let mut layer = vec![0; Dense::bytes(WIDTH, count)];
    layer[4 * motion as usize] = 100;
    layer[4 * padded..6 * padded].fill(1);
    let mut rest = versions.to_vec();
    rest.extend([0, STEPS, 1, 0, 0]);
    rest.extend([7; 32]);
    rest.push(count as u8);
    rest.extend([0; LAYERS - 1]);
    rest.extend(layer);
    let mut blob = MAGIC.to_vec();
    blob.extend(FORMAT_VERSION.to_le_bytes());
    blob.extend(((rest.len() + 12) as u16).to_le_bytes());
    blob.extend(checksum(&rest).to_le_bytes());
    blob.extend(rest);
    blob
}

const VERSIONS: [u8; 3] = [OBSERVATION_VERSION, ACTIONS_VERSION, SHIELD_VERSION];

fn policy(motion: Motion) -> Vec<u8> {
    policy_of(VERSIONS, motion)
}

fn refused(reason: &str) -> (String, Option<String>) {
    ("refused".to_owned(), Some(reason.to_owned()))
}

fn outcome_of(simulation: &mut Simulation, release: Release) -> (String, Option<String>) {
    Server::new(release).until_outcome(simulation, LATE)
}

/// What the robot answers when it is told to drive by the policy of this name, and the duties two seconds later.
fn drives(server: &mut Server, simulation: &mut Simulation, name: &str) -> (Value, [f32; 2]) {
    let policy = PolicyName::new(name).expect("a name");
    for _ in 0..10 {
        server.answers.clear();
        let policy = policy.clone();
        simulation.submit(0, Action::Behave(BehaviourSpec::Policy { policy }));
        for _ in 0..100 {
            server.turn(simulation);
        }
        let reason = server.answers.last().map(|answer| answer["reason"].clone());
        // After a start it knows no time, or nothing arrives; after a fault it looks around itself first.
        let soon = |reason: &Value| reason == "no_clock" || reason == "busy";
        let Some(reason) = reason.filter(|reason| !soon(reason)) else {
            continue;
        };
        let duties = simulation.robot(0).expect("there").snapshot().wheels;
        simulation.submit(0, Action::Stop);
        for _ in 0..50 {
            server.turn(simulation);
        }
        return (reason, duties);
    }
    panic!("no answer: {:?}", server.answers.last());
}

fn restart(server: &mut Server, simulation: &mut Simulation, cause: ResetCause) {
    let index = simulation.index(0).expect("there");
    simulation.world_mut().reset(index, cause);
    server.models = None;
    // Until it can be told something again.
    for _ in 0..250 {
        server.turn(simulation);
    }
}

/// The models that the status tells of.
fn told(server: &Server) -> Value {
    server.models.clone().expect("a status")
}

#[test]
fn a_policy_is_confirmed_without_a_restart_and_driven_by_under_its_name() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let release = signer.policy("turn-left", &policy(Motion::Left), 5, 0);
    let build = release.build();
    let mut server = Server::new(release);
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    assert_eq!(simulation.boots(0), 1);
    let states: Vec<_> = server
        .heard
        .iter()
        .filter_map(|said| said["state"].as_str())
        .collect();
    for state in ["preparing", "receiving", "verifying", "staged"] {
        assert!(states.contains(&state), "{state} in {states:?}");
    }
    assert!(!states.contains(&"trial"), "{states:?}");
    let outcome = server.heard.last().expect("an outcome");
    assert_eq!(outcome["build"], build.as_str(), "{outcome}");
    let tells = json!({ "turn-left": build });
    for cause in [None, Some(ResetCause::PowerOn), Some(ResetCause::Panic)] {
        if let Some(cause) = cause {
            restart(&mut server, &mut simulation, cause);
        }
        let (reason, [left, right]) = drives(&mut server, &mut simulation, "turn-left");
        assert_eq!(reason, Value::Null, "{cause:?}");
        assert!(left < 0.0 && right > 0.0, "{left} {right}");
        assert_eq!(told(&server), tells);
        let (reason, _) = drives(&mut server, &mut simulation, SPREAD.name);
        assert_eq!(reason, Value::Null, "that of the program is there as well");
        let (reason, duties) = drives(&mut server, &mut simulation, "turn-right");
        assert_eq!((reason, duties), (json!("no_policy"), [0.0; 2]));
    }
    let can = server.capabilities.clone().expect("a status");
    let can = can.as_array().expect("a list");
    assert!(can.contains(&json!("policies")), "{can:?}");
    // The first was made before there was one.
    assert_eq!(server.wills, [Value::Null, tells]);
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    assert_eq!(chip.borrow().violations(), 0);
}

#[test]
fn the_next_policy_takes_the_place_of_the_one_before_whatever_they_are_called() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let first = signer.policy("turn-left", &policy(Motion::Left), 5, 4);
    assert_eq!(outcome_of(&mut simulation, first.clone()), confirmed());
    let next = signer.policy("turn-right", &policy(Motion::Right), 6, 0);
    let build = next.build();
    let mut server = Server::new(next);
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    let (reason, [left, right]) = drives(&mut server, &mut simulation, "turn-right");
    assert_eq!(reason, Value::Null);
    assert!(left > 0.0 && right < 0.0, "{left} {right}");
    let (reason, duties) = drives(&mut server, &mut simulation, "turn-left");
    assert_eq!((reason, duties), (json!("no_policy"), [0.0; 2]));
    assert_eq!(told(&server), json!({ "turn-right": build }));
    // Policies have one order, so the way back goes forward.
    for (sequence, reason) in [(6, "downgrade"), (5, "downgrade"), (3, "below_floor")] {
        let back = signer.policy("turn-left", &policy(Motion::Left), sequence, 0);
        assert_eq!(outcome_of(&mut simulation, back), refused(reason));
    }
    // One of the name of that of the program takes its place.
    let same = signer.policy(SPREAD.name, &policy(Motion::Right), 7, 0);
    assert_eq!(outcome_of(&mut simulation, same), refused("same_build"));
    let spread = signer.policy(SPREAD.name, &policy(Motion::Left), 7, 0);
    let mut server = Server::new(spread);
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    let (_, [left, right]) = drives(&mut server, &mut simulation, SPREAD.name);
    assert!(left < 0.0 && right > 0.0, "{left} {right}");
}

#[test]
fn what_is_no_policy_of_this_program_is_refused_with_a_reason_and_the_former_one_stays() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let former = signer.policy("turn-left", &policy(Motion::Left), 1, 0);
    let build = former.build();
    let mut server = Server::new(former);
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    let good = policy(Motion::Right);
    let mut torn = good.clone();
    *torn.last_mut().expect("bytes") ^= 1;
    let [observation, actions, shield] = VERSIONS;
    let other = |versions| policy_of(versions, Motion::Right);
    // A first layer of more outputs than there can be, and more layers than there are bytes.
    let sealed = |mut blob: Vec<u8>| {
        let sum = checksum(&blob[12..]);
        blob[8..12].copy_from_slice(&sum.to_le_bytes());
        blob
    };
    let (mut wide, mut deep) = (good.clone(), good.clone());
    wide[52] = 255;
    (deep[17], deep[53], deep[54], deep[55]) = (4, 255, 255, 255);
    let cases = [
        (torn, "bad_policy"),
        (good[..good.len() - 1].to_vec(), "bad_policy"),
        (good[..40].to_vec(), "bad_policy"),
        (sealed(wide), "bad_policy"),
        (sealed(deep), "bad_policy"),
        (vec![0xFF; MAX_BYTES], "bad_policy"),
        (vec![0], "bad_policy"),
        (BLOB[..MAX_BYTES].to_vec(), "bad_policy"),
        (
            other([observation + 1, actions, shield]),
            "other_observation",
        ),
        (
            other([observation, actions + 1, shield]),
            "other_observation",
        ),
        (
            other([observation, actions, shield + 1]),
            "other_observation",
        ),
        (vec![0; MAX_BYTES + 1], "too_large"),
        (BLOB.to_vec(), "too_large"),
    ];
    for (sequence, (blob, reason)) in (2..).zip(cases) {
        let release = signer.policy("turn-right", &blob, sequence, 0);
        let outcome = outcome_of(&mut simulation, release);
        assert_eq!(outcome, refused(reason), "release {sequence}");
        let (no_policy, duties) = drives(&mut server, &mut simulation, "turn-right");
        assert_eq!((no_policy, duties), (json!("no_policy"), [0.0; 2]));
        let (reason, [left, right]) = drives(&mut server, &mut simulation, "turn-left");
        assert_eq!(reason, Value::Null, "after release {sequence}");
        assert!(left < 0.0 && right > 0.0, "{left} {right}");
    }
    assert_eq!(told(&server), json!({ "turn-left": build }));
    assert_eq!(simulation.boots(0), 1);
}

#[test]
fn a_policy_that_is_not_signed_for_this_robot_is_refused_before_anything_is_erased() {
    let signer = Signer::new();
    let mut scenario = Scenario::built_in("empty").expect("there").with_robots(1);
    scenario.spawn.camera_share = 1.0;
    scenario.detector = Some(BLOB);
    let mut simulation = Simulation::updating(scenario, 7, signer.keys()).expect("sound");
    simulation.network().expect("lockstep").record(1_000_000);
    let index = simulation.index(0).expect("there");
    let blob = policy(Motion::Left);
    for (release, reason) in [
        (
            Signer::new().policy("turn-left", &blob, 5, 0),
            "unknown_key",
        ),
        (
            signer.policy_for("virt", "turn-left", &blob, 5),
            "wrong_board",
        ),
        // What looks is no policy, nor is a policy something to look with.
        (signer.model("turn-left", &blob, 5, 0), "wrong_kind"),
        (signer.policy("eyes", &blob, 5, 0), "wrong_kind"),
        (
            signer.policy("turn-left", &blob, 5, 0).forged(),
            "bad_signature",
        ),
    ] {
        assert_eq!(outcome_of(&mut simulation, release), refused(reason));
    }
    let chip = simulation.world().chip(index).expect("there");
    assert!(chip.borrow().operations().is_empty());
    drop(chip);
    // A policy that came as a model for the eyes is none of those either.
    let release = signer.model("eyes", &blob, 5, 0);
    assert_eq!(outcome_of(&mut simulation, release), refused("bad_model"));
    // It takes a model and a policy, and tells both.
    let (eyes, drives) = (
        signer.model("eyes", BLOB, 6, 0),
        signer.policy("turn-left", &blob, 1, 0),
    );
    let tells = json!({ "eyes": eyes.build(), "turn-left": drives.build() });
    assert_eq!(outcome_of(&mut simulation, eyes), confirmed());
    let mut server = Server::new(drives);
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    for _ in 0..50 {
        server.turn(&mut simulation);
    }
    assert_eq!(told(&server), tells);
    restart(&mut server, &mut simulation, ResetCause::PowerOn);
    assert_eq!(told(&server), tells);
}

#[test]
fn a_policy_that_decays_in_flash_is_told_as_bad_and_the_one_before_is_there() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let first = signer.policy("turn-left", &policy(Motion::Left), 5, 0);
    let second = signer.policy("turn-right", &policy(Motion::Right), 6, 6);
    let build = first.build();
    assert_eq!(outcome_of(&mut simulation, first), confirmed());
    let mut server = Server::new(second.clone());
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    chip.borrow_mut().spoil(POLICIES.places[1].start + 24);
    for _ in 0..2 {
        restart(&mut server, &mut simulation, ResetCause::PowerOn);
        let (reason, duties) = drives(&mut server, &mut simulation, "turn-right");
        assert_eq!((reason, duties), (json!("bad_policy"), [0.0; 2]));
        let (reason, [left, right]) = drives(&mut server, &mut simulation, "turn-left");
        assert_eq!(reason, Value::Null);
        assert!(left < 0.0 && right > 0.0, "{left} {right}");
        assert_eq!(told(&server), json!({ "turn-left": build }));
    }
    chip.borrow_mut().spoil(POLICIES.places[0].start + 24);
    restart(&mut server, &mut simulation, ResetCause::PowerOn);
    let (reason, duties) = drives(&mut server, &mut simulation, "turn-right");
    assert_eq!((reason, duties), (json!("bad_policy"), [0.0; 2]));
    let (reason, duties) = drives(&mut server, &mut simulation, "turn-left");
    assert_eq!((reason, duties), (json!("no_policy"), [0.0; 2]));
    assert_eq!(told(&server), Value::Null);
    let (reason, _) = drives(&mut server, &mut simulation, SPREAD.name);
    assert_eq!(reason, Value::Null, "that of the program");
    // The same release mends it.
    assert_eq!(outcome_of(&mut simulation, second), confirmed());
    let (reason, _) = drives(&mut server, &mut simulation, "turn-right");
    assert_eq!(reason, Value::Null);
}

/// Cuts the power once so many bytes were written for a policy that follows another, and sees to its end.
fn cut_after(signer: &Signer, bytes: u64) {
    let mut simulation = robot(signer);
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    let former = signer.policy("turn-left", &policy(Motion::Left), 5, 0);
    assert_eq!(outcome_of(&mut simulation, former), confirmed());
    let mut server = Server::new(signer.policy("turn-right", &policy(Motion::Right), 6, 0));
    let mut cut = false;
    chip.borrow_mut().cut_power_after(bytes);
    loop {
        let outcome = server.until_outcome_with(&mut simulation, LATE, |simulation| {
            let robot = simulation.robot(0).expect("there");
            if robot.boot().cause == ResetCause::BrownOut && !cut && robot.is_loaded() {
                cut = true;
            }
        });
        if outcome == confirmed() {
            break;
        }
        let gone = ["power_cycles", "interrupted"].map(rolled_back);
        assert!(gone.contains(&outcome), "{outcome:?}, cut after {bytes}");
        // Between having been activated and being proven the power went: the former one is there.
        let (reason, [left, right]) = drives(&mut server, &mut simulation, "turn-left");
        assert_eq!(reason, Value::Null, "cut after {bytes}");
        assert!(left < 0.0 && right > 0.0, "{left} {right}");
        server.heard.clear();
        server.offer(&mut simulation);
    }
    assert!(cut, "no cut after {bytes} bytes");
    let (reason, _) = drives(&mut server, &mut simulation, "turn-right");
    assert_eq!(reason, Value::Null, "cut after {bytes}");
    assert_eq!(chip.borrow().violations(), 0);
}

#[test]
fn a_power_cut_anywhere_leaves_the_former_policy_or_the_next_one() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    let former = signer.policy("turn-left", &policy(Motion::Left), 5, 0);
    assert_eq!(outcome_of(&mut simulation, former), confirmed());
    let before = chip.borrow().operations().len();
    let next = signer.policy("turn-right", &policy(Motion::Right), 6, 0);
    assert_eq!(outcome_of(&mut simulation, next), confirmed());
    let is_image = |at: u32| {
        POLICIES.places.iter().any(|place| {
            let end = place.start + place.length - ERASE_BYTES as u32;
            (place.start..end).contains(&at)
        })
    };
    let chip = chip.borrow();
    let operations = &chip.operations()[before..];
    let cuts = cuts(operations, is_image);
    let last: u64 = operations.iter().map(Operation::length).sum();
    assert!(cuts.len() > 50 && cuts.last() == Some(&(last - 1)));
    for bytes in cuts {
        cut_after(&signer, bytes);
    }
}

#[test]
fn an_update_of_a_policy_that_is_put_off_leaves_the_former_one_in_use() {
    let signer = Signer::new();
    let (mut former_ones, mut next_ones) = (0, 0);
    for delay_ms in (0..60).step_by(4) {
        let mut simulation = robot(&signer);
        let former = signer.policy("turn-left", &policy(Motion::Left), 5, 0);
        assert_eq!(outcome_of(&mut simulation, former), confirmed());
        let mut server = Server::new(signer.policy("turn-right", &policy(Motion::Right), 6, 0));
        server.turn(&mut simulation);
        server.offer(&mut simulation);
        let receives = |said: &Value| said["state"] == "receiving";
        while !server.heard.iter().any(receives) {
            server.turn(&mut simulation);
        }
        simulation.run_for(Duration::from_millis(delay_ms));
        simulation.submit(0, Action::Estop);
        for _ in 0..50 {
            server.turn(&mut simulation);
        }
        simulation.submit(0, Action::Reset);
        for _ in 0..50 {
            server.turn(&mut simulation);
        }
        let (name, other, sign) = match server.outcome() {
            None => ("turn-left", "turn-right", -1.0),
            Some(outcome) => {
                assert_eq!(outcome, confirmed());
                ("turn-right", "turn-left", 1.0)
            }
        };
        let (reason, [left, right]) = drives(&mut server, &mut simulation, name);
        assert_eq!(reason, Value::Null, "{name} after {delay_ms} ms");
        assert!(left * sign > 0.0 && right * sign < 0.0, "{left} {right}");
        let (reason, duties) = drives(&mut server, &mut simulation, other);
        assert_eq!((reason, duties), (json!("no_policy"), [0.0; 2]));
        if name == "turn-left" {
            former_ones += 1;
            server.offer(&mut simulation);
        } else {
            next_ones += 1;
        }
        assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
        let (reason, _) = drives(&mut server, &mut simulation, "turn-right");
        assert_eq!(reason, Value::Null);
    }
    assert!(
        former_ones > 2 && next_ones > 2,
        "{former_ones} {next_ones}"
    );
}

/// A candidate decides beside the policy that drives: whatever it is, not one bit of the history changes.
#[test]
fn a_candidate_moves_nothing_and_is_compared() {
    let signer = Signer::new();
    // One that would only turn, one that would only drive ahead, and the one that drives, under another name.
    for (blob, agrees) in [
        (policy(Motion::Left), None),
        (policy(Motion::Ahead), None),
        (SPREAD.blob.to_vec(), Some(true)),
    ] {
        let release = signer.policy("candidate", &blob, 5, 0);
        let drive = |candidate: Option<&str>| {
            let mut simulation = robot(&signer);
            let mut server = Server::new(release.clone());
            assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
            let name = |name: &str| PolicyName::new(name).expect("a name");
            let policy = candidate.map(name);
            simulation.submit(0, Action::Shadow { policy });
            simulation.run_for(Duration::from_secs(1));
            let policy = name(SPREAD.name);
            simulation.submit(0, Action::Behave(BehaviourSpec::Policy { policy }));
            let index = simulation.index(0).expect("there");
            // The whole physical state after every control step, and all that the robot says but what is compared.
            let states: Vec<_> = (0..1_500)
                .map(|_| {
                    simulation.run_for(Duration::from_millis(20));
                    simulation.world().robot_hash(index)
                })
                .collect();
            let said = simulation.network().expect("lockstep").take_record();
            let said = said.into_iter().map(|said| (said.topic, said.payload));
            let said: Vec<_> = said
                .filter(|(topic, _)| !topic.contains("/heartbeat/"))
                .collect();
            assert!(said.len() > 150, "telemetry comes five times a second");
            let robot = simulation.robot(0).expect("there");
            ((states, said), robot.snapshot().pose, robot.shadow())
        };
        let (alone, before, nothing) = drive(None);
        assert_eq!(nothing, None);
        let (beside, after, told) = drive(Some("candidate"));
        assert!(beside == alone, "another history");
        assert_eq!(after, before);
        let told = told.expect("asked for");
        assert!((280..=301).contains(&told.decisions), "{told:?}");
        assert_eq!(agrees.unwrap_or(false), told.agreed == told.decisions);
        if agrees == Some(true) {
            assert_eq!(told.vetoes, told.driving_vetoes);
        }
        assert!(
            before.x.abs() + before.y.abs() > 0.1,
            "it drives: {before:?}"
        );
    }
}
