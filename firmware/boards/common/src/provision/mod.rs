//! Telling a robot its settings from a phone or a computer.
//!
//! A small HTTP server with one page. [`serve`] runs it over embassy-net; [`Server::converse`]
//! serves any byte stream, so that all of it is tested on the host. Whatever arrives is bounded:
//! a request has [`BUFFER`] bytes and [`ARRIVED_WITHIN`], and each connection serves one request.
//!
//! | who asks | gets |
//! |---|---|
//! | `GET /` by address | the page |
//! | `GET /networks` by address | networks nearby, where the board has a radio to look with |
//! | `POST /settings` by address, from the page itself | the page again with what is wrong, or a word on what happens next |
//! | anything by name | on the robot's own access point a redirect to its address, which is how phones find the page; elsewhere 421 |
//!
//! A page of someone else that makes a browser send the form is refused twice: by `Origin`, and
//! for want of the [`Token`] that only readers of the page know. A name that someone makes point
//! here is refused because the page is served by address alone. Passwords are written, never
//! shown.

pub mod access_point;
mod check;
pub mod fallback;
mod form;
mod http;
mod listen;
mod page;
mod portal;
mod scan;
mod serve;
#[cfg(test)]
mod tests;

pub use check::Flaws;
pub use form::{Form, FormError, Value};
pub use http::{Host, Method, Origin, Path, Request, Status};
pub use listen::{Connection, serve};
pub use portal::{Portal, Token};
pub use scan::{MAX_NETWORKS, Nearby, Networks, NoScanner, ScanFailed, Scanner};
pub use serve::{
    ARRIVED_WITHIN, BEGUN_WITHIN, BUFFER, Outcome, SCANNED_WITHIN, Server, TAKEN_WITHIN,
};

/// What a board has to be told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Features {
    /// It joins a Wi-Fi network.
    pub wifi: bool,
    /// It can look for networks while it serves the page.
    pub scan: bool,
    /// It has a US-100, whose wiring is not known.
    pub ranger: bool,
}
