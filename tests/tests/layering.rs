//! Dependencies point one way, between crates and within them, and the robot program needs nothing
//! that a microcontroller lacks.

mod circles;
mod modules;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use cargo_metadata::{DependencyKind, MetadataCommand};
use crawler_tests::root;
use syn::visit::{self, Visit};

/// For each crate, the crates of the workspace that it may depend on.
const ALLOWED: &[(&str, &[&str])] = &[
    ("crawler-hal", &[]),
    ("crawler-boot", &["crawler-hal"]),
    ("crawler-bundle", &[]),
    ("crawler-delta", &[]),
    ("crawler-image-format", &["crawler-boot"]),
    ("crawler-stack", &[]),
    ("crawler-micromodel", &[]),
    ("crawler-convert", &["crawler-micromodel"]),
    ("crawler-detector", &[]),
    ("crawler-federated", &[]),
    ("crawler-policy", &[]),
    ("crawler-properties", &[]),
    ("crawler-drivers", &["crawler-hal"]),
    ("crawler-protocol", &["crawler-hal"]),
    ("crawler-release", &[]),
    ("crawler-tls", &["crawler-hal"]),
    (
        "crawler-app",
        &[
            "crawler-hal",
            "crawler-boot",
            "crawler-delta",
            "crawler-drivers",
            "crawler-protocol",
            "crawler-release",
            "crawler-micromodel",
        ],
    ),
    (
        "crawler-sim",
        &[
            "crawler-hal",
            "crawler-drivers",
            "crawler-protocol",
            "crawler-tls",
            "crawler-app",
            "crawler-boot",
            "crawler-bundle",
            "crawler-cells",
            "crawler-release",
            "crawler-sim-protocol",
        ],
    ),
    ("crawler-sim-protocol", &["crawler-protocol"]),
    (
        "crawler-board",
        &[
            "crawler-boot",
            "crawler-hal",
            "crawler-image-format",
            "crawler-protocol",
            "crawler-release",
            "crawler-tls",
            "crawler-app",
        ],
    ),
    (
        "crawler-experiments",
        &[
            "crawler-detector",
            "crawler-federated",
            "crawler-federation",
            "crawler-learning",
            "crawler-metrics",
            "crawler-records",
            "crawler-sim",
            "crawler-system",
        ],
    ),
    (
        "crawler-federation",
        &[
            "crawler-access",
            "crawler-federated",
            "crawler-learning",
            "crawler-protocol",
        ],
    ),
    (
        "crawler-learning",
        &[
            "crawler-app",
            "crawler-federated",
            "crawler-hal",
            "crawler-micromodel",
            "crawler-policy",
            "crawler-protocol",
            "crawler-sim",
        ],
    ),
    (
        "crawler-server",
        &[
            "crawler-access",
            "crawler-accounts",
            "crawler-api",
            "crawler-broker",
            "crawler-bundle",
            "crawler-calibrations",
            "crawler-cells",
            "crawler-cluster",
            "crawler-commands",
            "crawler-counterfactuals",
            "crawler-experiments",
            "crawler-federation",
            "crawler-fleet",
            "crawler-history",
            "crawler-learning",
            "crawler-metrics",
            "crawler-protocol",
            "crawler-records",
            "crawler-release",
            "crawler-rollouts",
            "crawler-server-tls",
            "crawler-sim",
            "crawler-simulations",
            "crawler-system",
            "crawler-timeseries",
            "crawler-twin",
            "crawler-twins",
            "crawler-updates",
        ],
    ),
    (
        "crawler-simulations",
        &[
            "crawler-metrics",
            "crawler-protocol",
            "crawler-sim",
            "crawler-sim-protocol",
        ],
    ),
    ("crawler-metrics", &["crawler-protocol", "crawler-system"]),
    (
        "crawler-accounts",
        &[
            "crawler-access",
            "crawler-cluster",
            "crawler-passwords",
            "crawler-records",
            "crawler-system",
        ],
    ),
    (
        "crawler-broker",
        &[
            "crawler-access",
            "crawler-metrics",
            "crawler-passwords",
            "crawler-protocol",
            "crawler-records",
            "crawler-server-tls",
            "crawler-system",
        ],
    ),
    ("crawler-server-tls", &["crawler-system"]),
    ("crawler-system", &[]),
    (
        "crawler-cells",
        &["crawler-app", "crawler-hal", "crawler-protocol"],
    ),
    ("crawler-cluster", &[]),
    (
        "crawler-commands",
        &[
            "crawler-cluster",
            "crawler-delivery",
            "crawler-metrics",
            "crawler-protocol",
            "crawler-system",
        ],
    ),
    (
        "crawler-api",
        &[
            "crawler-access",
            "crawler-accounts",
            "crawler-broker",
            "crawler-calibrations",
            "crawler-cluster",
            "crawler-commands",
            "crawler-counterfactuals",
            "crawler-delivery",
            "crawler-experiments",
            "crawler-fleet",
            "crawler-history",
            "crawler-metrics",
            "crawler-protocol",
            "crawler-records",
            "crawler-release",
            "crawler-rollouts",
            "crawler-server-tls",
            "crawler-sim",
            "crawler-sim-protocol",
            "crawler-simulations",
            "crawler-system",
            "crawler-twins",
            "crawler-updates",
        ],
    ),
    ("crawler-access", &["crawler-protocol"]),
    ("crawler-passwords", &["crawler-access", "crawler-system"]),
    ("crawler-delivery", &["crawler-protocol"]),
    (
        "crawler-fleet",
        &[
            "crawler-cluster",
            "crawler-commands",
            "crawler-delivery",
            "crawler-metrics",
            "crawler-protocol",
            "crawler-records",
            "crawler-system",
        ],
    ),
    ("crawler-database", &[]),
    ("crawler-twin", &[]),
    (
        "crawler-twins",
        &["crawler-metrics", "crawler-protocol", "crawler-twin"],
    ),
    (
        "crawler-counterfactuals",
        &[
            "crawler-database",
            "crawler-history",
            "crawler-protocol",
            "crawler-records",
            "crawler-sim",
            "crawler-system",
            "crawler-twin",
        ],
    ),
    (
        "crawler-calibrations",
        &[
            "crawler-protocol",
            "crawler-system",
            "crawler-twin",
            "crawler-twins",
        ],
    ),
    ("crawler-history", &["crawler-database", "crawler-protocol"]),
    (
        "crawler-records",
        &[
            "crawler-access",
            "crawler-database",
            "crawler-history",
            "crawler-metrics",
            "crawler-protocol",
            "crawler-release",
            "crawler-system",
        ],
    ),
    (
        "crawler-timeseries",
        &["crawler-history", "crawler-protocol"],
    ),
    (
        "crawler-updates",
        &[
            "crawler-bundle",
            "crawler-delta",
            "crawler-protocol",
            "crawler-release",
        ],
    ),
    ("crawler-hil", &["crawler-image-format", "crawler-protocol"]),
    (
        "crawler-rollouts",
        &[
            "crawler-metrics",
            "crawler-protocol",
            "crawler-records",
            "crawler-release",
            "crawler-system",
            "crawler-updates",
        ],
    ),
    (
        "crawler-world-history",
        &["crawler-hal", "crawler-protocol", "crawler-sim"],
    ),
    ("xtask", &[]),
];

