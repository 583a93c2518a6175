//! The documentation is true as far as a program can tell: every example in it is taken apart and
//! held against what it calls, those that are cheap are carried out, and the lists in it are those of
//! the program. A line that nobody here knows fails, so that a new example cannot slip through.

mod check;
mod commands;
mod lists;
mod mutated;
pub(crate) mod page;
mod programs;
mod served;
mod shell;

use std::error::Error;
use std::process::Stdio;

use check::faults;
use commands::check_console;
use crawler_app::motion::Twist;
use crawler_hal::Duration;
use crawler_sim::run::bare::{BareWorld, Drive, Steering};
use crawler_sim::scenario::Scenario;
use crawler_tests::root;
use page::{Example, Page};
use programs::{program, said};
use tempfile::TempDir;

fn examples(page: &Page) -> Vec<Example> {
    page.examples()
        .unwrap_or_else(|wrong| panic!("{}", wrong.join("\n")))
}

/// The block of a page that holds a text.
fn block(page: &str, text: &str) -> String {
    let page = Page::read(page);
    let mut blocks = page.blocks().into_iter();
    let found = blocks.find(|block| block.text.contains(text));
    found
        .unwrap_or_else(|| panic!("no block of {} has {text}", page.name))
        .text
}

/// The file of options that an operator is shown.
fn options() -> String {
    block("docs/operate.md", "tls_names = ")
}

#[test]
fn every_example_is_one_that_the_program_takes() {
    let pages = Page::all();
    let faults: Vec<_> = pages.iter().flat_map(faults).collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    // Were none found, there would be none to be wrong.
    let count: usize = pages.iter().map(|page| examples(page).len()).sum();
    assert!(count > 60, "only {count} command lines");
}

/// What is cheap in a folder of its own is done, not only read.
#[test]
fn commands_of_the_console_can_be_meant() {
    let options = options();
    let mut count = 0;
    for page in Page::all() {
        let aliases = commands::aliases(&page);
        for example in examples(&page) {
            for command in &example.commands {
                let words: Vec<&str> = command.words.iter().map(String::as_str).collect();
                let words = match words.as_slice() {
                    ["terracrawler", rest @ ..] => rest,
                    [name, rest @ ..] if aliases.contains_key(*name) => rest,
                    _ => continue,
                };
                let done = ["audit", "backup", "mosquitto", "restore", "robot", "user"];
                if !words.first().is_some_and(|name| done.contains(name)) || words.contains(&"…")
                {
                    continue;
                }
                count += 1;
                let words: Vec<_> = words.iter().map(|&word| word.to_owned()).collect();
                if let Err(why) = check_console(&words, &options) {
                    panic!("{}: {why}", page.at(example.line));
                }
            }
        }
    }
    assert!(count > 5, "only {count} commands of the console");
}

/// Keys, a program, a model, a policy, a bundle and a gate, made, verified and added one after the other in one folder, where there is
/// a server's data.
#[test]
fn releases_are_made_as_the_page_says() {
    let folder = TempDir::new().expect("a folder");
    // As the header of an image for an ESP32-C3 has it: what it is, segments, the chip.
    let mut image = vec![0; 70_000];
    (image[0], image[1], image[12]) = (0xE9, 4, 5);
    let server = "robot enroll rover-1 --address rover.example --data data";
    let server: Vec<_> = server.split(' ').map(str::to_owned).collect();
    let output = programs::output(program(folder.path(), &server));
    assert!(output.status.success(), "{}", said(&output));
    let plan = block("docs/updates.md", "# gate.toml");
    std::fs::write(folder.path().join("gate.toml"), plan).expect("a plan");
    let mut done = Vec::new();
    for example in examples(&Page::read("docs/updates.md")) {
        for command in &example.commands {
            let words = match command.words.split_first() {
                Some((name, words)) if name == "terracrawler" => words,
                _ => continue,
            };
            // Recordings are what gates replay.
            if !["release", "replay"].contains(&&*words[0]) {
                continue;
            }
            let image_at = words.iter().position(|word| word == "--image");
            let path = image_at.map(|at| folder.path().join(&words[at + 1]));
            if let Some(path) = path.filter(|path| !path.exists()) {
                std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
                if path.extension().is_some_and(|end| end == "tcpo") {
                    // Policies are read before they are signed.
                    let policy = root().join("firmware/app/policies/spread.tcpo");
                    std::fs::copy(policy, path).expect("a policy");
                } else {
                    // Another name is another image, so that there is a delta between them.
                    image[1_000] = path.as_os_str().len() as u8;
                    std::fs::write(path, &image).expect("an image");
                }
            }
            let output = programs::output(program(folder.path(), words));
            assert!(output.status.success(), "{words:?}: {}", said(&output));
            if words[0] == "release" {
                done.push(words[1].clone());
            }
        }
    }
    let all = "keygen sign sign verify verify add gate verify add sign sign add sign add bundle sign add bundle sign sign delta";
    assert_eq!(done.join(" "), all);
}

