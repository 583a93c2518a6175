//! A folder for what a command of a test reads and writes.

use crate::scratch::Scratch;

/// It goes away with the value.
pub(crate) struct Folder(Scratch);

impl Folder {
    pub(crate) fn new() -> Self {
        let folder = Scratch::new();
        std::fs::create_dir_all(&folder.0).expect("a folder");
        Self(folder)
    }

    /// The path of a file in it.
    pub(crate) fn file(&self, name: &str) -> String {
        self.0.0.join(name).to_str().expect("UTF-8").to_owned()
    }
}
