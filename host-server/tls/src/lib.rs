//! TLS: the certificates of this server, and connections that are encrypted with them.
//!
//! - [`Certificates`]: what the listeners show, always current; [`CertificateOptions`] say what it is to be.
//! - [`TlsHandshake`]: the way in, a handshake that takes a bounded time.
//! - [`TlsClient`]: a connection to somebody else's listener.
//! - [`Tunnel`]: the way to an outside broker, for clients of this process that encrypt nothing.
//!
//! The server either has a private authority of its own or uses files that the user
//! keeps current. Both are looked after while the server runs: a certificate that is due is made
//! anew, and files that change are read again. Every connection from then on gets the new one.
//!
//! Reading order: `error`, `provider`, `time` and `validity`, then certificates in `files`, `names`, `authority`,
//! `certificates` and `shown`, then connections in `handshake`, `carry`, `client` and `tunnel`. Each imports from those
//! before it alone, and a test holds them to it.

mod authority;
mod carry;
mod certificates;
mod client;
mod error;
mod files;
mod handshake;
mod names;
mod provider;
mod shown;
mod time;
mod tunnel;
mod validity;

pub use certificates::{CertificateOptions, Certificates, MQTT};
pub use client::{ConnectError, TlsClient};
pub use error::TlsError;
pub use files::first_certificate;
pub use handshake::{Refusal, TlsHandshake};
pub use shown::Shown;
pub use tunnel::{Tunnel, reachable};
