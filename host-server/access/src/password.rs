//! Passwords of people: what is good enough, and what is kept.
//!
//! A hash costs 19 MiB and some tens of milliseconds, on purpose. The [`Memory`] is the caller's, who uses
//! it again and again: allocated anew each time, what allocators keep of it for each thread adds up. So hash
//! off the threads that serve others, with as many memories as there may be passwords at a time, and only
//! after [`limits::Attempts`](crate::limits::Attempts) let the attempt pass.

use core::fmt;
use core::hint::black_box;

use argon2::password_hash::phc::{Output, ParamsString, PasswordHash, Salt};
use argon2::{Algorithm, Argon2, Block, Params, Version};
use subtle::ConstantTimeEq as _;

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

/// What one password at a time is hashed in: 19 MiB, once it was used.
///
/// What it holds afterwards comes from a password and a salt, and is no easier to guess from than the hash.
#[derive(Default)]
pub struct Memory(Vec<Block>);

impl Memory {
    /// One that takes its room with the first password.
    #[must_use]
    pub const fn new() -> Self {
        Self(Vec::new())
    }

    /// What is kept of `password`: Argon2id with a random salt, as a PHC string.
    ///
    /// # Errors
    /// [`HashError`] when it is too long or there are no random numbers.
    pub fn hash(&mut self, password: &str) -> Result<String, HashError> {
        if too_long(password) {
            return Err(HashError::TooLong);
        }
        let mut salt = [0; 16];
        getrandom::fill(&mut salt).map_err(|_| HashError::NoRandomness(NoRandomness))?;
        self.hash_with(password, &salt).ok_or(HashError::Failed)
    }

    fn hash_with(&mut self, password: &str, salt: &[u8]) -> Option<String> {
        let argon2 = algorithm()?;
        let hash = PasswordHash {
            algorithm: Algorithm::Argon2id.ident(),
            version: Some(Version::V0x13.into()),
            params: ParamsString::try_from(argon2.params()).ok()?,
            salt: Some(Salt::new(salt).ok()?),
            hash: Some(Output::new(&self.digest(&argon2, password, salt)?).ok()?),
        };
        Some(hash.to_string())
    }

    fn digest(&mut self, argon2: &Argon2<'_>, password: &str, salt: &[u8]) -> Option<Digest> {
        self.0.resize(argon2.params().block_count(), Block::new());
        let mut digest = Digest::default();
        argon2
            .hash_password_into_with_memory(password.as_bytes(), salt, &mut digest, &mut self.0)
            .ok()?;
        Some(digest)
    }

    /// Whether `hash` was made of `password`. What is not a hash of ours belongs to no password.
    #[must_use]
    pub fn verify(&mut self, password: &str, hash: &str) -> bool {
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
        let version = hash.version.map(Version::try_from);
        let ours = hash.algorithm == Algorithm::Argon2id.ident()
            && affordable
            && matches!(version, None | Some(Ok(Version::V0x13)));
        let (true, Some(salt), Some(kept)) = (ours, hash.salt, hash.hash) else {
            return false;
        };
        let digest = self.digest(&argon2, password, &salt);
        digest.is_some_and(|digest| digest.ct_eq(kept.as_bytes()).into())
    }

    /// Does the work of [`Memory::verify`] for nothing. Call it where there is no hash to compare with, so
    /// that the time of an answer does not tell which names exist.
    pub fn verify_nobody(&mut self, password: &str) {
        let _ = black_box(self.verify(black_box(password), NOBODY));
    }
}

type Digest = [u8; Params::DEFAULT_OUTPUT_LEN];

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