/// Worlds in virtual time are run: one seed where an example asks for many, and a prompt is left at
/// once where nobody types.
#[test]
fn worlds_of_the_examples_can_be_run() {
    let folder = TempDir::new().expect("a folder");
    std::fs::write(
        folder.path().join("my.toml"),
        block("docs/scenarios.md", "[arena.scatter]"),
    )
    .expect("a scenario");
    // What a twin is calibrated on is printed by the program itself.
    let script = ["twin", "script"].map(str::to_owned);
    let script = programs::output(program(folder.path(), &script));
    std::fs::write(folder.path().join("calibration.toml"), script.stdout).expect("a scenario");
    let mut count = 0;
    for page in Page::all() {
        for example in examples(&page) {
            let mut input = None;
            for command in &example.commands {
                let mut words = command.words.clone();
                let second = words.get(1).cloned().unwrap_or_default();
                if command.calls("printf") {
                    input = Some(second.replace("\\n", "\n"));
                }
                // A recording of a live world has a test of its own.
                let runs = match second.as_str() {
                    "evaluate" => true,
                    "replay" => words.iter().any(|word| word == "--scenario"),
                    _ => false,
                };
                if !runs || !command.calls("terracrawler") {
                    continue;
                }
                if second == "evaluate" {
                    few(&mut words);
                }
                let mut command = program(folder.path(), &words[1..]);
                command
                    .stdin(Stdio::piped())
                    .stdout(Stdio::piped())
                    .stderr(Stdio::piped());
                let mut child = command.spawn().expect("terracrawler");
                let lines = input.take().unwrap_or_default() + "quit\n";
                let mut pipe = child.stdin.take().expect("a pipe");
                // One that does not read ends before.
                let _ = std::io::Write::write_all(&mut pipe, lines.as_bytes());
                drop(pipe);
                let output = child.wait_with_output().expect("it ends");
                // One seed may well miss a threshold, which is 1.
                let missed = second == "evaluate" && output.status.code() == Some(1);
                assert!(
                    output.status.success() || missed,
                    "{}: {words:?}: {}\n{}",
                    page.at(example.line),
                    output.status,
                    said(&output)
                );
                count += 1;
            }
        }
    }
    assert!(count > 6, "only {count} worlds");
}

/// As few runs as show that the options are understood.
fn few(words: &mut Vec<String>) {
    let options = [("--monte-carlo", "2"), ("--budget", "1"), ("--seeds", "1")];
    for (option, number) in options {
        if let Some(at) = words.iter().position(|word| word == option) {
            number.clone_into(&mut words[at + 1]);
        }
    }
    let has = |option: &str| words.iter().any(|word| word == option);
    if !["--seeds", "--monte-carlo", "--adversarial"]
        .into_iter()
        .any(has)
    {
        words.extend(["--seeds".to_owned(), "1".to_owned()]);
    }
}

