//! A backup that was damaged since it was made is none.

use std::fs::File;

use crate::console::{Place, back_up};

/// Where the contents of its files are in an archive, in bytes: name, beginning, length.
fn contents(archive: &std::path::Path) -> Vec<(String, usize, usize)> {
    let mut archive = tar::Archive::new(File::open(archive).expect("a backup"));
    let entries = archive.entries().expect("an archive");
    let entries = entries.map(|entry| {
        let entry = entry.expect("an entry");
        let name = entry.path().expect("a name").display().to_string();
        (
            name,
            entry.raw_file_position() as usize,
            entry.size() as usize,
        )
    });
    entries.collect()
}

#[test]
fn one_flipped_bit_is_found() {
    let place = Place::with_admin();
    std::fs::create_dir_all(place.path().join("tls")).expect("directory");
    std::fs::write(place.path().join("tls/ca.key"), "a key").expect("file");
    let (folder, file) = back_up(&place);
    let whole = std::fs::read(&file).expect("backup");
    let broken = folder.0.join("broken.tar");
    let name = broken.to_str().expect("UTF-8");
    let contents = contents(&file);
    for known in ["records.sqlite", "history.sqlite", "tls/ca.key"] {
        assert!(contents.iter().any(|(name, ..)| name == known), "{known}");
    }
    for (what, begin, length) in contents {
        for at in [0, length / 2, length.saturating_sub(1)] {
            if at >= length {
                continue;
            }
            let mut damaged = whole.clone();
            damaged[begin + at] ^= 0x20;
            std::fs::write(&broken, damaged).expect("file");
            let other = Place::new();
            let told = other.refused(&["restore", name]);
            assert!(told.contains("broken.tar"), "{what} at {at}: {told}");
            assert!(
                !other.path().join("records.sqlite").exists(),
                "{what} at {at}"
            );
        }
    }
    // As it was, it is good.
    std::fs::write(&broken, whole).expect("file");
    Place::new().ok(&["restore", name]);
}
