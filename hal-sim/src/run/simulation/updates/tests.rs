//! Updates from offer to outcome, in lockstep, with a server that is a part of the test.

mod deltas;
mod models;
mod policies;
mod server;

use crawler_bundle::{Bundle, Defect, DefectKind};
use crawler_hal::{Duration, ResetCause};

use crate::devices::Operation;
use crate::run::Simulation;
use crate::scenario::Scenario;
use server::{Server, Signer};

/// Long enough for a release of a few chunks and its trial.
const SOON: Duration = Duration::from_secs(120);
/// Long enough for a trial that comes to its limit.
const LATE: Duration = Duration::from_secs(500);

/// A robot that believes these keys.
fn robot(signer: &Signer) -> Simulation {
    let scenario = Scenario::built_in("empty").expect("there").with_robots(1);
    let simulation = Simulation::updating(scenario, 7, signer.keys()).expect("sound");
    simulation.network().expect("lockstep").record(1_000_000);
    simulation
}

fn good() -> Bundle {
    Bundle::new("9.0.0", "new")
}

fn bad(kind: DefectKind, value: u32) -> Bundle {
    Bundle {
        defects: vec![Defect::everywhere(kind, value)],
        ..good()
    }
}

fn firmware(simulation: &Simulation) -> &'static str {
    simulation.robot(0).expect("there").config().firmware
}

fn confirmed() -> (String, Option<String>) {
    ("confirmed".to_owned(), None)
}

fn rolled_back(reason: &str) -> (String, Option<String>) {
    ("rolled_back".to_owned(), Some(reason.to_owned()))
}

#[test]
fn a_good_release_is_confirmed_by_the_program_that_it_brought() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let mut server = Server::new(signer.release(&good(), 5, 40_000));
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    assert_eq!(firmware(&simulation), "9.0.0");
    let states: Vec<_> = server
        .heard
        .iter()
        .filter_map(|said| said["state"].as_str())
        .collect();
    for state in ["preparing", "receiving", "verifying", "staged", "trial"] {
        assert!(states.contains(&state), "{state} in {states:?}");
    }
    let outcome = server.heard.last().expect("an outcome");
    assert_eq!(outcome["build"], "new", "{outcome}");
    // It stays, whatever happens.
    let index = simulation.index(0).expect("there");
    for _ in 0..3 {
        simulation.world_mut().crash(index, "test");
        simulation.run_for(Duration::from_secs(3));
        assert_eq!(firmware(&simulation), "9.0.0");
    }
    // And it takes a next one, into the slot of the factory.
    let next = signer.release(&Bundle::new("9.1.0", "newer"), 6, 30_000);
    let mut server = Server::new(next);
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    assert_eq!(firmware(&simulation), "9.1.0");
}

#[test]
fn bad_releases_are_left_behind_with_the_reason() {
    for (kind, value, reason) in [
        (DefectKind::Panic, 5_000, "panic"),
        (DefectKind::Hang, 5_000, "watchdog"),
        (DefectKind::Hang, 0, "watchdog"),
        (DefectKind::Restart, 3_000, "restarts"),
        (DefectKind::NeverLink, 0, "no_link"),
        (DefectKind::RangerDead, 0, "unhealthy_sensors"),
        (DefectKind::MissControl, 1_000, "control_missed"),
    ] {
        let signer = Signer::new();
        let mut simulation = robot(&signer);
        let mut server = Server::new(signer.release(&bad(kind, value), 5, 5_000));
        let outcome = server.until_outcome(&mut simulation, LATE);
        assert_eq!(outcome, rolled_back(reason), "{kind:?}");
        assert_eq!(firmware(&simulation), env!("CARGO_PKG_VERSION"), "{kind:?}");
    }
}

