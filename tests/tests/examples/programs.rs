//! What the repository has that a command line can name: programs, options, tasks, packages, calls.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::LazyLock;

use cargo_metadata::{Metadata, MetadataCommand};
use crawler_tests::{root, terracrawler};
use serde_json::Value;
use syn::visit::{self, Visit};

/// A `terracrawler` that no variable of this test reaches.
pub(crate) fn program(folder: &Path, words: &[String]) -> Command {
    let mut command = Command::new(terracrawler());
    let ours = std::env::vars_os().map(|(name, _)| name);
    for name in ours.filter(|name| name.to_string_lossy().starts_with("TERRACRAWLER_")) {
        command.env_remove(name);
    }
    command.args(words).current_dir(folder).stdin(Stdio::null());
    command
}

pub(crate) fn output(mut command: Command) -> Output {
    command.output().expect("terracrawler, which cargo built")
}

/// Both streams of a program, for messages.
pub(crate) fn said(output: &Output) -> String {
    let text = [&output.stdout[..], &output.stderr[..]].concat();
    String::from_utf8_lossy(&text).into_owned()
}

/// Words like `--seeds` in a text.
pub(crate) fn options(text: &str) -> BTreeSet<String> {
    let edge = |c: char| !(c.is_ascii_alphanumeric() || c == '-');
    text.split(edge)
        .filter(|word| {
            let name = word.strip_prefix("--").unwrap_or_default();
            name.starts_with(|c: char| c.is_ascii_lowercase())
        })
        .map(str::to_owned)
        .collect()
}

/// The subcommands of `terracrawler`, below each its options; `user` and `user add` are two.
pub(crate) static TERRACRAWLER: LazyLock<BTreeMap<String, BTreeSet<String>>> =
    LazyLock::new(|| {
        let mut known = BTreeMap::new();
        let mut waiting = vec![String::new()];
        while let Some(name) = waiting.pop() {
            let mut words: Vec<_> = name.split_whitespace().map(str::to_owned).collect();
            words.push("--help".to_owned());
            let output = output(program(&root(), &words));
            let help = said(&output);
            assert!(output.status.success(), "terracrawler {name}: {help}");
            let below = help.lines().skip_while(|line| *line != "Commands:").skip(1);
            for line in below.take_while(|line| !line.trim().is_empty()) {
                let word = line.split_whitespace().next().unwrap_or_default();
                if word != "help" {
                    waiting.push(format!("{name} {word}").trim().to_owned());
                }
            }
            // Lines that begin with an option; the text of one may speak of others.
            let own = help.lines().filter_map(|line| {
                let line = line.trim_start();
                line.starts_with('-').then(|| {
                    let end = line.find("  ").unwrap_or(line.len());
                    options(&line[..end])
                })
            });
            known.insert(name, own.flatten().collect());
        }
        assert!(known.len() > 20, "{known:?}");
        known
    });

/// Every option of any subcommand.
pub(crate) fn terracrawler_options() -> BTreeSet<String> {
    TERRACRAWLER.values().flatten().cloned().collect()
}

/// What the sources of a program say: its texts, and the options that clap makes of its fields.
#[derive(Debug, Default)]
struct Sources {
    texts: BTreeSet<String>,
    /// Values of the fields `name` and `arguments` that stand together.
    tasks: BTreeMap<String, String>,
    /// By the name of the struct.
    fields: BTreeMap<String, BTreeSet<String>>,
}

fn text_of(expression: &syn::Expr) -> Option<String> {
    match expression {
        syn::Expr::Lit(literal) => match &literal.lit {
            syn::Lit::Str(text) => Some(text.value()),
            _ => None,
        },
        _ => None,
    }
}

impl<'ast> Visit<'ast> for Sources {
    fn visit_lit_str(&mut self, text: &'ast syn::LitStr) {
        self.texts.insert(text.value());
    }

    fn visit_expr_struct(&mut self, made: &'ast syn::ExprStruct) {
        let field = |wanted: &str| {
            let mut fields = made.fields.iter();
            let found = fields.find(
                |field| matches!(&field.member, syn::Member::Named(name) if name == wanted),
            )?;
            text_of(&found.expr)
        };
        if let (Some(name), Some(arguments)) = (field("name"), field("arguments")) {
            self.tasks.insert(name, arguments);
        }
        visit::visit_expr_struct(self, made);
    }

