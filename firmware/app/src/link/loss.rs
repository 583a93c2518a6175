//! Why there is no session.

use core::fmt;

use crawler_hal::{Elapsed, NetError};
use crawler_protocol::LinkCut;
use embedded_io_async::ErrorKind;
use rust_mqtt::client::MqttError;
use rust_mqtt::types::ReasonCode;

use crate::trouble::LinkTrouble;

/// Why a session ended, or did not begin. Each variant is a different thing to look at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Loss {
    /// The network could not be joined or the broker not be reached.
    Unreachable(NetError),
    /// Joining the network took too long.
    Unjoined,
    /// Connecting to the broker took too long.
    Unanswered,
    /// The network went away beneath the session.
    NetworkDown,
    /// The stream broke or was closed.
    Broken,
    /// What came is not what the broker sent.
    Tampered,
    /// Nothing was heard for too long, not even an answer to a ping.
    Silent,
    /// The stream took no more bytes.
    Stalled,
    /// A QoS 1 message was not acknowledged in time: sending it again needs a new connection.
    Unacknowledged,
    /// The broker sent what is not MQTT 5, or more than was agreed.
    Protocol,
    /// A subscription was refused or not acknowledged: commands would not arrive.
    NotSubscribed,
    /// Another client with this robot's id connected.
    TakenOver,
    /// The broker refused name and password, or their absence, with this reason.
    Credentials(ReasonCode),
    /// The broker said no, or good-bye, with this reason.
    Dismissed(ReasonCode),
    /// The broker does not support what this program needs.
    Unsupported,
}

impl Loss {
    /// What is seen of a link that is lost on purpose.
    pub(super) const fn injected(how: LinkCut) -> Self {
        match how {
            LinkCut::Radio => Self::Unreachable(NetError::NotJoined),
            LinkCut::Password => Self::Unreachable(NetError::BadCredentials),
            LinkCut::NoAddress => Self::Unreachable(NetError::NoAddress),
            LinkCut::Silent => Self::Unanswered,
        }
    }

    /// Whether trying again soon would hardly help.
    pub(super) const fn is_refusal(self) -> bool {
        match self {
            Self::Dismissed(reason) => matches!(
                reason,
                ReasonCode::UnsupportedProtocolVersion
                    | ReasonCode::ClientIdentifierNotValid
                    | ReasonCode::Banned
            ),
            Self::Unreachable(NetError::Insecure(_))
            | Self::Credentials(_)
            | Self::NotSubscribed
            | Self::Unsupported => true,
            Self::Unreachable(_)
            | Self::Unjoined
            | Self::Unanswered
            | Self::NetworkDown
            | Self::Broken
            | Self::Tampered
            | Self::Silent
            | Self::Stalled
            | Self::Unacknowledged
            | Self::Protocol
            | Self::TakenOver => false,
        }
    }

    /// What is to be looked at, in as far as it can be told apart from here.
    pub(super) const fn trouble(self) -> LinkTrouble {
        match self {
            Self::Unreachable(NetError::BadCredentials) => LinkTrouble::Password,
            Self::Unreachable(NetError::NoAddress) => LinkTrouble::NoAddress,
            Self::Unreachable(NetError::NotJoined) | Self::Unjoined | Self::NetworkDown => {
                LinkTrouble::NoNetwork
            }
            Self::Credentials(_) => LinkTrouble::Credentials,
            Self::Unreachable(NetError::Insecure(_)) | Self::Tampered => LinkTrouble::Untrusted,
            Self::Unreachable(_)
            | Self::Unanswered
            | Self::Broken
            | Self::Silent
            | Self::Stalled
            | Self::Unacknowledged
            | Self::Protocol
            | Self::NotSubscribed
            | Self::TakenOver
            | Self::Dismissed(_)
            | Self::Unsupported => LinkTrouble::NoBroker,
        }
    }
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreachable(NetError::NotJoined) => f.write_str("no network"),
            Self::Unreachable(NetError::BadCredentials) => {
                f.write_str("the network refuses the password")
            }
            Self::Unreachable(NetError::NoAddress) => f.write_str("the network gives no address"),
            Self::Unjoined => f.write_str("the network does not answer"),
            Self::Unreachable(NetError::UnknownHost) => f.write_str("unknown broker host"),
            Self::Unreachable(NetError::Refused) => f.write_str("broker refuses connections"),
            Self::Unreachable(NetError::NoResources) => f.write_str("no room for a stream"),
            Self::Unreachable(NetError::Insecure(why)) => {
                write!(f, "broker not trusted ({why})")
            }
            Self::Tampered => f.write_str("connection tampered with"),
            Self::Unreachable(_) | Self::Unanswered => f.write_str("broker does not answer"),
            Self::NetworkDown => f.write_str("network down"),
            Self::Broken => f.write_str("connection broken"),
            Self::Silent => f.write_str("broker silent"),
            Self::Stalled => f.write_str("broker takes no more bytes"),
            Self::Unacknowledged => f.write_str("message not acknowledged"),
            Self::Protocol => f.write_str("broker violates the protocol"),
            Self::NotSubscribed => f.write_str("subscription refused"),
            Self::TakenOver => f.write_str("another robot with this id connected"),
            Self::Credentials(reason) => write!(
                f,
                "broker refuses name and password (0x{:02x})",
                reason.value()
            ),
            Self::Dismissed(reason) => write!(f, "broker said 0x{:02x}", reason.value()),
            Self::Unsupported => f.write_str("broker lacks a feature"),
        }
    }
}

impl From<NetError> for Loss {
    fn from(error: NetError) -> Self {
        Self::Unreachable(error)
    }
}

impl From<Elapsed> for Loss {
    fn from(_: Elapsed) -> Self {
        Self::Unanswered
    }
}

/// Why a broker refuses who we say we are: MQTT 5, section 2.4. Mosquitto answers a wrong
/// password with 0x87.
const fn is_about_credentials(reason: ReasonCode) -> bool {
    matches!(
        reason,
        ReasonCode::BadUserNameOrPassword
            | ReasonCode::NotAuthorized
            | ReasonCode::BadAuthenticationMethod
    )
}

impl<const PROPERTIES: usize> From<MqttError<'_, PROPERTIES>> for Loss {
    fn from(error: MqttError<'_, PROPERTIES>) -> Self {
        match error {
            MqttError::Disconnect {
                reason: ReasonCode::SessionTakenOver,
                ..
            } => Self::TakenOver,
            MqttError::Disconnect { reason, .. } if is_about_credentials(reason) => {
                Self::Credentials(reason)
            }
            MqttError::Disconnect { reason, .. } => Self::Dismissed(reason),
            // What a stream says that checks what comes.
            MqttError::Network(ErrorKind::InvalidData) => Self::Tampered,
            MqttError::Network(_) | MqttError::RecoveryRequired => Self::Broken,
            // `Alloc`: a field longer than any packet we agreed to.
            MqttError::Server | MqttError::Alloc => Self::Protocol,
            _ => Self::Unsupported,
        }
    }
}
