//! The power goes at any byte.

use crawler_boot::trailer::Outcome as Fate;
use crawler_hal::ResetCause;
use proptest::prelude::*;

use super::life::{End, Life, World};
use super::releases::Draft;

proptest! {
    #![proptest_config(crawler_properties::cases(48))]

    /// Whenever the power goes, and however often: the robot starts a whole program, goes on where it was, and in the
    /// end runs the new one. At most a block is sent again for each time.
    #[test]
    fn whenever_the_power_goes_it_goes_on(
        cuts in prop::collection::vec(
            prop_oneof![0_usize..2_000, 0_usize..60_000, 250_000_usize..330_000],
            1..6,
        ),
        lost in prop_oneof![Just(0_u32), Just(50)],
    ) {
        let release = Draft::new("new", 12).release();
        let world = World::new(&release);
        world.server.borrow_mut().lost = lost;
        for cut in &cuts {
            world.cells.borrow_mut().budget = Some(*cut);
            let cause = ResetCause::PowerOn;
            let mut life = world.start(cause);
            let limit = crawler_hal::Duration::from_secs(100);
            life.run_until(limit, |_| false);
            prop_assert!(life.build == "old" || life.build == "new");
            world.cells.borrow_mut().budget = None;
        }
        world.server.borrow_mut().told.clear();
        let life = world.run_until(|life| {
            life.server.borrow().has_told("outcome", "confirmed")
        });
        prop_assert_eq!(life.build.as_str(), "new");
        if lost == 0 {
            let chunks = release.image.len().div_ceil(1_024) as u32 + 1;
            let most = chunks + (cuts.len() as u32 + 1) * (64 + 1);
            let sent = life.server.borrow().sent;
            prop_assert!(sent <= most, "{sent} of {chunks}");
        }
    }
}

/// What of an update is written at its end decides what is started: every word of it is cut off once.
#[test]
fn the_power_goes_at_every_word_of_the_activation_and_the_confirmation() {
    let mut draft = Draft::new("new", 12);
    draft.size = 9_000;
    let release = draft.release();
    let spent = |world: &World| world.cells.borrow().spent;
    let limit = crawler_hal::Duration::from_secs(200);

    let world = World::new(&release);
    let end = world.start(ResetCause::PowerOn).run_until(limit, |_| false);
    assert_eq!(end, End::Restart);
    let activated = spent(&world);
    let confirmed = |life: &Life| life.server.borrow().has_told("outcome", "confirmed");
    let end = world
        .start(ResetCause::Software)
        .run_until(limit, confirmed);
    assert_eq!(end, End::Done);
    let proven = spent(&world);
    assert!(proven > activated);

    for at in (activated - 100..proven).step_by(4) {
        let world = World::new(&release);
        world.cells.borrow_mut().budget = Some(at);
        let mut life = world.start(ResetCause::PowerOn);
        let mut end = life.run_until(limit, |_| false);
        if end == End::Restart {
            drop(life);
            life = world.start(ResetCause::Software);
            end = life.run_until(limit, confirmed);
        }
        assert!(matches!(end, End::Dark), "at byte {at}: {end:?}");
        drop(life);
        world.cells.borrow_mut().budget = None;
        let life = world.run_until(confirmed);
        assert_eq!(life.build, "new", "at byte {at}");
        drop(life);
        // For good: whatever was left of the old one.
        assert_eq!(
            world.start(ResetCause::PowerOn).build,
            "new",
            "at byte {at}"
        );
        let trailer = world.trailer(1);
        assert_eq!(trailer.outcome(), Some(Fate::Confirmed), "at byte {at}");
    }
}
