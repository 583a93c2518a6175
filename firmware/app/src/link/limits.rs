//! How long anything may take; the [module above](super) has the table.

use crawler_hal::Duration;

/// Keep-alive announced to the broker. Some brokers add seconds to anything below six.
pub const KEEP_ALIVE: Duration = Duration::from_secs(6);
/// Silence after which the broker is asked whether it is there.
pub const PING_AFTER: Duration = Duration::from_secs(3);
/// Silence after which the link is lost.
pub const LOST_AFTER: Duration = Duration::from_secs(8);
/// Longest time to join the network.
pub const JOINED_WITHIN: Duration = Duration::from_secs(15);
/// Longest time to open a stream, and then to be accepted by the broker.
pub const OPENED_WITHIN: Duration = Duration::from_secs(5);
/// Longest time until every subscription is confirmed.
pub const SUBSCRIBED_WITHIN: Duration = Duration::from_secs(5);
/// Longest time to write one packet.
pub const WRITTEN_WITHIN: Duration = Duration::from_secs(5);
/// Longest time that a chunk of a release which waits for its place keeps others from being received: many times what
/// a flash takes to write one.
pub const ROOM_WITHIN: Duration = Duration::from_secs(1);
/// Longest time until a QoS 1 message is acknowledged.
pub const ACKNOWLEDGED_WITHIN: Duration = Duration::from_secs(10);
/// How long the broker keeps the session of a robot that is away.
pub const SESSION_EXPIRY: Duration = Duration::from_secs(60);
/// Period of heartbeats.
pub const HEARTBEAT_PERIOD: Duration = Duration::from_secs(1);
