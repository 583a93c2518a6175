//! Lists in the documentation, each compared with that of the program.

use std::collections::BTreeSet;

use crawler_protocol::{BehaviourName, CommandName, Fleet, Qos, Reason, ResponseStatus};
use crawler_protocol::{Topic, TopicFilter};
use crawler_sim::scenario::{Metric, Scenario};
use crawler_sim_protocol::SimulatorCommandName;
use crawler_tests::root;

use super::commands::check_variable;
use super::page::Page;
use super::programs::{self, TERRACRAWLER};

/// The cells of the rows of a table, below a row that begins like this.
fn table(page: &Page, head: &str) -> Vec<Vec<String>> {
    let prose = page.prose();
    let below = prose.lines().skip_while(|line| !line.starts_with(head));
    let rows = below.skip(2).take_while(|line| line.starts_with('|'));
    let cells = |row: &str| {
        let row = row.replace("\\|", "¦");
        let cells = row.trim_matches('|').split('|');
        cells.map(|cell| cell.trim().to_owned()).collect()
    };
    let rows: Vec<Vec<String>> = rows.map(cells).collect();
    assert!(!rows.is_empty(), "{} has no table {head}", page.name);
    rows
}

/// What stands between backticks in a text.
fn names(text: &str) -> Vec<String> {
    let parts = text.split('`').skip(1).step_by(2);
    parts.map(str::to_owned).collect()
}

fn set<'a>(names: impl IntoIterator<Item = &'a str>) -> BTreeSet<String> {
    names.into_iter().map(str::to_owned).collect()
}

fn named<'a>(pages: &'a [Page], name: &str) -> &'a Page {
    let found = pages.iter().find(|page| page.name == name);
    found.unwrap_or_else(|| panic!("there is no {name}"))
}

