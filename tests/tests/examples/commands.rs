//! Each command line of a page, held against what it calls.

use std::collections::BTreeMap;
use std::path::Path;

use crawler_protocol::{Command, Fleet, Topic};
use crawler_sim_protocol::SimulatorCommand;
use crawler_tests::root;
use tempfile::TempDir;

use super::page::Page;
use super::programs::{TERRACRAWLER, check_call, check_cargo, check_xtask, output, program, said};
use super::shell::{self, Simple};

/// Programs that are not ours. Another one is added here when it is meant.
const OUTSIDE: [&str; 26] = [
    "createdb",
    "createuser",
    "echo",
    "espflash",
    "espup",
    "grep",
    "install",
    "journalctl",
    "npm",
    "openssl",
    "pip",
    "printf",
    "prometheus",
    "promtool",
    "rustup",
    "systemctl",
    "systemd-sysusers",
    "tail",
    "tee",
    "tensorboard",
    "udevadm",
    "usermod",
    "xxd",
    "dmesg",
    "smartctl",
    "systemd-analyze",
];

/// What `cargo install` is told to install.
const INSTALLED: [&str; 6] = [
    "cargo-deny",
    "cargo-fuzz",
    "cargo-nextest",
    "espflash",
    "espup",
    "mdbook",
];

/// Words that stand for others in a sentence, and something that they may stand for.
const PLACEHOLDERS: [(&str, &str); 10] = [
    ("ADDRESS", "127.0.0.1:1"),
    ("COMMAND", "up"),
    ("DIR", "folder"),
    ("FILE", "file"),
    ("FILE.mcap", "file.mcap"),
    ("ID", "9f2c1ab034d5e6f7"),
    ("N", "7"),
    ("NAME", "ada"),
    ("ROLE", "viewer"),
    ("URL", "postgres://localhost/terracrawler"),
];

/// Names that a page gives to programs.
pub(crate) type Aliases = BTreeMap<String, String>;

/// The names that a page's `alias` lines make.
pub(crate) fn aliases(page: &Page) -> Aliases {
    let examples = page.examples().unwrap_or_default();
    let commands = examples.into_iter().flat_map(|example| example.commands);
    commands
        .filter(|command| command.words.first().is_some_and(|word| word == "alias"))
        .flat_map(|command| command.words.into_iter().skip(1))
        .filter_map(|word| {
            let (name, meaning) = word.split_once('=')?;
            Some((name.to_owned(), meaning.to_owned()))
        })
        .collect()
}

/// Holds one command against what it calls.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn check(command: &Simple, aliases: &Aliases) -> Result<(), String> {
    let words = &command.words;
    for (name, _) in &command.variables {
        check_variable(name)?;
    }
    let Some((name, rest)) = words.split_first() else {
        return Ok(());
    };
    check_paths(words)?;
    if let Some(meaning) = aliases.get(name).filter(|_| name != "terracrawler") {
        let mut whole = shell::parse(meaning).map_err(|_| format!("alias {name} has no end"))?;
        let command = whole
            .pop()
            .ok_or_else(|| format!("alias {name} is empty"))?;
        let words = [command.words, rest.to_vec()].concat();
        return check(&Simple { words, ..command }, aliases);
    }
    match name.as_str() {
        "terracrawler" | "/usr/local/bin/terracrawler" => check_terracrawler(rest),
        "cargo" => check_cargo_call(rest),
        "sudo" => {
            let behind = match rest.first().map(String::as_str) {
                Some("-u") => 2,
                _ => 0,
            };
            let words = rest.get(behind..).unwrap_or_default().to_vec();
            let variables = Vec::new();
            check(&Simple { variables, words }, aliases)
        }
        "alias" => Ok(()),
        "export" => rest.iter().try_for_each(|word| {
            let name = word.split('=').next().unwrap_or_default();
            check_variable(name)
        }),
        "curl" => check_curl(&Request::of(rest)?),
        "mosquitto_pub" => check_publication(rest),
        "mosquitto_sub" => check_subscription(rest),
        "docker" => check_docker(rest, aliases),
        "echo" => {
            // A line of cron: five words of time, an account, and the command.
            for text in rest.iter().filter(|text| text.contains("terracrawler")) {
                let words = shell::parse(text).map_err(|_| format!("{text}: has no end"))?;
                for mut command in words {
                    command.words.drain(..6.min(command.words.len()));
                    check(&command, aliases)?;
                }
            }
            Ok(())
        }
        name if OUTSIDE.contains(&name) => Ok(()),
        name => Err(format!("nobody here knows the program `{name}`")),
    }
}

