//! A page, held against the program.

use crawler_protocol::{
    Action, Command, MapSegment, Response, StatusMessage, Telemetry, UpdateCommand, open,
};
use crawler_sim::scenario::Scenario;
use crawler_sim_protocol::SimulatorCommand;
use tempfile::TempDir;

use super::page::{Block, Page};
use super::programs::{self, output, program, said};
use super::{commands, shell};

/// What a block may be, beside `console`, `json` and `toml`, which are held against the program.
/// `cddl` and `mermaid` are held by tests of the crates that they are about.
/// Those of `python` are run by the tests of `python/`.
const LANGUAGES: [&str; 10] = [
    "cddl", "haproxy", "ini", "influx", "mermaid", "nginx", "python", "rust", "text", "udev",
];

/// What is wrong with a page.
pub(crate) fn faults(page: &Page) -> Vec<String> {
    let mut faults = Vec::new();
    for block in page.blocks() {
        if let Err(why) = check_block(&block) {
            faults.push(format!("{}: {why}", page.at(block.line)));
        }
    }
    let aliases = commands::aliases(page);
    match page.examples() {
        Ok(examples) => {
            for example in examples {
                for command in &example.commands {
                    if let Err(why) = commands::check(command, &aliases) {
                        faults.push(format!("{}: {why}", page.at(example.line)));
                    }
                }
            }
        }
        Err(wrong) => faults.extend(wrong),
    }
    for span in page.spans() {
        if let Err(why) = commands::check_paths(std::slice::from_ref(&span.text)) {
            faults.push(format!("{}: {why}", page.at(span.line)));
        }
        // What may be left out is written in brackets.
        let text = span.text.replace(['[', ']'], "");
        let checked = match text.split_once(' ') {
            Some((method @ ("GET" | "POST" | "PUT" | "PATCH" | "DELETE"), path)) => {
                // A call of InfluxDB.
                if path.starts_with("/write?") {
                    continue;
                }
                programs::check_call(method, path)
            }
            Some(_) => match shell::parse(&text) {
                Ok(parsed) => parsed.into_iter().try_for_each(|mut command| {
                    command.words.retain(|word| word != "…");
                    let named = command.words.first().is_some_and(|name| {
                        [
                            "cargo",
                            "curl",
                            "docker",
                            "mosquitto_pub",
                            "mosquitto_sub",
                            "sudo",
                        ]
                        .contains(&name.as_str())
                            || name == "terracrawler"
                            || aliases.contains_key(name)
                    });
                    if named && command.words.len() > 1 {
                        commands::check(&command, &aliases)
                    } else {
                        Ok(())
                    }
                }),
                // No command line.
                Err(shell::Incomplete) => Ok(()),
            },
            None => Ok(()),
        };
        if let Err(why) = checked {
            faults.push(format!("{}: `{}`: {why}", page.at(span.line), span.text));
        }
    }
    faults
}

fn check_block(block: &Block) -> Result<(), String> {
    match block.language.as_str() {
        "console" => Ok(()),
        "json" => check_json(&block.text),
        "toml" => check_toml(&block.text),
        language if LANGUAGES.contains(&language) => {
            let command = |line: &&str| {
                let line = line.trim_start();
                ["$ ", "cargo ", "curl ", "terracrawler "]
                    .iter()
                    .any(|begin| line.starts_with(begin))
            };
            match block.text.lines().find(command) {
                Some(line) => Err(format!("a command in a block of {language}: {line}")),
                None => Ok(()),
            }
        }
        "" => Err("a block without a language".to_owned()),
        other => Err(format!("nobody here knows blocks of {other}")),
    }
}

/// Every value is a message of the protocol.
fn check_json(text: &str) -> Result<(), String> {
    let values = serde_json::Deserializer::from_str(text).into_iter::<serde_json::Value>();
    for value in values {
        let value = value.map_err(|error| error.to_string())?.to_string();
        let bytes = value.as_bytes();
        let known = Command::parse(bytes).is_ok()
            || Action::parse(bytes).is_ok()
            || SimulatorCommand::from_json(bytes).is_ok()
            || Response::from_json(bytes).is_ok()
            || Telemetry::from_json(bytes).is_ok()
            || MapSegment::from_json(bytes).is_ok_and(|segment| segment.is_consistent())
            || StatusMessage::from_json(bytes).is_ok()
            || matches!(UpdateCommand::from_json(bytes), Ok(Some(_)))
            || open::update(bytes).is_ok_and(|update| {
                matches!(
                    update,
                    open::Update::Report(read) if read.unknown.is_none()
                )
            });
        if !known {
            return Err(format!("no message of the protocol: {value}"));
        }
    }
    Ok(())
}

/// It is a scenario, or a part of one, or a file of options.
fn check_toml(text: &str) -> Result<(), String> {
    let named = if text.lines().any(|line| line.starts_with("name = ")) {
        text.to_owned()
    } else {
        format!("name = \"example\"\n{text}")
    };
    let Err(scenario) = Scenario::parse(&named) else {
        return Ok(());
    };
    // A command that reads its options, and then opens nothing.
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("options.toml");
    std::fs::write(&file, text).expect("a file");
    let words = ["mosquitto", "acl", "--config", "options.toml"];
    let output = output(program(folder.path(), &words.map(str::to_owned)));
    if output.status.success() {
        return Ok(());
    }
    Err(format!(
        "neither a scenario ({scenario}) nor options ({})",
        said(&output)
    ))
}
