//! Within a crate, a module imports from itself and from the layers below its own.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crawler_tests::root;
use syn::visit::{self, Visit};

use super::{only_on_the_host, program};

/// The modules of one crate, in layers.
pub(super) struct Crate {
    pub(super) folder: &'static str,
    /// Paths below the crate's root, the lowest layer first. Of several that hold, the longest
    /// does: `a::b` may stand in another layer than the rest of `a`.
    layers: &'static [&'static [&'static str]],
    /// What modules may have from other crates, where that is held.
    from_outside: &'static [(&'static str, &'static [&'static str])],
}

pub(super) const CRATES: &[Crate] = &[
    Crate {
        folder: "firmware/tls",
        layers: &[
            &["error", "sizes"],
            &["der", "keys", "reader"],
            &["name", "record", "time"],
            &["certificate"],
            &["authority"],
            &["expected"],
            &["chain", "hello"],
            &["handshake"],
            &["connection"],
            &["stream"],
            &["network"],
        ],
        from_outside: &[],
    },
    Crate {
        folder: "firmware/app",
        layers: &[
            &[
                "hold",
                "injected",
                "ledger",
                "motion::angle",
                "navigation",
                "parameters",
                "perception",
                "timesync",
                "tracking",
                "vision::lens",
            ],
            &["config", "memory", "neighbours"],
            &["motion"],
            &["goal", "policy", "vision"],
            &["order", "state"],
            &["behaviour", "map_report", "trouble"],
            &["controller", "outbox"],
            &["context"],
            &[
                "camera", "control", "decide", "intake", "lamp", "observe", "power", "sense",
                "store", "update",
            ],
            &[
                "link::backoff",
                "link::buffered",
                "link::cells",
                "link::images",
                "link::limits",
                "link::loss",
                "link::messages",
                "link::packet",
            ],
            &["link::batch", "link::flow"],
            &["link::connection"],
            &["link::session"],
            &["link"],
        ],
        from_outside: &[],
    },
    Crate {
        folder: "host-server/tls",
        layers: &[
            &["error", "names", "provider", "time", "validity"],
            &["files", "handshake"],
            &["authority", "carry", "client"],
            &["certificates", "tunnel"],
            &["shown"],
        ],
        from_outside: &[],
    },
    Crate {
        folder: "hal-sim",
        layers: &[
            &["faults", "sched", "world"],
            &["net", "render"],
            &["devices"],
            &["scenario"],
            &["run"],
            &["evaluate", "tools"],
            &["live", "what_if"],
        ],
        from_outside: &[
            // A world is its bodies and the numbers of its hardware: no program, no device, no network, no file.
            (
                "world",
                &[
                    "crawler_drivers",
                    "crawler_hal",
                    "crawler_sim_protocol",
                    "libm",
                    "rand_core",
                    "rand_pcg",
                    "serde",
                ],
            ),
            ("faults", &["crawler_protocol", "serde"]),
            ("sched", &["branches", "crawler_hal", "embassy_sync"]),
            ("render", &["libm"]),
        ],
    },
];

#[test]
fn modules_import_from_the_layers_below_their_own() {
    let mut findings = Vec::new();
    for one in CRATES {
        let source = root().join(one.folder).join("src");
        let root_file = std::fs::read_to_string(source.join("lib.rs")).expect("lib.rs");
        let root_file = syn::parse_file(&root_file).expect("valid Rust");
        let exported = exported(&root_file);
        for module in modules(&root_file) {
            let place = one.place(std::slice::from_ref(&module));
            assert!(
                place.is_some(),
                "{}: `{module}` has no layer: add it to CRATES",
                one.folder
            );
        }
        let needs = needs(&root().join(one.folder));
        for (module, allowed) in one.from_outside {
            let known = modules(&root_file).iter().any(|one| one == module);
            assert!(known, "{}: `{module}` is gone", one.folder);
            for name in *allowed {
                assert!(needs.contains(*name), "{}: {name} is gone", one.folder);
            }
        }
        let mut seen = Vec::new();
        for (path, text) in program(&source) {
            let module = module_of(path.strip_prefix(&source).expect("below the folder"));
            let Some(own) = one.place(&module) else {
                continue; // the root, which exports from everywhere
            };
            seen.push(own);
            let found = seen_in(&text, &module);
            let inside = found
                .inside
                .into_iter()
                .filter_map(|(line, import)| Some((line, one.fault(own, &import, &exported)?)));
            let outside = found
                .outside
                .into_iter()
                .filter(|(_, name)| needs.contains(name))
                .filter_map(|(line, name)| Some((line, one.fault_outside(&module, &name)?)));
            for (line, what) in inside.chain(outside) {
                let file = path.strip_prefix(root()).expect("in the repository");
                findings.push(format!("{}:{line} {what}", file.display()));
            }
        }
        for layer in one.layers {
            for module in *layer {
                let place = one.place(&module.split("::").map(str::to_owned).collect::<Vec<_>>());
                assert!(
                    place.is_some_and(|place| seen.contains(&place)),
                    "{}: `{module}` is gone: drop it from CRATES",
                    one.folder
                );
            }
        }
    }
    assert!(findings.is_empty(), "\n{}", findings.join("\n"));
}

