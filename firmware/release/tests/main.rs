//! Releases against those who mean them no good, and against programs that nobody here wrote.

mod admission;
mod chunks;
mod corpus;
mod envelopes;
mod images;
mod manifests;
mod openssl;
mod support;
mod wycheproof;
