//! Starting programs from the slots: which one, and when it is given up.

use std::cell::RefCell;
use std::rc::Rc;

use crawler_boot::RollbackReason;
use crawler_boot::otadata::{Goal, Otadata, Slots};
use crawler_boot::trailer::{Outcome, Trailer};
use crawler_bundle::{Bundle, Defect, DefectKind};
use crawler_hal::ResetCause;
use embedded_storage::nor_flash::{NorFlash as _, ReadNorFlash as _};
use proptest::prelude::*;

use super::*;
use crate::devices::boot::{DefectDraw, install, journal, start};
use crate::devices::flash::BootFlash;

const DRAW: DefectDraw = DefectDraw {
    seed: 7,
    robot: RobotIndex::new(3),
};

/// A robot whose new program waits in slot 1 for its first start.
fn updated() -> Rc<RefCell<Chip>> {
    let chip = Chip::blank(4, 1);
    install(
        &mut chip.borrow_mut(),
        &Bundle::new("2.0.0", "new"),
        2_000,
        0,
    );
    chip
}

/// Starts a program; the slot, and the cause that it is told.
fn started(chip: &Rc<RefCell<Chip>>, cause: ResetCause) -> (u8, ResetCause) {
    let started = start(&mut chip.borrow_mut(), cause, DRAW).expect("a program");
    let build = started.bundle.as_ref().map(|bundle| bundle.build.as_str());
    assert_eq!(build, (started.running == 1).then_some("new"));
    (started.running, started.cause)
}

fn outcome(chip: &Rc<RefCell<Chip>>) -> Option<Outcome> {
    let chip = &mut *chip.borrow_mut();
    let trailer = Trailer::read(&mut BootFlash(chip), journal(1));
    trailer.expect("powered").outcome()
}

fn rolled_back(chip: &Rc<RefCell<Chip>>) -> Option<RollbackReason> {
    match outcome(chip) {
        Some(Outcome::RolledBack(reason)) => Some(reason),
        _ => None,
    }
}

#[test]
fn a_robot_from_the_factory_runs_what_is_compiled_in_and_its_flash_stays_blank() {
    let chip = Chip::blank(4, 1);
    for cause in [ResetCause::PowerOn, ResetCause::Panic, ResetCause::Software] {
        assert_eq!(started(&chip, cause), (0, cause));
    }
    assert_eq!(
        (chip.borrow().bytes_written(), chip.borrow().footprint()),
        (0, 0)
    );
}

#[test]
fn a_new_program_is_tried_and_given_up_when_it_keeps_failing() {
    use ResetCause::{Panic, PowerOn, Software, Watchdog};
    for (cause, attempts, reason) in [
        (Panic, 1, RollbackReason::Panic),
        (Watchdog, 1, RollbackReason::Watchdog),
        (PowerOn, 3, RollbackReason::PowerCycles),
        (Software, 15, RollbackReason::Restarts),
    ] {
        let chip = updated();
        assert_eq!(started(&chip, Software), (1, Software));
        for _ in 0..attempts {
            assert_eq!(started(&chip, cause), (1, cause));
        }
        // Given up within the next start, which ends in the program before.
        assert_eq!(started(&chip, cause), (0, Software), "{cause:?}");
        assert_eq!(rolled_back(&chip), Some(reason));
        for cause in [Panic, PowerOn, Software] {
            assert_eq!(started(&chip, cause), (0, cause));
        }
    }
}

#[test]
fn a_program_that_was_confirmed_stays() {
    let chip = updated();
    assert_eq!(started(&chip, ResetCause::Software).0, 1);
    let goal = Goal::Confirm { running: 1 };
    let reached = Otadata::reach(
        &mut BootFlash(&mut chip.borrow_mut()),
        OTADATA_AT,
        Slots::TWO,
        goal,
    );
    assert!(reached.is_ok());
    for _ in 0..20 {
        assert_eq!(started(&chip, ResetCause::Panic), (1, ResetCause::Panic));
    }
}

