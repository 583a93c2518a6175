//! Access tokens: JSON Web Tokens of one kind only.
//!
//! A token is `HEADER.CLAIMS.SIGNATURE`. The header is a constant and compared byte for byte, so a
//! token cannot choose its algorithm or its key. The signature is checked before anything of the
//! claims is read.

use core::fmt;

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use hmac::{Hmac, KeyInit as _, Mac as _};
use serde::{Deserialize, Serialize};
use sha2::Sha256;

use crate::secret::decode;
use crate::{Role, Secret, UserName};

/// Seconds for which a token is good.
pub const LIFETIME: i64 = 15 * 60;
/// Longest token that is looked at, in bytes. Ours stay below 300.
pub const MAX_TOKEN: usize = 512;
/// Seconds that the clock may have been set back since a token was issued.
pub const LEEWAY: i64 = 60;

/// `{"alg":"HS256","typ":"JWT"}` in base64url.
const HEADER: &str = "eyJhbGciOiJIUzI1NiIsInR5cCI6IkpXVCJ9";

/// The key that signs tokens and checks them.
#[derive(Clone)]
pub struct Key(Secret);

/// What a token says.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Claims {
    /// Whose it is.
    #[serde(rename = "sub")]
    pub user: UserName,
    /// What they may do.
    pub role: Role,
    /// The session that it belongs to and ends with.
    #[serde(rename = "sid")]
    pub session: u64,
    /// When it was made, in seconds since 1970.
    #[serde(rename = "iat")]
    pub issued: i64,
    /// From when on it is worth nothing, in seconds since 1970.
    #[serde(rename = "exp")]
    pub expires: i64,
}

/// Why a token is worth nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum TokenError {
    /// It is not a token of the one kind that there is.
    Malformed,
    /// This key did not sign it.
    Signature,
    /// It was good once: log in again, or refresh.
    Expired,
    /// It comes from the future: the clock was set back.
    NotYet,
}

impl Key {
    /// The key that `secret` is.
    #[must_use]
    pub const fn from_secret(secret: Secret) -> Self {
        Self(secret)
    }

    /// A token that says `claims`.
    #[must_use]
    pub fn sign(&self, claims: &Claims) -> String {
        // Names, numbers and a word: nothing that JSON could not say.
        let claims = serde_json::to_vec(claims).unwrap_or_default();
        let mut token = format!("{HEADER}.{}", URL_SAFE_NO_PAD.encode(claims));
        let signature = self.mac(&token).finalize().into_bytes();
        token.push('.');
        URL_SAFE_NO_PAD.encode_string(signature, &mut token);
        token
    }

    /// What `token` says, at `now_s` seconds since 1970.
    ///
    /// # Errors
    /// [`TokenError`] says why it is worth nothing.
    pub fn verify(&self, token: &str, now_s: i64) -> Result<Claims, TokenError> {
        if token.len() > MAX_TOKEN {
            return Err(TokenError::Malformed);
        }
        let (signed, signature) = token.rsplit_once('.').ok_or(TokenError::Malformed)?;
        let claims = signed
            .strip_prefix(HEADER)
            .and_then(|rest| rest.strip_prefix('.'))
            .ok_or(TokenError::Malformed)?;
        let signature = decode(signature).ok_or(TokenError::Malformed)?;
        self.mac(signed)
            .verify_slice(&signature)
            .map_err(|_| TokenError::Signature)?;
        let claims = URL_SAFE_NO_PAD
            .decode(claims)
            .map_err(|_| TokenError::Malformed)?;
        let claims: Claims = serde_json::from_slice(&claims).map_err(|_| TokenError::Malformed)?;
        if now_s >= claims.expires {
            return Err(TokenError::Expired);
        }
        if claims.issued > now_s.saturating_add(LEEWAY) {
            return Err(TokenError::NotYet);
        }
        Ok(claims)
    }

    fn mac(&self, signed: &str) -> Hmac<Sha256> {
        // HMAC fills a short key up to a block with zeros. Done here, it cannot fail.
        let mut block = [0; 64];
        block[..32].copy_from_slice(self.0.as_bytes());
        let mut mac = Hmac::<Sha256>::new(&block.into());
        mac.update(signed.as_bytes());
        mac
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(hidden)")
    }
}

impl fmt::Display for TokenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Malformed => "not a token of this server",
            Self::Signature => "the token was not signed by this server",
            Self::Expired => "the token has expired",
            Self::NotYet => "the token comes from the future",
        })
    }
}

impl core::error::Error for TokenError {}

#[cfg(test)]
#[path = "token_tests.rs"]
mod tests;
