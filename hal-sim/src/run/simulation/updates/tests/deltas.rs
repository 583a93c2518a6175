//! Updates by a patch of the program that runs.

use crawler_bundle::Bundle;
use crawler_hal::ResetCause;

use super::server::{Release, Server, Signer};
use super::{LATE, SOON, confirmed, firmware, good, is_image, robot};
use crate::devices::Operation;
use crate::run::Simulation;

/// A block and a piece.
const SIZE: u32 = 70_000;

fn next() -> Bundle {
    Bundle::new("9.1.0", "newer")
}

/// A release, and the one after it with its patch.
fn both(signer: &Signer, size: u32) -> (Release, Release) {
    let first = signer.release(&good(), 5, size);
    let second = signer.release(&next(), 6, size).after(&first, "new");
    (first, second)
}

/// A robot that runs the first release.
fn updated(signer: &Signer, first: &Release) -> Simulation {
    let mut simulation = robot(signer);
    let mut server = Server::new(first.clone());
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    simulation
}

#[test]
fn a_release_comes_as_a_patch_of_the_one_before() {
    for (lose_every, most) in [(0, 30), (3, 20)] {
        let signer = Signer::new();
        let (first, second) = both(&signer, crawler_bundle::SIZE_DEFAULT);
        let mut simulation = robot(&signer);
        let mut whole = Server::new(first);
        assert_eq!(whole.until_outcome(&mut simulation, LATE), confirmed());
        let patch = second.patch_bytes();
        let mut server = Server::new(second).losing_every(lose_every);
        assert_eq!(server.until_outcome(&mut simulation, LATE), confirmed());
        assert_eq!(firmware(&simulation), "9.1.0");
        assert_eq!(server.of_image, 0);
        println!(
            "one of {lose_every} lost: {} bytes of stream as an image, {} as a patch of {patch}",
            whole.stream, server.stream
        );
        assert!(server.stream * most < whole.stream * 2, "{}", server.stream);
    }
}

/// The program of the factory is not what the patch was made of: the image comes as it is, and the robot says why.
#[test]
fn a_patch_of_another_program_costs_itself() {
    let signer = Signer::new();
    let (first, _) = both(&signer, SIZE);
    let build = super::super::FACTORY_BUILD;
    let second = signer.release(&next(), 6, SIZE).after(&first, build);
    let mut simulation = robot(&signer);
    let mut server = Server::new(second);
    assert_eq!(server.until_outcome(&mut simulation, LATE), confirmed());
    assert_eq!(firmware(&simulation), "9.1.0");
    assert_eq!(server.of_image, SIZE.div_ceil(1_024));
    let mut told = server.heard.iter();
    assert!(told.any(|said| said["reason"] == "delta_mismatch"));
}

/// Wherever the power goes: the patch comes once more, and nothing of the image.
#[test]
fn a_power_cut_anywhere_costs_the_patch_once_more() {
    let signer = Signer::new();
    let (first, second) = both(&signer, SIZE);
    let mut simulation = updated(&signer, &first);
    let index = simulation.index(0).expect("there");
    let chip = simulation.world().chip(index).expect("there");
    simulation.run_for(crawler_hal::Duration::from_secs(3));
    let before = chip.borrow().operations().len();
    let mut server = Server::new(second.clone());
    assert_eq!(server.until_outcome(&mut simulation, SOON), confirmed());
    let operations = chip.borrow().operations()[before..].to_vec();
    let cuts = cuts(&operations);
    assert!((8..40).contains(&cuts.len()), "{}", cuts.len());
    for bytes in cuts {
        let mut simulation = updated(&signer, &first);
        let index = simulation.index(0).expect("there");
        let chip = simulation.world().chip(index).expect("there");
        simulation.run_for(crawler_hal::Duration::from_secs(3));
        chip.borrow_mut().cut_power_after(bytes);
        let mut server = Server::new(second.clone());
        let mut cut = false;
        let outcome = server.until_outcome_with(&mut simulation, LATE, |simulation| {
            let cause = simulation.robot(0).map(|robot| robot.boot().cause);
            cut |= cause == Some(ResetCause::BrownOut);
        });
        assert_eq!(outcome, confirmed(), "cut after {bytes} bytes");
        assert_eq!(firmware(&simulation), "9.1.0", "cut after {bytes} bytes");
        assert!(cut, "no cut after {bytes} bytes");
        assert_eq!(server.of_image, 0, "cut after {bytes} bytes");
        assert_eq!(chip.borrow().violations(), 0, "cut after {bytes} bytes");
    }
}

/// After how many bytes the power is to be cut: within some of the erases and each hundredth page of the image, and once
/// within every other operation before its last byte is there.
fn cuts(operations: &[Operation]) -> Vec<u64> {
    let (mut cuts, mut before, mut pages) = (Vec::new(), 0, 0);
    let last = operations
        .iter()
        .rposition(|operation| matches!(operation, Operation::Program { at, .. } if is_image(*at)));
    for operation in &operations[..last.expect("an image")] {
        let length = operation.length();
        let chosen = match operation {
            Operation::Erase { from, .. } => from % 0x4000 == 0,
            Operation::Program { at, .. } if is_image(*at) => {
                pages += 1;
                pages % 100 == 1
            }
            Operation::Program { .. } => true,
        };
        if chosen {
            cuts.push(before + length / 2);
        }
        before += length;
    }
    cuts
}