/// Holds the name of a variable of ours against the options.
///
/// # Errors
/// When no option has it.
pub(crate) fn check_variable(name: &str) -> Result<(), String> {
    let Some(key) = name.strip_prefix("TERRACRAWLER_") else {
        return Ok(());
    };
    let option = format!("--{}", key.to_lowercase().replace('_', "-"));
    let known = ["up", "serve", "sim"]
        .iter()
        .any(|command| TERRACRAWLER[*command].contains(&option));
    if known {
        Ok(())
    } else {
        Err(format!("there is no variable {name}"))
    }
}

/// Files of the repository are where they are said to be.
pub(crate) fn check_paths(words: &[String]) -> Result<(), String> {
    let folders = [
        ".ci/",
        "boards/",
        "deploy/",
        "docs/",
        "firmware/",
        "fuzz/",
        "hal-sim/",
        "hil/",
        "host-server/",
        "models/",
        "python/",
        "tests/",
        "world/",
        "xtask/",
    ];
    let ours = |word: &&String| folders.iter().any(|folder| word.starts_with(folder));
    match words
        .iter()
        .filter(ours)
        .find(|word| !root().join(word).exists())
    {
        Some(word) => Err(format!("there is no {word}")),
        None => Ok(()),
    }
}

/// Whether clap takes these words, without anything being done. Words that stand for others are
/// taken for one of them.
fn check_terracrawler(words: &[String]) -> Result<(), String> {
    let mut words: Vec<String> = words
        .iter()
        .filter(|word| *word != "…")
        .map(|word| {
            let word = word.trim_start_matches('[').trim_end_matches(']');
            let place = PLACEHOLDERS.iter().find(|(name, _)| *name == word);
            place
                .map_or(word, |(_, meaning)| *meaning)
                .replace('…', "localhost")
        })
        .collect();
    // The value of the last option may be left to the reader.
    let valued = ["--config", "--timeseries", "--database"];
    if words
        .last()
        .is_some_and(|last| valued.contains(&last.as_str()))
    {
        words.pop();
    }
    words.push("--help".to_owned());
    let output = output(program(&root(), &words));
    if output.status.success() {
        Ok(())
    } else {
        let said = said(&output);
        let why = said.lines().next().unwrap_or_default();
        Err(format!("terracrawler: {why}"))
    }
}

fn check_cargo_call(words: &[String]) -> Result<(), String> {
    let words = match words.first() {
        Some(first) if first.starts_with('+') => &words[1..],
        _ => words,
    };
    let Some((name, rest)) = words.split_first() else {
        return Err("cargo is told nothing".to_owned());
    };
    // What follows is for the program that cargo runs.
    let split = rest.iter().position(|word| word == "--");
    let (own, theirs) = rest.split_at(split.unwrap_or(rest.len()));
    match name.as_str() {
        "up" => check_terracrawler(&[&["up".to_owned()][..], rest].concat()),
        "xtask" => check_xtask(rest),
        "install" => match own.iter().find(|word| !word.starts_with('-')) {
            Some(name) if INSTALLED.contains(&name.as_str()) => Ok(()),
            other => Err(format!("cargo installs {other:?}, which nobody here uses")),
        },
        "build" | "run" | "bench" | "test" => {
            check_cargo(own)?;
            match own.iter().position(|word| word == "crawler-server") {
                Some(_) if name == "run" && !theirs.is_empty() => check_terracrawler(&theirs[1..]),
                _ => Ok(()),
            }
        }
        other => Err(format!("cargo has no command `{other}` here")),
    }
}

/// What `curl` is told to send.
#[derive(Debug)]
pub(crate) struct Request {
    pub(crate) method: String,
    /// Path and query.
    pub(crate) target: String,
    pub(crate) body: Option<String>,
}

impl Request {
    /// Takes the words behind `curl` apart.
    ///
    /// # Errors
    /// An option that no example uses, or no address.
    pub(crate) fn of(words: &[String]) -> Result<Self, String> {
        let (mut method, mut address, mut body) = (None, None, None);
        let mut rest = words.iter();
        while let Some(word) = rest.next() {
            let mut value = || {
                rest.next()
                    .ok_or_else(|| format!("curl: {word} has no value"))
            };
            match word.as_str() {
                "-s" => {}
                "-d" => body = Some(value()?.clone()),
                "-X" => method = Some(value()?.clone()),
                "-o" | "-H" | "--cacert" => {
                    value()?;
                }
                option if option.starts_with('-') => {
                    return Err(format!("curl: nobody here knows {option}"));
                }
                word => address = Some(word),
            }
        }
        let address = address.ok_or("curl: there is no address")?;
        let bare = address.split_once("://").map_or(address, |(_, bare)| bare);
        let (_, path) = bare.split_once('/').ok_or("curl: there is no path")?;
        let implied = if body.is_some() { "POST" } else { "GET" };
        Ok(Self {
            method: method.unwrap_or_else(|| implied.to_owned()),
            target: format!("/{path}"),
            body,
        })
    }
}

