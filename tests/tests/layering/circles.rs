//! Within a crate, modules form no circles: whoever reads one meets, sooner or later, the end of
//! what it stands on.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crawler_tests::root;
use syn::visit::{self, Visit};

use super::modules::{CRATES, exported, imports, module_of, modules};
use super::{only_on_the_host, program};

/// What the root of a crate is called among its modules.
const ROOT: &str = "lib.rs";

/// The circles that there are yet, each with all of its modules: no crate gets another one, and whoever opens one
/// drops it here.
const CIRCLES: &[(&str, &[&[&str]])] = &[
    ("firmware/boards/virt", &[&["log", "system", "time"]]),
    (
        "firmware/protocol",
        &[&["command", "message", "open", "words"]],
    ),
    ("firmware/release", &[&["cbor", "encoding", "manifest"]]),
    ("host-server/accounts", &[&["lib.rs", "login", "tickets"]]),
    (
        "host-server/api",
        &[&["access", "audit", "commands", "guard", "releases", "state"]],
    ),
    ("host-server/broker", &[&["guard", "lib.rs", "numbers"]]),
    ("host-server/calibrations", &[&["calibrations", "runner"]]),
    (
        "host-server/commands",
        &[&[
            "driver", "journal", "lib.rs", "pending", "record", "sequence", "shared",
        ]],
    ),
    ("host-server/delivery", &[&["lib.rs", "queue"]]),
    (
        "host-server/experiments",
        &[&["board", "keeper", "lib.rs", "results", "training", "worker"]],
    ),
    ("host-server/fleet", &[&["fences", "ingest", "lib.rs"]]),
    (
        "host-server/history",
        &[&[
            "fold",
            "frames",
            "lib.rs",
            "memory",
            "points",
            "query",
            "retention",
            "seal",
            "span",
            "writer",
        ]],
    ),
    ("host-server/metrics", &[&["fences", "http", "lib.rs"]]),
    (
        "host-server/rollouts",
        &[&[
            "control", "gate", "lib.rs", "link", "numbers", "plan", "runner", "sender", "view",
        ]],
    ),
    ("models/micromodel", &[&["kernels", "model"]]),
];

#[test]
fn modules_form_no_circles() {
    let mut findings = Vec::new();
    let folders = crates();
    assert!(folders.len() > 40, "only {} crates", folders.len());
    for folder in &folders {
        let name = folder.strip_prefix(root()).expect("in the repository");
        let name = name.to_string_lossy();
        let known = CIRCLES.iter().find(|(known, _)| *known == name);
        let known: BTreeSet<Vec<String>> = known
            .into_iter()
            .flat_map(|(_, circles)| *circles)
            .map(|circle| circle.iter().map(|&module| module.to_owned()).collect())
            .collect();
        let graph = graph(&folder.join("src"));
        let mut found = circles(&graph);
        // Where modules have layers, those below them have theirs: only what goes through the root is not seen there.
        if CRATES.iter().any(|one| one.folder == name) {
            found.retain(|circle| circle.iter().any(|module| module == ROOT));
        }
        for circle in found.difference(&known) {
            let ways = circle.iter().map(|module| {
                let there = graph[module].iter().filter(|to| circle.contains(to.0));
                let there = there.map(|(to, place)| format!("{to} ({place})"));
                format!("    {module}: {}", there.collect::<Vec<_>>().join(", "))
            });
            let ways = ways.collect::<Vec<_>>().join("\n");
            findings.push(format!("{name}: a circle of {circle:?}\n{ways}"));
        }
        for circle in known.difference(&found) {
            findings.push(format!("{name}: {circle:?} is no circle any more: drop it"));
        }
    }
    assert!(findings.is_empty(), "\n{}", findings.join("\n"));
}

