//! What is refused, with its own reason, before a byte of flash has changed.

use crawler_hal::ResetCause;
use crawler_release::{Chip, Requires};

use super::life::World;
use super::releases::{Draft, Release};

/// What becomes of a release that is offered: the reason, whether it lasts, and how often the flash was changed.
fn refused(release: &Release) -> (std::string::String, bool, usize) {
    refused_in(&World::new(release))
}

fn refused_in(world: &World) -> (std::string::String, bool, usize) {
    let mut life = world.start(ResetCause::PowerOn);
    life.run_until_told("outcome", "refused");
    let server = life.server.borrow();
    let said = server
        .told
        .iter()
        .rfind(|said| said["outcome"] == "refused");
    let said = said.expect("told");
    let changes = world.cells.borrow().changes;
    let reason = said["reason"].as_str().expect("a reason").into();
    (reason, said["lasting"].as_bool().expect("told"), changes)
}

#[test]
fn a_program_without_keys_believes_nobody() {
    let mut world = World::new(&Draft::new("new", 12).release());
    world.keys = None;
    assert_eq!(refused_in(&world), ("unknown_key".into(), true, 0));
}

#[test]
fn each_with_its_own_reason_and_before_anything_is_erased() {
    let draft = || Draft::new("new", 12);
    let changed = |change: fn(&mut Draft)| {
        let mut draft = draft();
        change(&mut draft);
        draft.release()
    };
    let cases: [(Release, &str, bool); 8] = [
        (changed(|draft| draft.key = 3), "unknown_key", true),
        (changed(|draft| draft.board = "other"), "wrong_board", true),
        (
            changed(|draft| draft.chip = Chip::ESP32_C3),
            "wrong_chip",
            true,
        ),
        (
            changed(|draft| draft.expires = Some(1_700_000_000)),
            "expired",
            true,
        ),
        (changed(|draft| draft.build = "old"), "same_build", true),
        (changed(|draft| draft.size = 0x4_0000), "too_large", true),
        (
            changed(|draft| {
                draft.requires = Requires {
                    sequence: 5,
                    protocol: 0,
                }
            }),
            "requires",
            false,
        ),
        (
            changed(|draft| {
                draft.requires = Requires {
                    sequence: 0,
                    protocol: 200,
                }
            }),
            "requires",
            false,
        ),
    ];
    for (release, reason, lasting) in cases {
        assert_eq!(refused(&release), (reason.into(), lasting, 0));
    }
}

#[test]
fn a_changed_bit_is_a_wrong_signature_or_no_release() {
    let good = Draft::new("new", 12).release();
    for at in [0, 3, 4, 11, 12, 75, 76, 200, good.envelope.len() - 1] {
        let mut release = good.clone();
        release.envelope[at] ^= 4;
        // Offered under the name that such an envelope has, if it has one.
        if at < 4 {
            continue;
        }
        let (reason, _, changes) = refused(&release);
        let expected = if at < 12 {
            "unknown_key"
        } else {
            "bad_signature"
        };
        assert_eq!((reason.as_str(), changes), (expected, 0), "byte {at}");
    }
}

#[test]
fn another_release_than_the_one_that_was_offered_is_refused() {
    let release = Draft::new("new", 12).release();
    let world = World::new(&release);
    world.server.borrow_mut().offering = false;
    let mut life = world.start(ResetCause::PowerOn);
    life.executor.run_for(crawler_hal::Duration::from_secs(3));
    // Same tag, so that its chunks are taken, and another name.
    let mut id = release.id().bytes();
    id[7] ^= 1;
    life.say("offer", crawler_protocol::ReleaseId::new(id));
    life.run_until_told("outcome", "refused");
    let server = life.server.borrow();
    assert_eq!(server.reason("outcome", "refused"), Some("wrong_release"));
    assert_eq!(world.cells.borrow().changes, 0);
}
