//! Calibrations as files `{number}.json` in a folder of the data directory: each server has those that it carried out.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read as _, Write as _};
use std::path::{Path, PathBuf};

use crate::record::Calibration;

/// Calibrations that are kept; the oldest ones go.
pub(crate) const MOST: usize = 500;
/// Longest file.
const LONGEST: u64 = 64 * 1024;

/// See the [module](self).
#[derive(Debug, Clone)]
pub(crate) struct Store(PathBuf);

impl Store {
    pub(crate) const fn new(folder: PathBuf) -> Self {
        Self(folder)
    }

    fn path(&self, id: u64) -> PathBuf {
        self.0.join(format!("{id}.json"))
    }

    /// Keeps what is known of one, for good when this returns.
    pub(crate) fn put(&self, calibration: &Calibration) -> io::Result<()> {
        fs::create_dir_all(&self.0)?;
        let draft = self.0.join(format!("{}.part", calibration.id));
        let mut file = File::create(&draft)?;
        file.write_all(&serde_json::to_vec(calibration)?)?;
        file.sync_all()?;
        fs::rename(&draft, self.path(calibration.id))
    }

    /// Forgets one.
    pub(crate) fn remove(&self, id: u64) {
        // What stays is forgotten the next time.
        let _ = fs::remove_file(self.path(id));
    }

    /// All that there are, the newest [`MOST`].
    pub(crate) fn all(&self) -> BTreeMap<u64, Calibration> {
        let mut all = BTreeMap::new();
        let Ok(listed) = fs::read_dir(&self.0) else {
            return all;
        };
        for entry in listed.flatten() {
            let path = entry.path();
            if path.extension().is_none_or(|end| end != "json") {
                continue;
            }
            match read(&path) {
                Ok(found) => {
                    all.insert(found.id, found);
                }
                Err(error) => {
                    tracing::warn!(%error, file = %path.display(), "a calibration cannot be read");
                }
            }
            if all.len() > MOST
                && let Some((id, _)) = all.pop_first()
            {
                self.remove(id);
            }
        }
        all
    }
}

fn read(path: &Path) -> io::Result<Calibration> {
    let mut text = Vec::new();
    File::open(path)?.take(LONGEST + 1).read_to_end(&mut text)?;
    Ok(serde_json::from_slice(&text)?)
}