/// The folders of all crates with a library, those of boards and models as well.
fn crates() -> Vec<PathBuf> {
    fn find(folder: &Path, found: &mut Vec<PathBuf>) {
        if folder.join("src/lib.rs").exists() && folder.join("Cargo.toml").exists() {
            found.push(folder.to_owned());
        }
        for entry in std::fs::read_dir(folder).expect("readable folder") {
            let path = entry.expect("readable entry").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let skipped = ["src", "target", "node_modules", "ui", "tests", "fuzz"];
            if path.is_dir() && !name.starts_with('.') && !skipped.contains(&name.as_ref()) {
                find(&path, found);
            }
        }
    }
    let mut found = Vec::new();
    find(&root(), &mut found);
    found.sort();
    found
}

/// For each module of a crate, those that it imports from, and where it first does.
type Graph = BTreeMap<String, BTreeMap<String, String>>;

fn graph(source: &Path) -> Graph {
    let text = std::fs::read_to_string(source.join("lib.rs")).expect("lib.rs");
    let file = syn::parse_file(&text).expect("valid Rust");
    let modules: BTreeSet<String> = modules(&file).into_iter().collect();
    let exported = exported(&file);
    let defined = defined(&file);
    let mut graph: Graph = modules
        .iter()
        .map(|module| (module.clone(), BTreeMap::new()))
        .collect();
    graph.insert(ROOT.to_owned(), of_root(&file, &modules));
    for (path, text) in program(source) {
        let inside = path.strip_prefix(source).expect("below the folder");
        let module = module_of(inside);
        // What begins at another root than `lib.rs` is another crate.
        let Some(own) = module.first().filter(|own| modules.contains(*own)) else {
            continue;
        };
        for (line, import) in imports(&text, &module) {
            let Some(first) = import.first() else {
                continue;
            };
            let from = exported.get(first).and_then(|from| from.first());
            let there = if modules.contains(first) {
                first
            } else if let Some(from) = from.filter(|from| modules.contains(*from)) {
                from
            } else if defined.contains(first) {
                ROOT
            } else {
                continue;
            };
            if there != own {
                let place = || format!("{}:{line}", inside.display());
                let ways = graph.get_mut(own).expect("a module");
                ways.entry(there.to_owned()).or_insert_with(place);
            }
        }
    }
    graph
}

/// Names of what a root defines itself.
fn defined(file: &syn::File) -> BTreeSet<String> {
    let names = file.items.iter().filter_map(|item| match item {
        syn::Item::Const(item) => Some(&item.ident),
        syn::Item::Enum(item) => Some(&item.ident),
        syn::Item::Fn(item) => Some(&item.sig.ident),
        syn::Item::Static(item) => Some(&item.ident),
        syn::Item::Struct(item) => Some(&item.ident),
        syn::Item::Trait(item) => Some(&item.ident),
        syn::Item::Type(item) => Some(&item.ident),
        _ => None,
    });
    names.map(ToString::to_string).collect()
}

/// What a root has from its modules for itself: not what it merely exports, nor for tests.
fn of_root(file: &syn::File, modules: &BTreeSet<String>) -> BTreeMap<String, String> {
    let mut needs = Needs {
        modules,
        found: BTreeMap::new(),
    };
    // Names that a private `use` brings count where they are used for something of its own.
    let mut brought: BTreeMap<String, String> = BTreeMap::new();
    for (name, path) in exported(file) {
        if let Some(module) = path.first().filter(|module| modules.contains(*module)) {
            brought.insert(name, module.clone());
        }
    }
    for item in &file.items {
        if !matches!(item, syn::Item::Use(_) | syn::Item::Mod(_)) {
            needs.visit_item(item);
            let mut names = Names {
                brought: &brought,
                found: &mut needs.found,
            };
            names.visit_item(item);
        }
    }
    needs.found
}

/// Paths that begin with a module.
struct Needs<'a> {
    modules: &'a BTreeSet<String>,
    found: BTreeMap<String, String>,
}

