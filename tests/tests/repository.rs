//! Small promises of the repository: licences, dependencies with a reason, types that stay readable.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use cargo_metadata::{Metadata, MetadataCommand, Package};
use crawler_tests::root;
use syn::visit::{self, Visit};

/// Licences that go with MIT OR Apache-2.0. The same list stands in `deny.toml`.
const LICENCES: &[&str] = &[
    "MIT",
    "MIT-0",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "MPL-2.0",
    "Unicode-3.0",
    "Zlib",
    "0BSD",
    "CDLA-Permissive-2.0",
    "IJG",
    "Unlicense",
    "BlueOak-1.0.0",
];

/// In how many files a type may have functions of its own. Where it needs more, it is several types.
const MOST_FILES: usize = 6;

/// Types that are not divided yet, and in how many files they are at most.
const SCATTERED: [(&str, &str, usize); 4] = [
    ("firmware/app", "Connection", 7),
    ("hal-sim", "Scenario", 8),
    ("hal-sim", "Space", 9),
    ("hil", "Bench", 7),
];

/// Where a text is what an error is made of, and in how many places at most: details of fields that are refused.
const SAID: [(&str, usize); 1] = [("host-server/api", 2)];

/// Modules from which on a crate says in which order to read them.
const MANY_MODULES: usize = 8;

/// The workspace of the host, and those of boards and models, which have lock files of their own.
fn workspaces() -> Vec<PathBuf> {
    let inside = |folder: &str| std::fs::read_dir(root().join(folder)).expect("a folder of ours");
    let mut found = vec![root()];
    for entry in inside("firmware/boards").chain(inside("models")) {
        let folder = entry.expect("readable entry").path();
        if std::fs::read_to_string(folder.join("Cargo.toml"))
            .is_ok_and(|manifest| manifest.lines().any(|line| line == "[workspace]"))
        {
            found.push(folder);
        }
    }
    assert!(found.len() > 1, "no board has a workspace of its own");
    found
}

fn metadata() -> Vec<Metadata> {
    workspaces()
        .into_iter()
        .map(|folder| {
            MetadataCommand::new()
                .current_dir(folder)
                .other_options(["--locked".to_owned()])
                .exec()
                .expect("cargo metadata")
        })
        .collect()
}

#[test]
fn every_licence_goes_with_ours() {
    let allowed: Vec<spdx::Licensee> = LICENCES
        .iter()
        .map(|name| spdx::Licensee::parse(name).expect(name))
        .collect();
    let mut refused = Vec::new();
    for package in metadata()
        .into_iter()
        .flat_map(|workspace| workspace.packages)
    {
        let stated = package.license.clone().unwrap_or_default();
        let fine = spdx::Expression::parse_mode(&stated, spdx::ParseMode::LAX).is_ok_and(|terms| {
            terms.evaluate(|required| allowed.iter().any(|licence| licence.satisfies(required)))
        });
        if !fine {
            refused.push(format!("{} {}: '{stated}'", package.name, package.version));
        }
    }
    assert!(refused.is_empty(), "{}", refused.join("\n"));
}

#[test]
fn cargo_deny_is_told_the_same_licences() {
    let deny = std::fs::read_to_string(root().join("deny.toml")).expect("deny.toml");
    for licence in LICENCES {
        assert!(
            deny.contains(&format!("\"{licence}\"")),
            "deny.toml lacks {licence}"
        );
    }
}

#[test]
fn every_direct_dependency_says_why() {
    let reasons =
        std::fs::read_to_string(root().join("docs/dependencies.md")).expect("docs/dependencies.md");
    let metadata = metadata();
    let packages: Vec<&Package> = metadata
        .iter()
        .flat_map(Metadata::workspace_packages)
        .collect();
    let ours: BTreeSet<&str> = packages
        .iter()
        .map(|package| package.name.as_str())
        .collect();
    let direct: BTreeSet<&str> = packages
        .iter()
        .flat_map(|package| &package.dependencies)
        .map(|need| need.name.as_str())
        .filter(|name| !ours.contains(name))
        .collect();
    let listed: BTreeSet<&str> = reasons
        .lines()
        .filter_map(|line| line.strip_prefix("| `"))
        .filter_map(|line| line.split_once('`'))
        .map(|(name, _)| name)
        .collect();
    let missing: Vec<_> = direct.difference(&listed).collect();
    assert!(missing.is_empty(), "without a reason: {missing:?}");
    let gone: Vec<_> = listed
        .iter()
        .filter(|name| !name.starts_with("npm:") && !direct.contains(*name))
        .collect();
    assert!(gone.is_empty(), "listed but not used: {gone:?}");
}

