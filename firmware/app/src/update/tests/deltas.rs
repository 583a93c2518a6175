//! Updates by a patch of the program that runs, and what becomes of patches that are wrong.

use crawler_hal::{Duration, ResetCause};
use proptest::prelude::*;

use super::life::{End, Life, World};
use super::releases::{Draft, Release};

/// A release with a patch of 20 chunks.
fn changed() -> Release {
    let mut draft = Draft::new("new", 12);
    draft.changed = Some(25);
    draft.release()
}

fn chunks(bytes: &[u8]) -> u32 {
    bytes.len().div_ceil(1_024) as u32
}

fn confirmed(life: &Life) -> bool {
    life.server.borrow().has_told("outcome", "confirmed")
}

/// The reasons that were told while the image was received, each once.
fn reasons(life: &Life) -> std::vec::Vec<std::string::String> {
    let server = life.server.borrow();
    let received = server
        .told
        .iter()
        .filter(|report| report["state"] == "receiving");
    let mut reasons: std::vec::Vec<_> = received
        .filter_map(|report| report["reason"].as_str().map(Into::into))
        .collect();
    reasons.dedup();
    reasons
}

#[test]
fn a_patch_makes_the_image() {
    for (lost, doubled, shuffled) in [(0, 0, false), (50, 50, false), (200, 200, true)] {
        let release = changed();
        let patch = release.patch.clone().expect("made");
        assert!(
            (17..40).contains(&chunks(&patch)),
            "more than a window: {}",
            patch.len()
        );
        let world = World::new(&release);
        {
            let mut server = world.server.borrow_mut();
            (server.lost, server.doubled, server.shuffled) = (lost, doubled, shuffled);
        }
        let life = world.run_until(confirmed);
        assert_eq!((life.build.as_str(), life.slot), ("new", 1));
        let server = life.server.borrow();
        assert_eq!(server.of_image, 0, "{lost}: {:?}", reasons(&life));
        if lost == 0 {
            assert_eq!(server.sent, 1 + chunks(&patch), "nothing is sent twice");
        }
        // As often as without a patch: each sector, the trailer, a sector of otadata.
        let sectors = release.image.len().div_ceil(4_096);
        assert!(world.cells.borrow().erased <= sectors + 2);
        for report in &server.told {
            assert!(report["reason"].is_null(), "{report}");
        }
    }
}

/// What is wrong with a patch costs what it has made of the block that it is wrong in, and is told.
#[test]
fn a_patch_that_is_wrong_is_given_up_for_the_image() {
    let good = changed();
    let patch = good.patch.clone().expect("made");
    let mut of_another_size = patch.clone();
    of_another_size[1] ^= 1;
    let mut wrong = patch.clone();
    // A byte of a difference, in the last block.
    let at = patch.len() - 200;
    wrong[at] ^= 0x10;
    for (patch, reason, kept) in [
        (std::vec![0x55; 3_000], "delta_type", 0),
        (of_another_size, "delta_size", 0),
        (patch[..patch.len() / 2].to_vec(), "delta_cut_off", 1),
        ([&patch[..], &[0; 40]].concat(), "delta_trailing", 2),
        (wrong, "delta_", 2),
    ] {
        let mut release = good.clone();
        release.patch = Some(patch);
        let world = World::new(&release);
        let life = world.run_until(confirmed);
        assert_eq!(life.build, "new", "{reason}");
        let told = reasons(&life);
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told[0].starts_with(reason), "{told:?} {reason}");
        let server = life.server.borrow();
        let kept = kept * 64;
        assert_eq!(server.of_image, chunks(&release.image) - kept, "{reason}");
    }
}

#[test]
fn a_patch_of_another_program_is_not_asked_for() {
    let mut release = changed();
    release.patch = None;
    let world = World::new(&release);
    world.server.borrow_mut().offering = false;
    let mut life = world.start(ResetCause::PowerOn);
    life.run_until(Duration::from_secs(2), |_| false);
    for base in ["older", "new"] {
        let id = release.id();
        let offer = std::format!(
            r#"{{"update":"offer","release":"{id}","delta":{{"base":"{base}","bytes":5000}}}}"#
        );
        crate::update::UpdatePort::arrived(&*life.updates, offer.as_bytes()).expect("an offer");
    }
    let end = life.run_until(Duration::from_secs(400), |_| false);
    assert_eq!(end, End::Restart);
    let server = life.server.borrow();
    assert_eq!(server.of_image, chunks(&release.image));
    assert!(server.told.iter().all(|report| report["part"] != "delta"));
}

