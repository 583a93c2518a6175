//! The slots for programs: how long they take, what a power cut leaves, and what robots share.

use std::cell::RefCell;
use std::rc::Rc;

use embassy_futures::select::{Either, select};
use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};
use proptest::prelude::*;

use super::*;

const SLOT: u32 = SLOTS[0].start;

/// A chip, its slots, and the time in which they work.
fn bench(seed: u64) -> (Scheduler, Rc<RefCell<Chip>>, SimSlots) {
    let clock = SimClock::new();
    let chip = Chip::blank(2, seed);
    let slots = SimSlots::open(&chip, &clock);
    (Scheduler::new(&clock), chip, slots)
}

/// Runs `work` to its end; what it came to, and how long it took.
fn run<F: Future>(sched: &mut Scheduler, work: F) -> (F::Output, Duration) {
    let begun = sched.now();
    let result = sched.block_on(work, begun + Duration::from_secs(60));
    (result.expect("it comes to an end"), sched.now() - begun)
}

#[test]
fn a_program_takes_as_long_as_on_a_real_chip() {
    let (mut sched, _, mut slots) = bench(1);
    let (erased, erasing) = run(&mut sched, slots.erase(SLOT, SLOT + 0x9_8000));
    erased.expect("erased");
    let ((), writing) = run(&mut sched, async {
        for at in (0..608).map(|kilobyte| kilobyte * 1_024) {
            let written = slots.write(SLOT + at, &[0x5A; 1_024]).await;
            written.expect("erased before");
        }
    });
    // 9 blocks of 64 KiB and one of 32 KiB; 608 × 4 pages.
    assert_eq!(erasing, Duration::from_millis(9 * 150 + 120));
    assert_eq!(writing, Duration::from_micros(608 * 4 * 400));
}

#[test]
fn the_rules_hold_and_cost_no_time() {
    let (mut sched, chip, mut slots) = bench(1);
    let work = async move {
        let end = slots.capacity() as u32;
        assert_eq!(slots.write(2, &[0; 4]).await, Err(FlashError::NotAligned));
        assert_eq!(
            slots.write(end, &[0; 4]).await,
            Err(FlashError::OutOfBounds)
        );
        assert_eq!(slots.erase(0, 2_048).await, Err(FlashError::NotAligned));
        assert_eq!(
            slots.erase(8_192, 4_096).await,
            Err(FlashError::OutOfBounds)
        );
        assert_eq!(
            slots.read(end - 4, &mut [0; 8]).await,
            Err(FlashError::OutOfBounds)
        );
        assert_eq!(slots.write(SLOT, &[]).await, Ok(()));
        assert_eq!(slots.erase(SLOT, SLOT).await, Ok(()));
    };
    let ((), took) = run(&mut sched, work);
    assert_eq!(took, Duration::ZERO);
    assert_eq!(chip.borrow().violations(), 5);
    let mut slots = SimSlots::open(&chip, sched.clock());
    let work = async move {
        slots.write(SLOT + 4_092, &[0xF0; 8]).await.expect("blank");
        assert_eq!(
            slots.write(SLOT + 4_096, &[0x0F; 4]).await,
            Err(FlashError::NotErased)
        );
        slots
            .write(SLOT + 4_096, &[0x30; 4])
            .await
            .expect("bits that fall");
        let mut word = [0; 8];
        slots.read(SLOT + 4_092, &mut word).await.expect("read");
        assert_eq!(word, [0xF0, 0xF0, 0xF0, 0xF0, 0x30, 0x30, 0x30, 0x30]);
        let mut far = [0; 4];
        slots.read(SLOTS[1].start, &mut far).await.expect("read");
        assert_eq!(far, [0xFF; 4], "never written");
    };
    let ((), took) = run(&mut sched, work);
    assert_eq!(took, Duration::from_micros(3 * 38));
}

#[test]
fn the_last_sector_of_every_place_is_within_the_chip() {
    let (mut sched, _, mut slots) = bench(1);
    let work = async move {
        for place in SLOTS.into_iter().chain(POLICIES.places) {
            let last = place.start + place.length - 4;
            slots.write(last, &[0; 4]).await.expect("written");
        }
        let [_, highest] = POLICIES.places;
        assert_eq!(slots.capacity() as u32, highest.start + highest.length);
        assert!(SLOTS[1].start + SLOTS[1].length <= POLICIES.select);
        assert!(OTADATA_AT + 8_192 <= SLOTS[0].start);
    };
    run(&mut sched, work);
}

