//! Models from offer to outcome, in lockstep.

use crawler_detector::{BLOB, LABELS};
use crawler_hal::{Duration, ResetCause};
use crawler_micromodel::{Convolution, Shape, Writer};
use serde_json::{Value, json};

use super::server::{Release, Server, Signer};
use super::{LATE, SOON, confirmed, cuts, rolled_back};
use crate::devices::{ERASE_BYTES, MODELS, Operation};
use crate::run::Simulation;
use crate::scenario::Scenario;

/// A robot that sees and believes these keys.
fn robot(signer: &Signer) -> Simulation {
    let mut scenario = Scenario::built_in("empty").expect("there").with_robots(1);
    scenario.spawn.camera_share = 1.0;
    scenario.detector = Some(BLOB);
    let simulation = Simulation::updating(scenario, 7, signer.keys()).expect("sound");
    simulation.network().expect("lockstep").record(1_000_000);
    simulation
}

/// A detector that finds nothing, from a picture of this many pixels in each direction, of layers with so many channels
/// and such a stride.
fn detector(pixels: u16, layers: &[(u16, u8)]) -> Vec<u8> {
    let input = Shape {
        height: pixels,
        width: pixels,
        channels: 3,
    };
    let mut blob = vec![0; 90_000];
    let mut writer = Writer::new(&mut blob, input, 0, layers.len()).expect("a header");
    let mut inputs = input.channels;
    for (input, &(channels, stride)) in (0..).zip(layers) {
        let outputs = usize::from(channels);
        let layer = Convolution {
            depthwise: false,
            input,
            channels,
            kernel: 3,
            stride,
            padding: [1, 1],
            zero: 0,
            range: [-128, 127],
            weights: &vec![1; 9 * usize::from(inputs) * outputs],
            bias: &vec![0; outputs],
            multipliers: &vec![1; outputs],
            shifts: &vec![9; outputs],
        };
        writer.convolution(&layer).expect("a layer");
        inputs = channels;
    }
    let length = writer
        .finish(0, &LABELS[..usize::from(inputs)])
        .expect("a model");
    blob.truncate(length);
    blob
}

/// A model that a robot can run, with so many channels in the middle.
fn good(channels: u16) -> Vec<u8> {
    detector(96, &[(channels, 4), (4, 2)])
}

/// One that takes its time: three times that of the shipped one.
fn slow() -> Vec<u8> {
    detector(96, &[(56, 2), (56, 2), (4, 2)])
}

/// The models that the status tells of, once it does.
fn told(server: &mut Server, simulation: &mut Simulation) -> Option<Value> {
    for _ in 0..50 {
        server.turn(simulation);
    }
    server.models.clone().filter(|models| !models.is_null())
}

fn restart(simulation: &mut Simulation, cause: ResetCause) {
    let index = simulation.index(0).expect("there");
    simulation.world_mut().reset(index, cause);
    simulation.run_for(Duration::from_millis(200));
}

fn outcome_of(simulation: &mut Simulation, release: Release) -> (String, Option<String>) {
    Server::new(release).until_outcome(simulation, LATE)
}

#[test]
fn a_good_model_is_confirmed_without_a_restart_and_stays() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let release = signer.model("eyes", &good(8), 5, 0);
    let build = release.build();
    let mut server = Server::new(release);
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    assert_eq!(simulation.boots(0), 1);
    let states: Vec<_> = server
        .heard
        .iter()
        .filter_map(|said| said["state"].as_str())
        .collect();
    for state in ["preparing", "receiving", "verifying", "staged", "trial"] {
        assert!(states.contains(&state), "{state} in {states:?}");
    }
    let outcome = server.heard.last().expect("an outcome");
    assert_eq!(outcome["build"], build.as_str(), "{outcome}");
    let tells = Some(json!({ "eyes": build }));
    assert_eq!(told(&mut server, &mut simulation), tells);
    // It looked for the trial, and ends with that.
    let looks = simulation.looks().taken;
    assert!(looks >= 20, "{looks}");
    simulation.run_for(Duration::from_secs(10));
    assert!(simulation.looks().taken <= looks + 3);
    // It stays, whatever happens, and a last will tells it too.
    let index = simulation.index(0).expect("there");
    for _ in 0..2 {
        simulation.world_mut().crash(index, "test");
        simulation.run_for(Duration::from_secs(3));
        server.models = None;
        assert_eq!(told(&mut server, &mut simulation), tells);
    }
    // The first was made before there was a model.
    assert_eq!(server.wills, [Value::Null, json!({ "eyes": build })]);
    let chip = simulation.world().chip(index).expect("there");
    assert_eq!(chip.borrow().violations(), 0);
}

