//! The documentation is one book: every page has its place in it, once.

use std::collections::BTreeSet;

use crawler_tests::root;

use crate::examples::page::Page;

/// Every page of the repository, but for the table of contents.
fn pages() -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut waiting = vec![root()];
    while let Some(folder) = waiting.pop() {
        for entry in std::fs::read_dir(&folder).expect("readable folder") {
            let path = entry.expect("readable entry").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let skipped = ["target", "node_modules", "dist", "data"].contains(&name.as_ref());
            if path.is_dir() && !skipped && !name.starts_with('.') {
                waiting.push(path);
            } else if path.extension().is_some_and(|ending| ending == "md") {
                let path = path.strip_prefix(root()).expect("below the root");
                found.insert(path.to_string_lossy().replace('\\', "/"));
            }
        }
    }
    found.remove("docs/SUMMARY.md");
    found
}

#[test]
fn every_page_is_in_the_book_once() {
    let told: Vec<String> = Page::of_the_book()
        .into_iter()
        .map(|page| page.name)
        .collect();
    let once: BTreeSet<String> = told.iter().cloned().collect();
    assert_eq!(once, pages(), "docs/SUMMARY.md and the pages");
    assert_eq!(once.len(), told.len(), "a page is there twice: {told:?}");
}
