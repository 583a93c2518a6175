//! What a change must pass, in three tiers, each one command for laptop and CI.

use crate::beside::{BOARDS, Beside, CONTROL_ROOM};
use crate::boards::{self, Board, C3, C6, PROGRAM, VIRT};
use crate::report::Report;
use crate::run::{self, Failure, Outcome};
use crate::suites::Selection;
use crate::{
    bench_server, bogo, counts, counts_simulator, cross, detector, docs, fuzz, fuzz_api, histories,
    image, mixed, mutants, paho, python, size, tools, ui,
};

/// Seconds for each fuzz target of the deep tier.
const FUZZ_SECONDS: u32 = 60;

/// Cases for each property in the deep tier.
const DEEP_CASES: u32 = 2_000;

/// Cases for each operation of the API in the deep tier.
const DEEP_EXAMPLES: u32 = 200;

/// How often everything that has to do with time runs in the deep tier.
const REPETITIONS: u32 = 20;

/// What a developer runs at every save: formats, lints, types, and the tests of the robot program.
///
/// # Errors
/// Names the steps that failed.
pub(crate) fn check(arguments: &[String]) -> Outcome {
    if let Some(argument) = arguments.first() {
        return Err(Failure(format!("'{argument}' is not understood")));
    }
    let mut report = Report::default();
    report.step("format", |_| format());
    report.step("control room", |_| ui::check());
    report.step("clippy", |_| clippy());
    report.step("clippy of a board", |_| clippy_of(&[&VIRT]));
    report.step("the robot program", |_| {
        let crates = ["hal", "drivers", "protocol", "tls", "app", "micromodel"];
        let names = crates.map(|name| format!("crawler-{name}"));
        let mut words = vec!["test", "--locked", "--quiet", "--all-features", "--lib"];
        words.extend(names.iter().flat_map(|name| ["--package", name]));
        run::cargo(&words)
    });
    report.close()
}

/// Everything a change must pass; with `--deep` what takes hours instead; with other arguments only the
/// tests that they select.
///
/// # Errors
/// Names the steps that failed, or the argument that is none.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    match arguments {
        [] => all(),
        [only] if only == "--deep" => deep(),
        _ => {
            let selection = Selection::parse(arguments)?;
            let mut report = Report::default();
            prepare(&mut report);
            report.step("tests", |report| selection.run(report));
            report.close()
        }
    }
}

/// What the tests start: tools, the control room, the emulated board.
fn prepare(report: &mut Report) {
    report.step("tools", |_| tools::setup());
    report.step("control room", |_| ui::build());
    report.step("emulated board", |_| image::image(&VIRT));
}

fn all() -> Outcome {
    let mut report = Report::default();
    report.step("tools", |_| tools::setup());
    report.step("format", |_| format());
    let beside = Beside::start(&CONTROL_ROOM);
    // The tests start it in QEMU.
    report.step("emulated board", |_| image::image(&VIRT));
    report.step("until the steps beside the board end", |report| {
        beside?.end(report)
    });
    // Builds the server too, which the end-to-end tests start.
    report.step("tests: compiling", |_| Selection::default().build());
    let beside = Beside::start(&BOARDS);
    report.step("tests", |report| Selection::default().run(report));
    report.step("examples in the documentation", |_| doctests());
    // Sends to the server that the tests have built.
    report.step("API from its description", |_| fuzz_api::step());
    report.step("histories on other targets", |_| histories::command(&[]));
    report.step("until the steps beside the tests end", |report| {
        beside?.end(report)
    });
    report.step("instruction counts", |_| counts::command(&[]));
    report.step("instructions of simulated robots", |_| {
        counts_simulator::step()
    });
    // The tests have measured the stack of the emulated board.
    report.step("sizes", |_| size::command(&[]));
    report.step("clippy", |_| clippy());
    report.step("documentation", |_| documentation());
    report.step("advisories", |_| advisories());
    report.close()
}

/// What takes hours and finds what is rare. Its seed is new in every run, and printed.
fn deep() -> Outcome {
    let seed = run::fresh_seed();
    println!("seed {seed}");
    let mut report = Report::default();
    prepare(&mut report);
    report.step("properties with new seeds", |report| {
        println!("PROPTEST_RNG_SEED={seed} PROPTEST_CASES={DEEP_CASES}");
        Selection::drawn_from(seed, DEEP_CASES).run(report)
    });
    report.step("time under load, again and again", |report| {
        Selection::timed_under_load(REPETITIONS).run(report)
    });
    report.step("a million robot-seconds", |_| safety(seed));
    report.step("fuzz targets", |_| fuzz::targets(FUZZ_SECONDS));
    report.step("API from its description", |_| {
        fuzz_api::thorough(DEEP_EXAMPLES, seed)
    });
    report.step("clients of Eclipse Paho", |_| paho::step());
    report.step("an earlier version beside this one", |_| mixed::step());
    report.step("clippy of the other RISC-V chip", |_| clippy_of(&[&C6]));
    report.step("tasks that everybody knows", |_| known_tasks());
    report.step("package for Python", |_| python::step());
    report.step("instructions of simulated robots", |_| {
        counts_simulator::thorough_step()
    });
    report.step("another engine", |_| detector::compare(&[]));
    report.step("TLS tests of BoringSSL", |_| bogo::if_there());
    report.step("mutants", |_| mutants::sample(seed));
    report.step("trouble and load", |_| soak());
    report.step("undefined behaviour", |_| miri());
    report.step("book", |_| docs::if_there());
    report.step("advisories", |_| advisories());
    report.close()
}

