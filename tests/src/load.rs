//! A thousand publishers and one subscriber in one process, over real sockets: MQTT 5 by hand
//! (OASIS MQTT Version 5.0), since a client library would cost more than the broker under test.
//!
//! Publishers share one thread and never block: whoever owes acknowledgements or whose socket is
//! full skips a turn, which is counted. Every payload carries its publisher, its number and when it
//! was written, so that what was lost, came twice, and how long it took are known exactly.

pub(crate) mod packet;
mod publishers;
mod subscriber;

pub use publishers::{Payload, Plan, Publishers, Sent, stamp};
pub use subscriber::{Heard, Subscriber};

/// Quality of service of a load.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Qos {
    /// At most once.
    Zero,
    /// At least once.
    One,
}

impl Qos {
    /// Its number on the wire.
    pub const fn number(self) -> u8 {
        match self {
            Self::Zero => 0,
            Self::One => 1,
        }
    }
}
