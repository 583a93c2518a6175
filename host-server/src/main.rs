//! The binary `terracrawler`.

use std::process::ExitCode;

use clap::Parser as _;
use crawler_server::config::{Cli, Command, Settings};
use crawler_server::{console, evaluate, replay, run};

fn main() -> ExitCode {
    let cli = Cli::parse();
    match &cli.command {
        Command::Evaluate(args) => return evaluate::run(args),
        Command::Replay(args) => return replay::run(args),
        Command::User(_)
        | Command::Robot(_)
        | Command::Audit(_)
        | Command::Backup(_)
        | Command::Restore(_)
        | Command::Mosquitto(_)
        | Command::Doctor { .. } => return console::run(cli),
        Command::Up { .. } | Command::Serve { .. } | Command::Sim { .. } => {}
    }
    let settings = match Settings::resolve(cli, std::env::vars_os()) {
        Ok(settings) => settings,
        Err(error) => {
            eprintln!("terracrawler: {error}");
            return ExitCode::from(2);
        }
    };
    match run::run(&settings) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("terracrawler: {error}");
            ExitCode::FAILURE
        }
    }
}