fn check_curl(request: &Request) -> Result<(), String> {
    check_call(&request.method, &request.target)?;
    match &request.body {
        Some(body) => serde_json::from_str::<serde_json::Value>(body)
            .map(drop)
            .map_err(|error| format!("curl: {body}: {error}")),
        None => Ok(()),
    }
}

fn value<'a>(words: &'a [String], option: &str) -> Result<&'a str, String> {
    let at = words.iter().position(|word| word == option);
    let word = at.and_then(|at| words.get(at + 1));
    word.map(String::as_str)
        .ok_or_else(|| format!("{option} is missing"))
}

fn topic(text: &str) -> Result<Topic, String> {
    Topic::parse(&Fleet::default(), text).map_err(|error| format!("{text}: {error}"))
}

fn check_publication(words: &[String]) -> Result<(), String> {
    let topic = topic(value(words, "-t")?)?;
    let text = value(words, "-m")?;
    let filled = text
        .replace("$(date +%s%3N)", "1700000000000")
        .replace("$(date +%s)", "1700000000");
    let bytes = filled.as_bytes();
    let read = match topic {
        Topic::CommandSwarm | Topic::CommandRobot(_) => Command::parse(bytes)
            .map(drop)
            .map_err(|error| format!("{error:?}")),
        Topic::SimulatorCommand => SimulatorCommand::from_json(bytes)
            .map(drop)
            .map_err(|error| error.to_string()),
        _ => Err("people do not publish there".to_owned()),
    };
    read.map_err(|why| format!("{text}: {why}"))
}

fn check_subscription(words: &[String]) -> Result<(), String> {
    let filter = value(words, "-t")?;
    if filter == "swarm/#" {
        return Ok(());
    }
    // Robot ids and numbers of cells can be 0.
    topic(&filter.replace('+', "0")).map(drop)
}

fn check_docker(words: &[String], aliases: &Aliases) -> Result<(), String> {
    if words.first().is_some_and(|word| word == "buildx") {
        return Ok(());
    }
    let file = value(words, "--file")?;
    let text = std::fs::read_to_string(root().join(file));
    let text = text.map_err(|error| format!("{file}: {error}"))?;
    let service = |name: &str| {
        let begin = format!("\n  {name}:\n");
        text.contains(&begin)
            .then_some(())
            .ok_or(format!("{file} has no service {name}"))
    };
    if let Ok(profile) = value(words, "--profile")
        && !text.contains(&format!("profiles: [{profile}]"))
    {
        return Err(format!("{file} has no profile {profile}"));
    }
    if let Ok(name) = value(words, "logs") {
        service(name)?;
    }
    let Ok(name) = value(words, "exec") else {
        return Ok(());
    };
    service(name)?;
    let at = words
        .iter()
        .position(|word| word == "exec")
        .unwrap_or_default();
    let words = words[at + 2..].to_vec();
    let variables = Vec::new();
    check(&Simple { variables, words }, aliases)
}

/// Runs a subcommand of the console in a folder of its own, with the file of options that
/// `docs/operate.md` shows: whether anybody could mean it can only be told by doing it.
///
/// # Errors
/// When options are missing or exclude each other.
pub(crate) fn check_console(words: &[String], options: &str) -> Result<(), String> {
    let folder = TempDir::new().expect("a folder");
    let here = folder.path().to_str().expect("UTF-8");
    let inside = |path: &str| {
        let place = folder.path().join(path.trim_start_matches('/'));
        std::fs::create_dir_all(&place).expect("a folder in it");
        place
    };
    let options = options.replace("\"/", &format!("\"{here}/"));
    inside("/var/lib/terracrawler");
    let file = inside("/etc/terracrawler").join("terracrawler.toml");
    std::fs::write(file, options).expect("a file");
    let words: Vec<_> = words
        .iter()
        .map(|word| {
            if Path::new(word).is_absolute() {
                format!("{here}{word}")
            } else {
                word.clone()
            }
        })
        .collect();
    let output = output(program(folder.path(), &words));
    // 1 says that it could not be done here, 2 that it cannot be meant.
    match output.status.code() {
        Some(0 | 1) => Ok(()),
        other => Err(format!("{words:?} ended with {other:?}: {}", said(&output))),
    }
}
