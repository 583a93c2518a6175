//! Flash memory: its rules, its losses, and a real store on top of it.

use std::cell::RefCell;
use std::collections::BTreeMap;

use embassy_futures::block_on;
use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};
use proptest::prelude::*;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};

use super::*;
use crate::faults::Fault;

#[test]
fn every_rule_is_enforced_and_every_violation_counted() {
    let chip = Chip::blank(2, 1);
    let mut flash = SimFlash::open(&chip);
    block_on(async {
        let mut word = [0; 4];
        assert_eq!(flash.capacity(), 8_192);
        assert_eq!(flash.read(2, &mut word).await, Err(FlashError::NotAligned));
        assert_eq!(
            flash.read(0, &mut word[..3]).await,
            Err(FlashError::NotAligned)
        );
        assert_eq!(
            flash.read(8_192, &mut word).await,
            Err(FlashError::OutOfBounds)
        );
        assert_eq!(flash.write(1, &word).await, Err(FlashError::NotAligned));
        assert_eq!(flash.write(0, &[0; 6]).await, Err(FlashError::NotAligned));
        assert_eq!(
            flash.write(8_188, &[0; 8]).await,
            Err(FlashError::OutOfBounds)
        );
        assert_eq!(
            flash.write(u32::MAX - 3, &word).await,
            Err(FlashError::OutOfBounds)
        );
        assert_eq!(flash.erase(0, 4_000).await, Err(FlashError::NotAligned));
        assert_eq!(flash.erase(0, 12_288).await, Err(FlashError::OutOfBounds));
        assert_eq!(flash.erase(4_096, 0).await, Err(FlashError::OutOfBounds));
        assert_eq!(chip.borrow().violations(), 10);

        flash.write(4, &[0xF0, 0, 0xFF, 0x0F]).await.expect("blank");
        flash
            .write(4, &[0x50, 0, 0xAA, 0x0F])
            .await
            .expect("only falls");
        flash.read(4, &mut word).await.expect("in bounds");
        assert_eq!(word, [0x50, 0, 0xAA, 0x0F]);
        assert_eq!(
            flash.write(0, &[0, 0, 0, 0, 0, 1, 0, 0]).await,
            Err(FlashError::NotErased)
        );
        flash.read(0, &mut word).await.expect("in bounds");
        assert_eq!(word, [0xFF; 4], "a refused write changes nothing");
        assert_eq!(chip.borrow().violations(), 11);
        assert_eq!(chip.borrow().erases(0), Some(0));
        flash.erase(0, 4_096).await.expect("a whole block");
        flash.read(4, &mut word).await.expect("in bounds");
        assert_eq!(word, [0xFF; 4]);
        assert_eq!(chip.borrow().erases(0), Some(1));
        assert_eq!(chip.borrow().erases(1), Some(0));
        assert_eq!(chip.borrow().violations(), 11);
    });
}

#[test]
fn power_goes_at_exactly_the_byte_it_was_told_to() {
    for cut in 0..12_u64 {
        let chip = Chip::blank(2, cut);
        chip.borrow_mut().cut_power_after(cut);
        let mut flash = SimFlash::open(&chip);
        block_on(async {
            let result = flash.write(0, &[0; 12]).await;
            assert_eq!(result, Err(FlashError::PowerLost));
            assert_eq!(flash.read(0, &mut [0; 4]).await, Err(FlashError::PowerLost));
            chip.borrow_mut().restore_power();
            assert_eq!(
                flash.read(0, &mut [0; 4]).await,
                Err(FlashError::PowerLost),
                "the old handle stays cut off"
            );
            let mut read = [0; 12];
            let mut flash = SimFlash::open(&chip);
            flash.read(0, &mut read).await.expect("powered");
            let cut = cut as usize;
            assert!(read[..cut].iter().all(|&byte| byte == 0), "{read:?}");
            assert!(read[cut + 1..].iter().all(|&byte| byte == 0xFF), "{read:?}");
        });
    }
}