impl<'ast> Visit<'ast> for Needs<'_> {
    fn visit_path(&mut self, path: &'ast syn::Path) {
        let mut parts = path.segments.iter();
        let mut first = parts.next().map(|part| part.ident.to_string());
        if matches!(first.as_deref(), Some("crate" | "self")) {
            first = parts.next().map(|part| part.ident.to_string());
        }
        // A name alone is a variable or a type.
        if let Some(first) = first.filter(|first| self.modules.contains(first))
            && parts.next().is_some()
        {
            let line = path.segments[0].ident.span().start().line;
            let place = || format!("{ROOT}:{line}");
            self.found.entry(first).or_insert_with(place);
        }
        visit::visit_path(self, path);
    }
}

/// Names that come from a module.
struct Names<'a> {
    brought: &'a BTreeMap<String, String>,
    found: &'a mut BTreeMap<String, String>,
}

impl<'ast> Visit<'ast> for Names<'_> {
    fn visit_item(&mut self, item: &'ast syn::Item) {
        let is_test = matches!(item, syn::Item::Mod(one) if only_on_the_host(&one.attrs));
        if !is_test {
            visit::visit_item(self, item);
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let first = path.segments[0].ident.to_string();
        if let Some(module) = self.brought.get(&first) {
            let place = || format!("{ROOT}:{}", path.segments[0].ident.span().start().line);
            self.found.entry(module.clone()).or_insert_with(place);
        }
        visit::visit_path(self, path);
    }
}

/// Modules that reach each other, in sets of two and more.
fn circles(graph: &Graph) -> BTreeSet<Vec<String>> {
    let reached: BTreeMap<&String, BTreeSet<&String>> = graph
        .keys()
        .map(|from| {
            let (mut reached, mut next) = (BTreeSet::new(), vec![from]);
            while let Some(module) = next.pop() {
                next.extend(graph[module].keys().filter(|to| reached.insert(*to)));
            }
            (from, reached)
        })
        .collect();
    let there_and_back =
        |from: &String, to: &String| reached[from].contains(to) && reached[to].contains(from);
    graph
        .keys()
        .filter(|module| there_and_back(module, module))
        .map(|from| {
            let circle = graph.keys().filter(|to| there_and_back(from, to));
            circle.cloned().collect()
        })
        .collect()
}

/// The check is only worth something if it sees what it looks for.
#[test]
fn circles_are_found() {
    let of = |ways: &[(&str, &[&str])]| {
        let graph: Graph = ways
            .iter()
            .map(|(from, to)| {
                let to = to.iter().map(|to| ((*to).to_owned(), String::new()));
                ((*from).to_owned(), to.collect())
            })
            .collect();
        circles(&graph)
            .into_iter()
            .map(|circle| circle.join(" "))
            .collect::<Vec<_>>()
    };
    assert_eq!(of(&[("a", &["b"]), ("b", &["c"]), ("c", &[])]), [""; 0]);
    assert_eq!(of(&[("a", &["b"]), ("b", &["a"]), ("c", &["a"])]), ["a b"]);
    let two: &[(&str, &[&str])] = &[
        ("a", &["b"]),
        ("b", &["c"]),
        ("c", &["a", "d"]),
        ("d", &["e"]),
        ("e", &["d"]),
    ];
    assert_eq!(of(two), ["a b c", "d e"]);
    let file = "mod a; mod b; mod c; pub use a::Word; use b::Other; pub use c::Third;
        pub struct Own(Other); fn f() { c::g(); let a = 1; } #[cfg(test)] mod tests { use super::a; }";
    let file = syn::parse_file(file).expect("valid Rust");
    assert_eq!(defined(&file), ["Own", "f"].map(str::to_owned).into());
    let modules = modules(&file).into_iter().collect();
    let needs: Vec<String> = of_root(&file, &modules).into_keys().collect();
    assert_eq!(needs, ["b", "c"]);
}