#[test]
fn a_release_of_another_key_is_refused_before_anything_is_erased() {
    let (signer, other) = (Signer::new(), Signer::new());
    let mut simulation = robot(&signer);
    let mut server = Server::new(other.release(&good(), 5, 5_000));
    let (outcome, reason) = server.until_outcome(&mut simulation, SOON);
    assert_eq!(
        (outcome.as_str(), reason.as_deref()),
        ("refused", Some("unknown_key"))
    );
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    assert!(chip.borrow().operations().is_empty());
}

#[test]
fn chunks_that_are_lost_are_asked_for_again() {
    for (lose_every, most) in [(0, 10.0), (20, 15.0)] {
        let signer = Signer::new();
        let mut simulation = robot(&signer);
        let release = signer.release(&good(), 5, crawler_bundle::SIZE_DEFAULT);
        let mut server = Server::new(release).losing_every(lose_every);
        assert_eq!(server.until_outcome(&mut simulation, LATE), confirmed());
        let payload = server.payload() as f64;
        let over = |bytes: usize| 100.0 * (bytes as f64 - payload) / payload;
        let (stream, wire) = (over(server.stream), over(server.wire));
        println!("one of {lose_every} lost: {stream:.1} % over, {wire:.1} % with TCP and IP");
        assert!(stream <= most, "{stream} %, one of {lose_every} lost");
    }
}

/// Cuts the power once so many bytes were written for an update, and sees to its end: it is offered again.
fn cut_after(signer: &Signer, bytes: u64) {
    let mut simulation = robot(signer);
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    // Nothing but the update writes after the start.
    simulation.run_for(Duration::from_secs(3));
    let mut server = Server::new(signer.release(&good(), 5, 2_000));
    let (mut boots, mut cut) = (0, false);
    let outcome = server.until_outcome_with(&mut simulation, LATE, |simulation| {
        let cause = simulation.robot(0).map(|robot| robot.boot().cause);
        cut |= cause == Some(ResetCause::BrownOut);
        // A start takes back what was planned; what was not carried out is planned again.
        if !cut && simulation.boots(0) != boots {
            boots = simulation.boots(0);
            let chip = &mut *chip.borrow_mut();
            let done: u64 = chip.operations().iter().map(Operation::length).sum();
            chip.cut_power_after(bytes.saturating_sub(done));
        }
    });
    let starts = simulation.boots(0);
    assert!(
        cut,
        "no cut after {bytes} bytes, in {starts} starts: {:?}",
        server.heard
    );
    assert_eq!(outcome, confirmed(), "cut after {bytes} bytes");
    assert_eq!(firmware(&simulation), "9.0.0", "cut after {bytes} bytes");
    assert_eq!(chip.borrow().violations(), 0);
}

/// After how many bytes the power is to be cut, so that each word of trailer and otadata is cut within each of
/// its bytes, each page of the image within one, and each erase at its ends and between.
fn cuts(operations: &[Operation], is_image: impl Fn(u32) -> bool) -> Vec<u64> {
    let (mut cuts, mut before) = (Vec::new(), 0);
    for operation in operations {
        let length = operation.length();
        let within = match operation {
            Operation::Erase { .. } => vec![0, length / 2, length - 1],
            Operation::Program { at, .. } if is_image(*at) => vec![length / 3],
            Operation::Program { .. } => (0..length).collect(),
        };
        cuts.extend(within.into_iter().map(|byte| before + byte));
        before += length;
    }
    cuts
}

fn is_image(at: u32) -> bool {
    crate::devices::SLOTS.iter().any(|slot| {
        let end = slot.start + slot.length - crate::devices::ERASE_BYTES as u32;
        (slot.start..end).contains(&at)
    })
}

#[test]
fn a_power_cut_anywhere_costs_no_robot_and_no_release() {
    let signer = Signer::new();
    let mut simulation = robot(&signer);
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    let mut server = Server::new(signer.release(&good(), 5, 2_000));
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    let cuts = cuts(chip.borrow().operations(), is_image);
    assert!(cuts.len() > 100, "{}", cuts.len());
    for bytes in cuts {
        cut_after(&signer, bytes);
    }
}
