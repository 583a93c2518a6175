//! How much of anything fits.

/// Bytes for what arrives: a record of [`FRAGMENT`] bytes, and a message of the handshake of which
/// it is the end. Certificates of two authorities and a server fit.
pub const INPUT: usize = 4_096;
/// Bytes for what leaves: a packet of MQTT in one record, or the first message to a server with a
/// name of any length.
pub const OUTPUT: usize = 640;
/// Content of a record that servers are asked to keep to.
pub const FRAGMENT: usize = 2_048;

/// Bytes of a point of P-256, uncompressed.
pub const POINT: usize = 65;