/// The crates that run on a microcontroller: no std, no heap, no statics, no unsafe.
const BARE: &[(&str, &str)] = &[
    ("crawler-hal", "firmware/hal"),
    ("crawler-boot", "firmware/boot"),
    ("crawler-delta", "firmware/delta"),
    ("crawler-drivers", "firmware/drivers"),
    ("crawler-protocol", "firmware/protocol"),
    ("crawler-release", "firmware/release"),
    ("crawler-tls", "firmware/tls"),
    ("crawler-app", "firmware/app"),
    ("crawler-micromodel", "models/micromodel"),
    ("crawler-detector", "models/detector"),
];

/// Where two robots, or two worlds, must be able to live in one process.
const WITHOUT_GLOBALS: &[&str] = &[
    "firmware/boot",
    "firmware/delta",
    "firmware/drivers",
    "firmware/app",
    "hal-sim",
    "hal-sim/bundle",
    "hal-sim/protocol",
    "models/federated",
    "models/micromodel",
    "models/policy",
];

/// The crates of the workspace, each with what it depends on outside of its tests.
fn members() -> BTreeMap<String, BTreeSet<String>> {
    let metadata = MetadataCommand::new()
        .current_dir(root())
        .no_deps()
        .exec()
        .expect("cargo metadata");
    metadata
        .packages
        .iter()
        .map(|package| {
            let needs = package
                .dependencies
                .iter()
                .filter(|need| need.kind == DependencyKind::Normal)
                .map(|need| need.name.clone());
            (package.name.to_string(), needs.collect())
        })
        .collect()
}

