//! The one authority that a robot trusts.

use core::fmt;
use core::str::FromStr;

use p256::PublicKey;

use crate::certificate::Certificate;
use crate::error::TlsError;
use crate::sizes::POINT;

/// Bytes of a point of P-256, compressed.
const COMPRESSED: usize = 33;

/// The public key of an authority, a point of P-256.
///
/// It is the key and not its certificate that is pinned: it takes 33 bytes, and a certificate that
/// is renewed with the same key stays trusted. As text it is 66 hexadecimal digits, the compressed
/// form of SEC 1, section 2.3.3:
///
/// ```sh
/// openssl x509 -in ca.pem -noout -pubkey | openssl ec -pubin -conv_form compressed -outform DER | tail -c 33 | xxd -p -c 33
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Authority([u8; COMPRESSED]);

/// Why something is no authority.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AuthorityError {
    /// Not 66 hexadecimal digits.
    Digits,
    /// No point of P-256: a digit is wrong, or the key is of another kind.
    Point,
}

impl fmt::Display for AuthorityError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Digits => "an authority is 66 hexadecimal digits",
            Self::Point => "no public key of P-256: a digit is wrong",
        })
    }
}

impl core::error::Error for AuthorityError {}

impl Authority {
    /// Takes a compressed point.
    ///
    /// # Errors
    /// [`AuthorityError::Point`] when the bytes are none.
    pub fn new(bytes: [u8; COMPRESSED]) -> Result<Self, AuthorityError> {
        let compressed = matches!(bytes, [2 | 3, ..]);
        PublicKey::from_sec1_bytes(&bytes)
            .ok()
            .filter(|_| compressed)
            .map(|_| Self(bytes))
            .ok_or(AuthorityError::Point)
    }

    /// The key of a certificate in DER, such as `ca.pem` holds one. Nothing else of it is looked
    /// at: whoever pins it says that it is to be trusted.
    ///
    /// # Errors
    /// [`TlsError::BadCertificate`] when it is not understood, [`TlsError::Algorithm`] when its key
    /// is of another kind.
    pub fn of_certificate(der: &[u8]) -> Result<Self, TlsError> {
        let point = Certificate::parse(der)?.key()?;
        let [4, coordinates @ ..] = point else {
            return Err(TlsError::Algorithm);
        };
        let (x, y) = coordinates.split_at(32);
        let mut bytes = [2; COMPRESSED];
        for (to, from) in bytes.iter_mut().skip(1).zip(x) {
            *to = *from;
        }
        let odd = y.last().is_some_and(|byte| byte & 1 == 1);
        if let Some(parity) = bytes.first_mut() {
            *parity += u8::from(odd);
        }
        Self::new(bytes).map_err(|_| TlsError::BadCertificate)
    }

    /// The compressed point.
    #[must_use]
    pub const fn as_bytes(&self) -> &[u8; COMPRESSED] {
        &self.0
    }

    /// Whether an uncompressed point is this key.
    pub(crate) fn is(&self, point: &[u8; POINT]) -> bool {
        let odd = point.last().is_some_and(|byte| byte & 1 == 1);
        self.0.first() == Some(&(2 + u8::from(odd))) && self.0.get(1..) == point.get(1..33)
    }
}

impl FromStr for Authority {
    type Err = AuthorityError;

    fn from_str(text: &str) -> Result<Self, AuthorityError> {
        let mut bytes = [0; COMPRESSED];
        let mut digits = text.bytes();
        for byte in &mut bytes {
            let mut digit = || {
                let digit = char::from(digits.next()?).to_digit(16)?;
                u8::try_from(digit).ok()
            };
            let (high, low) = digit().zip(digit()).ok_or(AuthorityError::Digits)?;
            *byte = high << 4 | low;
        }
        if digits.next().is_some() {
            return Err(AuthorityError::Digits);
        }
        Self::new(bytes)
    }
}

impl fmt::Display for Authority {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}
