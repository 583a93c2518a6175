//! The documentation as one book, built by mdBook, every link in it followed.
//!
//! Pages link to each other and to files as they lie in the repository, which is how GitHub shows them.
//! The book is built from a copy in which they lie the same way, with the files that they link to.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::{Component, Path, PathBuf};

use crate::files;
use crate::run::{self, Failure, Outcome};

/// Where the pages are, with `SUMMARY.md` and `book.toml`.
const DOCS: &str = "docs";
/// How to get the program that builds the book.
const MISSING: &str = "mdbook is missing (for building the book): \
    cargo install mdbook --locked, or cargo binstall mdbook";

/// Builds the book and follows its links.
///
/// # Errors
/// When mdBook is missing or fails, or a link leads nowhere.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    if let Some(argument) = arguments.first() {
        return Err(Failure(format!("'{argument}' is not understood")));
    }
    if !present() {
        return Err(Failure(MISSING.to_owned()));
    }
    let folder = run::root().join(run::target_dir()).join("book");
    stage(&folder)?;
    let words = ["build".into(), folder.clone()];
    run::run::<PathBuf>(&run::root(), "mdbook", &words)?;
    let html = folder.join("html");
    let dead = dead_links(&html)?;
    if !dead.is_empty() {
        return Err(Failure(format!(
            "links that lead nowhere:\n{}",
            dead.join("\n")
        )));
    }
    println!("the book: {}", html.join("index.html").display());
    Ok(())
}

/// The same where mdBook is installed; else a line that says so.
///
/// # Errors
/// As [`command`].
pub(crate) fn if_there() -> Outcome {
    if present() {
        command(&[])
    } else {
        println!("skipped: {MISSING}");
        Ok(())
    }
}

fn present() -> bool {
    run::output("mdbook", &["--version"]).is_some()
}

/// Lays out what the book is built from: settings, table of contents, pages, and what they link to.
fn stage(folder: &Path) -> Outcome {
    files::remove(folder)?;
    let read = |path: &Path| {
        fs::read_to_string(path).map_err(|error| Failure(format!("{}: {error}", path.display())))
    };
    let docs = run::root().join(DOCS);
    files::write(&folder.join("book.toml"), &read(&docs.join("book.toml"))?)?;
    let summary = read(&docs.join("SUMMARY.md"))?;
    let source = folder.join("src");
    let mut contents = String::new();
    let mut waiting = Vec::new();
    for line in summary.lines() {
        let Some((before, target)) = line.split_once("](") else {
            contents += line;
            contents.push('\n');
            continue;
        };
        let page = normal(&Path::new(DOCS).join(target.trim_end_matches(')')));
        let _ = writeln!(contents, "{before}]({})", page.display());
        waiting.push(page);
    }
    files::write(&source.join("SUMMARY.md"), &contents)?;
    for page in waiting {
        let text = read(&run::root().join(&page))?;
        for target in links(&text) {
            let file = target.split('#').next().unwrap_or_default();
            let path = normal(&page.parent().unwrap_or(Path::new("")).join(file));
            let from = run::root().join(&path);
            if from.is_file() && path.extension().is_none_or(|ending| ending != "md") {
                let bytes = fs::read(&from);
                let to = source.join(&path);
                let failed = |error| Failure(format!("{}: {error}", path.display()));
                fs::create_dir_all(to.parent().unwrap_or(&source)).map_err(failed)?;
                fs::write(&to, bytes.map_err(failed)?).map_err(failed)?;
            }
        }
        files::write(&source.join(&page), &text)?;
    }
    Ok(())
}

/// The targets of a page's links and pictures that are files of ours.
fn links(text: &str) -> Vec<&str> {
    let parts = text.split("](").skip(1);
    let targets = parts.filter_map(|part| part.split(')').next());
    targets
        .filter(|target| !target.contains("://") && !target.is_empty())
        .collect()
}

/// A path without `.` and `..` on the way.
fn normal(path: &Path) -> PathBuf {
    let mut normal = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => {
                normal.pop();
            }
            Component::CurDir => {}
            other => normal.push(other),
        }
    }
    normal
}

/// Every link of a folder of pages that leads nowhere in it.
///
/// # Errors
/// When a page cannot be read.
fn dead_links(folder: &Path) -> Outcome<Vec<String>> {
    let mut pages = BTreeMap::new();
    read_pages(folder, &mut pages)?;
    let names: BTreeMap<&PathBuf, BTreeSet<&str>> = pages
        .iter()
        .map(|(path, text)| (path, values(text, " id=\"").collect()))
        .collect();
    let mut dead = Vec::new();
    for (path, text) in &pages {
        for target in values(text, " href=\"").chain(values(text, " src=\"")) {
            if target.contains(':') || target.starts_with("//") || target.is_empty() {
                continue;
            }
            // The page for addresses that are none is shown anywhere, and links from the top on.
            let target = target.trim_start_matches('/');
            let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
            let there = if file.is_empty() {
                path.clone()
            } else {
                normal(&path.parent().unwrap_or(folder).join(file))
            };
            let known = names.get(&there);
            let found = match known {
                Some(names) => anchor.is_empty() || names.contains(anchor),
                None => there.exists(),
            };
            if !found {
                let page = path.strip_prefix(folder).unwrap_or(path);
                dead.push(format!("{}: {target}", page.display()));
            }
        }
    }
    Ok(dead)
}

fn read_pages(folder: &Path, pages: &mut BTreeMap<PathBuf, String>) -> Outcome {
    let failed = |error| Failure(format!("{}: {error}", folder.display()));
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() {
            read_pages(&path, pages)?;
        } else if path.extension().is_some_and(|ending| ending == "html") {
            let text = fs::read_to_string(&path).map_err(failed)?;
            pages.insert(path, text);
        }
    }
    Ok(())
}

/// The values of an attribute in a page.
fn values<'a>(page: &'a str, attribute: &str) -> impl Iterator<Item = &'a str> {
    let parts = page.split(attribute).skip(1);
    parts.filter_map(|part| part.split('"').next())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::{dead_links, links, normal};
    use crate::{files, run};

    #[test]
    fn links_of_a_page_are_followed_from_where_it_is() {
        let text = "a [b](c.md#d), ![e](../f.png), [g](https://example.org/)";
        assert_eq!(links(text), ["c.md#d", "../f.png"]);
        assert_eq!(normal(Path::new("docs/../f.png")), Path::new("f.png"));
    }

    #[test]
    fn a_dead_link_is_found() {
        let folder = run::target_dir().join(format!("docs-test-{}", std::process::id()));
        let page = "<h1 id=\"top\">A</h1><a href=\"#top\"></a><a href=\"b/c.html#there\"></a>\
                    <a href=\"b/c.html#gone\"></a><a href=\"https://example.org\"></a>";
        files::write(&folder.join("a.html"), page).expect("written");
        let other = "<p id=\"there\"></p><img src=\"../no.png\">";
        files::write(&folder.join("b/c.html"), other).expect("written");
        let dead = dead_links(&folder).expect("pages");
        files::remove(&folder).expect("removed");
        assert_eq!(dead, ["a.html: b/c.html#gone", "b/c.html: ../no.png"]);
    }
}