#[test]
fn dependencies_point_one_way() {
    let members = members();
    for (name, needs) in &members {
        // The tests may look at everything.
        if name == "crawler-tests" {
            continue;
        }
        let allowed = ALLOWED
            .iter()
            .find(|(member, _)| member == name)
            .unwrap_or_else(|| panic!("{name} has no place in the layering: add it to ALLOWED"))
            .1;
        for need in needs.iter().filter(|need| members.contains_key(*need)) {
            assert!(
                allowed.contains(&need.as_str()),
                "{name} must not depend on {need}"
            );
        }
    }
    for (name, _) in ALLOWED {
        assert!(
            members.contains_key(*name),
            "{name} is gone: drop it from ALLOWED"
        );
    }
}

/// Whoever reads the server from its binary down to what stands on nothing meets no more crates than that.
#[test]
fn no_chain_of_crates_of_the_server_is_longer_than_six() {
    let members = members();
    let listed = std::fs::read_dir(root().join("host-server")).expect("host-server");
    let folders: BTreeSet<String> = listed
        .filter_map(|entry| entry.expect("host-server").path().canonicalize().ok())
        .chain([root().join("host-server")])
        .filter_map(|folder| std::fs::read_to_string(folder.join("Cargo.toml")).ok())
        .filter_map(|manifest| {
            Some(
                manifest
                    .split("name = \"")
                    .nth(1)?
                    .split('"')
                    .next()?
                    .to_owned(),
            )
        })
        .collect();
    assert!(folders.len() > 15, "{folders:?}");
    let mut longest: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    // A chain has a crate more with each round; crates depend one way, so the rounds come to an end.
    for _ in 0..=folders.len() {
        for name in &folders {
            let below = members[name]
                .iter()
                .filter_map(|need| longest.get(need.as_str()));
            let below = below.max_by_key(|chain| chain.len()).cloned();
            let chain = [vec![name.as_str()], below.unwrap_or_default()].concat();
            longest.insert(name, chain);
        }
    }
    for chain in longest.values() {
        assert!(chain.len() <= 6, "{chain:?}");
    }
}

/// A crate that is not hashed could change, and a report on a release would still name the same program.
#[test]
fn the_hash_of_the_robot_program_is_over_all_of_its_crates() {
    let members = members();
    let mut program = BTreeSet::new();
    let mut next = vec!["crawler-app"];
    while let Some(name) = next.pop() {
        if program.insert(name) {
            let needs = members[name].iter().map(String::as_str);
            next.extend(needs.filter(|need| members.contains_key(*need)));
        }
    }
    let folders = program.iter().map(|name| {
        let found = BARE.iter().find(|(bare, _)| bare == name);
        found.unwrap_or_else(|| panic!("{name} is not bare")).1
    });
    let sources = root().join("firmware/boards/image/src/sources.rs");
    let sources = std::fs::read_to_string(sources).expect("sources.rs");
    let list = sources.split("CRATES: [").nth(1).expect("CRATES");
    let list = list.split("];").next().expect("its end");
    let hashed: BTreeSet<&str> = list.split('"').skip(1).step_by(2).collect();
    assert_eq!(hashed, folders.collect());
}

