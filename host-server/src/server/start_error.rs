//! Why the server does not start.

use std::fmt;
use std::io;
use std::net::SocketAddr;

use crawler_records::RecordsError;

use crawler_accounts::OpenError;
use crawler_server_tls::TlsError;
use crawler_system::cli_error::CliError;
use crawler_system::data::DataError;

/// Why the server does not start, in one line each.
#[derive(Debug)]
#[non_exhaustive]
pub enum StartError {
    /// The data directory cannot be used.
    Data(DataError),
    /// Certificates or keys cannot be used.
    Tls(TlsError),
    /// The records in it cannot be used.
    Records(RecordsError),
    /// An address cannot be listened at.
    Bind {
        /// Whose address.
        what: &'static str,
        /// The option that sets it.
        option: &'static str,
        /// The address.
        address: SocketAddr,
        /// What the operating system said.
        cause: io::Error,
    },
    /// The broker does not answer, or not as a broker does.
    BrokerUnreachable {
        /// Its address.
        broker: String,
        /// What came instead.
        reason: String,
    },
    /// The history cannot be kept in this engine, whether it answers or not.
    Timeseries {
        /// Its address.
        engine: String,
        /// What is wrong.
        reason: String,
    },
    /// Other servers cannot be joined.
    Cache {
        /// Where they were to be met.
        cache: String,
        /// Why not.
        reason: String,
    },
    /// The simulated robots cannot be started.
    Simulation(CliError),
    /// No server has been here: where.
    NoRecords(String),
    /// There are no threads for experiments.
    Experiments(io::Error),
    /// There is no thread for twins.
    Twins(io::Error),
    /// A public key by which releases would be believed cannot be used.
    ReleaseKey(CliError),
    /// Something that cannot happen did.
    Internal(&'static str),
}

impl StartError {
    pub(super) const fn http(address: SocketAddr, cause: io::Error) -> Self {
        Self::Bind {
            what: "API and control room",
            option: "--http",
            address,
            cause,
        }
    }

    pub(super) const fn mqtt(address: SocketAddr, cause: io::Error) -> Self {
        Self::Bind {
            what: "the embedded broker",
            option: "--mqtt",
            address,
            cause,
        }
    }
}

impl From<DataError> for StartError {
    fn from(error: DataError) -> Self {
        Self::Data(error)
    }
}

impl From<TlsError> for StartError {
    fn from(error: TlsError) -> Self {
        Self::Tls(error)
    }
}

impl From<RecordsError> for StartError {
    fn from(error: RecordsError) -> Self {
        Self::Records(error)
    }
}

impl From<OpenError> for StartError {
    fn from(error: OpenError) -> Self {
        match error {
            OpenError::Records(error) => Self::Records(error),
            OpenError::NoRandomness => Self::Internal("no randomness"),
            OpenError::Key => Self::Internal("the stored key of tokens is invalid"),
        }
    }
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Data(error) => error.fmt(f),
            Self::Tls(error) => error.fmt(f),
            Self::Records(error) => error.fmt(f),
            Self::Bind {
                what,
                option,
                address,
                cause,
            } if cause.kind() == io::ErrorKind::AddrInUse => write!(
                f,
                "{address} is in use by another program; {what} can listen elsewhere with {option}"
            ),
            Self::Bind {
                what,
                option,
                address,
                cause,
            } => write!(f, "{what} cannot listen at {address} ({option}): {cause}"),
            Self::BrokerUnreachable { broker, reason } => {
                write!(f, "the broker at {broker} cannot be used: {reason}")
            }
            Self::Timeseries { engine, reason } => {
                write!(
                    f,
                    "the history cannot be kept at {engine} (--timeseries): {reason}"
                )
            }
            Self::Cache { cache, reason } => {
                write!(f, "the other servers cannot be joined at {cache}: {reason}")
            }
            Self::Simulation(reason) => {
                write!(f, "the simulated robots cannot be started: {reason}")
            }
            Self::NoRecords(database) => write!(
                f,
                "{database} holds no records: start a server with it first (--database)"
            ),
            Self::Experiments(cause) => {
                write!(f, "there are no threads for experiments: {cause}")
            }
            Self::Twins(cause) => write!(f, "there is no thread for twins: {cause}"),
            Self::ReleaseKey(reason) => write!(f, "{reason} (--release-key)"),
            Self::Internal(what) => write!(f, "internal error: {what}"),
        }
    }
}

impl std::error::Error for StartError {}
