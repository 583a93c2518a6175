//! Why a call came to nothing.

use std::error::Error;
use std::fmt;
use std::io;
use std::time::Duration;

use crawler_server_tls::ConnectError;
use crawler_system::text::line;
use hyper::StatusCode;
use serde::Deserialize;

/// Characters of what a server says that are shown: a plan with several faults fits.
const SHOWN: usize = 1_000;

/// What a server says against a request (RFC 9457).
#[derive(Debug, Deserialize)]
pub(crate) struct Refusal {
    /// Stable, for programs.
    pub(super) code: String,
    detail: String,
    #[serde(default)]
    retry_after: Option<u32>,
    #[serde(skip)]
    status: u16,
    /// Whether somebody had logged in.
    #[serde(skip)]
    as_somebody: bool,
}

impl Refusal {
    /// The problem document of an answer; `None` where that is none.
    pub(super) fn read(status: StatusCode, body: &[u8], as_somebody: bool) -> Option<Self> {
        let refusal: Self = serde_json::from_slice(body).ok()?;
        Some(Self {
            status: status.as_u16(),
            as_somebody,
            ..refusal
        })
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (detail, code) = (line(&self.detail, SHOWN), line(&self.code, SHOWN));
        write!(f, "{detail} ({code})")?;
        if let Some(seconds) = self.retry_after {
            write!(f, "; try again in {seconds} s")?;
        }
        if self.status == 401 && !self.as_somebody && self.code == "unauthenticated" {
            write!(f, "; --user names an account")?;
        }
        Ok(())
    }
}

/// Why a call came to nothing.
#[derive(Debug)]
pub(crate) enum CallError {
    /// No whole answer came.
    Unreachable {
        /// From where.
        url: String,
        /// Why not.
        why: ExchangeError,
    },
    /// The server refuses.
    Refused(Refusal),
    /// What answers is no server of ours.
    Strange(String),
}

impl CallError {
    /// Whether the same call may be answered later.
    pub(crate) const fn is_passing(&self) -> bool {
        match self {
            Self::Unreachable { .. } => true,
            Self::Refused(refusal) => refusal.status >= 500 || refusal.status == 429,
            Self::Strange(_) => false,
        }
    }
}

impl fmt::Display for CallError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreachable { url, why } => write!(
                f,
                "{url} cannot be reached: {}; does the server run? --server names another one",
                line(&why.to_string(), SHOWN)
            ),
            Self::Refused(refusal) => refusal.fmt(f),
            Self::Strange(what) => write!(f, "no server of robots: {}", line(what, SHOWN)),
        }
    }
}

impl Error for CallError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        match self {
            Self::Unreachable { why, .. } => Some(why),
            Self::Refused(_) | Self::Strange(_) => None,
        }
    }
}

/// Why a request came to nothing before there was an answer.
#[derive(Debug)]
pub(crate) enum ExchangeError {
    /// There is no TLS.
    Tls(ConnectError),
    /// There is no connection.
    Io(io::Error),
    /// The connection ended, or what came is no HTTP.
    Http(hyper::Error),
    /// There can be no such request.
    Request(hyper::http::Error),
    /// The rest of the answer did not come, or it is too long.
    Body(Box<dyn Error + Send + Sync>),
    /// It took longer than this.
    TimedOut(Duration),
}

impl fmt::Display for ExchangeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tls(error) => error.fmt(f),
            Self::Io(error) => error.fmt(f),
            Self::Http(error) => error.fmt(f),
            Self::Request(error) => error.fmt(f),
            Self::Body(error) => error.fmt(f),
            Self::TimedOut(limit) => write!(f, "no answer within {} s", limit.as_secs()),
        }
    }
}

impl Error for ExchangeError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        match self {
            Self::Tls(error) => Some(error),
            Self::Io(error) => Some(error),
            Self::Http(error) => Some(error),
            Self::Request(error) => Some(error),
            Self::Body(error) => Some(&**error),
            Self::TimedOut(_) => None,
        }
    }
}