#[test]
fn calls_of_the_examples_are_answered() {
    let pages = Page::all().into_iter().map(|page| {
        let examples = examples(&page);
        (page, examples)
    });
    served::requests(&pages.collect::<Vec<_>>());
}

/// The words of the only command of the README that calls `terracrawler` with these.
fn of_the_readme(begin: &[&str]) -> Vec<String> {
    let examples = examples(&Page::read("README.md")).into_iter();
    let commands = examples.flat_map(|example| example.commands);
    let found: Vec<_> = commands
        .filter_map(|command| {
            Some(
                command
                    .words
                    .strip_prefix(&["terracrawler".to_owned()][..])?
                    .to_vec(),
            )
        })
        .filter(|words| words.iter().zip(begin).all(|(word, wanted)| word == wanted))
        .collect();
    assert_eq!(found.len(), 1, "{begin:?}: {found:?}");
    found.into_iter().next().unwrap_or_default()
}

#[test]
fn a_world_that_is_recorded_as_the_readme_says_can_be_replayed() {
    served::recording(
        &of_the_readme(&["up"]),
        &of_the_readme(&["replay", "run.mcap"]),
    );
}

#[test]
fn the_first_command_of_the_readme_moves_a_robot() {
    let examples = examples(&Page::read("README.md")).into_iter();
    let mut lines = examples.filter(|example| example.text.starts_with("mosquitto_pub "));
    let line = lines.next().expect("an example of mosquitto_pub");
    served::first_command(&line.text);
}

/// A Rust text without comments and white space.
fn bare(text: &str) -> String {
    let lines = text.lines().filter_map(|line| line.split("//").next());
    lines.flat_map(str::split_whitespace).collect()
}

#[test]
fn a_world_without_the_firmware_is_stepped_as_its_page_says() -> Result<(), Box<dyn Error>> {
    let scenario = Scenario::built_in("arena")?;
    let seed = 1;
    let mut world = BareWorld::of_scenario(&scenario, seed, Steering::Caller)?;
    world.step_with(Duration::from_millis(100), |_robot, senses| {
        // Filtered range, odometry, battery, duties; contacts from the truth, for rewards.
        let range = senses.reading.range_mm(senses.now);
        let near = range.is_some_and(|mm| mm < 400);
        let twist = if near {
            Twist { v: 0.0, w: 2.0 }
        } else {
            Twist { v: 0.3, w: 0.0 }
        };
        Some(Drive::Twist(twist))
    });
    let snapshot = world.clone(); // in memory
    let bytes = world.save(); // and on disk
    let again = BareWorld::load(&bytes)?; // goes on to the last bit, or says what is wrong
    assert!(again.save() == snapshot.save(), "the same world");
    let page = bare(&block("docs/simulator.md", "BareWorld::of_scenario"));
    let here = bare(include_str!("examples.rs"));
    assert!(
        here.contains(&page),
        "docs/simulator.md shows other lines: {page}"
    );
    Ok(())
}

#[test]
fn lists_in_the_documentation_are_those_of_the_program() {
    let faults = lists::faults(&Page::all());
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn every_link_leads_somewhere() {
    let mut faults = Vec::new();
    for page in Page::of_the_book()
        .into_iter()
        .chain([Page::read("docs/SUMMARY.md")])
    {
        for (line, target) in page.links() {
            if target.starts_with("http") {
                continue;
            }
            let (file, anchor) = target.split_once('#').unwrap_or((&target, ""));
            let folder = root().join(&page.name);
            let folder = folder.parent().expect("a folder");
            let path = if file.is_empty() {
                root().join(&page.name)
            } else {
                folder.join(file)
            };
            if !path.exists() {
                faults.push(format!("{}: there is no {target}", page.at(line)));
            } else if !anchor.is_empty() {
                let text = std::fs::read_to_string(&path).expect("UTF-8");
                let name = target.clone();
                if !(Page { name, text }).anchors().contains(anchor) {
                    faults.push(format!("{}: nothing is called {target}", page.at(line)));
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}