#[test]
fn an_operation_that_nobody_waits_for_comes_to_its_end() {
    let (mut sched, _, mut slots) = bench(1);
    let clock = sched.clock().clone();
    let work = async move {
        let write = select(
            slots.write(SLOT, &[0; 256]),
            clock.sleep(Duration::from_micros(100)),
        );
        assert!(matches!(write.await, Either::Second(())));
        // The next one waits for it.
        let mut page = [0xFF; 256];
        slots.read(SLOT, &mut page).await.expect("read");
        assert_eq!(page, [0; 256]);
        clock.now()
    };
    let (now, _) = run(&mut sched, work);
    assert_eq!(now, Instant::from_micros(400));
}

#[test]
fn a_reset_of_the_controller_lets_the_chip_finish_and_a_power_cut_does_not() {
    for (reset, whole) in [(true, true), (false, false)] {
        let (mut sched, chip, mut slots) = bench(3);
        let clock = sched.clock().clone();
        let held = Rc::clone(&chip);
        let work = async move {
            let cut = async {
                clock.sleep(Duration::from_micros(100)).await;
                if !reset {
                    held.borrow_mut().lose_power();
                }
                held.borrow_mut().restore_power();
            };
            let (written, ()) =
                embassy_futures::join::join(slots.write(SLOT, &[0; 256]), cut).await;
            assert_eq!(written, Err(FlashError::PowerLost), "an old handle");
            let mut page = [0; 256];
            let mut slots = SimSlots::open(&held, &clock);
            slots.read(SLOT, &mut page).await.expect("read");
            page
        };
        let (page, _) = run(&mut sched, work);
        assert_eq!(page == [0; 256], whole, "reset {reset}");
        let done = page.iter().take_while(|byte| **byte == 0).count();
        let untouched = page.iter().rev().take_while(|byte| **byte == 0xFF).count();
        assert!(
            whole || done + 1 + untouched >= 256,
            "one byte is torn: {page:?}"
        );
        assert!(chip.borrow().has_power());
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]

    /// Wherever the power goes within a write, what is before is written, what is behind is not.
    #[test]
    fn a_power_cut_tears_one_byte(cut in 0_u64..1_200, at in 0_u32..300, seed: u64) {
        let (mut sched, chip, mut slots) = bench(seed);
        chip.borrow_mut().cut_power_after(cut);
        let from = SLOT + at * 4;
        let (written, _) = run(&mut sched, async move { slots.write(from, &[0; 1_024]).await });
        prop_assert_eq!(written.is_ok(), cut >= 1_024);
        chip.borrow_mut().restore_power();
        let mut slots = SimSlots::open(&chip, sched.clock());
        let (bytes, _) = run(&mut sched, async move {
            let mut bytes = [0; 1_024];
            slots.read(from, &mut bytes).await.map(|()| bytes)
        });
        let bytes = bytes.expect("read");
        let whole = (cut as usize).min(1_024);
        prop_assert!(bytes[..whole].iter().all(|byte| *byte == 0));
        prop_assert!(bytes.get(whole + 1..).unwrap_or(&[]).iter().all(|byte| *byte == 0xFF));
    }
}

#[test]
fn robots_with_the_same_programs_hold_them_once() {
    let clock = SimClock::new();
    let mut world = World::new(Arena::empty(60.0, 10.0), 7, &clock).expect("sound");
    let before = world.flash_footprint();
    let image: Vec<u8> = (0..608 * 1_024_u32)
        .map(|at| (at.wrapping_mul(at) >> 7) as u8)
        .collect();
    let mut sched = Scheduler::new(&clock);
    let mut own = Vec::new();
    for robot in 0..20_u8 {
        let pose = Pose {
            x: f32::from(robot) * 2.0 - 20.0,
            ..Pose::default()
        };
        let (_, parts) = world.add_robot(pose).expect("free");
        let mut slots = parts.slots.flash;
        let (written, _) = run(&mut sched, async {
            for slot in SLOTS {
                for (at, piece) in (slot.start..).step_by(1_024).zip(image.chunks(1_024)) {
                    slots.write(at, piece).await?;
                }
            }
            Ok::<_, FlashError>(())
        });
        written.expect("written");
        own.push(world.flash_footprint() - before);
    }
    let each = (own[19] - own[0]) / 19;
    // Both programs are alike too, so the pages are there once.
    assert!(own[0] < 700 * 1_024, "{}", own[0]);
    assert!(each < 24 * 1_024, "{each} bytes a robot");
}
