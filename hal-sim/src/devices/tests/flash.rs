//! Flash memory: its rules, its losses, and a real store on top of it.

use std::cell::RefCell;
use std::collections::BTreeMap;

use embassy_futures::block_on;
use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};
use rand_core::Rng;
use rand_pcg::Pcg32;
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
fn a_torn_write_only_ever_clears_bits() {
    for seed in 0..50 {
        let chip = Chip::blank(2, seed);
        let mut flash = SimFlash::open(&chip);
        block_on(async {
            flash.write(0, &[0x5A; 4]).await.expect("blank");
            chip.borrow_mut().cut_power_after(1);
            let torn = flash.write(0, &[0x50; 4]).await;
            assert_eq!(torn, Err(FlashError::PowerLost));
            chip.borrow_mut().restore_power();
            let mut read = [0; 4];
            let mut flash = SimFlash::open(&chip);
            flash.read(0, &mut read).await.expect("powered");
            assert_eq!([read[0], read[2], read[3]], [0x50, 0x5A, 0x5A]);
            assert_eq!(read[1] & !0x5A, 0, "no bit rose: {read:02X?}");
            assert_eq!(read[1] & 0x50, 0x50, "no bit fell that was to stay");
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
    let mut bench = TestBody::facing(1.0, exact(), 1);
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
        vec![BodyEvent::Reset(robot, cause)]
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

/// The store that the robots use, over thousands of writes and power cuts at any byte of them and
/// of the erases between: a value whose store was confirmed is never lost, one whose store was cut
/// is the old or the new one.
#[test]
fn a_map_survives_power_cuts_anywhere() {
    let (mut cuts, mut erases) = (0, 0);
    for seed in 0..40 {
        let chip = Chip::blank(2, seed);
        let mut rng = Pcg32::new(seed, 77);
        cuts += block_on(torture(&chip, &mut rng, 300));
        assert_eq!(chip.borrow().violations(), 0, "the store keeps the rules");
        erases += chip.borrow().erases(0).expect("a sector");
    }
    assert!(cuts > 500, "{cuts}");
    assert!(erases > 100, "{erases}");
}

/// Returns how often the power went.
async fn torture(chip: &Rc<RefCell<Chip>>, rng: &mut Pcg32, writes: u32) -> u32 {
    let mut model: BTreeMap<u8, Vec<u8>> = BTreeMap::new();
    let mut buffer = [0; 128];
    let mut store = map(chip);
    let mut cuts = 0;
    let mut planned = false;
    for write in 0..writes {
        if !planned && rng.next_u32().is_multiple_of(4) {
            // Now and then far enough away to meet an erase.
            let reach = [100, 6_000][usize::from(rng.next_u32().is_multiple_of(4))];
            chip.borrow_mut()
                .cut_power_after(u64::from(rng.next_u32() % reach));
            planned = true;
        }
        let key = (rng.next_u32() % 6) as u8;
        let mut bytes = vec![0; 1 + (rng.next_u32() % 60) as usize];
        rng.fill_bytes(&mut bytes);
        match store.store_item(&mut buffer, &key, &&bytes[..]).await {
            Ok(()) => {
                model.insert(key, bytes);
            }
            Err(error) => {
                assert!(!chip.borrow().has_power(), "write {write}: {error:?}");
                chip.borrow_mut().restore_power();
                (cuts, planned) = (cuts + 1, false);
                store = map(chip);
                let found = fetch(&mut store, &mut buffer, key).await;
                let old = model.get(&key);
                assert!(
                    found.as_ref() == old || found.as_ref() == Some(&bytes),
                    "write {write}, key {key}: {found:?}, was {old:?}, cut at {bytes:?}"
                );
                if let Some(found) = found {
                    model.insert(key, found);
                }
            }
        }
        for (&key, want) in &model {
            let found = fetch(&mut store, &mut buffer, key).await;
            assert_eq!(found.as_ref(), Some(want), "write {write}, key {key}");
        }
    }
    cuts
}

async fn fetch(store: &mut Store, buffer: &mut [u8], key: u8) -> Option<Vec<u8>> {
    let found = store.fetch_item::<&[u8]>(buffer, &key).await;
    found.expect("readable after any cut").map(<[u8]>::to_vec)
}

#[test]
fn memory_follows_what_was_written() {
    let chip = Chip::blank(64, 1);
    let mut flash = SimFlash::open(&chip);
    block_on(flash.write(4_096 * 60, &[0; 8])).expect("blank");
    assert!(chip.borrow().footprint() <= 16, "not the whole region");
}
