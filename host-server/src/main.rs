//! The binary `terracrawler`.

use std::process::ExitCode;

use clap::Parser as _;
use crawler_server::config::{Cli, Settings};
use crawler_server::run;

fn main() -> ExitCode {
    let settings = match Settings::resolve(Cli::parse(), std::env::vars_os()) {
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
