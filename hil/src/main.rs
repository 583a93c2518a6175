//! The bench's commands: `hil suite` and `hil emulate`.

mod cli;
mod emulate;

use std::process::ExitCode;

use clap::Parser;
use cli::{Cli, Command, SuiteArguments};
use crawler_hil::suite::{self, Bench, BenchError, CASES, Options, Target};
use crawler_protocol::Action;

/// Everything that keeps the suite, or an emulator, from being run.
const CANNOT: u8 = 2;
/// As a shell reports a program that Ctrl-C has ended.
const INTERRUPTED: u8 = 130;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    let runtime = match runtime {
        Ok(runtime) => runtime,
        Err(error) => return cannot(&error),
    };
    runtime.block_on(async {
        match cli.command {
            Command::Suite(arguments) => Box::pin(suite(*arguments)).await,
            Command::Emulate(arguments) => emulate::emulate(&arguments).await,
        }
    })
}

fn cannot(error: &dyn std::fmt::Display) -> ExitCode {
    eprintln!("hil: {error}");
    ExitCode::from(CANNOT)
}

async fn suite(arguments: SuiteArguments) -> ExitCode {
    if arguments.list {
        for case in CASES {
            let motion = if case.motion { "moves" } else { "" };
            println!("{:<18} {motion:<6} {}", case.name, case.shows);
        }
        return ExitCode::SUCCESS;
    }
    let Some(robot) = arguments.robot else {
        return cannot(&"which robot? --robot ID");
    };
    let target = Target {
        broker: arguments.broker,
        fleet: arguments.fleet,
        robot,
    };
    let options = Options {
        no_motion: arguments.no_motion,
        only: arguments.only,
    };
    println!("{} of {} at {}", target.robot, target.fleet, target.broker);
    let result = tokio::select! {
        result = suite::run(&target, &options, |case| println!("{case}")) => result,
        _ = tokio::signal::ctrl_c() => return Box::pin(interrupted(target)).await,
    };
    let report = match result {
        Ok(report) => report,
        Err(error) => return cannot(&error),
    };
    println!("{report}");
    if let Some(file) = arguments.json {
        let text = format!("{:#}\n", report.to_json());
        if let Err(error) = std::fs::write(&file, text) {
            return cannot(&format!("{}: {error}", file.display()));
        }
    }
    if report.failed() == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

/// Somebody wants it to end: perhaps because of what the robot does.
async fn interrupted(target: Target) -> ExitCode {
    let stopped = async {
        let mut bench = Bench::open(target).await?;
        bench.ask(Action::Stop).await?;
        bench.close().await;
        Ok::<(), BenchError>(())
    };
    match Box::pin(stopped).await {
        Ok(()) => eprintln!(
            "hil: interrupted; the robot is told to stop, parameters are as the last case left them"
        ),
        Err(error) => {
            eprintln!("hil: interrupted, and the robot could not be told to stop: {error}");
        }
    }
    ExitCode::from(INTERRUPTED)
}
