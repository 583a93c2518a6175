//! The command line.

#[cfg(test)]
mod tests;

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Parser, Subcommand};
use crawler_experiments::evaluate::EvaluateArgs;
use crawler_learning::gym::GymArgs;
use crawler_learning::train::TrainArgs;

use crate::config::{
    Common, ConfigError, Layer, RobotOptions, Role, ServerOptions, Settings, WorkerOptions,
};
use crate::console::{
    AuditArgs, BackupArgs, MosquittoArgs, RestoreArgs, RobotArgs, Task, UserArgs,
};
use crate::learn_node::LearnNodeArgs;
use crate::release::{ReleaseArgs, ReleaseTask};
use crate::replay::ReplayArgs;
use crate::rollout::RolloutArgs;
use crate::twin::TwinArgs;

/// A swarm of robots, simulated or real: broker, API, control room.
///
/// Every option of `up`, `serve`, `sim`, `worker` and `doctor` is also an environment variable (`--log-format` is
/// `TERRACRAWLER_LOG_FORMAT`) and a key of the file given by `--config` (`log_format`). The command line
/// wins over the environment, that over the file.
#[derive(Debug, Parser)]
#[command(name = "terracrawler", version)]
pub struct Cli {
    /// What to run.
    #[command(subcommand)]
    pub command: Command,
}

/// What to run.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Server, broker and simulated robots in one process
    Up {
        #[command(flatten)]
        #[allow(missing_docs)] // a doc comment here would become the command's description
        common: Common,
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        server: ServerOptions,
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        robots: RobotOptions,
    },
    /// Server and broker, without robots
    Serve {
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        common: Common,
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        server: ServerOptions,
    },
    /// Simulated robots alone, on any MQTT 5 broker
    Sim {
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        common: Common,
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        robots: RobotOptions,
    },
    /// Works on experiments of servers with one database, beside them and other workers
    Worker(WorkerOptions),
    /// Runs a scenario on many seeds and tells what comes of it
    Evaluate(Box<EvaluateArgs>),
    /// Trains a policy for robots, from nothing
    Train(Box<TrainArgs>),
    /// Learns in worlds of its own for a training of the fleet, together with other nodes
    LearnNode(Box<LearnNodeArgs>),
    /// Worlds to learn in for another program, over standard input and output; `python/` is one
    Gym(GymArgs),
    /// Runs a recording, or a seed, through the program once more
    Replay(Box<ReplayArgs>),
    /// Models of robots: identifies their bodies from drives, and certifies them
    Twin(Box<TwinArgs>),
    /// Signs programs and models for updates, verifies them, and adds them to those of a server
    Release(ReleaseArgs),
    /// Brings releases to robots, over the API of a running server
    Rollout(RolloutArgs),
    /// Accounts of people
    User(UserArgs),
    /// Credentials of robots, simulators and learners
    Robot(RobotArgs),
    /// Who did what
    Audit(AuditArgs),
    /// Copies records, keys and certificates to one file, also beside a running server
    Backup(BackupArgs),
    /// Puts a backup back
    Restore(RestoreArgs),
    /// Configurations for the broker Mosquitto, on sites and in the middle
    Mosquitto(MosquittoArgs),
    /// Checks everything a server needs, and says what to do
    Doctor {
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        common: Common,
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        server: ServerOptions,
    },
}

impl Cli {
    /// What the command line, `environment` and the file that either of them names come to.
    ///
    /// `environment` is every variable of the process; those without our prefix are ignored.
    ///
    /// # Errors
    /// [`ConfigError`] when a source cannot be read or holds something unknown or unusable, and for
    /// commands that have options of their own.
    pub fn settings(
        self,
        environment: impl IntoIterator<Item = (OsString, OsString)>,
    ) -> Result<Settings, ConfigError> {
        let (role, arguments, config) = self.into_layer()?;
        Settings::resolve(role, arguments, config, environment)
    }

