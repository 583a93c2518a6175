//! Small promises of the house: licences, dependencies with a reason, files that stay readable.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use cargo_metadata::{Metadata, MetadataCommand, Package};
use crawler_tests::root;

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

/// Longest source file: beyond this, tests or a part of it move to a file of their own.
const LONGEST: usize = 450;

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
fn files_stay_readable() {
    let mut long = Vec::new();
    measure(&root(), &mut long);
    assert!(
        long.is_empty(),
        "longer than {LONGEST} lines:\n{}",
        long.join("\n")
    );
}

fn measure(folder: &Path, long: &mut Vec<String>) {
    for entry in std::fs::read_dir(folder).expect("readable folder") {
        let path = entry.expect("readable entry").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_dir() {
            let skip = ["target", "node_modules", "dist"].contains(&name.as_ref());
            if !skip && !name.starts_with('.') {
                measure(&path, long);
            }
        } else if [".rs", ".ts", ".vue", ".css", ".mjs"]
            .iter()
            .any(|ending| name.ends_with(ending))
        {
            let lines = std::fs::read_to_string(&path)
                .expect("UTF-8")
                .lines()
                .count();
            if lines > LONGEST {
                long.push(format!("{} has {lines}", path.display()));
            }
        }
    }
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