/// Both algorithms learn what others have learned before: to balance a pole, and to swing up.
fn known_tasks() -> Outcome {
    let words =
        "test --locked --package crawler-policy --test suite -- --ignored --skip seeds_are_written";
    run::cargo(&words.split(' ').collect::<Vec<_>>())
}

fn clippy() -> Outcome {
    run::cargo(&[
        "clippy",
        "--locked",
        "--workspace",
        "--all-targets",
        "--all-features",
        "--",
        "--deny",
        "warnings",
    ])
}

/// The manifests of every workspace but the host's.
fn other_workspaces() -> impl Iterator<Item = String> {
    let boards = boards::WORKSPACES.into_iter().map(boards::manifest);
    boards.chain([detector::COMPARE.to_owned()])
}

/// Every workspace's.
fn format() -> Outcome {
    run::cargo(&["fmt", "--all", "--check"])?;
    for manifest in other_workspaces() {
        run::cargo(&["fmt", "--manifest-path", &manifest, "--check"])?;
    }
    Ok(())
}

fn clippy_of(boards: &[&Board]) -> Outcome {
    for board in boards {
        let mut command = cross::compiler(board)?.cargo(board, "clippy");
        command.args(["--", "--deny", "warnings"]);
        run::run_command(command)?;
    }
    Ok(())
}

/// The server contains the control room.
pub(crate) fn control_room() -> Outcome {
    ui::check().and_then(|()| ui::build())
}

/// The images that no test starts.
pub(crate) fn images() -> Outcome {
    [&PROGRAM, &C3, &C6].into_iter().try_for_each(image::image)
}

/// What is built for the host there is also tested. The two RISC-V chips differ in a few lines, which the
/// deep tier looks at.
pub(crate) fn clippy_of_boards() -> Outcome {
    clippy_of(&[&PROGRAM, &VIRT, &C3])?;
    for workspace in ["image", "log"] {
        image::tool(workspace, "test", &[])?;
        let strict = ["--all-targets", "--", "--deny", "warnings"];
        image::tool(workspace, "clippy", &strict)?;
    }
    Ok(())
}

/// The examples in the documentation of public items; cargo-nextest leaves them to cargo.
fn doctests() -> Outcome {
    let line = "test --locked --quiet --workspace --all-features --doc";
    run::cargo(&line.split(' ').collect::<Vec<_>>())
}

/// Broken links in the documentation are errors.
fn documentation() -> Outcome {
    // The features of clippy, which has checked the dependencies with them.
    let line = "doc --locked --workspace --all-features --no-deps --quiet";
    run::run_with_env(
        &run::root(),
        &run::cargo_program(),
        &line.split(' ').collect::<Vec<_>>(),
        &[("RUSTDOCFLAGS", "--deny warnings")],
    )
}

/// The safety rules under every behaviour, in worlds from `seed` on.
fn safety(seed: u64) -> Outcome {
    println!("PROPTEST_RNG_SEED={seed}");
    let line = "nextest run --locked --workspace --all-features --run-ignored only --no-capture \
                -E test(the_rules_hold_for_a_million_robot_seconds)";
    run::run_with_env(
        &run::root(),
        &run::cargo_program(),
        &line.split_whitespace().collect::<Vec<_>>(),
        &[("PROPTEST_RNG_SEED", &seed.to_string())],
    )
}

/// Servers and robots in trouble and under load, for longer than a test may take: each fails on a
/// count that must be zero.
fn soak() -> Outcome {
    bench_server::chaos(&[])?;
    bench_server::load(&[])?;
    bench_server::disk(&[])?;
    bench_server::updates(&[])?;
    bench_server::soak(&[])
}

/// Miri on the crates that read bytes from outside and do without a heap; it takes a nightly compiler.
fn miri() -> Outcome {
    if run::output("cargo", &["miri", "--version"]).is_none() {
        println!(
            "skipped: no Miri (`rustup +nightly component add miri`, then `cargo +nightly xtask test --deep`)"
        );
        return Ok(());
    }
    let line = "miri test --locked --package crawler-protocol --package crawler-drivers \
                --package crawler-micromodel";
    let words: Vec<&str> = line.split_whitespace().collect();
    // A property is tried a few times: each step takes a thousand.
    let few = [
        ("PROPTEST_CASES", "8"),
        ("MIRIFLAGS", "-Zmiri-disable-isolation"),
    ];
    run::run_with_env(&run::root(), &run::cargo_program(), &words, &few)
}

/// Licences are checked by a test of ours; known vulnerabilities by cargo-deny, where the user
/// has it and its database, which needs the network.
fn advisories() -> Outcome {
    if run::output("cargo", &["deny", "--version"]).is_none() {
        println!("skipped: cargo-deny is not installed (cargo install cargo-deny --locked)");
        return Ok(());
    }
    run::cargo(&["deny", "--all-features", "check"])?;
    for manifest in other_workspaces() {
        run::cargo(&[
            "deny",
            "--manifest-path",
            &manifest,
            "check",
            "--config",
            "deny.toml",
        ])?;
    }
    Ok(())
}