#[test]
fn an_image_that_is_not_whole_is_passed_over() {
    let images = |word: u32| {
        let chip = updated();
        let at = SLOTS[1].start + word * 4;
        let mut flash = chip.borrow_mut();
        let mut flash = BootFlash(&mut flash);
        let mut bytes = [0; 4];
        flash.read(at, &mut bytes).expect("powered");
        let falls = bytes.iter().position(|byte| *byte != 0)?;
        // One bit falls.
        bytes[falls] &= bytes[falls] - 1;
        flash.write(at, &bytes).expect("bits that fall");
        Some(Rc::clone(&chip))
    };
    for word in 0..500 {
        let Some(chip) = images(word) else { continue };
        assert_eq!(started(&chip, ResetCause::Software).0, 0, "word {word}");
        assert_eq!(rolled_back(&chip), Some(RollbackReason::BadImage));
        assert_eq!(started(&chip, ResetCause::PowerOn).0, 0);
    }
}

#[test]
fn with_nothing_left_to_start_nothing_starts() {
    let chip = updated();
    {
        let flash = &mut *chip.borrow_mut();
        for slot in SLOTS {
            let mut flash = BootFlash(flash);
            let erased = flash.erase(slot.start, slot.start + 4_096);
            erased.expect("powered");
        }
    }
    assert!(start(&mut chip.borrow_mut(), ResetCause::PowerOn, DRAW).is_none());
}

#[test]
fn a_power_cut_at_any_byte_of_giving_up_ends_with_the_program_before() {
    for cut in 0.. {
        let chip = updated();
        assert_eq!(started(&chip, ResetCause::Software).0, 1);
        assert_eq!(started(&chip, ResetCause::Panic).0, 1);
        let before = chip.borrow().bytes_written();
        chip.borrow_mut().cut_power_after(cut);
        // A cut that came first is a reason of its own to start again.
        let ran = (0..3).take_while(|_| started(&chip, ResetCause::Panic).0 == 1);
        let ran = ran.count();
        assert!(ran <= 1, "{ran} starts after a cut at byte {cut}");
        assert!(rolled_back(&chip).is_some(), "{cut}");
        if chip.borrow().bytes_written() - before < cut {
            assert!(cut > 4, "{cut}");
            return;
        }
    }
}

#[test]
fn defects_show_at_their_share_of_robots_and_at_others_with_another_build() {
    let bundle = |build| Bundle {
        defects: vec![
            Defect {
                percent: 10,
                ..Defect::everywhere(DefectKind::Panic, 5_000)
            },
            Defect::everywhere(DefectKind::NeverLink, 0),
        ],
        ..Bundle::new("1", build)
    };
    let hit = |build| -> Vec<u32> {
        let bundle = bundle(build);
        let robots = 0..2_000;
        let robots = robots.filter(|&robot| {
            let draw = DefectDraw {
                robot: RobotIndex::new(robot),
                ..DRAW
            };
            let defects = crate::devices::boot::shown(&bundle, draw);
            assert!(
                defects
                    .iter()
                    .any(|defect| defect.kind == DefectKind::NeverLink)
            );
            defects
                .iter()
                .any(|defect| defect.kind == DefectKind::Panic)
        });
        robots.collect()
    };
    let (one, other) = (hit("a"), hit("b"));
    assert!((140..260).contains(&one.len()), "{}", one.len());
    assert_eq!(one, hit("a"));
    assert_ne!(one, other);
}

proptest! {
    #![proptest_config(crawler_properties::cases(200))]

    /// Whatever is in the flash, starting comes to an end without a panic.
    #[test]
    fn any_flash_starts_or_does_not(
        entries in proptest::collection::vec(any::<u8>(), 64),
        front in proptest::collection::vec(any::<u8>(), 64),
        trailer in proptest::collection::vec(any::<u8>(), 64),
        keep: bool,
    ) {
        let chip = if keep { updated() } else { Chip::blank(4, 1) };
        {
            let flash = &mut *chip.borrow_mut();
            let mut flash = BootFlash(flash);
            let mut spoil = |at: u32, bytes: &[u8]| {
                let mut old = vec![0; bytes.len()];
                flash.read(at, &mut old).expect("powered");
                let fallen: Vec<u8> = old.iter().zip(bytes).map(|(old, new)| old & new).collect();
                flash.write(at, &fallen).expect("bits that fall");
            };
            spoil(OTADATA_AT, &entries[..32]);
            spoil(OTADATA_AT + 4_096, &entries[32..]);
            spoil(SLOTS[1].start, &front);
            spoil(journal(1), &trailer);
        }
        for cause in [ResetCause::Software, ResetCause::Panic, ResetCause::PowerOn] {
            // The program from the factory is never touched, so one always starts.
            let started = start(&mut chip.borrow_mut(), cause, DRAW);
            prop_assert!(started.is_some());
        }
    }
}
