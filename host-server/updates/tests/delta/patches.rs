//! What is made of two images.

use crawler_delta::DeltaError;
use crawler_updates::delta::{apply, make};
use proptest::prelude::*;

use crate::images::{golden, pairs};

#[track_caller]
fn check(old: &[u8], new: &[u8]) -> Vec<u8> {
    let patch = make(old, new);
    assert!(apply(old, new.len() as u32, &patch).as_deref() == Ok(new));
    patch
}

proptest! {
    #[test]
    fn a_patch_makes_the_new_image((old, new) in pairs()) {
        let patch = make(&old, &new);
        prop_assert_eq!(apply(&old, new.len() as u32, &patch), Ok(new.clone()));
        prop_assert_eq!(&make(&old, &new), &patch, "the same again");
        // At worst every byte has a bit beside it, and there are a few numbers.
        prop_assert!(patch.len() <= new.len() * 9 / 8 + 16 + new.len() / 4);
    }
}

#[test]
fn a_patch_is_no_larger_than_that_of_detools() {
    let (old, new) = (golden("old.bin"), golden("new.bin"));
    let ours = check(&old, &new);
    for theirs in ["w4-l3", "w8-l7", "w10-l4", "w10-l9"] {
        let theirs = golden(&format!("{theirs}.patch"));
        assert!(
            ours.len() <= theirs.len(),
            "{} {}",
            ours.len(),
            theirs.len()
        );
    }
    assert!(check(&new, &old).len() <= golden("back.patch").len());
}

#[test]
fn what_is_alike_takes_next_to_nothing() {
    let image: Vec<u8> = (0..60_000_u32).map(|at| ((at * at) >> 7) as u8).collect();
    assert!(check(&image, &image).len() < 320);
    assert_eq!(check(&image, &[]), [0x04, 0x00]);
    check(&[], &image);
    check(&[], &[]);
    let mut changed = image.clone();
    changed[30_000] ^= 1;
    assert!(check(&image, &changed).len() < 330);
    let longer = [&image[..20_000], b"something", &image[20_000..]].concat();
    assert!(check(&image, &longer).len() < 350);
}

/// What makes some differs slow: long stretches of the same, of different lengths, and short periods.
#[test]
fn images_that_are_filled_up_are_no_trouble() {
    let filled = |byte: u8, length: usize| {
        let mut image = b"a program and what fills its slot up ".repeat(4);
        image.resize(length, byte);
        image
    };
    for (old, new) in [
        (filled(0, 120_000), filled(0, 150_000)),
        (filled(0, 150_000), filled(0, 120_000)),
        (filled(0, 100_000), filled(0xFF, 100_000)),
        (b"ab".repeat(50_000), b"ba".repeat(50_001)),
    ] {
        let patch = check(&old, &new);
        assert!(patch.len() < 2_000, "{}", patch.len());
    }
}

#[test]
fn a_patch_is_for_two_images() {
    let (old, new) = (golden("old.bin"), golden("new.bin"));
    let patch = make(&old, &new);
    let length = new.len() as u32;
    assert_eq!(apply(&old, length - 1, &patch), Err(DeltaError::Size));
    let short = &old[..old.len() / 2];
    assert_eq!(apply(short, length, &patch), Err(DeltaError::Outside));
    assert_eq!(apply(&old, length, &patch[..90]), Err(DeltaError::CutOff));
    let other = apply(&new, length, &patch).expect("as long");
    assert_ne!(other, new);
}

#[test]
#[should_panic(expected = "an image too long")]
fn an_image_has_an_end() {
    let _ = make(&[], &vec![0; crawler_updates::delta::IMAGE_MAX + 1]);
}
