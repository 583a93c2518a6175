//! What the console's commands take.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use crawler_access::{Role, UserName};
use crawler_protocol::RobotId;
use crawler_system::cli_error::{CliError, OrSay as _};

use crate::config::Place;

/// Accounts of people.
#[derive(Debug, Clone, Args)]
pub struct UserArgs {
    /// What to do.
    #[command(subcommand)]
    pub task: UserTask,
    #[command(flatten)]
    #[allow(missing_docs)] // a doc comment here would become the command's description
    pub place: Place,
}

/// What can be done with accounts.
#[derive(Debug, Clone, Subcommand)]
pub enum UserTask {
    /// Adds an account; asks for its password, or reads it from standard input
    Add {
        /// Name of the account: a-z, then a-z, 0-9, dot, underscore, hyphen
        name: UserName,
        /// viewer, operator or admin
        #[arg(long, default_value_t = Role::Viewer)]
        role: Role,
    },
    /// Lists accounts
    List,
    /// Sets a new password and ends the account's sessions
    Passwd {
        /// Name of the account
        name: UserName,
    },
    /// Gives an account another role
    Role {
        /// Name of the account
        name: UserName,
        /// viewer, operator or admin
        role: Role,
    },
    /// Locks an account and ends its sessions
    Disable {
        /// Name of the account
        name: UserName,
    },
    /// Unlocks an account
    Enable {
        /// Name of the account
        name: UserName,
    },
    /// Removes an account and ends its sessions; what it did stays in the audit log
    Remove {
        /// Name of the account
        name: UserName,
    },
    /// Prints a link with which a person sets their own password, once
    Invite {
        /// Name of the account, new or known; without it the person chooses
        name: Option<UserName>,
        /// viewer, operator or admin; who has an account keeps its role [default: viewer]
        #[arg(long)]
        role: Option<Role>,
        /// For how many hours the link is valid
        #[arg(long, default_value_t = 24, value_name = "N",
              value_parser = clap::value_parser!(u16).range(1..=720))]
        hours: u16,
    },
}

/// Credentials of robots.
#[derive(Debug, Clone, Args)]
pub struct RobotArgs {
    /// What to do.
    #[command(subcommand)]
    pub task: RobotTask,
    #[command(flatten)]
    #[allow(missing_docs)] // a doc comment here would become the command's description
    pub place: Place,
}

/// Whose credential.
#[derive(Debug, Clone, Args)]
#[group(required = true, multiple = false)]
pub struct Whose {
    /// Id of the robot: a-z, 0-9 and hyphen
    #[arg(value_parser = robot_id, value_name = "ROBOT")]
    pub robot: Option<RobotId>,
    /// A process of simulated robots (`terracrawler sim`) instead of one robot
    #[arg(long, value_parser = robot_id, value_name = "NAME")]
    pub simulator: Option<RobotId>,
    /// A machine of federated learning (`terracrawler learn-node`) instead of one robot
    #[arg(long, value_parser = robot_id, value_name = "NAME")]
    pub learner: Option<RobotId>,
}

fn robot_id(text: &str) -> Result<RobotId, CliError> {
    RobotId::new(text)
        .or_say(|_| format!("`{text}` is not a robot's id: 1 to 32 of a-z, 0-9 and -"))
}

/// What can be done with credentials of robots.
#[derive(Debug, Clone, Subcommand)]
pub enum RobotTask {
    /// Makes a robot's secret and prints it, once; an earlier one of that robot is void from then on
    Enroll {
        #[command(flatten)]
        #[allow(missing_docs)] // a doc comment here would become the command's description
        whose: Whose,
        /// Where robots find the broker, HOST or HOST:PORT [default: from the options of the server]
        #[arg(long, value_name = "ADDRESS")]
        address: Option<String>,
    },
    /// Lists credentials of robots, simulators and learners
    List,
    /// Makes a robot's secret void
    Revoke {
        #[command(flatten)]
        #[allow(missing_docs)] // a doc comment here would become the command's description
        whose: Whose,
    },
}

/// The log of who did what.
#[derive(Debug, Clone, Args)]
pub struct AuditArgs {
    /// What to do.
    #[command(subcommand)]
    pub task: AuditTask,
    #[command(flatten)]
    #[allow(missing_docs)] // a doc comment here would become the command's description
    pub place: Place,
}

/// What can be done with the audit log. Nothing changes it.
#[derive(Debug, Clone, Subcommand)]
pub enum AuditTask {
    /// Prints entries, the newest first
    List {
        /// At most so many
        #[arg(long, default_value_t = 50, value_name = "N",
              value_parser = clap::value_parser!(u32).range(1..=10_000))]
        limit: u32,
        /// Only entries before this number
        #[arg(long, value_name = "NUMBER")]
        before: Option<u64>,
        /// Only what this person or part did
        #[arg(long, value_name = "NAME")]
        who: Option<String>,
    },
    /// Checks the chain of hashes from the first entry to the last
    Verify,
    /// Writes every entry as one JSON object per line
    Export {
        /// A new file; without it, standard output
        file: Option<PathBuf>,
    },
}

/// A file and where the records are.
#[derive(Debug, Clone, Args)]
pub struct BackupArgs {
    /// A new file
    pub file: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)] // a doc comment here would become the command's description
    pub place: Place,
}

/// A file and where its contents go.
#[derive(Debug, Clone, Args)]
pub struct RestoreArgs {
    /// A file made by `terracrawler backup`
    pub file: PathBuf,
    /// Puts aside what the data directory, and the database, hold now
    #[arg(long)]
    pub replace: bool,
    #[command(flatten)]
    #[allow(missing_docs)] // a doc comment here would become the command's description
    pub place: Place,
}
