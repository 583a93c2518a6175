//! From one file with a release to another.

use crawler_release::{Chip, ImageError, Kind, Requires};
use crawler_updates::delta::{BetweenFault, Side, apply, between};
use crawler_updates::release::{FileFault, SecretKey, SignOptions, join};

use crate::images::golden;

fn release(image: &[u8], change: impl FnOnce(&mut SignOptions<'static>)) -> Vec<u8> {
    let mut options = SignOptions {
        kind: Kind::Program,
        name: None,
        board: "virt",
        chip: None,
        version: "0.4.0",
        build: Some("new"),
        sequence: 12,
        floor: 0,
        expires: None,
        requires: Requires::default(),
    };
    change(&mut options);
    let key = SecretKey::generate().expect("random numbers");
    let envelope = options.sign(image, &key).expect("signed");
    join(&envelope, image).expect("an envelope")
}

fn old(image: &[u8]) -> Vec<u8> {
    release(image, |options| options.build = Some("old"))
}

#[test]
fn a_delta_makes_the_image_of_the_later_release() {
    let (a, b) = (golden("old.bin"), golden("new.bin"));
    let (from, to) = (old(&a), release(&b, |_| {}));
    let delta = between(&from, &to).expect("a delta");
    assert_eq!((delta.from.build, delta.to.build), ("old", "new"));
    assert_eq!(apply(&a, delta.to.size, &delta.patch), Ok(b));
}

#[test]
fn what_does_not_belong_together_has_none() {
    let (a, b) = (golden("old.bin"), golden("new.bin"));
    let (from, to) = (old(&a), release(&b, |_| {}));
    let fault = |from: &[u8], to: &[u8]| between(from, to).expect_err("no delta");
    for (side, from, to) in [
        (Side::From, &b"text"[..], &to[..]),
        (Side::To, &from, b""),
        (Side::To, &from, &to[..40]),
    ] {
        assert_eq!(fault(from, to), BetweenFault::File(side, FileFault));
    }
    let mut changed = from.clone();
    *changed.last_mut().expect("a byte") ^= 1;
    let broken = BetweenFault::Image(Side::From, ImageError::BadBlock(0));
    assert_eq!(fault(&changed, &to), broken);
    let cut = BetweenFault::Image(Side::To, ImageError::TooShort);
    assert_eq!(fault(&from, &to[..to.len() - 1]), cut);
    for other in [
        release(&b, |options| {
            (options.board, options.chip) = ("rover", Some(Chip::NONE));
        }),
        release(&b, |options| {
            (options.kind, options.name) = (Kind::Model, Some("eyes"));
        }),
    ] {
        assert_eq!(fault(&from, &other), BetweenFault::Unlike);
    }
    assert_eq!(fault(&from, &old(&b)), BetweenFault::Same);
    assert_eq!(fault(&from, &release(&a, |_| {})), BetweenFault::Same);
    // The first bytes of a square have nothing in common with a short text.
    let square: Vec<u8> = (0..300_u32)
        .map(|at| (at.wrapping_mul(2_654_435_761) >> 13) as u8)
        .collect();
    let useless = fault(&old(b"text"), &release(&square, |_| {}));
    assert!(
        matches!(useless, BetweenFault::Useless(300..400)),
        "{useless:?}"
    );
    assert!(useless.to_string().contains("no fewer than"));
}