#[test]
fn a_type_is_in_few_files() {
    let mut files: BTreeMap<(String, String), BTreeSet<PathBuf>> = BTreeMap::new();
    for path in sources() {
        let folder = crate_of(&path);
        for name in types_with_functions(&path) {
            let key = (folder.clone(), name);
            files.entry(key).or_default().insert(path.clone());
        }
    }
    assert!(files.len() > 500, "only {} types", files.len());
    let mut scattered = Vec::new();
    for ((folder, name), files) in files {
        let known = SCATTERED
            .iter()
            .find(|one| (one.0, one.1) == (&folder, &name));
        let most = known.map_or(MOST_FILES, |one| one.2);
        if files.len() > most {
            let count = files.len();
            scattered.push(format!("{folder}: {name} in {count} files, not {most}"));
        }
    }
    assert!(scattered.is_empty(), "{}", scattered.join("\n"));
}

#[test]
fn an_error_is_a_type_and_no_text() {
    let parts = ["firmware", "hal-sim", "hil", "host-server", "models"];
    let mut said: BTreeMap<String, usize> = BTreeMap::new();
    for path in sources() {
        let inside = path.strip_prefix(root()).expect("below the root");
        let is_part = parts.iter().any(|part| inside.starts_with(part));
        if is_part && !inside.iter().any(|folder| folder == "examples") {
            let text = std::fs::read_to_string(&path).expect("UTF-8");
            let mut texts = Texts::default();
            texts.visit_file(&syn::parse_file(&text).expect("valid Rust"));
            *said.entry(crate_of(&path)).or_default() += texts.count;
        }
    }
    assert!(said.len() > 40, "only {} crates", said.len());
    for (folder, most) in SAID {
        let count = said.remove(folder).unwrap_or_default();
        assert!(count <= most, "{folder}: {count} errors are texts");
    }
    said.retain(|_, count| *count > 0);
    assert!(said.is_empty(), "errors that are texts: {said:?}");
}

/// Counts `Result<_, String>`, but not in tests.
#[derive(Default)]
struct Texts {
    count: usize,
}

impl<'ast> Visit<'ast> for Texts {
    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        if !is_test(&module.attrs) {
            visit::visit_item_mod(self, module);
        }
    }

    fn visit_path_segment(&mut self, segment: &'ast syn::PathSegment) {
        if segment.ident == "Result"
            && let syn::PathArguments::AngleBracketed(arguments) = &segment.arguments
            && let Some(syn::GenericArgument::Type(syn::Type::Path(error))) =
                arguments.args.iter().nth(1)
            && error.path.is_ident("String")
        {
            self.count += 1;
        }
        visit::visit_path_segment(self, segment);
    }
}

#[test]
fn a_crate_says_in_which_order_to_read_it() {
    let mut silent = Vec::new();
    let mut count = 0;
    for path in sources().iter().filter(|path| path.ends_with("src/lib.rs")) {
        let text = std::fs::read_to_string(path).expect("UTF-8");
        let modules = modules(&syn::parse_file(&text).expect("valid Rust"));
        if modules.len() < MANY_MODULES {
            continue;
        }
        count += 1;
        let head = text.lines().take_while(|line| line.starts_with("//!"));
        let words: BTreeSet<&str> = head
            .flat_map(|line| line.split(|c: char| !(c.is_alphanumeric() || c == '_')))
            .collect();
        let missing: Vec<_> = modules
            .iter()
            .filter(|name| !words.contains(name.as_str()))
            .collect();
        if !missing.is_empty() {
            silent.push(format!("{}: {missing:?}", path.display()));
        }
    }
    assert!(silent.is_empty(), "{}", silent.join("\n"));
    assert!(count > 8, "only {count} crates of many modules");
}

