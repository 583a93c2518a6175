//! Whether an image is the one that was signed.

use crawler_release::{BLOCK_SIZES, BlockHasher, ImageError, ImageHasher, Manifest};
use proptest::prelude::*;

use crate::support::Draft;

fn image(length: usize, seed: u8) -> Vec<u8> {
    (0..length)
        .map(|at| (at as u8).wrapping_mul(31) ^ (at >> 8) as u8 ^ seed)
        .collect()
}

/// What a hasher says of an image that arrives in slices.
fn check(manifest: &Manifest<'_>, image: &[u8], slice: usize) -> Result<(), ImageError> {
    let mut hasher = ImageHasher::new(manifest);
    for (count, bytes) in image.chunks(slice).enumerate() {
        hasher.update(bytes)?;
        let arrived = (count + 1) * slice;
        let blocks = arrived.min(image.len()) / BLOCK_SIZES[0] as usize;
        assert!(hasher.verified() >= blocks, "a block waits for the next");
    }
    hasher.finish()
}

proptest! {
    #![proptest_config(crawler_properties::cases(24))]

    #[test]
    fn an_image_is_itself_in_any_slices(length in 1..200_000_usize, slice in 1..70_000_usize, seed: u8) {
        let image = image(length, seed);
        let draft = Draft::of(&image);
        prop_assert_eq!(check(&draft.manifest(), &image, slice), Ok(()));
    }

    #[test]
    fn a_changed_bit_is_found_in_its_block(length in 1..200_000_usize, at: proptest::sample::Index, bit in 0..8_u8) {
        let mut image = image(length, 1);
        let draft = Draft::of(&image);
        let place = at.index(length);
        image[place] ^= 1 << bit;
        let block = u16::try_from(place / BLOCK_SIZES[0] as usize).expect("few");
        prop_assert_eq!(check(&draft.manifest(), &image, 4_096), Err(ImageError::BadBlock(block)));
    }

    /// Each block by itself, and the whole without its blocks.
    #[test]
    fn blocks_and_whole_are_found_apart(length in 1..200_000_usize, at: proptest::sample::Index, seed: u8) {
        let mut image = image(length, seed);
        let draft = Draft::of(&image);
        let place = at.index(length);
        let spoiled = place / BLOCK_SIZES[0] as usize;
        for changed in [false, true] {
            image[place] ^= u8::from(changed);
            let manifest = draft.manifest();
            for (index, block) in image.chunks(BLOCK_SIZES[0] as usize).enumerate() {
                let mut hasher = BlockHasher::new(&manifest, index).expect("a block");
                prop_assert_eq!(hasher.update(block), Ok(()));
                let bad = Err(ImageError::BadBlock(u16::try_from(index).expect("few")));
                prop_assert_eq!(hasher.finish(), if changed && index == spoiled { bad } else { Ok(()) });
            }
            let mut whole = BlockHasher::whole(&manifest);
            for piece in image.chunks(999) {
                prop_assert_eq!(whole.update(piece), Ok(()));
            }
            prop_assert_eq!(whole.update(&[0]), Err(ImageError::TooLong));
            prop_assert_eq!(whole.finish(), if changed { Err(ImageError::BadHash) } else { Ok(()) });
            prop_assert_eq!(BlockHasher::whole(&manifest).finish(), Err(ImageError::TooShort));
        }
    }

    #[test]
    fn another_length_is_found(length in 1..200_000_usize, cut: proptest::sample::Index, more in 1..70_000_usize) {
        let whole = image(length, 2);
        let draft = Draft::of(&whole);
        let short = &whole[..cut.index(length)];
        prop_assert_eq!(check(&draft.manifest(), short, 4_096), Err(ImageError::TooShort));
        let long = image(length + more, 2);
        prop_assert!(check(&draft.manifest(), &long, 4_096).is_err());
    }
}

#[test]
fn the_image_of_another_release_is_refused_at_once() {
    let (ours, theirs) = (image(140_000, 1), image(140_000, 2));
    let draft = Draft::of(&ours);
    assert_eq!(
        check(&draft.manifest(), &theirs, 1_024),
        Err(ImageError::BadBlock(0))
    );
    // Its last block, behind ours.
    let mixed = [&ours[..131_072], &theirs[131_072..]].concat();
    assert_eq!(
        check(&draft.manifest(), &mixed, 1_024),
        Err(ImageError::BadBlock(2))
    );
}

#[test]
fn the_whole_counts_beside_its_blocks() {
    let image = image(70_000, 3);
    let mut draft = Draft::of(&image);
    draft.sha256[31] ^= 1;
    assert_eq!(
        check(&draft.manifest(), &image, 1_024),
        Err(ImageError::BadHash)
    );
}

#[test]
fn a_block_stands_alone() {
    let image = image(140_000, 4);
    let draft = Draft::of(&image);
    let manifest = draft.manifest();
    for (index, bytes) in image.chunks(65_536).enumerate() {
        let mut hasher = BlockHasher::new(&manifest, index).expect("a block");
        for slice in bytes.chunks(1_024) {
            hasher.update(slice).expect("within the block");
        }
        assert_eq!(hasher.left(), 0);
        assert_eq!(hasher.clone().update(&[0]), Err(ImageError::TooLong));
        assert_eq!(hasher.finish(), Ok(()));
    }
    assert!(BlockHasher::new(&manifest, 3).is_none());
    let mut hasher = BlockHasher::new(&manifest, 1).expect("a block");
    hasher.update(&image[..65_535]).expect("within the block");
    assert_eq!(hasher.clone().finish(), Err(ImageError::TooShort));
    hasher.update(&[0]).expect("within the block");
    assert_eq!(hasher.finish(), Err(ImageError::BadBlock(1)));
}
