//! Patches that detools made; `golden/make.py` says how.

use std::fs;
use std::path::Path;

use crawler_delta::{Decoder, DeltaError, Step, add};
use proptest::prelude::*;

use crate::support::apply;

fn golden(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    fs::read(folder.join(name)).expect("a golden file")
}

/// Old image, new image, patch.
fn patches() -> Vec<(Vec<u8>, Vec<u8>, Vec<u8>)> {
    let (old, new) = (golden("old.bin"), golden("new.bin"));
    let mut patches: Vec<_> = ["w4-l3", "w8-l7", "w10-l4", "w10-l9"]
        .map(|name| {
            let patch = golden(&format!("{name}.patch"));
            (old.clone(), new.clone(), patch)
        })
        .into();
    patches.push((new.clone(), old.clone(), golden("back.patch")));
    patches.push((old.clone(), old.clone(), golden("same.patch")));
    patches.push((vec![], new, golden("from-nothing.patch")));
    patches.push((old, vec![], golden("to-nothing.patch")));
    patches
}

#[test]
fn patches_of_detools_make_the_new_image() {
    for (index, (old, new, patch)) in patches().iter().enumerate() {
        for (piece, buffer) in [(1, 1), (1, 256), (7, 3), (1_024, 256), (9_999, 9_999)] {
            let made = apply(old, new.len(), patch, piece, buffer);
            assert_eq!(made.as_ref(), Ok(new), "{index} {piece} {buffer}");
        }
    }
}

#[test]
fn cut_off_anywhere_a_patch_makes_nothing_whole() {
    for (old, new, patch) in patches() {
        for length in 0..patch.len() {
            let made = apply(&old, new.len(), &patch[..length], 64, 64);
            assert_eq!(made, Err(DeltaError::CutOff), "{length}");
        }
        let longer = [&patch[..], &[0]].concat();
        let made = apply(&old, new.len(), &longer, 64, 64);
        assert_eq!(made, Err(DeltaError::Trailing));
    }
}

/// After a restart what was written before is passed over: nothing of it is read from the old image.
#[test]
fn a_patch_is_taken_up_again_from_its_beginning() {
    for (old, new, patch) in patches() {
        for written in (0..new.len()).step_by(97) {
            let mut decoder = Decoder::new(old.len() as u32, new.len() as u32);
            let mut flash = new[..written].to_vec();
            let mut out = [0; 32];
            for mut piece in patch.chunks(100) {
                loop {
                    let before = decoder.made() as usize;
                    let step = decoder.step(&mut piece, &mut out).expect("a patch");
                    let Step::Made { length, old: from } = step else {
                        break;
                    };
                    let known = written.saturating_sub(before).min(length);
                    let fresh = &mut out[known..length];
                    if let Some(from) = from {
                        add(fresh, &old[from as usize + known..]);
                    }
                    flash.extend_from_slice(fresh);
                }
            }
            assert_eq!(decoder.finish(), Ok(()));
            assert!(flash == new, "from {written}");
        }
    }
}

proptest! {
    /// A patch that was changed somewhere makes something else, or nothing; it never makes more.
    #[test]
    fn a_changed_patch_is_survived(
        which in any::<prop::sample::Index>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        (piece, buffer) in (1_usize..300, 1_usize..300),
    ) {
        let patches = patches();
        let (old, new, patch) = which.get(&patches);
        let mut patch = patch.clone();
        for (at, byte) in changes {
            let at = at.index(patch.len());
            patch[at] = byte;
        }
        if let Ok(made) = apply(old, new.len(), &patch, piece, buffer) {
            prop_assert_eq!(made.len(), new.len());
        }
    }
}
