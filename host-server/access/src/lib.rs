//! Who may do what: accounts, roles, credentials, and the topics that each may use.
//!
//! Everything here is a value or a decision. Nothing reads a clock, opens a file or keeps a list of
//! accounts: time is handed in, and the records live elsewhere. So each rule can be tested alone.
//!
//! - [`Role`] and [`UserName`], in `role` and `name`: people.
//! - [`Secret`] and [`Digest`], in `secret`: what machines prove themselves with, and what is kept of it.
//! - [`password`]: what people prove themselves with.
//! - [`token`]: what a person holds after the password, for a quarter of an hour.
//! - [`topics`]: what each of them may publish and subscribe.
//! - [`LearnTopic`], in `learn_topic`: topics of federated learning.
//! - [`limits`]: how often one may fail, and how much one may send.

mod learn_topic;
pub mod limits;
mod name;
pub mod password;
mod role;
mod secret;
pub mod token;
pub mod topics;

pub use learn_topic::{LearnTopic, MAX_ROUND, MAX_UPDATE};
pub use name::{MAX_USER_NAME, UserName, UserNameError};
pub use role::{Role, RoleError};
pub use secret::{Digest, NoRandomness, Secret, SecretError};