#[test]
fn no_dependency_of_the_robot_program_brings_std_or_a_heap() {
    for (name, _) in BARE {
        let output = Command::new(env!("CARGO"))
            .args(["tree", "--locked", "--package", name])
            .args(["--edges", "normal,no-proc-macro", "--prefix", "none"])
            .args(["--format", "{p}|{f}"])
            .current_dir(root())
            .output()
            .expect("cargo tree");
        let tree = String::from_utf8(output.stdout).expect("UTF-8");
        assert!(output.status.success() && tree.starts_with(name), "{tree}");
        for line in tree.lines() {
            let (package, features) = line.trim_end_matches(" (*)").split_once('|').expect(line);
            for feature in features.split(',') {
                assert!(
                    !["std", "alloc", "use-std", "unstable-alloc"].contains(&feature),
                    "{name} gets {package} with feature {feature}"
                );
            }
        }
    }
}

#[test]
fn bare_crates_are_no_std_and_forbid_unsafe() {
    for (name, folder) in BARE {
        let folder = root().join(folder);
        let lib = std::fs::read_to_string(folder.join("src/lib.rs")).expect(name);
        let file = syn::parse_file(&lib).expect(name);
        let no_std = file.attrs.iter().any(|a| a.path().is_ident("no_std"));
        assert!(no_std, "{name} must be #![no_std] without conditions");
        let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).expect(name);
        assert!(
            manifest.contains("[lints]\nworkspace = true"),
            "{name} must use the lints of the workspace"
        );
    }
    let workspace = std::fs::read_to_string(root().join("Cargo.toml")).expect("Cargo.toml");
    for lint in ["unsafe_code = \"forbid\"", "missing_docs = \"deny\""] {
        assert!(workspace.contains(lint), "the workspace must say {lint}");
    }
}

#[test]
fn bare_crates_name_neither_std_nor_alloc_and_hold_no_statics() {
    let mut findings = Vec::new();
    for (_, folder) in BARE {
        scan(&root().join(folder).join("src"), true, &mut findings);
    }
    assert!(findings.is_empty(), "{}", findings.join("\n"));
}

#[test]
fn drivers_program_and_simulator_hold_no_statics() {
    let mut findings = Vec::new();
    for folder in WITHOUT_GLOBALS {
        scan(&root().join(folder).join("src"), false, &mut findings);
    }
    assert!(findings.is_empty(), "{}", findings.join("\n"));
}