/// The modules that the root of a crate has in files, without its tests.
fn modules(file: &syn::File) -> Vec<String> {
    let modules = file.items.iter().filter_map(|item| match item {
        syn::Item::Mod(module) if module.content.is_none() => Some(module),
        _ => None,
    });
    let ours = modules.filter(|module| !is_test(&module.attrs));
    ours.map(|module| module.ident.to_string()).collect()
}

/// Whether what has these attributes is there for tests alone.
fn is_test(attributes: &[syn::Attribute]) -> bool {
    let conditions = attributes.iter().filter(|one| one.path().is_ident("cfg"));
    let mut texts = conditions.filter_map(|one| match &one.meta {
        syn::Meta::List(list) => Some(list.tokens.to_string()),
        _ => None,
    });
    texts.any(|text| text == "test")
}

/// Every source file that is no test.
fn sources() -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut waiting = vec![root()];
    while let Some(folder) = waiting.pop() {
        for entry in std::fs::read_dir(&folder).expect("readable folder") {
            let path = entry.expect("readable entry").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if path.is_dir() {
                let skip = ["target", "node_modules", "benches"].contains(&name.as_ref());
                // The crate of that name has sources; the other folders are tests of a crate.
                let tests = name == "tests" && folder != root();
                if !skip && !tests && !name.starts_with('.') {
                    waiting.push(path);
                }
            } else if name.ends_with(".rs") && !name.ends_with("tests.rs") {
                found.push(path);
            }
        }
    }
    found
}

/// The folder of the crate that a source file belongs to.
fn crate_of(path: &Path) -> String {
    let mut folders = path.ancestors().skip(1);
    let folder = folders.find(|folder| folder.join("Cargo.toml").exists());
    let folder = folder.unwrap_or(path);
    let folder = folder.strip_prefix(root()).expect("below the root");
    folder.to_string_lossy().replace('\\', "/")
}

/// The types that have functions of their own in a file; traits do not count.
fn types_with_functions(path: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(path).expect("UTF-8");
    let file = syn::parse_file(&text).expect("valid Rust");
    let blocks = file.items.into_iter().filter_map(|item| match item {
        syn::Item::Impl(block) if block.trait_.is_none() => Some(*block.self_ty),
        _ => None,
    });
    let names = blocks.filter_map(|of| match of {
        syn::Type::Path(of) => Some(of.path.segments.last()?.ident.to_string()),
        _ => None,
    });
    names.collect()
}

/// What tries the parsers is listed where people look for it, and has something to begin with.
#[test]
fn every_fuzz_target_is_listed_and_has_a_corpus() {
    let page = std::fs::read_to_string(root().join("docs/fuzzing.md")).expect("docs/fuzzing.md");
    let names = |folder: &str| -> BTreeSet<String> {
        let entries = std::fs::read_dir(root().join("fuzz").join(folder)).expect(folder);
        let paths = entries.map(|entry| entry.expect("an entry").path());
        let stem = |path: PathBuf| {
            path.file_stem()
                .map(|stem| stem.to_string_lossy().into_owned())
        };
        paths.filter_map(stem).collect()
    };
    let targets = names("fuzz_targets");
    assert_eq!(targets, names("corpus"));
    let rows = page.lines().filter(|line| line.starts_with("| "));
    let listed: BTreeSet<String> = rows
        .filter_map(|row| row.trim_end_matches(" |").rsplit(" | ").next())
        .flat_map(|cell| cell.split(", "))
        .filter_map(|word| word.strip_prefix('`')?.strip_suffix('`'))
        .filter(|word| !word.contains(' '))
        .map(str::to_owned)
        .collect();
    assert_eq!(listed, targets, "docs/fuzzing.md and fuzz/fuzz_targets");
}