    fn into_layer(self) -> Result<(Role, Layer, Option<PathBuf>), ConfigError> {
        let (role, common, server, robots) = match self.command {
            Command::Up {
                common,
                server,
                robots,
            } => (Role::Up, common, Some(server), Some(robots)),
            // The doctor looks at a server with these options.
            Command::Serve { common, server } | Command::Doctor { common, server } => {
                (Role::Serve, common, Some(server), None)
            }
            Command::User(UserArgs { place, .. })
            | Command::Robot(RobotArgs { place, .. })
            | Command::Audit(AuditArgs { place, .. })
            | Command::Backup(BackupArgs { place, .. })
            | Command::Restore(RestoreArgs { place, .. }) => {
                return Ok((Role::Serve, place.layer(), place.config));
            }
            Command::Mosquitto(args) => (Role::Sim, args.task.common(), None, None),
            Command::LearnNode(args) => (Role::Sim, args.common, None, None),
            Command::Sim { common, robots } => (Role::Sim, common, None, Some(robots)),
            Command::Worker(options) => {
                let (layer, config) = options.layer();
                return Ok((Role::Worker, layer, config));
            }
            Command::Evaluate(_) => {
                return Err(ConfigError::Conflict("`evaluate` has options of its own"));
            }
            Command::Train(_) => {
                return Err(ConfigError::Conflict("`train` has options of its own"));
            }
            Command::Gym(_) => {
                return Err(ConfigError::Conflict("`gym` has options of its own"));
            }
            Command::Replay(_) => {
                return Err(ConfigError::Conflict("`replay` has options of its own"));
            }
            Command::Twin(args) => {
                let Some(live) = args.live() else {
                    return Err(ConfigError::Conflict("`twin` has options of its own"));
                };
                let remote = live.remote();
                return Ok((Role::Serve, remote.layer(), remote.config.clone()));
            }
            Command::Release(ReleaseArgs {
                task: ReleaseTask::Add(args),
            }) => return Ok((Role::Serve, args.layer(), args.place.config)),
            Command::Rollout(RolloutArgs { remote, .. }) => {
                return Ok((Role::Serve, remote.layer(), remote.config));
            }
            Command::Release(_) => {
                return Err(ConfigError::Conflict("`release` has options of its own"));
            }
        };
        let (mut layer, config) = common.layer();
        if let Some(server) = server {
            server.fill(&mut layer);
        }
        if let Some(robots) = robots {
            robots.fill(&mut layer);
        }
        Ok((role, layer, config))
    }
}

impl Command {
    /// What of it the console does; `None` for commands that are not its own.
    #[must_use]
    pub fn console(&self) -> Option<Task> {
        match self {
            Self::User(args) => Some(Task::User(args.clone())),
            Self::Robot(args) => Some(Task::Robot(args.clone())),
            Self::Audit(args) => Some(Task::Audit(args.clone())),
            Self::Backup(args) => Some(Task::Backup(args.clone())),
            Self::Restore(args) => Some(Task::Restore(args.clone())),
            Self::Mosquitto(args) => Some(Task::Mosquitto(args.clone())),
            Self::Release(ReleaseArgs {
                task: ReleaseTask::Add(args),
            }) => Some(Task::AddRelease(args.clone())),
            Self::Rollout(args) => Some(Task::Rollout(args.clone())),
            Self::Twin(args) => args.live().map(|_| Task::Twin(args.clone())),
            Self::LearnNode(args) => Some(Task::LearnNode(args.clone())),
            Self::Doctor { .. } => Some(Task::Doctor),
            Self::Up { .. }
            | Self::Serve { .. }
            | Self::Sim { .. }
            | Self::Worker(_)
            | Self::Evaluate(_)
            | Self::Train(_)
            | Self::Gym(_)
            | Self::Replay(_)
            | Self::Release(_) => None,
        }
    }
}
