//! Small text files that people write.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::Path;

/// Longest file that is read, bytes. A scenario with a thousand obstacles has a tenth of it.
const MOST: u64 = 1024 * 1024;

/// Reads a text of at most a megabyte.
///
/// # Errors
/// What the system says, and [`io::ErrorKind::FileTooLarge`].
pub(crate) fn read_text(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    let file = File::open(path)?;
    if file.take(MOST + 1).read_to_string(&mut text)? as u64 > MOST {
        let told = format!("it has more than {MOST} bytes");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, told));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_without_an_end_are_refused() {
        let path = std::env::temp_dir().join(format!("crawler-text-{}", std::process::id()));
        std::fs::write(&path, vec![b' '; MOST as usize]).expect("room");
        assert_eq!(read_text(&path).expect("short").len(), MOST as usize);
        std::fs::write(&path, vec![b' '; MOST as usize + 1]).expect("room");
        let error = read_text(&path).expect_err("too long");
        assert_eq!(error.kind(), io::ErrorKind::FileTooLarge);
        std::fs::remove_file(&path).expect("it is ours");
        let endless = Path::new("/dev/zero");
        if endless.exists() {
            assert!(read_text(endless).is_err());
        }
    }
}