/// What is wrong with the lists.
pub(crate) fn faults(pages: &[Page]) -> Vec<String> {
    let mut faults = Vec::new();
    let mut compare = |what: &str, told: BTreeSet<String>, real: BTreeSet<String>| {
        let lacking: Vec<_> = real.difference(&told).collect();
        let gone: Vec<_> = told.difference(&real).collect();
        if !lacking.is_empty() || !gone.is_empty() {
            faults.push(format!(
                "{what}: lacks {lacking:?}, tells of {gone:?} which are not there"
            ));
        }
    };
    let scenarios = named(pages, "docs/scenarios.md");
    let operate = named(pages, "docs/operate.md");
    let debugger = named(pages, "docs/debugger.md");
    let first = |rows: &[Vec<String>]| -> BTreeSet<String> {
        rows.iter().flat_map(|row| names(&row[0])).collect()
    };

    let told = table(scenarios, "| name | robots |");
    let robots = |name: &str| Scenario::built_in(name).expect("a scenario").robots;
    compare(
        "docs/scenarios.md, scenarios and their robots",
        told.iter()
            .map(|row| format!("{} {}", row[0], row[1]))
            .collect(),
        Scenario::names()
            .map(|name| format!("`{name}` {}", robots(name)))
            .collect(),
    );
    let rows = table(operate, "| option | default |");
    let row = rows.iter().find(|row| row[0].starts_with("`--scenario"));
    let told = row.map_or_else(Vec::new, |row| names(&row[2]));
    compare(
        "docs/operate.md, scenarios",
        told.into_iter().collect(),
        Scenario::names().map(str::to_owned).collect(),
    );
    compare(
        "docs/scenarios.md, metrics",
        first(&table(scenarios, "| metric | of a run |")),
        set(Metric::ALL.iter().map(|metric| metric.name())),
    );
    let rows = table(operate, "| command | parameters | answers |");
    compare(
        "docs/operate.md, commands",
        first(&rows),
        set(CommandName::ALL.iter().map(|name| name.name())),
    );
    let row = rows
        .iter()
        .find(|row| row[0] == "`behave`")
        .expect("behave");
    // The names of its parameters stand among them.
    let parameters = [
        "behaviour",
        "speed",
        "x",
        "y",
        "leader",
        "distance",
        "waypoints",
        "laps",
        "value",
        "measure",
        "f",
        "tasks",
        "area",
        "shape",
        "spacing",
        "radius",
        "heading",
        "path",
    ];
    let told = names(&row[1]).into_iter();
    compare(
        "docs/operate.md, behaviours",
        told.filter(|name| !parameters.contains(&name.as_str()))
            .collect(),
        set(BehaviourName::ALL.iter().map(|name| name.name())),
    );
    let mut keys = programs::fields(
        &["hal-sim/src/scenario.rs", "hal-sim/src/scenario"],
        &[
            "Scenario",
            "Start",
            "Ground",
            "Scatter",
            "Generate",
            "Spawn",
            "SpawnPose",
            "Line",
            "Zone",
            "TimedCommand",
            "TimedFault",
            "Goal",
            "Success",
            "Measure",
            "Difficulty",
        ],
    );
    // Given by the program.
    keys.remove("detector");
    keys.remove("policy");
    let edge = |c: char| !(c.is_ascii_lowercase() || c == '_');
    let shown: BTreeSet<String> = set(scenarios.text.split(edge));
    compare("docs/scenarios.md, keys", &keys & &shown, keys);
    let protocol = named(pages, "docs/protocol.md");
    compare(
        "docs/protocol.md, answers",
        first(&table(protocol, "| status | meaning |")),
        set(ResponseStatus::ALL.iter().map(|status| status.name())),
    );
    compare(
        "docs/protocol.md, reasons",
        first(&table(protocol, "| reason | meaning |")),
        set(Reason::ALL.iter().map(|reason| reason.name())),
    );
    for (page, schema) in [
        ("docs/experiments.md", "NewExperiment"),
        ("docs/learning.md", "NewTraining"),
        ("docs/operate.md", "NewFence"),
    ] {
        compare(
            &format!("{page}, fields of {schema}"),
            first(&table(named(pages, page), "| field | |")),
            programs::properties(schema),
        );
    }
    let leading = |rows: &[Vec<String>]| -> BTreeSet<String> {
        let names = first(rows).into_iter();
        names
            .filter_map(|name| Some(name.split(' ').next()?.to_owned()))
            .collect()
    };
    compare(
        "docs/bench.md, options",
        leading(&table(
            named(pages, "docs/bench.md"),
            "| option | meaning |",
        )),
        programs::suite_options(),
    );
    compare(
        "docs/debugger.md, commands at the prompt",
        leading(&table(debugger, "| at the prompt | does |")),
        programs::prompt(),
    );
    for row in table(named(pages, "docs/tls.md"), "| option | variable | key |") {
        let cells: Vec<_> = row.iter().flat_map(|cell| names(cell)).collect();
        let key = cells[0].split([' ', '¦']).next().unwrap_or_default();
        let key = key.trim_start_matches('-').replace('-', "_");
        compare(
            "docs/tls.md, an option",
            set([cells[1].as_str(), &cells[2]]),
            set([
                format!("TERRACRAWLER_{}", key.to_uppercase()).as_str(),
                &key,
            ]),
        );
    }
    let begin = debugger
        .text
        .split_once("\nCommands are ")
        .expect("a list of commands")
        .1;
    compare(
        "docs/debugger.md, commands of a live world",
        names(begin.split_once('.').expect("an end").0)
            .into_iter()
            .collect(),
        set(SimulatorCommandName::ALL.iter().map(|name| name.name())),
    );
    let found = std::fs::read_dir(root().join("hal-sim/scenarios/found")).expect("a folder");
    let found = found.map(|entry| entry.expect("an entry").path());
    compare(
        "docs/scenarios.md, what was found",
        first(&table(scenarios, "| file in `hal-sim/scenarios/found`")),
        found
            .filter_map(|path| Some(path.file_stem()?.to_str()?.to_owned()))
            .collect(),
    );
    let commands = ["up", "serve", "sim"].iter();
    let served: BTreeSet<String> = commands
        .flat_map(|name| &TERRACRAWLER[*name])
        .filter(|name| *name != "--help")
        .cloned()
        .collect();
    let documented: BTreeSet<String> = pages
        .iter()
        .flat_map(|page| programs::options(&page.text))
        .collect();
    compare(
        "options of terracrawler up, serve and sim in the documentation",
        &served & &documented,
        served,
    );
    faults.extend(layers(named(pages, "docs/architecture.md")));
    faults.extend(folders(named(pages, "README.md")));
    faults.extend(topics(protocol));
    faults.extend(words(pages));
    faults
}

