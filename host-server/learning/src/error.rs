//! Why a run ends without a result.

use std::error::Error;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use crawler_federated::MessageError;
use crawler_federated::coordinator::SettingsError;
use crawler_policy::ppo::WeightsError;
use crawler_policy::{CheckpointError, ConfigError, Diverged};

use crate::export::Unfit;

/// Why a run ends without a result.
#[derive(Debug)]
pub enum RunError {
    /// A file.
    File(PathBuf, io::Error),
    /// An option.
    Config(ConfigError),
    /// The checkpoint that is there.
    Checkpoint(PathBuf, CheckpointError),
    /// The loss.
    Diverged(Diverged),
    /// The policy is none for robots.
    Unfit(Unfit),
    /// The checkpoint of a run of many nodes that is there.
    Rounds(PathBuf, crawler_federated::CheckpointError),
    /// An option of a run of many nodes.
    Settings(SettingsError),
    /// A plan that no node could learn by.
    Plan(MessageError),
    /// Weights of other networks.
    Weights(WeightsError),
}

impl fmt::Display for RunError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path, error) => write!(f, "{}: {error}", path.display()),
            Self::Config(error) => error.fmt(f),
            Self::Checkpoint(path, error) => other_folder(f, path, error),
            Self::Rounds(path, error) => other_folder(f, path, error),
            Self::Diverged(error) => error.fmt(f),
            Self::Unfit(error) => error.fmt(f),
            Self::Settings(error) => error.fmt(f),
            Self::Plan(error) => error.fmt(f),
            Self::Weights(error) => error.fmt(f),
        }
    }
}

fn other_folder(f: &mut fmt::Formatter<'_>, path: &Path, error: &dyn Error) -> fmt::Result {
    let path = path.display();
    write!(
        f,
        "{path}: {error}; with other options a run needs a folder of its own"
    )
}

impl Error for RunError {}

impl From<ConfigError> for RunError {
    fn from(error: ConfigError) -> Self {
        Self::Config(error)
    }
}

impl From<Diverged> for RunError {
    fn from(error: Diverged) -> Self {
        Self::Diverged(error)
    }
}

impl From<SettingsError> for RunError {
    fn from(error: SettingsError) -> Self {
        Self::Settings(error)
    }
}

impl From<MessageError> for RunError {
    fn from(error: MessageError) -> Self {
        Self::Plan(error)
    }
}

impl From<WeightsError> for RunError {
    fn from(error: WeightsError) -> Self {
        Self::Weights(error)
    }
}

impl From<Unfit> for RunError {
    fn from(error: Unfit) -> Self {
        Self::Unfit(error)
    }
}
