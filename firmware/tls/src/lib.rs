//! TLS 1.3 (RFC 8446) for a robot: a client that knows one authority and little else.
//!
//! | what | which |
//! |---|---|
//! | version | TLS 1.3 alone |
//! | cipher suite | `TLS_CHACHA20_POLY1305_SHA256`: these chips have no fast AES in software |
//! | key exchange | ECDHE with P-256, whose arithmetic the signatures need in any case |
//! | signatures | ECDSA with P-256 and SHA-256, of certificates as well; no RSA |
//! | trust | one public key ([`Authority`]), pinned beforehand |
//! | resumption, early data, certificates of the client | none; tickets are skipped |
//!
//! [`Connection`] is the protocol without input and output: bytes go in, bytes come out.
//! [`TlsStream`] moves them over an asynchronous byte stream, and [`Secured`] puts that beneath
//! whatever opens streams through [`Network`](crawler_hal::Network).
//!
//! # What is checked
//!
//! The certificate of the server and at most [`MOST_BETWEEN`] between it and the authority: signature,
//! time, name (DNS name or address among the alternative names; the common name does not count),
//! basic constraints, key usage, extended key usage. A critical extension that this crate does not
//! know, name constraints among them, is a refusal. The time is checked against the robot's clock
//! when that is set. It usually is not before the first session, which is where it is learned from:
//! then only what had ended before this program was made ([`MADE_AFTER`]) is refused.
//!
//! # Memory
//!
//! [`Buffers`] take [`INPUT`] and [`OUTPUT`] bytes and belong to the caller; everything else lives in
//! the connection, about half a kilobyte. A record of the server has to fit the input beside what is
//! left of a handshake message: servers are asked for records of at most [`FRAGMENT`] bytes by both
//! extensions that there are for it (RFC 6066, RFC 8449). One that sends more ends the connection with
//! [`TlsError::TooBig`].
//!
//! # Why not a library
//!
//! `embedded-tls` 0.19.0, the one client for TLS 1.3 without a heap, was read before: the check of
//! certificates (`pki.rs`) asks none of the issuers whether it is an authority, so the holder of any
//! certificate that the pinned one has signed can issue others for any name; addresses among the
//! alternative names are not compared; a read that is dropped loses the header of a record
//! (`record_reader.rs`), which the session's `select` does all the time; a record without content
//! panics (`connection.rs`); and its suites are AES alone. rustls needs a heap.
//!
//! # Reading order
//!
//! `authority`, `expected` and `error`; `stream` and `network`, which are called; `connection` with `hello`,
//! `handshake`, `keys` and `record`; certificates in `chain`, `certificate`, `name` and `time`, over `der` and
//! `reader`; `sizes`.
#![no_std]

#[cfg(test)]
extern crate std;

mod authority;
mod certificate;
mod chain;
mod connection;
mod der;
mod error;
mod expected;
mod handshake;
mod hello;
mod keys;
mod name;
mod network;
mod reader;
mod record;
mod sizes;
mod stream;
#[cfg(test)]
mod tests;
mod time;

pub use authority::{Authority, AuthorityError};
pub use chain::{MADE_AFTER, MOST_BETWEEN};
pub use connection::{Buffers, Connection, Step};
pub use error::TlsError;
pub use expected::Expected;
pub use network::{Secured, SecuredStream, Security};
pub use sizes::{FRAGMENT, INPUT, OUTPUT, POINT};
pub use stream::{StreamError, TlsStream};

/// Reads a certificate and checks it against an authority: what a fuzzer throws itself at.
///
/// # Errors
/// See [`TlsError`].
pub fn check_certificates(list: &[u8], expected: &Expected<'_>) -> Result<[u8; POINT], TlsError> {
    chain::check(list, expected)
}
