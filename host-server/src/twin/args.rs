//! What `terracrawler twin` takes.

use std::path::PathBuf;

/// What `terracrawler twin` takes.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "calibrate and import end with 0 and a certificate when a part of the drive that was held out \
    is predicted better than by the nominal body, and than by the certificate before; with 1 and the reason when \
    not; with 2 when a file cannot be used. follow ends with 1 when it names a fault."
)]
pub struct TwinArgs {
    /// What to do
    #[command(subcommand)]
    pub task: TwinTask,
}

/// What to do.
#[derive(Debug, clap::Subcommand)]
pub enum TwinTask {
    /// Prints the drive to calibrate on, as a scenario
    Script,
    /// Identifies the body of a robot from a recording
    Calibrate(CalibrateArgs),
    /// Identifies the body of a robot from a table of comma-separated values
    Import(ImportArgs),
    /// Lets a twin follow a robot through a recording: what it foretells, and what is wrong with the robot
    Follow(FollowArgs),
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
#[derive(Debug, clap::Args)]
pub struct CalibrateArgs {
    /// Recording of the drive
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Which robot of it [default: the only one]
    #[arg(long, value_name = "ID")]
    pub robot: Option<String>,
    /// Recording to validate on, in place of the end of the drive
    #[arg(long, value_name = "FILE")]
    pub validate: Option<PathBuf>,
    /// What is the same for recordings and tables.
    #[command(flatten)]
    pub common: Common,
}

/// What `twin follow` takes.
#[derive(Debug, clap::Args)]
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
#[derive(Debug, clap::Args)]
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
#[derive(Debug, clap::Args)]
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
