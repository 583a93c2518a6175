//! Where the records of a server are.

use std::path::PathBuf;

use clap::Args;

use super::{EngineUrl, Layer, Postgres};

/// Where the records are. Everything else comes from the environment and the file, as for `serve`.
#[derive(Debug, Clone, Default, Args)]
pub struct Place {
    /// Data directory of the server [default: data]
    #[arg(long, value_name = "DIR", global = true)]
    pub data: Option<PathBuf>,
    /// Database of the server, where it has one: postgres://… [default: a file in the data directory]
    #[arg(long, value_name = "URL", global = true)]
    pub database: Option<EngineUrl<Postgres>>,
    /// TOML file with the server's options
    #[arg(long, value_name = "FILE", global = true)]
    pub config: Option<PathBuf>,
}

impl Place {
    /// The options that it sets.
    pub(crate) fn layer(&self) -> Layer {
        Layer {
            data: self.data.clone(),
            database: self.database.clone(),
            ..Layer::default()
        }
    }
}