/// The scan is only worth something if it sees what it looks for.
#[test]
fn the_scan_finds_what_it_looks_for() {
    let bad = [
        ("static X: u8 = 0;", "static"),
        ("thread_local! { static X: u8 = 0; }", "thread_local"),
        ("use std::vec::Vec;", "std"),
        ("fn f() { let _ = alloc::vec::Vec::<u8>::new(); }", "alloc"),
        ("extern crate alloc;", "alloc"),
        (
            "fn f() { unsafe { core::hint::unreachable_unchecked() } }",
            "unsafe",
        ),
        ("fn f() { std::env::var(\"X\").ok(); }", "std"),
        ("mod m { static mut Y: u8 = 0; }", "static"),
    ];
    for (source, what) in bad {
        let findings = scan_source(source, true);
        assert!(
            findings.iter().any(|(_, found)| found.contains(what)),
            "{source}: {findings:?}"
        );
    }
    let good = "#[cfg(test)] mod tests { use std::vec::Vec; static X: u8 = 0; }
        fn f(x: &'static str) { let _ = \"std::x\"; } // std::y";
    assert_eq!(scan_source(good, true), []);
    let twice = "#[cfg(any(test, not(feature = \"schema\")))] extern crate std;";
    assert_eq!(scan_source(twice, true).len(), 1);
}

/// Looks at every source file below `folder`; `bare` also forbids std, alloc and unsafe.
fn scan(folder: &Path, bare: bool, findings: &mut Vec<String>) {
    for (path, source) in program(folder) {
        for (line, what) in scan_source(&source, bare) {
            findings.push(format!("{}:{line}: {what}", path.display()));
        }
    }
}

/// Every source file below `folder` that is part of the program: not for tests, nor for the host
/// alone.
fn program(folder: &Path) -> Vec<(PathBuf, String)> {
    let mut sources = Vec::new();
    collect(folder, &mut sources);
    assert!(!sources.is_empty(), "{} is empty", folder.display());
    let for_the_host: BTreeSet<String> = sources
        .iter()
        .flat_map(|(_, source)| modules_for_the_host(source))
        .collect();
    sources.retain(|(path, _)| {
        let relative = path.strip_prefix(folder).expect("below the folder");
        let mut parts = relative.with_extension("");
        // `#[path = "x_tests.rs"] mod tests` is how tests beside a long file are named.
        if parts.to_string_lossy().ends_with("_tests") {
            parts.set_file_name("tests");
        }
        !parts
            .iter()
            .any(|part| for_the_host.contains(part.to_string_lossy().as_ref()))
    });
    sources
}

fn collect(folder: &Path, sources: &mut Vec<(PathBuf, String)>) {
    for entry in std::fs::read_dir(folder).expect("readable folder") {
        let path = entry.expect("readable entry").path();
        if path.is_dir() {
            collect(&path, sources);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let source = std::fs::read_to_string(&path).expect("readable file");
            sources.push((path, source));
        }
    }
}

/// Names of the modules that a file declares for tests or for the host alone.
fn modules_for_the_host(source: &str) -> Vec<String> {
    let file = syn::parse_file(source).expect("valid Rust");
    let declared = file.items.iter().filter_map(|item| match item {
        syn::Item::Mod(module) if module.content.is_none() => Some(module),
        _ => None,
    });
    declared
        .filter(|module| only_on_the_host(&module.attrs))
        .map(|module| module.ident.to_string())
        .collect()
}

fn scan_source(source: &str, bare: bool) -> Vec<(usize, String)> {
    let file = syn::parse_file(source).expect("valid Rust");
    let mut scan = Scan {
        bare,
        findings: Vec::new(),
    };
    scan.visit_file(&file);
    scan.findings
}

struct Scan {
    bare: bool,
    findings: Vec<(usize, String)>,
}

impl Scan {
    fn find(&mut self, span: proc_macro2::Span, what: &str) {
        self.findings.push((span.start().line, what.to_owned()));
    }

    fn check_root(&mut self, ident: &syn::Ident) {
        if self.bare && (ident == "std" || ident == "alloc") {
            self.find(ident.span(), &format!("names `{ident}`"));
        }
    }
}

/// Whether an item exists only on the host: in tests, or for the JSON Schemas.
fn only_on_the_host(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        let syn::Meta::List(list) = &attribute.meta else {
            return false;
        };
        let condition = list.tokens.to_string().replace(' ', "");
        let for_the_host = ["test", "feature=\"schema\"", "any(feature=\"schema\",test)"];
        list.path.is_ident("cfg") && for_the_host.contains(&condition.as_str())
    })
}

impl<'ast> Visit<'ast> for Scan {
    fn visit_item(&mut self, item: &'ast syn::Item) {
        let attributes = match item {
            syn::Item::Mod(item) => &item.attrs,
            syn::Item::Fn(item) => &item.attrs,
            syn::Item::Impl(item) => &item.attrs,
            syn::Item::Use(item) => &item.attrs,
            syn::Item::ExternCrate(item) => &item.attrs,
            _ => &Vec::new(),
        };
        if !only_on_the_host(attributes) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_static(&mut self, item: &'ast syn::ItemStatic) {
        self.find(item.ident.span(), "a static");
        visit::visit_item_static(self, item);
    }

    fn visit_item_extern_crate(&mut self, item: &'ast syn::ItemExternCrate) {
        self.check_root(&item.ident);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        if call.path.is_ident("thread_local") {
            let span = call.path.segments[0].ident.span();
            self.find(span, "a thread_local");
        }
        visit::visit_macro(self, call);
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        if path.segments.len() > 1 {
            self.check_root(&path.segments[0].ident);
        }
        visit::visit_path(self, path);
    }

    fn visit_use_path(&mut self, path: &'ast syn::UsePath) {
        self.check_root(&path.ident);
    }

    fn visit_expr_unsafe(&mut self, block: &'ast syn::ExprUnsafe) {
        if self.bare {
            self.find(block.unsafe_token.span, "an unsafe block");
        }
        visit::visit_expr_unsafe(self, block);
    }
}
