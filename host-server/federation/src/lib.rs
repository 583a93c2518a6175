//! Federated learning over a broker: the session of a coordinator, and a node.
//!
//! ```text
//! {fleet}/learn/{run}/round          coordinator to nodes, retained: an announcement, or nothing once the run stands
//! {fleet}/learn/{run}/update/{node}  node to coordinator
//! ```
//!
//! Both are at QoS 1, and nothing is asked of the broker beyond that. A session that is lost is replaced by a new one, which says once more
//! what its end said last: the announcement of the round, or the answer to it. So whoever was away hears it, and what comes twice
//! counts once.
//!
//! Reading order: `topics`; `session`, either end's; `nodes`, the coordinator's end; `learn`, a node.
#![forbid(unsafe_code)]

mod learn;
mod nodes;
mod session;
mod topics;

pub use learn::{Told, learn};
pub use nodes::{Broker, Nodes};
/// Options of a session with the broker.
pub use rumqttc::v5::MqttOptions as SessionOptions;
pub use session::LARGEST_PACKET;
pub use topics::NodeName;