#[test]
fn one_model_follows_another_and_goes_back_to_the_one_before() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let first = signer.model("eyes", &good(8), 5, 4);
    let build = first.build();
    assert_eq!(outcome_of(&mut simulation, first), confirmed());
    let mut server = Server::new(signer.model("eyes", &slow(), 6, 0));
    let outcome = server.until_outcome(&mut simulation, LATE);
    assert_eq!(outcome, rolled_back("too_slow"));
    let tells = Some(json!({ "eyes": build }));
    assert_eq!(told(&mut server, &mut simulation), tells);
    // What was given up is told again to a server that asks, and to a new session.
    server.heard.clear();
    let index = simulation.index(0).expect("there");
    simulation.world_mut().crash(index, "test");
    assert_eq!(server.until_outcome(&mut simulation, SOON), outcome);
    assert_eq!(told(&mut server, &mut simulation), tells);
    // The next one takes its place.
    let next = signer.model("eyes", BLOB, 7, 0);
    let build = next.build();
    let mut server = Server::new(next);
    assert_eq!(server.until_outcome(&mut simulation, LATE), confirmed());
    let tells = Some(json!({ "eyes": build }));
    assert_eq!(told(&mut server, &mut simulation), tells);
    let again = signer.model("eyes", &good(8), 6, 0);
    let refused = ("refused".to_owned(), Some("downgrade".to_owned()));
    assert_eq!(outcome_of(&mut simulation, again), refused);
    let below = signer.model("eyes", &good(8), 3, 0);
    let refused = ("refused".to_owned(), Some("below_floor".to_owned()));
    assert_eq!(outcome_of(&mut simulation, below), refused);
}

#[test]
fn what_the_program_cannot_run_is_refused_and_not_used() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let mut torn = good(8);
    let last = torn.len() - 1;
    torn[last] ^= 1;
    let cases = [
        torn,
        // Too few classes, too many cells, too much memory, and what is no model.
        detector(96, &[(8, 4), (3, 2)]),
        detector(192, &[(8, 4), (4, 2)]),
        detector(512, &[(50, 1), (8, 4), (8, 4), (4, 4)]),
        vec![7; 20_000],
        vec![0; 3],
    ];
    for (at, blob) in (1..).zip(cases) {
        let release = signer.model("eyes", &blob, at, 0);
        let refused = ("refused".to_owned(), Some("bad_model".to_owned()));
        assert_eq!(outcome_of(&mut simulation, release), refused, "case {at}");
    }
    assert_eq!(simulation.boots(0), 1);
    let mut server = Server::new(signer.model("eyes", BLOB, 9, 0));
    assert_eq!(
        told(&mut server, &mut simulation),
        None,
        "that of the program"
    );
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
}

#[test]
fn a_model_for_something_else_is_refused_before_anything_is_erased() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let index = simulation.index(0).expect("there");
    let large = vec![0; MODELS.places[0].length as usize];
    for (release, reason) in [
        (signer.model("ears", &good(8), 5, 0), "wrong_kind"),
        (Signer::new().model("eyes", &good(8), 5, 0), "unknown_key"),
        (signer.model("eyes", &large, 5, 0), "too_large"),
    ] {
        let refused = ("refused".to_owned(), Some(reason.to_owned()));
        assert_eq!(outcome_of(&mut simulation, release), refused);
    }
    let chip = simulation.world().chip(index).expect("there");
    assert!(chip.borrow().operations().is_empty());
    // A robot without a camera has no place for models.
    let scenario = Scenario::built_in("empty").expect("there").with_robots(1);
    let mut blind = Simulation::updating(scenario, 7, signer.keys()).expect("sound");
    blind.network().expect("lockstep").record(1_000_000);
    let release = signer.model("eyes", &good(8), 5, 0);
    let refused = ("refused".to_owned(), Some("wrong_kind".to_owned()));
    assert_eq!(outcome_of(&mut blind, release), refused);
}

/// Runs until the model is on trial.
fn until_trial(server: &mut Server, simulation: &mut Simulation) {
    server.turn(simulation);
    server.offer(simulation);
    for _ in 0..5_000 {
        server.turn(simulation);
        if server.heard.iter().any(|said| said["state"] == "trial") {
            return;
        }
    }
    panic!("no trial: {:?}", server.heard.last());
}

