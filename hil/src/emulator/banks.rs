//! The flash banks of the machine as files: the boot stage, and programs with parameters.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::Path;

use crawler_image_format::factory::{self, MARK_BYTES};
use crawler_image_format::layout::{BANK, FLASHED};

/// Makes the first bank, which holds the boot stage and is never written again.
pub(super) fn boot(path: &Path, stage: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(stage)?;
    // Sparse: what is never written takes no room.
    file.set_len(BANK.into())
}

/// Puts `image` into the second bank, a file that is made when it is not there, unless it was put there before.
pub(super) fn flash(path: &Path, image: &[u8]) -> io::Result<()> {
    let mut file = File::options()
        .create(true)
        .truncate(false)
        .read(true)
        .write(true)
        .open(path)?;
    if file.metadata()?.len() != u64::from(BANK) {
        file.set_len(BANK.into())?;
    }
    let mut mark = [0; MARK_BYTES];
    file.seek(SeekFrom::Start(FLASHED.into()))?;
    file.read_exact(&mut mark)?;
    if mark[..] == factory::mark(image) {
        return Ok(());
    }
    for (offset, bytes) in factory::writes(image) {
        file.seek(SeekFrom::Start(offset.into()))?;
        file.write_all(&bytes)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use crawler_image_format::layout::{Group, OTADATA, SLOTS};

    use super::*;

    #[test]
    fn a_bank_is_flashed_once_with_each_image() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("flash");
        let at = |address| Group::of(address).expect("in the slots").block as usize;
        flash(&path, b"first").expect("made");
        let mut bank = std::fs::read(&path).expect("there");
        assert_eq!(bank.len(), BANK as usize);
        assert!(bank[at(SLOTS[0])..].starts_with(b"first\xFF"));
        // An update, and a parameter.
        bank[at(OTADATA)] = 1;
        bank[0] = 2;
        std::fs::write(&path, &bank).expect("written");
        flash(&path, b"first").expect("left alone");
        assert!(std::fs::read(&path).expect("there") == bank);
        flash(&path, b"second").expect("flashed anew");
        let bank = std::fs::read(&path).expect("there");
        assert!(bank[at(SLOTS[0])..].starts_with(b"second\xFF"));
        assert_eq!((bank[at(OTADATA)], bank[0]), (0xFF, 2));
    }

    #[test]
    fn a_boot_stage_fills_a_bank() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        boot(file.path(), b"stage").expect("made");
        let bank = std::fs::read(file.path()).expect("there");
        assert!(bank.starts_with(b"stage\0") && bank.len() == BANK as usize);
    }
}