/// The layer of a module, and its entry in the table.
type Place = (usize, &'static str);

impl Crate {
    fn place(&self, module: &[String]) -> Option<Place> {
        let holds = |entry: &str| {
            let mut given = module.iter();
            entry
                .split("::")
                .all(|part| given.next().is_some_and(|have| have == part))
        };
        let entries = self.layers.iter().enumerate();
        entries
            .flat_map(|(layer, entries)| entries.iter().map(move |&entry| (layer, entry)))
            .filter(|(_, entry)| holds(entry))
            .max_by_key(|(_, entry)| entry.len())
    }

    /// What is wrong about a module that names another crate, if anything is.
    fn fault_outside(&self, module: &[String], name: &str) -> Option<String> {
        let own = module.first()?;
        let (_, allowed) = self.from_outside.iter().find(|(held, _)| held == own)?;
        let allowed = allowed.contains(&name);
        (!allowed).then(|| format!("(`{own}`) has {name} from outside"))
    }

    /// What is wrong about a module of `own` that imports `path`, if anything is.
    fn fault(
        &self,
        own: Place,
        path: &[String],
        exported: &BTreeMap<String, Vec<String>>,
    ) -> Option<String> {
        let there = self.place(path).or_else(|| {
            // An item of the root is where the root has it from.
            self.place(exported.get(path.first()?)?)
        })?;
        (there != own && there.0 >= own.0).then(|| {
            let path = path.join("::");
            format!(
                "(`{}`) imports crate::{path}, which is not in a layer below",
                own.1
            )
        })
    }
}

/// The path of the module that a file holds.
pub(super) fn module_of(file: &Path) -> Vec<String> {
    let without = file.with_extension("");
    let parts = without
        .iter()
        .map(|part| part.to_string_lossy().into_owned());
    parts
        .filter(|part| !["lib", "main", "mod"].contains(&part.as_str()))
        .collect()
}

/// Names of the modules that a root declares.
pub(super) fn modules(file: &syn::File) -> Vec<String> {
    let modules = file.items.iter().filter_map(|item| match item {
        syn::Item::Mod(module) if !only_on_the_host(&module.attrs) => Some(module),
        _ => None,
    });
    modules.map(|module| module.ident.to_string()).collect()
}

/// Names that a root has from its modules, and where from.
pub(super) fn exported(file: &syn::File) -> BTreeMap<String, Vec<String>> {
    let mut names = BTreeMap::new();
    for item in &file.items {
        if let syn::Item::Use(item) = item {
            let mut found = Vec::new();
            leaves(&item.tree, &mut Vec::new(), &mut found);
            for (name, mut path) in found {
                if path[0] == "crate" || path[0] == "self" {
                    path.remove(0);
                }
                names.insert(name, path);
            }
        }
    }
    names
}

/// Every path that a use tree stands for, under the name that it has from then on.
fn leaves(tree: &syn::UseTree, above: &mut Vec<String>, found: &mut Vec<(String, Vec<String>)>) {
    let mut leaf = |ident: &syn::Ident, name: &syn::Ident| {
        let mut path = above.clone();
        // `a::{self}` is `a`.
        if ident != "self" || path.is_empty() {
            path.push(ident.to_string());
        }
        found.push((name.to_string(), path));
    };
    match tree {
        syn::UseTree::Path(path) => {
            above.push(path.ident.to_string());
            leaves(&path.tree, above, found);
            above.pop();
        }
        syn::UseTree::Name(name) => leaf(&name.ident, &name.ident),
        syn::UseTree::Rename(rename) => leaf(&rename.ident, &rename.rename),
        syn::UseTree::Glob(_) => found.push(("*".to_owned(), above.clone())),
        syn::UseTree::Group(group) => {
            for tree in &group.items {
                leaves(tree, above, found);
            }
        }
    }
}

/// Lines of a file of `module`, and the paths from the crate's root that are named there outside
/// of tests.
pub(super) fn imports(text: &str, module: &[String]) -> Vec<(usize, Vec<String>)> {
    seen_in(text, module).inside
}

fn seen_in(text: &str, module: &[String]) -> Imports {
    let file = syn::parse_file(text).expect("valid Rust");
    let mut imports = Imports {
        module: module.to_vec(),
        inside: Vec::new(),
        outside: Vec::new(),
    };
    imports.visit_file(&file);
    imports
}

/// Names, as Rust has them, of what a crate depends on outside of its tests.
fn needs(folder: &Path) -> BTreeSet<String> {
    let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).expect("Cargo.toml");
    let mut needs = BTreeSet::new();
    let mut counts = false;
    for line in manifest.lines() {
        if line.starts_with('[') {
            counts = line.ends_with("dependencies]") && !line.contains("-dependencies]");
        } else if counts && let Some((name, _)) = line.split_once(['.', ' ', '=']) {
            needs.insert(name.replace('-', "_"));
        }
    }
    needs
}