#[test]
fn a_restart_ends_the_trial() {
    for (cause, reason) in [
        (ResetCause::Panic, "panic"),
        (ResetCause::Watchdog, "watchdog"),
        (ResetCause::Software, "restarts"),
        (ResetCause::PowerOn, "power_cycles"),
    ] {
        let signer = Signer::new();
        let mut simulation = robot(&signer);
        simulation.run_for(Duration::from_secs(3));
        let mut server = Server::new(signer.model("eyes", &good(8), 5, 0));
        until_trial(&mut server, &mut simulation);
        restart(&mut simulation, cause);
        let outcome = server.until_outcome(&mut simulation, SOON);
        assert_eq!(outcome, rolled_back(reason));
        assert_eq!(told(&mut server, &mut simulation), None);
        // It may be tried again.
        server.heard.clear();
        server.offer(&mut simulation);
        assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    }
}

#[test]
fn a_model_that_decays_in_flash_gives_way_to_the_one_before_and_to_the_programs_own() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let (first, second) = (good(8), good(9));
    let releases = [
        signer.model("eyes", &first, 5, 0),
        signer.model("eyes", &second, 6, 6),
    ];
    let builds = [releases[0].build(), releases[1].build()];
    let [release, next] = releases;
    assert_eq!(outcome_of(&mut simulation, release), confirmed());
    let mut server = Server::new(next);
    assert_eq!(server.until_outcome(&mut simulation, LATE), confirmed());
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    assert_eq!(
        told(&mut server, &mut simulation),
        Some(json!({ "eyes": builds[1] }))
    );
    for (place, left) in [(1, Some(json!({ "eyes": builds[0] }))), (0, None)] {
        chip.borrow_mut().spoil(MODELS.places[place].start + 400);
        server.models = None;
        restart(&mut simulation, ResetCause::PowerOn);
        assert_eq!(told(&mut server, &mut simulation), left);
        server.models = None;
        restart(&mut simulation, ResetCause::PowerOn);
        assert_eq!(told(&mut server, &mut simulation), left, "and again");
    }
    let release = signer.model("eyes", &first, 7, 0);
    assert_eq!(outcome_of(&mut simulation, release), confirmed());
}

/// Cuts the power once so many bytes were written for a model, and sees to its end: it is offered again.
fn cut_after(signer: &Signer, blob: &[u8], bytes: u64) {
    let mut simulation = robot(signer);
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    // Nothing but the update writes after the start.
    simulation.run_for(Duration::from_secs(3));
    let release = signer.model("eyes", blob, 5, 0);
    let build = release.build();
    let mut server = Server::new(release);
    let mut cut = false;
    chip.borrow_mut().cut_power_after(bytes);
    loop {
        let outcome = server.until_outcome_with(&mut simulation, LATE, |simulation| {
            let cause = simulation.robot(0).map(|robot| robot.boot().cause);
            cut |= cause == Some(ResetCause::BrownOut);
        });
        if outcome == confirmed() {
            break;
        }
        // In the trial the power went, and nothing else.
        let gone = ["power_cycles", "interrupted"].map(rolled_back);
        assert!(
            gone.contains(&outcome),
            "{outcome:?}, cut after {bytes} bytes"
        );
        assert_eq!(told(&mut server, &mut simulation), None);
        server.heard.clear();
        server.offer(&mut simulation);
    }
    assert!(cut, "no cut after {bytes} bytes");
    let tells = Some(json!({ "eyes": build }));
    assert_eq!(told(&mut server, &mut simulation), tells, "{bytes}");
    server.models = None;
    restart(&mut simulation, ResetCause::PowerOn);
    assert_eq!(told(&mut server, &mut simulation), tells, "{bytes}");
    assert_eq!(chip.borrow().violations(), 0);
}

#[test]
fn a_power_cut_anywhere_costs_no_robot_and_no_model() {
    let signer = Signer::new();
    let blob = good(5);
    let mut simulation = robot(&signer);
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    let release = signer.model("eyes", &blob, 5, 0);
    assert_eq!(outcome_of(&mut simulation, release), confirmed());
    let is_image = |at: u32| {
        MODELS.places.iter().any(|place| {
            let end = place.start + place.length - ERASE_BYTES as u32;
            (place.start..end).contains(&at)
        })
    };
    let cuts = cuts(chip.borrow().operations(), is_image);
    let last: u64 = chip
        .borrow()
        .operations()
        .iter()
        .map(Operation::length)
        .sum();
    assert!(cuts.len() > 100 && cuts.last() == Some(&(last - 1)));
    for bytes in cuts {
        cut_after(&signer, &blob, bytes);
    }
}
