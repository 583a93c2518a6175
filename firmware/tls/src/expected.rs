//! Who the server has to be.

use crate::authority::Authority;

/// Whom a connection is for.
#[derive(Debug, Clone, Copy)]
pub struct Expected<'e> {
    /// Host name or address, which the certificate has to be for.
    pub host: &'e str,
    /// The authority, which has to have signed it.
    pub authority: Authority,
    /// Seconds since 1970, when that is known.
    pub now: Option<u64>,
}
