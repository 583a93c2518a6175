//! Random lives of a robot: updates of every nature, restarts of every cause, and power cuts at random bytes,
//! several of them in one update.

use proptest::prelude::*;

use crate::chip::{Chip, PowerLost};
use crate::robot::{Nature, resume, start, update};
use crawler_boot::otadata::{Entry, Goal, ImageState, Otadata, Slots};
use crawler_hal::ResetCause;

#[derive(Clone, Debug)]
enum Happening {
    /// An update, and the power cuts that it meets: bytes until each, and how it tears.
    Update(Nature, Vec<(u64, u64)>),
    /// A restart while a proven program runs.
    Restart(ResetCause),
}

fn nature() -> impl Strategy<Value = Nature> {
    prop_oneof![
        Just(Nature::Good),
        Just(Nature::Restarting),
        (0_u32..6).prop_map(Nature::CutOff),
        Just(Nature::Panics),
        Just(Nature::Hangs),
        Just(Nature::NoLink),
        Just(Nature::Rots),
    ]
}

fn happening() -> impl Strategy<Value = Happening> {
    let causes = [
        ResetCause::PowerOn,
        ResetCause::Software,
        ResetCause::Watchdog,
        ResetCause::BrownOut,
        ResetCause::Panic,
        ResetCause::External,
    ];
    // Few bytes are programmed after the long erases: cuts shall not all fall into these.
    let cut = prop_oneof![0_u64..200, 4_000_u64..4_400, 0_u64..10_000];
    let cuts = proptest::collection::vec((cut, any::<u64>()), 0..4);
    prop_oneof![
        3 => (nature(), cuts).prop_map(|(nature, cuts)| Happening::Update(nature, cuts)),
        1 => proptest::sample::select(causes.to_vec()).prop_map(Happening::Restart),
    ]
}

proptest! {
    #![proptest_config(crawler_properties::cases(300))]

    /// The model of it all: one proven program, and one that may come to be.
    #[test]
    fn a_robot_always_starts_what_is_proven_or_on_trial(
        blank in any::<bool>(),
        life in proptest::collection::vec(happening(), 1..12),
    ) {
        let mut chip = Chip::new();
        chip.images[0] = Some(1);
        chip.truth.proven.insert(1);
        if !blank {
            chip.bytes[..32].copy_from_slice(&Entry::new(1, ImageState::Valid).to_bytes());
        }
        let (mut running, _) = start(&mut chip, ResetCause::PowerOn).unwrap();
        let mut version = 1;
        for happening in life {
            let before = chip.images[usize::from(running)];
            match happening {
                Happening::Restart(cause) => {
                    prop_assert_eq!(start(&mut chip, cause), Ok((running, false)));
                }
                Happening::Update(nature, cuts) => {
                    version += 1;
                    let mut cuts = cuts.into_iter();
                    chip.budget = cuts.next();
                    let mut ended = update(&mut chip, running, version, nature, b"envelope");
                    while ended == Err(PowerLost) {
                        chip.budget = cuts.next();
                        ended = resume(&mut chip, version, nature);
                    }
                    chip.budget = None;
                    running = ended.unwrap();
                    let now = chip.images[usize::from(running)];
                    // Started before it rots, an image may prove itself; cut off too often, it may not.
                    let either = matches!(nature, Nature::Rots | Nature::CutOff(_));
                    let expected = if nature.is_good() { Some(version) } else { before };
                    prop_assert!(now == expected || either && (now == before || now == Some(version)));
                    prop_assert_eq!(start(&mut chip, ResetCause::PowerOn), Ok((running, false)));
                }
            }
        }
    }

    /// Whatever the entries hold, going toward a goal ends: reached, or refused, in a few operations.
    #[test]
    fn whatever_the_entries_hold_a_robot_that_runs_can_say_so(
        mut first in proptest::array::uniform32(any::<u8>()),
        mut second in proptest::array::uniform32(any::<u8>()),
        fits in any::<[bool; 2]>(),
        running in 0_u8..2,
    ) {
        for (entry, fits) in [(&mut first, fits[0]), (&mut second, fits[1])] {
            if fits {
                let crc = crawler_boot::crc32_le(u32::MAX, &entry[..4]);
                entry[28..].copy_from_slice(&crc.to_le_bytes());
            }
        }
        let mut chip = Chip::new();
        chip.bytes[..32].copy_from_slice(&first);
        chip.bytes[4_096..4_128].copy_from_slice(&second);
        let confirm = Goal::Confirm { running };
        let otadata = Otadata::reach(&mut chip, 0, Slots::TWO, confirm).unwrap();
        prop_assert_eq!(otadata.toward(Goal::Keep { running }), Ok(None));
        let activate = Goal::Activate { slot: 1 - running, running };
        Otadata::reach(&mut chip, 0, Slots::TWO, activate).unwrap();
        let give_up = Goal::GiveUp { running: 1 - running };
        let otadata = Otadata::reach(&mut chip, 0, Slots::TWO, give_up).unwrap();
        prop_assert_eq!(otadata.toward(Goal::Keep { running }), Ok(None));
    }
}
