//! Every command of the repository: `cargo xtask` lists them.

mod architecture;
mod bench;
mod bench_server;
mod bench_sim;
mod bench_vision;
mod beside;
mod boards;
mod bogo;
mod check_s3;
mod counts;
mod counts_simulator;
mod cross;
mod dataset;
mod detector;
mod docs;
mod files;
mod flash;
mod fuzz;
mod fuzz_api;
mod hil;
mod histories;
mod image;
mod mixed;
mod mutants;
mod paho;
mod python;
mod report;
mod run;
mod server;
mod sight;
mod size;
mod suites;
mod test;
mod tools;
mod ui;
mod up;

use std::process::ExitCode;

use run::{Failure, Outcome};

/// One command: its name, what follows it, what it does.
struct Task {
    name: &'static str,
    arguments: &'static str,
    about: &'static str,
    run: fn(&[String]) -> Outcome,
}

const TASKS: &[Task] = &[
    Task {
        name: "up",
        arguments: "[OPTIONS]",
        about: "build the control room and start server, broker and 50 simulated robots (`cargo up`)",
        run: up::command,
    },
    Task {
        name: "setup",
        arguments: "",
        about: "install the tools that tests need, or say which are missing and how to get them",
        run: |_| tools::setup(),
    },
    Task {
        name: "check",
        arguments: "",
        about: "at every save: format, lints, types, control room, tests of the robot program",
        run: test::check,
    },
    Task {
        name: "test",
        arguments: "[--deep | [--repeat N] [--under-load] [--one-core] [SUITE]...]",
        about: "everything a change must pass; with --deep what takes hours; or only some tests",
        run: test::command,
    },
    Task {
        name: "ui",
        arguments: "",
        about: "build the control room into host-server/ui/dist",
        run: |_| ui::build(),
    },
    Task {
        name: "image",
        arguments: "--board NAME... [--release-key FILE]...",
        about: "build a board's program and pack it for flash: virt, esp32s3, esp32c3, esp32c6",
        run: image::command,
    },
    Task {
        name: "flash",
        arguments: "--board NAME [--port P] [--release-key FILE]",
        about: "build, flash with espflash, and show the board's log",
        run: flash::command,
    },
    Task {
        name: "check-s3",
        arguments: "",
        about: "type-check the ESP32-S3 board, also without Espressif's compiler",
        run: check_s3::command,
    },
    Task {
        name: "size",
        arguments: "[--board NAME]...",
        about: "flash, RAM and stack of the images, against firmware/boards/budgets.toml",
        run: size::command,
    },
    Task {
        name: "counts",
        arguments: "[--simulator] [--update]",
        about: "instructions of the robot program in QEMU, against docs/counts.md; with --simulator those of simulated robots",
        run: counts::command,
    },
    Task {
        name: "paho",
        arguments: "[DIRECTORY]",
        about: "the interoperability suite of Eclipse Paho, against docs/conformance.md",
        run: paho::command,
    },
    Task {
        name: "python",
        arguments: "",
        about: "types, lints and tests of the package for Python, and tasks of ours beside Gymnasium's own",
        run: python::command,
    },
    Task {
        name: "emulate",
        arguments: "[OPTIONS]",
        about: "run robots in QEMU until Ctrl-C (`cargo xtask emulate --help`)",
        run: hil::emulate,
    },
    Task {
        name: "hil",
        arguments: "--robot ID [OPTIONS]",
        about: "the suite that every robot must pass, on any robot and broker",
        run: hil::suite,
    },
    Task {
        name: "histories",
        arguments: "",
        about: "the same worlds on several threads, in WebAssembly and on RISC-V: same history",
        run: histories::command,
    },
    Task {
        name: "fuzz",
        arguments: "[--seconds N|api [--examples N] [--seed N]]",
        about: "run every fuzz target for N seconds (default 30); or the API from its description",
        run: fuzz::all,
    },
    Task {
        name: "bogo",
        arguments: "--runner FILE",
        about: "the robot's TLS client under BoringSSL's tests, whose runner is that FILE: docs/tls.md",
        run: bogo::command,
    },
    Task {
        name: "mutants",
        arguments: "[--seed N]",
        about: "do the tests notice a wrong program: a sample of mutants of the crates below everything",
        run: mutants::command,
    },
    Task {
        name: "dataset",
        arguments: "[--out DIR] [--seed N] [--train N] [--check N] [--test N]",
        about: "random pictures with the truth about them, for models/detector",
        run: dataset::command,
    },
    Task {
        name: "detector",
        arguments: "train|quantise|convert [OPTIONS]",
        about: "make models/detector anew from the pictures, step by step",
        run: detector::command,
    },
    Task {
        name: "architecture",
        arguments: "",
        about: "draw the crates anew from their manifests: docs/architecture.svg",
        run: architecture::command,
    },
    Task {
        name: "docs",
        arguments: "",
        about: "build the documentation as one book, with mdBook, and follow its links",
        run: docs::command,
    },
    Task {
        name: "bench",
        arguments: "[sim [ROBOTS...]|fleet [--seconds N] [ROBOTS...]|vision [FRAMES]|server [OPTIONS]|chaos [OPTIONS]|disk [OPTIONS]|soak [OPTIONS]|updates [OPTIONS]]",
        about: "measure, and print tables in the form of docs/numbers.md",
        run: bench::all,
    },
];

fn main() -> ExitCode {
    // While it lies where it was started.
    let _ = run::this_program();
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some((name, rest)) = arguments.split_first() else {
        print_tasks();
        return ExitCode::SUCCESS;
    };
    if name == suites::BUSY {
        suites::keep_a_core_busy();
        return ExitCode::SUCCESS;
    }
    if let Some(outcome) = beside::command(name) {
        return told(name, outcome);
    }
    let Some(task) = TASKS.iter().find(|task| task.name == name) else {
        eprintln!("xtask: there is no command '{name}'\n");
        print_tasks();
        return ExitCode::from(2);
    };
    told(name, (task.run)(rest))
}

/// What the shell is told of `outcome`, and the person.
fn told(name: &str, outcome: Outcome) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure(reason)) => {
            eprintln!("xtask {name}: {reason}");
            ExitCode::FAILURE
        }
    }
}

fn print_tasks() {
    println!("cargo xtask COMMAND\n");
    for task in TASKS {
        let call = format!("{} {}", task.name, task.arguments);
        println!("  {call:<24} {}", task.about);
    }
}
