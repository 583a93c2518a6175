//! What a person may do.

use core::fmt;
use core::str::FromStr;

use serde::{Deserialize, Serialize};

/// What a person may do. Each role may do all that the one before it may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Sees everything of the fleet, changes nothing.
    Viewer,
    /// Also commands robots and the simulator.
    Operator,
    /// Also decides who may do what.
    Admin,
}

/// A text is none of `viewer`, `operator` and `admin`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RoleError;

impl Role {
    /// Every role, the least first.
    pub const ALL: [Self; 3] = [Self::Viewer, Self::Operator, Self::Admin];

    /// The role as it is written everywhere.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Operator => "operator",
            Self::Admin => "admin",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Role {
    type Err = RoleError;

    fn from_str(text: &str) -> Result<Self, RoleError> {
        let mut all = Self::ALL.into_iter();
        all.find(|role| role.as_str() == text).ok_or(RoleError)
    }
}

impl fmt::Display for RoleError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("not a role: viewer, operator or admin")
    }
}

impl core::error::Error for RoleError {}
