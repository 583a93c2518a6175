//! The server's clock.

use serde::{Deserialize, Serialize};

use super::wire;

/// The server's clock, for robots without a time service of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct TimeMessage {
    /// Unix milliseconds when the message left.
    pub timestamp: u64,
}
wire!(TimeMessage);
