//! Nobody asks for the handle of another activity.

use std::fs;
use std::path::Path;
use std::string::String;
use std::vec::Vec;
use std::{format, vec};

/// Who may ask for which handle: files below `src`, by the beginning of their paths. `observe` is
/// what the link has heard.
const ASKED_FOR_BY: [(&str, &[&str]); 9] = [
    ("sense_handle", &["sense"]),
    ("power_handle", &["power"]),
    ("control_handle", &["control."]),
    ("store_handle", &["store"]),
    ("camera_handle", &["camera"]),
    ("lamp_handle", &["lamp"]),
    ("link_handle", &["link", "observe"]),
    ("update_handle", &["update"]),
    ("policy_handle", &["decide"]),
];

/// Source files below `folder` that are no tests, as paths from there.
fn sources(folder: &Path) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).expect("a folder") {
            let path = entry.expect("an entry").path();
            let name = path.strip_prefix(folder).expect("below");
            let name = name.to_str().expect("UTF-8").replace('\\', "/");
            let for_tests = ["tests", "testing", "rules"].iter().any(|part| {
                let part = format!("/{part}");
                format!("/{name}").contains(&part)
            });
            if for_tests || name.ends_with("_tests.rs") {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
            } else {
                let text = fs::read_to_string(&path).expect("a text");
                found.push((name, text));
            }
        }
    }
    found
}

#[test]
fn every_handle_is_asked_for_by_its_activity_alone() {
    let sources = sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
    for (handle, own) in ASKED_FOR_BY {
        let asked = format!(".{handle}()");
        let by: Vec<&str> = sources
            .iter()
            .filter(|(_, text)| text.contains(&asked))
            .map(|(name, _)| name.as_str())
            .collect();
        assert!(!by.is_empty(), "nobody asks for {handle}");
        for name in by {
            let may = own.iter().any(|own| name.starts_with(own));
            assert!(may, "{name} must not ask for {handle}");
        }
    }
}