/// The crates of ours that a manifest needs, with what only its tests need left out.
fn needs(manifest: &str) -> BTreeSet<String> {
    let sections = manifest.split("\n[");
    let own = sections.filter(|section| {
        let head = section.split(']').next().unwrap_or_default();
        head.ends_with("dependencies") && !head.ends_with("dev-dependencies")
    });
    let lines = own.flat_map(str::lines);
    let names = lines.map(|line| line.split([' ', '.']).next().unwrap_or_default());
    set(names.filter(|name| name.starts_with("crawler-")))
}

/// The table of crates: what each crate needs is what it may depend on.
fn layers(page: &Page) -> Vec<String> {
    let mut faults = Vec::new();
    let mut crates = Vec::new();
    for row in table(page, "| folder | what it is | may depend on |") {
        let folder = names(&row[0]).concat();
        let Ok(manifest) = std::fs::read_to_string(root().join(&folder).join("Cargo.toml")) else {
            faults.push(format!("{}: {folder} has no manifest", page.name));
            continue;
        };
        let mut lines = manifest.lines();
        let name = lines.find_map(|line| line.strip_prefix("name = \"")?.strip_suffix('"'));
        let name = name.unwrap_or_default().to_owned();
        crates.push((folder, name, needs(&manifest), row[2].clone()));
    }
    for (folder, _, needed, told) in &crates {
        for need in needed {
            let there = crates.iter().find(|(_, name, ..)| name == need);
            let Some((place, ..)) = there else {
                faults.push(format!("{}: has no row for {need}", page.name));
                continue;
            };
            let short = place.rsplit('/').next().unwrap_or_default();
            let firmware = place.starts_with("firmware/");
            let allowed = told == "everything"
                || (told.contains(" of `firmware`") && firmware)
                || (told.starts_with("its crates below")
                    && place.starts_with(&format!("{folder}/")))
                || names(told)
                    .iter()
                    .any(|name| name == place || name == short);
            if !allowed {
                faults.push(format!("{}: {folder} needs {place}", page.name));
            }
        }
    }
    faults
}

/// The table of folders at the top: all of them are there, and a member of the workspace is in one of them.
fn folders(page: &Page) -> Vec<String> {
    let rows = table(page, "| folder | what it is |");
    let told: BTreeSet<String> = rows.iter().flat_map(|row| names(&row[0])).collect();
    let gone = told.iter().filter(|name| !root().join(name).is_dir());
    let mut faults: Vec<String> = gone
        .map(|name| format!("{}: there is no folder {name}", page.name))
        .collect();
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).expect("Cargo.toml");
    let members = manifest.split_once("members = [").expect("members").1;
    let members = members.split(']').next().unwrap_or_default();
    let inside = members.split('"').skip(1).step_by(2);
    let tops: BTreeSet<String> = set(inside.filter_map(|path| path.split('/').next()));
    let missing = tops.difference(&told);
    faults.extend(missing.map(|name| format!("{}: has no row for {name}", page.name)));
    faults
}

