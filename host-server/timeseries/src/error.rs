//! What can go wrong with an engine, by what to do about it.

use std::fmt;

use crawler_history::EngineFailure;

/// Why an engine did not do what it was asked.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum EngineError {
    /// It does not answer; the text says what came instead.
    Unreachable(String),
    /// It does not know the user, the password or the token, or does not let them.
    Denied(String),
    /// It has no such database, and did not let us make it.
    NoDatabase(String),
    /// It answers that it cannot, for now.
    Busy(String),
    /// It understood the request and refused it.
    Refused(String),
    /// What it says is no answer to what was asked.
    Nonsense(String),
    /// Its language for questions is not spoken here.
    Unreadable,
    /// The question is none; the text says why.
    Invalid(String),
    /// Nobody vouches for the engine at `influxs://`; the text says why.
    Certificates(String),
    /// The history was closed.
    Closed,
}

impl EngineError {
    /// Whether another try may do better although nobody asks for anything else: the samples are
    /// kept until then.
    #[must_use]
    pub const fn may_pass(&self) -> bool {
        !matches!(
            self,
            Self::Refused(_) | Self::Unreadable | Self::Invalid(_) | Self::Closed
        )
    }

    /// What a person can do about it.
    #[must_use]
    pub const fn advice(&self) -> &'static str {
        match self {
            Self::Unreachable(_) => {
                "is it running, and reachable from here at this host and port? `influxs://` is for engines with TLS"
            }
            Self::Denied(_) => {
                "put a user and password that may write and read into the address, or `?token=` for InfluxDB 2"
            }
            Self::NoDatabase(_) => {
                "create the database, or let the user create it: `CREATE DATABASE`; for InfluxDB 2 map it to a bucket"
            }
            Self::Busy(_) => "look at the engine's own log: it is starting, or its disk is full",
            Self::Refused(_) => "look at the engine's own log and limits",
            Self::Nonsense(_) => "is there a time-series engine behind this address?",
            Self::Unreadable => {
                "look at the history with the engine's own tools, or use InfluxDB or VictoriaMetrics; `?read=` says which language an engine speaks"
            }
            Self::Invalid(_) => "ask for a longer step, or a shorter time",
            Self::Certificates(_) => "name a PEM file with the engine's authority: `?ca=FILE`",
            Self::Closed => "the server is stopping",
        }
    }
}

impl From<EngineError> for EngineFailure {
    fn from(error: EngineError) -> Self {
        match error {
            EngineError::Invalid(why) => Self::Invalid(why),
            EngineError::Unreadable => Self::Unreadable,
            error => Self::Unavailable {
                reason: error.to_string(),
                advice: error.advice(),
            },
        }
    }
}

impl fmt::Display for EngineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreachable(why) => write!(f, "it does not answer: {why}"),
            Self::Denied(why) => write!(f, "it does not let us in: {why}"),
            Self::NoDatabase(why) => write!(f, "it has no such database: {why}"),
            Self::Busy(why) => write!(f, "it cannot for now: {why}"),
            Self::Refused(why) => write!(f, "it refuses: {why}"),
            Self::Nonsense(why) => write!(f, "its answer is not understood: {why}"),
            Self::Unreadable => f.write_str(
                "it takes samples, but cannot be asked for them: its language is not known here",
            ),
            Self::Invalid(why) | Self::Certificates(why) => f.write_str(why),
            Self::Closed => f.write_str("the history was closed"),
        }
    }
}

impl std::error::Error for EngineError {}