#[test]
fn a_server_without_the_patch_that_it_offered_is_asked_for_the_image() {
    let release = changed();
    let world = World::new(&release);
    world.server.borrow_mut().without_patch = true;
    let mut life = world.start(ResetCause::PowerOn);
    let end = life.run_until(Duration::from_secs(400), |_| false);
    assert_eq!(end, End::Restart);
    assert_eq!(reasons(&life), ["delta_no_data"]);
    assert_eq!(life.server.borrow().of_image, chunks(&release.image));
}

/// What was made is not known any more once it could not be written.
#[test]
fn a_flash_that_fails_once_costs_the_patch() {
    let release = changed();
    let world = World::new(&release);
    let mut life = world.start(ResetCause::PowerOn);
    let end = life.run_until(Duration::from_secs(100), |life| {
        life.server.borrow().of_patch >= 10
    });
    assert_eq!(end, End::Done);
    world.cells.borrow_mut().failing = 1;
    let end = life.run_until(Duration::from_secs(400), |_| false);
    assert_eq!(end, End::Restart);
    assert_eq!(reasons(&life), ["flash_failed"]);
    assert_eq!(life.server.borrow().of_image, chunks(&release.image));
}

proptest! {
    #![proptest_config(crawler_properties::cases(32))]

    /// Whenever the power goes, and however often: the patch comes once more from its beginning, and nothing of the
    /// image; what is there is neither erased nor written again.
    #[test]
    fn whenever_the_power_goes_the_patch_begins_again(
        cuts in prop::collection::vec(
            prop_oneof![0_usize..2_000, 0_usize..60_000, 150_000_usize..330_000],
            1..5,
        ),
        lost in prop_oneof![Just(0_u32), Just(50)],
    ) {
        let release = changed();
        let world = World::new(&release);
        world.server.borrow_mut().lost = lost;
        for cut in &cuts {
            world.cells.borrow_mut().budget = Some(*cut);
            let mut life = world.start(ResetCause::PowerOn);
            life.run_until(Duration::from_secs(100), |_| false);
            prop_assert!(life.build == "old" || life.build == "new");
            world.cells.borrow_mut().budget = None;
        }
        world.server.borrow_mut().told.clear();
        let life = world.run_until(confirmed);
        prop_assert_eq!(life.build.as_str(), "new");
        let server = life.server.borrow();
        prop_assert_eq!(server.of_image, 0);
        let sectors = release.image.len().div_ceil(4_096) + 2;
        let most = sectors + (cuts.len() + 1) * sectors;
        prop_assert!(world.cells.borrow().erased <= most);
        if lost == 0 {
            let times = cuts.len() as u32 + 2;
            prop_assert!(server.of_patch <= times * chunks(release.patch.as_ref().expect("made")));
        }
    }

    /// Whatever a patch holds: in the end there is the right image, and each byte of it was asked for once at most.
    #[test]
    fn whatever_a_patch_holds_the_image_is_the_right_one(
        how in prop_oneof![
            Just(None),
            (any::<prop::sample::Index>(), any::<u8>()).prop_map(Some),
        ],
        anything in prop::collection::vec(any::<u8>(), 1..4_000),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut release = changed();
        let mut patch = match how {
            Some((at, value)) => {
                let mut patch = release.patch.take().expect("made");
                *at.get_mut(&mut patch) = value;
                patch
            }
            // With the head of one, so that it is not turned away at once.
            None => [&release.patch.take().expect("made")[..5], &anything].concat(),
        };
        if let Some(cut) = cut {
            patch.truncate(cut.index(patch.len()) + 1);
        }
        let sent = chunks(&patch);
        release.patch = Some(patch);
        let world = World::new(&release);
        let life = world.run_until(confirmed);
        prop_assert_eq!(life.build.as_str(), "new");
        let server = life.server.borrow();
        prop_assert!(server.of_patch <= sent, "a patch is read once");
        prop_assert!(server.of_image <= chunks(&release.image));
        let sectors = release.image.len().div_ceil(4_096);
        prop_assert!(world.cells.borrow().erased <= 2 * sectors + 2);
    }
}
