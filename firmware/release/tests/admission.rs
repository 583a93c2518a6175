//! Which releases a robot takes.

use crawler_release::{Chip, Kind, Refusal, Requires, Target};
use proptest::prelude::*;

use crate::support::{Draft, target};

fn admitted(change: impl FnOnce(&mut Draft, &mut Target<'static>)) -> Result<(), Refusal> {
    let mut draft = Draft::of(&vec![7; 100_000]);
    let mut target = target();
    change(&mut draft, &mut target);
    assert_eq!(draft.manifest().validate(), Ok(()));
    draft.manifest().admit(&target)
}

#[test]
fn each_reason_is_told() {
    type Change = fn(&mut Draft, &mut Target<'static>);
    let cases: [(Result<(), &str>, Change); 27] = [
        (Ok(()), |_, _| {}),
        (Err("wrong_kind"), |draft, _| {
            (draft.kind, draft.name) = (Kind::Model, Some("eyes".into()));
        }),
        (Err("wrong_kind"), |_, target| {
            (target.kind, target.name) = (Kind::Model, Some("eyes"));
        }),
        (Ok(()), |draft, target| {
            (draft.kind, draft.name) = (Kind::Model, Some("eyes".into()));
            (target.kind, target.name) = (Kind::Model, Some("eyes"));
        }),
        (Err("wrong_kind"), |draft, target| {
            (draft.kind, draft.name) = (Kind::Model, Some("ears".into()));
            (target.kind, target.name) = (Kind::Model, Some("eyes"));
        }),
        // A place for policies takes them whatever they are called, and nothing else.
        (Ok(()), |draft, target| {
            (draft.kind, draft.name) = (Kind::Policy, Some("spread".into()));
            (target.kind, target.name) = (Kind::Policy, None);
        }),
        (Err("wrong_kind"), |draft, target| {
            (draft.kind, draft.name) = (Kind::Model, Some("spread".into()));
            (target.kind, target.name) = (Kind::Policy, None);
        }),
        (Err("wrong_kind"), |draft, target| {
            (draft.kind, draft.name) = (Kind::Policy, Some("eyes".into()));
            (target.kind, target.name) = (Kind::Model, Some("eyes"));
        }),
        (Err("wrong_kind"), |draft, _| {
            (draft.kind, draft.name) = (Kind::Policy, Some("spread".into()));
        }),
        (Err("wrong_board"), |_, target| target.board = "virt"),
        (Err("wrong_chip"), |_, target| target.chip = Chip::ESP32_C6),
        // At that second it is too late, and not before.
        (Err("expired"), |draft, _| {
            draft.expires = Some(1_700_000_000);
        }),
        (Ok(()), |draft, _| draft.expires = Some(1_700_000_001)),
        // The later of clock and build: a clock that runs behind does not help.
        (Err("expired"), |draft, target| {
            draft.expires = Some(1_700_000_000);
            target.now = Some(5);
        }),
        (Err("expired"), |draft, target| {
            draft.expires = Some(1_700_000_100);
            target.now = Some(1_700_000_100);
        }),
        (Ok(()), |draft, target| {
            draft.expires = Some(1_700_000_100);
            target.now = Some(1_700_000_099);
        }),
        (Err("below_floor"), |_, target| {
            (target.sequence, target.floor) = (0, 13);
        }),
        (Ok(()), |_, target| {
            (target.sequence, target.floor) = (0, 12);
        }),
        (Err("downgrade"), |_, target| target.sequence = 12),
        (Err("downgrade"), |_, target| target.sequence = 13),
        (Err("same_build"), |_, target| target.build = "new"),
        (Err("too_large"), |_, target| target.capacity = 99_999),
        (Ok(()), |_, target| target.capacity = 100_000),
        (Err("requires"), |draft, target| {
            draft.requires.sequence = 11;
            target.sequence = 10;
        }),
        (Ok(()), |draft, _| draft.requires.sequence = 11),
        (Err("requires"), |draft, _| draft.requires.protocol = 2),
        (Ok(()), |draft, target| {
            draft.requires = Requires {
                sequence: 0,
                protocol: 2,
            };
            target.protocol = 3;
        }),
    ];
    for (number, (expected, change)) in cases.into_iter().enumerate() {
        let came = admitted(change).map_err(Refusal::code);
        assert_eq!(came, expected, "case {number}");
    }
}

proptest! {
    /// Whatever came before: once a release is installed, nothing that is not above it is taken, and the
    /// floor that it brought holds even if what is installed is lost.
    #[test]
    fn sequences_only_rise(first in 1..100_u32, second in 1..100_u32, floor in 0..100_u32, lost: bool) {
        let floor = floor.min(first);
        let sequence = if lost { 0 } else { first };
        let came = admitted(|draft, target| {
            (draft.sequence, draft.floor) = (second, 0);
            (target.sequence, target.floor) = (sequence, floor);
        });
        prop_assert_eq!(came.is_ok(), second > sequence && second >= floor);
    }
}