/// What is named in a file, outside of tests.
struct Imports {
    module: Vec<String>,
    /// Lines, and paths from the crate's root.
    inside: Vec<(usize, Vec<String>)>,
    /// Lines, and first names of other paths.
    outside: Vec<(usize, String)>,
}

impl Imports {
    /// Takes in a path. One that begins with `crate`, `self` or `super` leads into the crate; others lead to other
    /// crates, or to what the module has already.
    fn take(&mut self, line: usize, path: &[String]) {
        let mut from = match path.first().map(String::as_str) {
            Some("crate") => Vec::new(),
            Some("self" | "super") => self.module.clone(),
            Some(name) if path.len() > 1 => {
                self.outside.push((line, name.to_owned()));
                return;
            }
            _ => return,
        };
        for part in path {
            match part.as_str() {
                "crate" | "self" => {}
                "super" => {
                    from.pop();
                }
                part => from.push(part.to_owned()),
            }
        }
        self.inside.push((line, from));
    }

    /// Paths in what is handed to a macro, which is no syntax yet.
    fn take_tokens(&mut self, tokens: proc_macro2::TokenStream) {
        use proc_macro2::TokenTree;
        let mut path: Vec<String> = Vec::new();
        let (mut line, mut colons) = (0, 0);
        for token in tokens {
            match token {
                TokenTree::Ident(ident) => {
                    if path.is_empty() || colons != 2 {
                        let whole = std::mem::take(&mut path);
                        self.take(line, &whole);
                        line = ident.span().start().line;
                    }
                    path.push(ident.to_string());
                    colons = 0;
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' => colons += 1,
                other => {
                    let whole = std::mem::take(&mut path);
                    self.take(line, &whole);
                    if let TokenTree::Group(group) = other {
                        self.take_tokens(group.stream());
                    }
                }
            }
        }
        self.take(line, &path);
    }
}

impl<'ast> Visit<'ast> for Imports {
    fn visit_item(&mut self, item: &'ast syn::Item) {
        let attributes = match item {
            syn::Item::Mod(item) => &item.attrs,
            syn::Item::Fn(item) => &item.attrs,
            syn::Item::Impl(item) => &item.attrs,
            syn::Item::Use(item) => &item.attrs,
            _ => &Vec::new(),
        };
        if !only_on_the_host(attributes) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        self.module.push(item.ident.to_string());
        visit::visit_item_mod(self, item);
        self.module.pop();
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        let mut found = Vec::new();
        leaves(&item.tree, &mut Vec::new(), &mut found);
        for (_, path) in found {
            self.take(item.use_token.span.start().line, &path);
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let parts = path.segments.iter().map(|part| part.ident.to_string());
        let parts: Vec<String> = parts.collect();
        self.take(path.segments[0].ident.span().start().line, &parts);
        visit::visit_path(self, path);
    }

    fn visit_vis_restricted(&mut self, _: &'ast syn::VisRestricted) {}

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.take_tokens(call.tokens.clone());
        visit::visit_macro(self, call);
    }
}

/// The check is only worth something if it sees what it looks for.
#[test]
fn the_check_finds_what_it_looks_for() {
    let names = |path: &str| path.split("::").map(str::to_owned).collect::<Vec<_>>();
    let of = |text| {
        let found = imports(text, &names("a::b"));
        let paths = found.into_iter().map(|(_, path)| path.join("::"));
        paths.collect::<Vec<_>>()
    };
    for (text, paths) in [
        ("use crate::x::Y;", &["x::Y"][..]),
        ("use crate::{x::{self, Y as Z}, w::*};", &["x", "x::Y", "w"]),
        ("use super::c; use super::super::x::Y;", &["a::c", "x::Y"]),
        (
            "use self::c::D; use std::fmt; use heapless::Vec;",
            &["a::b::c::D"],
        ),
        ("fn f(y: crate::x::Y) { super::g(); }", &["x::Y", "a::g"]),
        ("mod m { use super::super::c; }", &["a::c"]),
        (
            "fn f() { println!(\"{}\", g(crate::x::Y::z(1), 2)); }",
            &["x::Y::z"],
        ),
        (
            "impl crate::x::T for U where U: crate::w::V {}",
            &["x::T", "w::V"],
        ),
        ("#[cfg(test)] mod tests { use crate::x; } // crate::y", &[]),
        (
            "/// See [`crate::x::Y`].\npub(in crate::a) fn f() { \"crate::x\"; }",
            &[],
        ),
    ] {
        let mut found = of(text);
        found.retain(|path| !path.is_empty());
        let mut paths: Vec<String> = paths.iter().map(|&path| path.to_owned()).collect();
        found.sort();
        paths.sort();
        assert_eq!(found, paths, "{text}");
    }
    let found = seen_in(
        "use tokio::{net, time}; fn f() { serde::g(rand); h!(x, mcap::Y) }",
        &[],
    );
    let outside: Vec<&str> = found
        .outside
        .iter()
        .map(|(_, name)| name.as_str())
        .collect();
    assert_eq!(outside, ["tokio", "tokio", "serde", "mcap"]);
    let table = Crate {
        folder: "",
        layers: &[&["a", "b"], &["c", "c::low"], &["d"]],
        from_outside: &[],
    };
    let below = Crate {
        folder: "",
        layers: &[&["c::low"], &["c"]],
        from_outside: &[],
    };
    let root = syn::parse_file("mod a; pub use d::{Word, e::Other}; pub(crate) use self::a::F;");
    let exported = exported(&root.expect("valid Rust"));
    let fault = |table: &Crate, own: &str, path: &str| {
        let own = table.place(&names(own)).expect("a place");
        table.fault(own, &names(path), &exported).is_some()
    };
    for path in ["a::X", "b", "c::X", "Word", "Other", "c::low::X"] {
        assert!(!fault(&table, "d::e", path), "{path}");
    }
    for path in ["b::X", "c", "d", "Word", "Other"] {
        assert!(fault(&table, "a", path), "{path}");
    }
    assert!(!fault(&table, "a", "F") && !fault(&table, "a", "a::other"));
    let held = Crate {
        from_outside: &[("a", &["serde"])],
        ..table
    };
    assert!(held.fault_outside(&names("a::b"), "tokio").is_some());
    assert!(held.fault_outside(&names("a"), "serde").is_none());
    assert!(held.fault_outside(&names("c"), "tokio").is_none());
    assert!(fault(&below, "c::low", "c::X") && !fault(&below, "c", "c::low::X"));
    assert_eq!(module_of(Path::new("a/b.rs")), ["a", "b"]);
    assert_eq!(module_of(Path::new("a/mod.rs")), ["a"]);
    assert_eq!(module_of(Path::new("lib.rs")), [""; 0]);
}