    fn visit_item_struct(&mut self, item: &'ast syn::ItemStruct) {
        let options = self.fields.entry(item.ident.to_string()).or_default();
        for field in &item.fields {
            let mut named = field.ident.as_ref().map(ToString::to_string);
            for attribute in &field.attrs {
                // Others, such as comments, have no `long`.
                let _ = attribute.parse_nested_meta(|meta| {
                    if let Ok(value) = meta.value() {
                        let text: syn::Expr = value.parse()?;
                        if meta.path.is_ident("long") {
                            named = text_of(&text);
                        }
                    }
                    Ok(())
                });
            }
            options.extend(named.map(|name| format!("--{}", name.replace('_', "-"))));
        }
        visit::visit_item_struct(self, item);
    }
}

fn sources(folder: &str) -> Sources {
    let mut sources = Sources::default();
    let mut waiting = vec![root().join(folder)];
    while let Some(path) = waiting.pop() {
        if path.is_dir() {
            let entries = std::fs::read_dir(&path).expect("a readable folder");
            waiting.extend(entries.map(|entry| entry.expect("an entry").path()));
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            let text = std::fs::read_to_string(&path).expect("UTF-8");
            let file = syn::parse_file(&text);
            let file = file.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            sources.visit_file(&file);
        }
    }
    sources
}

static XTASK: LazyLock<Sources> = LazyLock::new(|| {
    let sources = sources("xtask/src");
    let count = sources.tasks.len();
    assert!(count > 10, "the tasks of xtask are declared in another way");
    sources
});
static HIL: LazyLock<Sources> = LazyLock::new(|| sources("hil/src"));

/// Holds `cargo xtask` with these words against its tasks.
///
/// # Errors
/// What there is none of.
pub(crate) fn check_xtask(words: &[String]) -> Result<(), String> {
    let Some((name, rest)) = words.split_first() else {
        return Ok(());
    };
    let Some(arguments) = XTASK.tasks.get(name) else {
        return Err(format!("xtask has no command `{name}`"));
    };
    let known = match name.as_str() {
        "up" => TERRACRAWLER["up"].clone(),
        "emulate" => HIL.fields["EmulateArguments"].clone(),
        "hil" => HIL.fields["SuiteArguments"].clone(),
        _ => options(arguments),
    };
    // Where the list of the command is cut short, its sources have the whole one; clap has a help.
    let by_clap = ["up", "emulate", "hil"].contains(&name.as_str());
    let cut_short = arguments.contains("[OPTIONS]") && !by_clap;
    let among = |word: &str| XTASK.texts.iter().any(|text| text == word);
    for (number, word) in rest.iter().enumerate() {
        let fine = if word == "--help" {
            by_clap
        } else if word.starts_with('-') {
            known.contains(word) || (cut_short && among(word))
        } else {
            // The first word says what is to be done, unless it stands for another or is the value of an
            // option.
            let stands = word.chars().all(|c| c.is_ascii_uppercase() || c == '…');
            number > 0 || stands || arguments.contains(word.as_str()) || among(word)
        };
        if !fine {
            return Err(format!("`cargo xtask {name}` knows no `{word}`"));
        }
    }
    Ok(())
}

/// Every option that `cargo xtask` takes anywhere.
pub(crate) fn xtask_options() -> BTreeSet<String> {
    let texts = XTASK.texts.iter().chain(XTASK.tasks.values());
    // What it hands on to the measurements.
    let measured = ["tests/examples", "tests/benches", "hal-sim/examples"].map(sources);
    let measured = measured.iter().flat_map(|sources| &sources.texts);
    let own = texts.chain(measured).flat_map(|text| options(text));
    let bench = ["EmulateArguments", "SuiteArguments"].map(|name| HIL.fields[name].clone());
    own.chain(bench.into_iter().flatten()).collect()
}

/// The options of `cargo xtask hil`.
pub(crate) fn suite_options() -> BTreeSet<String> {
    HIL.fields["SuiteArguments"].clone()
}

/// The commands that the prompt of `terracrawler replay` tells of.
pub(crate) fn prompt() -> BTreeSet<String> {
    let words = ["replay", "--scenario", "empty", "--interactive"];
    let mut command = program(&root(), &words.map(str::to_owned));
    command.stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.spawn().expect("terracrawler, which cargo built");
    let mut input = child.stdin.take().expect("a pipe");
    input.write_all(b"help\nquit\n").expect("it reads");
    drop(input);
    let output = child.wait_with_output().expect("it ends");
    let said = said(&output);
    // Each stands behind two blanks.
    let lines = said.lines().filter_map(|line| line.strip_prefix("  "));
    let words = lines.filter_map(|line| line.split_whitespace().next());
    words.map(str::to_owned).collect()
}

