//! The binary `terracrawler`.

use std::process::ExitCode;

use clap::Parser as _;
use crawler_experiments::evaluate;
use crawler_learning::{gym, train};
use crawler_server::cli::{Cli, Command};
use crawler_server::{console, release, replay, run, twin};
use crawler_system::cli_error::CliError;

fn main() -> ExitCode {
    let cli = Cli::parse();
    match &cli.command {
        Command::Twin(args) if args.live().is_none() => return twin::run(args),
        Command::Evaluate(args) => return evaluate::run(args),
        Command::Train(args) => return train::run(args),
        Command::Gym(args) => return gym::run(args),
        Command::Replay(args) => return replay::run(args),
        Command::Release(args) => {
            if let Some(code) = release::run(args) {
                return code;
            }
        }
        _ => {}
    }
    let task = cli.command.console();
    let settings = match cli.settings(std::env::vars_os()) {
        Ok(settings) => settings,
        Err(error) => return CliError::from(error).exits(2).tell(),
    };
    if let Some(task) = task {
        return console::run(task, &settings);
    }
    match run::run(&settings) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => CliError::from(error).tell(),
    }
}
