//! One name for one thing: words that were given up stay away, and what a page says is in a file is there.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crawler_tests::root;
use proc_macro2::{TokenStream, TokenTree};

use crate::examples::page::Page;

/// Private metaphors, each with the word of the trade. Neither an identifier nor a page has them, in any
/// case.
const METAPHORS: &[(&str, &str)] = &[
    ("clerk", "driver of the delivery"),
    ("errand", "goal, or dispatch of commands"),
    ("haste", "factor of speed"),
    ("parcel", "pending command"),
];

/// Names of types that said too little, each with the one in use. As words of English they are fine.
const TYPES: &[(&str, &str)] = &[
    ("Desk", "CommandTable"),
    ("Lane", "RobotQueue"),
    ("Mind", "DetectorInstance"),
    ("Post", "DeliverySink"),
    ("Stranger", "AuthError"),
    ("Together", "ClusterMembership"),
    ("Trail", "AuditWriter"),
    ("Ways", "BrokerEndpoints"),
];

/// What begins with these is no source of ours.
const SKIPPED: [&str; 3] = ["target", "node_modules", "dist"];

/// The sources with one of these endings.
fn sources(endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut waiting = vec![root()];
    while let Some(folder) = waiting.pop() {
        for entry in std::fs::read_dir(&folder).expect("readable folder") {
            let path = entry.expect("readable entry").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if path.is_dir() {
                if !name.starts_with('.') && !SKIPPED.contains(&name.as_ref()) {
                    waiting.push(path);
                }
            } else if path
                .extension()
                .is_some_and(|ending| endings.iter().any(|wanted| ending == *wanted))
            {
                found.push(path);
            }
        }
    }
    assert!(found.len() > 20, "sources are missing: {found:?}");
    found
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The words that a name is made of, in lower case: those of `DeliverySink` are `delivery` and `sink`.
fn parts(name: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    let mut before = '_';
    for letter in name.chars() {
        let begins = letter.is_uppercase() && !before.is_uppercase();
        if begins || !letter.is_alphanumeric() {
            parts.push(String::new());
        }
        if letter.is_alphanumeric() {
            parts.last_mut().expect("one").extend(letter.to_lowercase());
        }
        before = letter;
    }
    parts.retain(|part| !part.is_empty());
    parts
}

/// The metaphor in a name, with what is said instead.
fn metaphor(name: &str) -> Option<(&'static str, &'static str)> {
    let parts = parts(name);
    let has = |word: &str| {
        let many = format!("{word}s");
        parts.iter().any(|part| part == word || *part == many)
    };
    METAPHORS.iter().find(|(word, _)| has(word)).copied()
}

/// The retired names in a Rust source, each with its line; comments and texts are left out.
fn retired(tokens: TokenStream, found: &mut Vec<(usize, String)>) {
    let mut before = String::new();
    for token in tokens {
        let mut name = String::new();
        match token {
            TokenTree::Group(group) => retired(group.stream(), found),
            TokenTree::Ident(ident) => {
                name = ident.to_string();
                let defined = ["struct", "enum", "trait", "type"].contains(&before.as_str());
                let exact = TYPES.iter().find(|(word, _)| defined && *word == name);
                if let Some((_, instead)) = exact.copied().or_else(|| metaphor(&name)) {
                    let line = ident.span().start().line;
                    found.push((line, format!("`{name}`: {instead}?")));
                }
            }
            TokenTree::Punct(_) | TokenTree::Literal(_) => {}
        }
        before = name;
    }
}

#[test]
fn names_in_rust_are_those_of_the_trade() {
    let mut faults = Vec::new();
    for path in sources(&["rs"]) {
        let tokens: TokenStream = read(&path).parse().expect("valid Rust");
        let mut found = Vec::new();
        retired(tokens, &mut found);
        faults.extend(
            found
                .into_iter()
                .map(|(line, what)| format!("{}:{line}: {what}", path.display())),
        );
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_control_room_and_its_texts_have_no_metaphors() {
    let mut faults = Vec::new();
    for path in sources(&["ts", "vue", "mjs"]) {
        for (number, line) in read(&path).lines().enumerate() {
            for name in line.split(|c: char| !(c.is_alphanumeric() || c == '_')) {
                if let Some((_, instead)) = metaphor(name) {
                    let line = number + 1;
                    faults.push(format!("{}:{line}: `{name}`: {instead}?", path.display()));
                }
            }
        }
    }
    for path in sources(&["rs", "ts", "vue", "mjs", "md"]) {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        if let Some((_, instead)) = metaphor(&stem) {
            faults.push(format!("{}: {instead}?", path.display()));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// The metaphors in a page.
fn faults(page: &Page) -> Vec<String> {
    let mut faults = Vec::new();
    for (number, line) in page.text.lines().enumerate() {
        for word in line.split(|c: char| !c.is_alphanumeric()) {
            if let Some((_, instead)) = metaphor(word) {
                faults.push(format!("{}: {word}: {instead}?", page.at(number + 1)));
            }
        }
    }
    faults
}

#[test]
fn pages_have_no_metaphors() {
    // What was is told in the words of then.
    let pages = Page::of_the_book().into_iter();
    let pages = pages.filter(|page| page.name != "CHANGELOG.md");
    let faults: Vec<_> = pages.flat_map(|page| faults(&page)).collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// The search is only worth something if it sees what it looks for.
#[test]
fn retired_words_are_noticed() {
    let lines = |source: &str| {
        let mut found = Vec::new();
        retired(source.parse().expect("valid Rust"), &mut found);
        found.len()
    };
    assert_eq!(lines("struct Ways; fn ways(_: Ways) {} // Ways"), 1);
    assert_eq!(
        lines("struct OfficeClerk; fn f(clerks: u8) { \"clerk\"; }"),
        2
    );
    assert_eq!(lines("fn hasten(HASTE: u8) { parcel_of(HASTE) }"), 3);
    let page = Page {
        name: "docs/page.md".to_owned(),
        text: "A command waits.\nThe Clerk sends it.\n".to_owned(),
    };
    assert_eq!(faults(&page).len(), 1);
}

/// Each "`NAME` in `FILE`" of a page, with whether it is true.
fn told(page: &Page) -> Vec<(String, String, bool)> {
    let mut told = Vec::new();
    for (at, _) in page.text.match_indices("` in `") {
        let name = page.text[..at].rsplit('`').next().unwrap_or_default();
        let rest = &page.text[at + "` in `".len()..];
        let path = rest.split('`').next().unwrap_or_default();
        if !path.contains('/') || !root().join(path).is_file() {
            // Another test asks for the files.
            continue;
        }
        let name = name
            .rsplit("::")
            .next()
            .unwrap_or_default()
            .trim_end_matches("()");
        let text = read(&root().join(path));
        let mut words = text.split(|c: char| !(c.is_alphanumeric() || c == '_'));
        let found = words.any(|word| word == name);
        told.push((name.to_owned(), path.to_owned(), found));
    }
    told
}

#[test]
fn what_a_page_says_is_in_a_file_is_there() {
    let mut faults = Vec::new();
    let mut count = 0;
    for page in Page::of_the_book() {
        for (name, path, found) in told(&page) {
            count += 1;
            if !found {
                faults.push(format!("{}: {path} has no `{name}`", page.name));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(count > 60, "only {count} names");
}

#[test]
fn a_term_is_explained_once() {
    let page = Page::read("docs/glossary.md");
    let rows = page.text.lines().filter_map(|line| line.strip_prefix("| "));
    let rows = rows.filter(|row| !row.starts_with("term |"));
    let mut terms = BTreeSet::new();
    for row in rows {
        let cells: Vec<&str> = row.trim_end_matches('|').split(" | ").collect();
        assert_eq!(
            cells.len(),
            3,
            "a term, its meaning, and where it is: {row}"
        );
        assert!(terms.insert(cells[0]), "{} is there twice", cells[0]);
    }
    assert!(terms.len() > 60, "only {} terms", terms.len());
}
