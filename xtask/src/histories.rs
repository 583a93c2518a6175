//! The same worlds on every target: a history is the same, bit for bit, whatever computes it.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::cross;
use crate::run::{self, Failure, Outcome};
use crate::tools::{NODE, QEMU_USER, RISCV_LINKER, Tool};

/// The program that prints histories.
const PROGRAM: &str = "crawler-world-history";

/// Starts a WebAssembly module in Node.js.
const START: &str = "\
import { WASI } from 'node:wasi';
import { readFile } from 'node:fs/promises';
const wasi = new WASI({ version: 'preview1', args: ['history'], returnOnExit: true });
const module = await WebAssembly.compile(await readFile(process.argv[2]));
const instance = await WebAssembly.instantiate(module, wasi.getImportObject());
process.exitCode = wasi.start(instance);
";

/// Somewhere else than here.
struct Target {
    triple: &'static str,
    /// What it takes besides a std.
    tools: &'static [&'static Tool],
    /// Name of the program, after its stem.
    suffix: &'static str,
    /// The command that runs it.
    start: fn(&Path) -> Outcome<Command>,
}

const TARGETS: [Target; 2] = [
    Target {
        triple: "wasm32-wasip1",
        tools: &[&NODE],
        suffix: ".wasm",
        start: in_node,
    },
    Target {
        triple: "riscv64gc-unknown-linux-gnu",
        tools: &[&RISCV_LINKER, &QEMU_USER],
        suffix: "",
        start: in_qemu,
    },
];

/// Compares the histories of this machine, on one thread and on several, with those of every
/// target that can be built and run here. Says how to get those that cannot.
///
/// # Errors
/// When two histories differ, with the first line that does, or a program cannot be built.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    if let Some(argument) = arguments.first() {
        return Err(Failure(format!("'{argument}' is not understood")));
    }
    let program = build(None)?.join(format!("{PROGRAM}{}", std::env::consts::EXE_SUFFIX));
    let here = output(Command::new(&program))?;
    let seconds = here.lines().filter(|line| line.starts_with("second "));
    println!("here: {} seconds of history", seconds.count());
    let mut threads = Command::new(&program);
    threads.arg("3");
    compare("here, on 3 threads", &here, &output(threads)?)?;
    for target in &TARGETS {
        if let Err(Failure(reason)) = available(target) {
            println!("{}: skipped: {reason}", target.triple);
            continue;
        }
        let folder = build(Some(target.triple))?;
        let program = folder.join(format!("{PROGRAM}{}", target.suffix));
        compare(target.triple, &here, &output((target.start)(&program)?)?)?;
    }
    Ok(())
}

fn available(target: &Target) -> Outcome {
    for tool in target.tools {
        tool.require()?;
    }
    if cross::has_std(target.triple) {
        Ok(())
    } else {
        Err(Failure(format!(
            "no std is installed for it: rustup target add {}",
            target.triple
        )))
    }
}

/// Builds the program; returns the folder that it lies in.
fn build(triple: Option<&str>) -> Outcome<PathBuf> {
    let folder = run::root().join(run::target_dir());
    let Some(triple) = triple else {
        run::build_beside_tests(&["--bin", PROGRAM])?;
        return Ok(folder.join("debug"));
    };
    let line = "build --locked --quiet --package";
    let mut arguments: Vec<&str> = line.split(' ').collect();
    arguments.extend([PROGRAM, "--target", triple]);
    let variables = [
        (
            "CARGO_TARGET_RISCV64GC_UNKNOWN_LINUX_GNU_LINKER",
            RISCV_LINKER.program,
        ),
        // Nor may optimisation change a history; and to optimise takes longer than it saves.
        ("CARGO_PROFILE_DEV_OPT_LEVEL", "0"),
    ];
    run::run_with_env(&run::root(), &run::cargo_program(), &arguments, &variables)?;
    Ok(folder.join(triple).join("debug"))
}

fn in_node(program: &Path) -> Outcome<Command> {
    let script = program.with_extension("mjs");
    fs::write(&script, START)
        .map_err(|error| Failure(format!("cannot write {}: {error}", script.display())))?;
    let mut command = Command::new(NODE.program);
    let arguments: [OsString; 3] = ["--no-warnings".into(), script.into(), program.into()];
    command.args(arguments);
    Ok(command)
}

#[allow(clippy::unnecessary_wraps)] // As the others.
fn in_qemu(program: &Path) -> Outcome<Command> {
    let mut command = Command::new(QEMU_USER.program);
    // Where Debian's linker for it has the C library.
    command.args(["-L", "/usr/riscv64-linux-gnu"]).arg(program);
    Ok(command)
}

fn output(command: Command) -> Outcome<String> {
    let shown = format!("{command:?}");
    run::output_of(command).ok_or_else(|| Failure(format!("{shown} failed")))
}

/// # Errors
/// Names the first line that differs.
fn compare(name: &str, here: &str, there: &str) -> Outcome {
    if here == there {
        println!("{name}: the same, bit for bit");
        return Ok(());
    }
    let (mut ours, mut theirs) = (here.lines(), there.lines());
    let mut world = "";
    loop {
        match (ours.next(), theirs.next()) {
            (Some(a), Some(b)) if a == b => {
                if a.starts_with("world ") {
                    world = a;
                }
            }
            (a, b) => {
                let (a, b) = (a.unwrap_or("nothing"), b.unwrap_or("nothing"));
                return Err(Failure(format!(
                    "{name} differs: in {world}, here `{a}`, there `{b}`"
                )));
            }
        }
    }
}
