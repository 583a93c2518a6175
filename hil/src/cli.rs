//! The command line.

use std::error::Error;
use std::fmt;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use crawler_hil::BrokerUrl;
use crawler_protocol::{Fleet, IdError, RobotId};

/// Hardware in the loop: a conformance suite for any robot, and emulated boards.
#[derive(Debug, Parser)]
#[command(name = "hil", version)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Run the conformance suite on one robot: put it on blocks first, its wheels will turn
    Suite(Box<SuiteArguments>),
    /// Run emulated boards under QEMU until Ctrl-C
    Emulate(Box<EmulateArguments>),
}

#[derive(Debug, Args)]
pub(crate) struct SuiteArguments {
    /// Id of the robot
    #[arg(long, value_name = "ID", value_parser = robot)]
    pub(crate) robot: Option<RobotId>,
    /// Its broker, `mqtt://[user:password@]host[:port]`
    #[arg(long, value_name = "URL", default_value = "mqtt://127.0.0.1:1883")]
    pub(crate) broker: BrokerUrl,
    /// Root topic of its fleet
    #[arg(long, value_name = "NAME", default_value = "swarm", value_parser = fleet)]
    pub(crate) fleet: Fleet,
    /// Leave out the cases that set wheels in motion
    #[arg(long)]
    pub(crate) no_motion: bool,
    /// Run this case alone; may be given several times
    #[arg(long = "case", value_name = "NAME")]
    pub(crate) only: Vec<String>,
    /// Write the report as JSON
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
    /// List the cases and end
    #[arg(long)]
    pub(crate) list: bool,
}

#[derive(Debug, Args)]
pub(crate) struct EmulateArguments {
    /// How many: virt-01, virt-02, …
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=64))]
    pub(crate) robots: u16,
    /// Their broker, `mqtt://[user:password@]host[:port]`
    #[arg(long, value_name = "URL", default_value = "mqtt://127.0.0.1:1883")]
    pub(crate) broker: BrokerUrl,
    /// Root topic of their fleet
    #[arg(long, value_name = "NAME", default_value = "swarm", value_parser = fleet)]
    pub(crate) fleet: Fleet,
    /// Directory of their flash, so that parameters and boot counts outlive the emulators
    #[arg(long, value_name = "DIR")]
    pub(crate) flash: Option<PathBuf>,
    /// The program, an ELF file [default: that of the environment variable `CRAWLER_VIRT_ELF`, or what `cargo xtask image --board virt` built]
    #[arg(long, value_name = "FILE")]
    pub(crate) image: Option<PathBuf>,
    /// Public key, in PEM, of releases that they take; may be given twice. Without any they take none
    #[arg(long = "release-key", value_name = "FILE")]
    pub(crate) release_keys: Vec<PathBuf>,
    /// Another boot argument for each of them, like `fault=ranger-dead`; may be given several times
    #[arg(long = "boot", value_name = "KEY=VALUE")]
    pub(crate) boot: Vec<String>,
}

/// Why a text is not the name of a thing, and what is.
#[derive(Debug)]
struct BadName {
    what: &'static str,
    cause: IdError,
}

impl fmt::Display for BadName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { what, cause } = self;
        write!(f, "{cause}: {what} is 1 to 32 of a-z, 0-9 and -")
    }
}

impl Error for BadName {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        Some(&self.cause)
    }
}

fn robot(text: &str) -> Result<RobotId, BadName> {
    let what = "a robot id";
    RobotId::new(text).map_err(|cause| BadName { what, cause })
}

fn fleet(text: &str) -> Result<Fleet, BadName> {
    let what = "a fleet";
    Fleet::new(text).map_err(|cause| BadName { what, cause })
}