/// The table of topics, its quality of service and its schemas.
fn topics(page: &Page) -> Vec<String> {
    let schemas = programs::schemas();
    let mut faults = Vec::new();
    let mut told = Vec::new();
    for row in table(page, "| topic | from → to |") {
        for name in names(&row[0]) {
            let text = name
                .replace("{id}", "r")
                .replace("{x}", "0")
                .replace("{y}", "0");
            // What simulators answer is between them and whoever controls them.
            if name == "simulator/response" {
                continue;
            }
            let Ok(topic) = Topic::parse(&Fleet::default(), &format!("swarm/{text}")) else {
                faults.push(format!("docs/protocol.md: {name} is no topic"));
                continue;
            };
            let quality = match topic.qos() {
                Qos::AtMostOnce => "0",
                Qos::AtLeastOnce => "1",
            };
            let retained = if topic.retained() { ", retained" } else { "" };
            if row[2] != format!("{quality}{retained}") {
                faults.push(format!(
                    "docs/protocol.md: {name} has QoS {quality}{retained}"
                ));
            }
            told.push(topic);
        }
        let body = names(&row[3]);
        if let Some(name) = body.first().filter(|name| !schemas.contains(*name)) {
            faults.push(format!("docs/protocol.md: there is no schema {name}"));
        }
    }
    for filter in TopicFilter::ALL {
        if !told.iter().any(|topic| filter.matches(topic)) {
            faults.push(format!("docs/protocol.md: no topic of {filter:?}"));
        }
    }
    faults
}

/// Options, variables, metrics and codes of errors, wherever they stand.
fn words(pages: &[Page]) -> Vec<String> {
    let mut faults = Vec::new();
    let mut options = &programs::terracrawler_options() | &programs::xtask_options();
    // Of Docker.
    options.insert("--profile".to_owned());
    let monitor = &named(pages, "docs/monitor.md").text;
    let sources = sources();
    for page in pages {
        for span in page.spans() {
            let first = span.text.split([' ', '=']).next().unwrap_or_default();
            let fault = if first.starts_with("--") && !options.contains(first) {
                Some("no such option".to_owned())
            } else if first.starts_with("TERRACRAWLER_") {
                check_variable(first).err()
            } else {
                None
            };
            faults
                .extend(fault.map(|why| format!("{}: `{}`: {why}", page.at(span.line), span.text)));
        }
        let edge = |c: char| !(c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
        for word in page.text.split(edge) {
            // That these are served is shown by another test.
            let metric = word.starts_with("terracrawler_") && word.len() > 13;
            let ending = ["_bucket", "_count", "_sum"];
            let bare = ending
                .iter()
                .find_map(|end| word.strip_suffix(*end))
                .unwrap_or(word);
            if metric && !monitor.contains(&format!("`{bare}")) {
                faults.push(format!("{}: docs/monitor.md has no {word}", page.name));
            }
        }
        // A status and the code that goes with it: "409 `other_server`".
        for (at, _) in page.text.match_indices(" `") {
            let (before, behind) = page.text.split_at(at);
            let code = behind[2..].split('`').next().unwrap_or_default();
            let digits = before
                .chars()
                .rev()
                .take(3)
                .filter(char::is_ascii_digit)
                .count();
            let word = code.chars().all(|c| c.is_ascii_lowercase() || c == '_');
            let alone = !before
                .chars()
                .rev()
                .nth(3)
                .is_some_and(char::is_alphanumeric);
            if digits == 3
                && alone
                && word
                && code.contains('_')
                && !sources.contains(&format!("\"{code}\""))
            {
                faults.push(format!("{}: the server has no error {code}", page.name));
            }
        }
    }
    faults
}

/// Everything the server is made of, as text.
fn sources() -> String {
    let mut text = String::new();
    let mut waiting = vec![root().join("host-server")];
    while let Some(path) = waiting.pop() {
        let name = path.file_name().unwrap_or_default();
        if path.is_dir() {
            if !["target", "tests", "ui"].iter().any(|other| name == *other) {
                let entries = std::fs::read_dir(&path).expect("a readable folder");
                waiting.extend(entries.map(|entry| entry.expect("an entry").path()));
            }
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            text += &std::fs::read_to_string(&path).expect("UTF-8");
        }
    }
    text
}
