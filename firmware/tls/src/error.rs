//! What can go wrong.

use core::fmt;

/// Why there is no connection, or no more. Each has a stable name: [`TlsError::reason`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum TlsError {
    /// The stream ended, and nobody said good-bye.
    Closed,
    /// The server sent this alert (RFC 8446, section 6): it does not like what we offer.
    Alert(u8),
    /// The server does not speak TLS 1.3.
    Version,
    /// The server chose a suite or a group that was not offered, or an extension where it has no place.
    Choice,
    /// The server answered an extension that was not offered.
    Extension,
    /// A message is not what the protocol says.
    Malformed,
    /// A message that has no place here.
    Unexpected,
    /// A record or a message is larger than the memory for it.
    TooBig,
    /// A record is not what was sent: tampered with, or cut.
    BadRecord,
    /// Records without content, one after the other.
    Flood,
    /// A certificate is not understood.
    BadCertificate,
    /// A certificate has another key or signature than ECDSA with P-256 and SHA-256.
    Algorithm,
    /// The certificate does not come from the authority.
    Untrusted,
    /// There are too many certificates between the server's and the authority's.
    LongChain,
    /// The certificate is for another name.
    Name,
    /// The certificate is no longer valid.
    Expired,
    /// The certificate is not valid yet.
    NotYet,
    /// The certificate, or one above it, must not be used for that.
    Purpose,
    /// The server does not have the key of its certificate.
    Signature,
    /// The two ends have not seen the same handshake.
    Finished,
    /// The caller's host name or memory cannot be used.
    Unusable,
}

impl TlsError {
    /// A name for log records. Does not change between versions.
    #[must_use]
    pub const fn reason(self) -> &'static str {
        match self {
            Self::Closed => "closed",
            Self::Alert(_) => "alert",
            Self::Version => "version",
            Self::Choice => "choice",
            Self::Extension => "extension",
            Self::Malformed => "malformed",
            Self::Unexpected => "unexpected",
            Self::TooBig => "too-big",
            Self::BadRecord => "bad-record",
            Self::Flood => "flood",
            Self::BadCertificate => "bad-certificate",
            Self::Algorithm => "algorithm",
            Self::Untrusted => "untrusted",
            Self::LongChain => "long-chain",
            Self::Name => "name",
            Self::Expired => "expired",
            Self::NotYet => "not-yet-valid",
            Self::Purpose => "purpose",
            Self::Signature => "signature",
            Self::Finished => "finished",
            Self::Unusable => "unusable",
        }
    }

    /// What the server is told, by RFC 8446, section 6.2; `None` when there is nobody to tell.
    #[must_use]
    pub const fn alert(self) -> Option<u8> {
        match self {
            Self::Closed | Self::Alert(_) => None,
            Self::Unexpected | Self::Flood => Some(10),
            Self::BadRecord => Some(20),
            Self::TooBig => Some(22),
            Self::BadCertificate | Self::Name | Self::Purpose | Self::LongChain => Some(42),
            Self::Algorithm => Some(43),
            Self::Expired | Self::NotYet => Some(45),
            Self::Choice => Some(47),
            Self::Untrusted => Some(48),
            Self::Malformed => Some(50),
            Self::Signature | Self::Finished => Some(51),
            Self::Version => Some(70),
            Self::Unusable => Some(80),
            Self::Extension => Some(110),
        }
    }
}

impl fmt::Display for TlsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Alert(code) => write!(f, "alert {code}"),
            _ => f.write_str(self.reason()),
        }
    }
}

impl core::error::Error for TlsError {}