#[test]
fn a_torn_erase_leaves_a_block_that_is_neither() {
    let chip = Chip::blank(2, 3);
    let mut flash = SimFlash::open(&chip);
    block_on(async {
        flash.write(0, &[0; 4_096]).await.expect("blank");
        flash.write(4_096, &[0; 4]).await.expect("blank");
        chip.borrow_mut().cut_power_after(1_000);
        assert_eq!(flash.erase(0, 8_192).await, Err(FlashError::PowerLost));
        chip.borrow_mut().restore_power();
        let mut flash = SimFlash::open(&chip);
        let mut block = [0; 4_096];
        flash.read(0, &mut block).await.expect("powered");
        assert!(block[..1_000].iter().all(|&byte| byte == 0xFF));
        assert!(block[1_000..].iter().any(|&byte| byte != 0xFF));
        flash.read(4_096, &mut block[..4]).await.expect("powered");
        assert_eq!(block[..4], [0; 4], "the second block was not reached");
        flash.erase(0, 8_192).await.expect("powered");
        flash.read(0, &mut block).await.expect("powered");
        assert!(block.iter().all(|&byte| byte == 0xFF));
    });
}

#[test]
fn a_cut_in_a_world_resets_the_robot_and_keeps_the_memory() {
    let mut bench = Bench::facing(1.0, exact(), 1);
    let robot = bench.robot;
    let mut parts = bench.parts();
    bench.run(parts.flash.write(0, &[7; 4])).expect("blank");
    let cut = Fault::FlashPowerCut { after_bytes: 2 };
    bench.world.inject(robot, cut).expect("any number");
    assert_eq!(
        bench.run(parts.flash.write(4, &[7; 4])),
        Err(FlashError::PowerLost)
    );
    let cause = crawler_hal::ResetCause::BrownOut;
    assert_eq!(
        bench.world.take_events(),
        vec![crate::world::BodyEvent::Reset(robot, cause)]
    );
    let mut parts = bench.world.boot(robot, cause).expect("powered");
    let mut read = [0; 8];
    bench.run(parts.flash.read(0, &mut read)).expect("powered");
    assert_eq!(read[..6], [7; 6]);
    assert_eq!(read[7], 0xFF);
}

type Store = MapStorage<u8, SimFlash, Cache<Uncached, Uncached, Uncached, u8>>;

fn map(chip: &Rc<RefCell<Chip>>) -> Store {
    MapStorage::new(
        SimFlash::open(chip),
        const { MapConfig::new(0..8_192) },
        Cache::new_uncached(),
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    /// The store that the robots use, over hundreds of writes and power cuts at any byte: a value
    /// whose store was confirmed is never lost, one that was cut is the old or the new one.
    #[test]
    fn a_map_survives_power_cuts_anywhere(
        seed: u64,
        writes in proptest::collection::vec((0..6_u8, any::<u32>(), 1..60_usize, 0..9_u8), 200..400),
    ) {
        let chip = Chip::blank(2, seed);
        let mut model: BTreeMap<u8, Vec<u8>> = BTreeMap::new();
        let mut buffer = [0; 128];
        let mut cuts = 0;
        block_on(async {
            let mut store = map(&chip);
            for (key, value, length, cut) in writes {
                let bytes = value.to_le_bytes().repeat(length.div_ceil(4));
                let bytes = &bytes[..length];
                if cut == 0 {
                    chip.borrow_mut().cut_power_after(u64::from(value % 300));
                }
                match store.store_item(&mut buffer, &key, &bytes).await {
                    Ok(()) => {
                        model.insert(key, bytes.to_vec());
                        chip.borrow_mut().keep_power();
                    }
                    Err(error) => {
                        prop_assert!(!chip.borrow().has_power(), "{error:?}");
                        cuts += 1;
                        chip.borrow_mut().restore_power();
                        store = map(&chip);
                        let found = store
                            .fetch_item::<&[u8]>(&mut buffer, &key)
                            .await
                            .expect("readable after a cut")
                            .map(<[u8]>::to_vec);
                        let old = model.get(&key);
                        prop_assert!(
                            found.as_ref() == old || found.as_deref() == Some(bytes),
                            "key {key}: {found:?}, was {old:?}, cut at {bytes:?}"
                        );
                        if let Some(found) = found {
                            model.insert(key, found);
                        }
                    }
                }
                for (key, want) in &model {
                    let found = store
                        .fetch_item::<&[u8]>(&mut buffer, key)
                        .await
                        .expect("readable");
                    prop_assert_eq!(found, Some(&want[..]), "key {}", key);
                }
            }
            Ok(())
        })?;
        prop_assert!(cuts > 0);
        prop_assert_eq!(chip.borrow().violations(), 0, "the store keeps the rules");
    }
}

#[test]
fn memory_follows_what_was_written() {
    let chip = Chip::blank(64, 1);
    let mut flash = SimFlash::open(&chip);
    block_on(flash.write(4_096 * 60, &[0; 8])).expect("blank");
    assert!(chip.borrow().footprint() <= 16, "not the whole region");
}
