//! What `terracrawler twin` takes.

use std::path::PathBuf;

use crawler_protocol::RobotId;

use crate::rollout::RemoteArgs;

/// What `terracrawler twin` takes.
#[derive(Debug, Clone, clap::Args)]
#[command(
    after_help = "calibrate and import end with 0 and a certificate when a part of the drive that was held out \
    is predicted better than by the nominal body, and than by the certificate before; with 1 and the reason when \
    not; with 2 when a file cannot be used. follow ends with 1 when it names a fault. gap of a server ends with 1 when no \
    robot has driven enough."
)]
pub struct TwinArgs {
    /// What to do
    #[command(subcommand)]
    pub task: TwinTask,
}

/// What a running server is asked.
#[derive(Debug, Clone, Copy)]
pub enum Live<'a> {
    /// To calibrate a robot.
    Calibrate(&'a CalibrateArgs),
    /// How far bodies and robots are apart.
    Gap(&'a GapArgs),
}

impl Live<'_> {
    /// Which server that is.
    #[must_use]
    pub const fn remote(&self) -> &RemoteArgs {
        match self {
            Self::Calibrate(args) => &args.remote,
            Self::Gap(args) => &args.remote,
        }
    }
}

impl TwinArgs {
    /// What a running server is asked, if that is meant.
    #[must_use]
    pub fn live(&self) -> Option<Live<'_>> {
        match &self.task {
            TwinTask::Calibrate(args) if args.live.is_some() => Some(Live::Calibrate(args)),
            TwinTask::Gap(args) if args.scenario.is_empty() => Some(Live::Gap(args)),
            _ => None,
        }
    }
}

/// What to do.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum TwinTask {
    /// Prints the drive to calibrate on, as a scenario
    Script,
    /// Identifies the body of a robot from a recording, or from a drive where it stands (--live)
    Calibrate(Box<CalibrateArgs>),
    /// Identifies the body of a robot from a table of comma-separated values
    Import(ImportArgs),
    /// Lets a twin follow a robot through a recording: what it foretells, and what is wrong with the robot
    Follow(FollowArgs),
    /// How far bodies and robots of a running server are apart; with --scenario, how alike scenarios are in two worlds
    Gap(Box<GapArgs>),
    /// Prints a certificate for people
    Show {
        /// Certificate
        #[arg(value_name = "CERTIFICATE")]
        file: PathBuf,
    },
    /// Prints a certificate as parameters of a scenario
    Export {
        /// Certificate
        #[arg(value_name = "CERTIFICATE")]
        file: PathBuf,
    },
}

/// What `twin calibrate` takes.
#[derive(Debug, Clone, clap::Args)]
pub struct CalibrateArgs {
    /// Recording of the drive
    #[arg(
        value_name = "FILE",
        required_unless_present = "live",
        conflicts_with = "live"
    )]
    pub file: Option<PathBuf>,
    /// Has a running server calibrate this robot where it stands; without --confirmed it only says whether it may
    #[arg(long, value_name = "ROBOT", conflicts_with_all = ["robot", "validate", "previous", "out"])]
    pub live: Option<RobotId>,
    /// The floor was looked at: it is free, and nobody is within a metre of it
    #[arg(long, requires = "live")]
    pub confirmed: bool,
    /// So many metres are free around the robot, from its middle to each side of a square; fences hold beside it
    #[arg(long, value_name = "METRES", requires = "live")]
    pub around: Option<f64>,
    /// Which robot of it [default: the only one]
    #[arg(long, value_name = "ID")]
    pub robot: Option<String>,
    /// Recording to validate on, in place of the end of the drive
    #[arg(long, value_name = "FILE")]
    pub validate: Option<PathBuf>,
    /// What is the same for recordings and tables.
    #[command(flatten)]
    pub common: Common,
    #[command(flatten)]
    #[allow(missing_docs)] // a doc comment here would become the command's description
    pub remote: RemoteArgs,
}

/// What `twin gap` takes.
#[derive(Debug, Clone, clap::Args)]
pub struct GapArgs {
    /// File for the report: .json has all numbers, .md and .html are for people
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Runs this scenario, by name or TOML file, in the simulator and in a reference reality; several times for several
    #[arg(long, value_name = "SCENARIO", conflicts_with = "server")]
    pub scenario: Vec<String>,
    /// Another value for a key of the scenario in the reference reality [default: randomisation=wild]
    #[arg(long, value_name = "KEY=VALUE", requires = "scenario")]
    pub reference: Vec<String>,
    /// Another value for a key of the scenario in both worlds
    #[arg(long, value_name = "KEY=VALUE", requires = "scenario")]
    pub set: Vec<String>,
    /// Difficulty from 0 to 1, or the name of one of the scenario's levels; several times for several
    #[arg(long, value_name = "LEVEL", requires = "scenario")]
    pub difficulty: Vec<String>,
    /// How many robots [default: those of the scenario]
    #[arg(long, value_name = "N", requires = "scenario")]
    pub robots: Option<u32>,
    /// How many seeds of each scenario
    #[arg(long, value_name = "N", default_value_t = 10, requires = "scenario", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub seeds: u64,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 1, requires = "scenario")]
    pub seed: u64,
    /// Worlds that run at the same time [default: one for each processor]
    #[arg(long, value_name = "N", requires = "scenario", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    #[command(flatten)]
    #[allow(missing_docs)] // a doc comment here would become the command's description
    pub remote: RemoteArgs,
}

/// What `twin follow` takes.
#[derive(Debug, Clone, clap::Args)]
pub struct FollowArgs {
    /// Recording
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Which robot of it [default: the only one]
    #[arg(long, value_name = "ID")]
    pub robot: Option<String>,
    /// Certificate of the robot [default: the nominal body]
    #[arg(long, value_name = "CERTIFICATE")]
    pub certificate: Option<PathBuf>,
}

/// What `twin import` takes.
#[derive(Debug, Clone, clap::Args)]
pub struct ImportArgs {
    /// Table of the drive; `docs/twin.md` has its columns
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Which robot it is of
    #[arg(long, value_name = "ID")]
    pub robot: String,
    /// Table to validate on, in place of the end of the drive
    #[arg(long, value_name = "FILE")]
    pub validate: Option<PathBuf>,
    /// What is the same for recordings and tables.
    #[command(flatten)]
    pub common: Common,
}

/// What is the same for recordings and tables.
#[derive(Debug, Clone, clap::Args)]
pub struct Common {
    /// Certificate that the new one has to be better than
    #[arg(long, value_name = "CERTIFICATE")]
    pub previous: Option<PathBuf>,
    /// What the robot drove on, in words
    #[arg(long, value_name = "TEXT")]
    pub floor: Option<String>,
    /// Write the certificate to this file
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}