static WORKSPACE: LazyLock<Metadata> = LazyLock::new(|| {
    MetadataCommand::new()
        .current_dir(root())
        .no_deps()
        .other_options(["--locked".to_owned()])
        .exec()
        .expect("cargo metadata")
});

/// Holds packages, examples, benchmarks, tests and programs that cargo is told to take against the
/// workspace.
///
/// # Errors
/// What there is none of.
pub(crate) fn check_cargo(words: &[String]) -> Result<(), String> {
    let value = |names: &[&str]| {
        let at = words
            .iter()
            .position(|word| names.contains(&word.as_str()))?;
        words.get(at + 1)
    };
    let package = match value(&["-p", "--package"]) {
        None => None,
        Some(name) => {
            let mut packages = WORKSPACE.packages.iter();
            let found = packages.find(|package| package.name.as_str() == name);
            Some(found.ok_or_else(|| format!("there is no package `{name}`"))?)
        }
    };
    for kind in ["example", "bench", "test", "bin"] {
        let (Some(name), Some(package)) = (value(&[&format!("--{kind}")]), package) else {
            continue;
        };
        let there = package.targets.iter().any(|target| {
            let kinds = target.kind.iter();
            target.name == *name && kinds.map(ToString::to_string).any(|found| found == kind)
        });
        if !there {
            return Err(format!("{} has no {kind} `{name}`", package.name));
        }
    }
    Ok(())
}

/// The description of the API, which another test holds to the server.
static INTERFACE: LazyLock<Value> = LazyLock::new(|| {
    let path = root().join("host-server/ui/interface.json");
    let text = std::fs::read(path).expect("host-server/ui/interface.json");
    serde_json::from_slice(&text).expect("JSON")
});

/// What the fields of these structs are called.
///
/// # Panics
/// When there is no such struct.
pub(crate) fn fields(places: &[&str], structs: &[&str]) -> BTreeSet<String> {
    let found: Vec<Sources> = places.iter().map(|place| sources(place)).collect();
    let of = |name: &&str| {
        let fields = found.iter().find_map(|sources| sources.fields.get(*name));
        let fields = fields.unwrap_or_else(|| panic!("{places:?} have no {name}"));
        let names = fields.iter().map(|field| field.trim_start_matches('-'));
        names.map(|name| name.replace('-', "_")).collect::<Vec<_>>()
    };
    structs.iter().flat_map(of).collect()
}

/// The fields of a body of the API.
pub(crate) fn properties(schema: &str) -> BTreeSet<String> {
    let schema = &INTERFACE["openapi"]["components"]["schemas"][schema];
    let properties = schema["properties"].as_object();
    properties.expect("properties").keys().cloned().collect()
}

/// The names of the messages that have a schema.
pub(crate) fn schemas() -> BTreeSet<String> {
    let messages = INTERFACE["messages"].as_object().expect("messages");
    messages.keys().cloned().collect()
}

/// What is served beside the calls that the description has.
pub(crate) const BESIDE: [&str; 5] = [
    "/healthz",
    "/readyz",
    "/metrics",
    "/mqtt",
    "/api/v1/openapi.json",
];

/// Holds a call, with what is asked in it, against the description of the API.
///
/// # Errors
/// What the API has none of.
pub(crate) fn check_call(method: &str, target: &str) -> Result<(), String> {
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    if BESIDE.contains(&path) && method == "GET" && query.is_empty() {
        return Ok(());
    }
    let fits = |template: &str| {
        let (given, wanted) = (path.split('/'), template.split('/'));
        given.clone().count() == wanted.clone().count()
            && given.zip(wanted).all(|(given, wanted)| {
                given == wanted || (wanted.starts_with('{') && !given.is_empty())
            })
    };
    let paths = INTERFACE["openapi"]["paths"].as_object().expect("paths");
    // A word of its own is meant before what stands for any.
    let mut calls: Vec<_> = paths.iter().filter(|(path, _)| fits(path)).collect();
    calls.sort_by_key(|(path, _)| path.matches('{').count());
    let call = calls
        .iter()
        .find_map(|(_, item)| item.get(method.to_ascii_lowercase()))
        .ok_or_else(|| format!("the API has no {method} {path}"))?;
    let takes = |name: &str| {
        let mut parameters = call["parameters"].as_array().into_iter().flatten();
        parameters.any(|parameter| parameter["in"] == "query" && parameter["name"] == name)
    };
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        let name = pair.split('=').next().unwrap_or_default();
        if !takes(name) {
            return Err(format!("{method} {path} takes no `{name}`"));
        }
    }
    Ok(())
}
