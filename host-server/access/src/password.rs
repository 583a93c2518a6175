//! Passwords of people: what is good enough, and what is kept.
//!
//! A hash costs about 20 MB and some tens of milliseconds, on purpose. So call [`hash`], [`verify`]
//! and [`verify_nobody`] off the threads that serve others, only a few at a time, and only after
//! [`limits::Attempts`](crate::limits::Attempts) let the attempt pass.

use core::fmt;
use core::hint::black_box;

use argon2::password_hash::phc::PasswordHash;
use argon2::password_hash::{PasswordHasher as _, PasswordVerifier as _};
use argon2::{Algorithm, Argon2, Params, Version};

use crate::{NoRandomness, UserName};

/// Fewest characters of a password.
pub const MIN: usize = 10;
/// Most characters of a password.
pub const MAX: usize = 256;

/// Memory in KiB, passes and lanes of Argon2id: the first of the settings that OWASP names.
const MEMORY: u32 = 19_456;
const PASSES: u32 = 2;
const LANES: u32 = 1;
/// A hash of no known password, with the settings above.
const NOBODY: &str = "$argon2id$v=19$m=19456,t=2,p=1$\
    bm9ib2R5J3MgbG9uZyBzYWx0$AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA";
/// Longest hash that is read. Ours have 97 characters.
const MAX_HASH: usize = 256;

/// Why a password is not good enough.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Weak {
    /// Fewer than [`MIN`] characters.
    TooShort,
    /// More than [`MAX`] characters.
    TooLong,
    /// The name of its owner.
    Name,
}

/// Why there is no hash of a password.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum HashError {
    /// It has more than [`MAX`] characters.
    TooLong,
    /// There was no salt to be had.
    NoRandomness(NoRandomness),
    /// The algorithm failed, which takes a lack of memory.
    Failed,
}

/// Whether `password` is good enough for `name`.
///
/// # Errors
/// [`Weak`] says what is wrong with it.
pub fn check(name: &UserName, password: &str) -> Result<(), Weak> {
    if too_long(password) {
        return Err(Weak::TooLong);
    }
    if password.chars().count() < MIN {
        return Err(Weak::TooShort);
    }
    if password.to_lowercase() == name.as_ref() {
        return Err(Weak::Name);
    }
    Ok(())
}

/// What is kept of `password`: Argon2id with a random salt, as a PHC string.
///
/// # Errors
/// [`HashError`] when it is too long or there are no random numbers.
pub fn hash(password: &str) -> Result<String, HashError> {
    if too_long(password) {
        return Err(HashError::TooLong);
    }
    let mut salt = [0; 16];
    getrandom::fill(&mut salt).map_err(|_| HashError::NoRandomness(NoRandomness))?;
    let argon2 = algorithm().ok_or(HashError::Failed)?;
    let hash: PasswordHash = argon2
        .hash_password_with_salt(password.as_bytes(), &salt)
        .map_err(|_| HashError::Failed)?;
    Ok(hash.to_string())
}

/// Whether `hash` was made of `password`. What is not a hash of ours belongs to no password.
#[must_use]
pub fn verify(password: &str, hash: &str) -> bool {
    if too_long(password) || hash.len() > MAX_HASH {
        return false;
    }
    let (Ok(hash), Some(argon2)) = (PasswordHash::new(hash), algorithm()) else {
        return false;
    };
    // The cost stands in the hash. One from elsewhere could ask for all memory and all day.
    let affordable = Params::try_from(&hash).is_ok_and(|params| {
        (params.m_cost(), params.t_cost(), params.p_cost()) == (MEMORY, PASSES, LANES)
    });
    hash.algorithm == Algorithm::Argon2id.ident()
        && affordable
        && argon2.verify_password(password.as_bytes(), &hash).is_ok()
}

/// Does the work of [`verify`] for nothing. Call it where there is no hash to compare with, so that
/// the time of an answer does not tell which names exist.
pub fn verify_nobody(password: &str) {
    let _ = black_box(verify(black_box(password), NOBODY));
}

/// The bytes are looked at first: counting the characters of a huge text takes time as well.
fn too_long(password: &str) -> bool {
    password.len() > 4 * MAX || password.chars().count() > MAX
}

/// `None` never: the settings are legal, as every test of this module would show.
fn algorithm() -> Option<Argon2<'static>> {
    let params = Params::new(MEMORY, PASSES, LANES, Some(Params::DEFAULT_OUTPUT_LEN)).ok()?;
    Some(Argon2::new(Algorithm::Argon2id, Version::V0x13, params))
}

impl fmt::Display for Weak {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooShort => write!(f, "the password has fewer than {MIN} characters"),
            Self::TooLong => write!(f, "the password has more than {MAX} characters"),
            Self::Name => f.write_str("the password is the name"),
        }
    }
}

impl core::error::Error for Weak {}

impl fmt::Display for HashError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong => Weak::TooLong.fmt(f),
            Self::NoRandomness(error) => error.fmt(f),
            Self::Failed => f.write_str("the password could not be hashed"),
        }
    }
}

impl core::error::Error for HashError {}
