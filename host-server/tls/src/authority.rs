//! The private authority of a server and the certificate that it signs for it.
//!
//! Both are made at the first start and kept in files, so that clients which pinned `ca.pem` know
//! the server again. The certificate lives for ninety days and is made anew when a third of them is
//! left, or when the server has another name. The authority keeps its key for good.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crawler_system::text::hex;
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa,
    Issuer, KeyPair, KeyUsagePurpose,
};
use tokio_rustls::rustls::Error;
use tokio_rustls::rustls::client::danger::ServerCertVerifier;
use tokio_rustls::rustls::client::{VerifierBuilderError, WebPkiServerVerifier};
use tokio_rustls::rustls::pki_types::{InvalidDnsNameError, ServerName, UnixTime};
use tokio_rustls::rustls::sign::CertifiedKey;

use crate::error::TlsError;
use crate::files;
use crate::provider::provider;
use crate::validity::Validity;

const DAY: i64 = 24 * 60 * 60;
/// How long the certificate is valid.
const CERTIFICATE: i64 = 90 * DAY;
/// How much of that must be left.
const LEFT: i64 = CERTIFICATE / 3;
/// How long the authority is valid.
const AUTHORITY: i64 = 20 * 365 * DAY;
/// How much of that must be left. Its certificate is renewed with the same key then, which clients
/// that pinned the old one go on trusting until that one expires.
const AUTHORITY_LEFT: i64 = 2 * 365 * DAY;
/// Clients' clocks may be that much behind.
const BACK: i64 = DAY;

/// Why a certificate that is there is made anew.
enum RenewalReason {
    /// It ends soon.
    Ends,
    /// There is none in the file.
    Empty,
    /// The authority cannot be read.
    Authority(TlsError),
    /// The authority vouches for nothing.
    Verifier(VerifierBuilderError),
    /// No certificate can be for such a name.
    Name(InvalidDnsNameError),
    /// It is not accepted under this name.
    NotFor(String, Error),
}

impl fmt::Display for RenewalReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ends => f.write_str("the old one expires soon"),
            Self::Empty => f.write_str("the old one is empty"),
            Self::Authority(error) => error.fmt(f),
            Self::Verifier(error) => error.fmt(f),
            Self::Name(error) => error.fmt(f),
            Self::NotFor(name, error) => {
                write!(f, "the old one does not serve for {name}: {error}")
            }
        }
    }
}

/// The authority, and what its certificates are for.
pub(crate) struct Authority {
    dir: PathBuf,
    names: Vec<String>,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    /// Opens the authority in `dir`, or makes one there.
    pub(crate) fn open(dir: &Path, names: Vec<String>, now: i64) -> Result<Self, TlsError> {
        files::private_dir(dir)?;
        let (certificate, key) = (dir.join("ca.pem"), dir.join("ca.key"));
        match (certificate.exists(), key.exists()) {
            (false, false) => {
                let made = KeyPair::generate()?;
                // The key first: a certificate without one would stand in the way of the next try.
                files::write(&key, &made.serialize_pem(), true)?;
                write_authority(&certificate, &made, now)?;
                tracing::info!(path = %certificate.display(), "made a private authority for TLS");
            }
            (true, true) => files::make_private(&key)?,
            // Interrupted between the two, or only the public half is lost: the key brings it back.
            (false, true) => {
                files::make_private(&key)?;
                write_authority(&certificate, &load_key(&key)?, now)?;
            }
            (true, false) => {
                return Err(TlsError::Half {
                    missing: key,
                    there: certificate,
                });
            }
        }
        // Whether the two belong together is seen here.
        let (_, validity) = files::pair(&certificate, &key)?;
        let own = load_key(&key)?;
        if now + AUTHORITY_LEFT > validity.until {
            write_authority(&certificate, &own, now)?;
            tracing::warn!(
                path = %certificate.display(),
                "renewed the private authority: give clients the new file before the old expires"
            );
        }
        Ok(Self {
            dir: dir.to_owned(),
            names,
            issuer: Issuer::new(authority(&own, now), own),
        })
    }

    /// Where the certificate is that clients pin.
    pub(crate) fn certificate(&self) -> PathBuf {
        self.dir.join("ca.pem")
    }

    /// The server's certificate: that in the files while it serves, else a new one.
    pub(crate) fn current(&self, now: i64) -> Result<(Arc<CertifiedKey>, Validity), TlsError> {
        let (certificate, key) = self.paths();
        if certificate.exists() && key.exists() {
            match files::pair(&certificate, &key) {
                Ok((pair, validity)) => match self.check(&pair, validity, now) {
                    Ok(()) => {
                        files::make_private(&key)?;
                        return Ok((pair, validity));
                    }
                    Err(why) => {
                        let why = why.to_string();
                        tracing::info!(why, "making a new certificate for TLS");
                    }
                },
                // A crash can part the two files; the authority makes good for it.
                Err(error) => tracing::warn!(%error, "making a new certificate for TLS"),
            }
        }
        self.issue(now)
    }

    /// Whether a certificate has to be replaced soon.
    pub(crate) const fn is_due(validity: Validity, now: i64) -> bool {
        now + LEFT > validity.until || now < validity.from
    }

    /// Makes a new certificate.
    pub(crate) fn issue(&self, now: i64) -> Result<(Arc<CertifiedKey>, Validity), TlsError> {
        let own = KeyPair::generate()?;
        let mut params = CertificateParams::new(self.names.clone())?;
        params.distinguished_name = DistinguishedName::new();
        params
            .distinguished_name
            .push(DnType::CommonName, "Terracrawler server");
        lasts(&mut params, now - BACK, now + CERTIFICATE);
        params.use_authority_key_identifier_extension = true;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
        let signed = params.signed_by(&own, &self.issuer)?;
        let (certificate, key) = self.paths();
        files::write(&key, &own.serialize_pem(), true)?;
        files::write(&certificate, &signed.pem(), false)?;
        files::pair(&certificate, &key)
    }

    fn paths(&self) -> (PathBuf, PathBuf) {
        (self.dir.join("server.pem"), self.dir.join("server.key"))
    }

    /// Whether a client that pinned the authority accepts the certificate under every name, now
    /// and for a while to come.
    fn check(
        &self,
        pair: &CertifiedKey,
        validity: Validity,
        now: i64,
    ) -> Result<(), RenewalReason> {
        if Self::is_due(validity, now) {
            return Err(RenewalReason::Ends);
        }
        let roots = files::authorities(&self.certificate()).map_err(RenewalReason::Authority)?;
        let client = WebPkiServerVerifier::builder_with_provider(Arc::new(roots), provider())
            .build()
            .map_err(RenewalReason::Verifier)?;
        let leaf = pair.cert.first().ok_or(RenewalReason::Empty)?;
        let now = UnixTime::since_unix_epoch(Duration::from_secs(now.try_into().unwrap_or(0)));
        for name in &self.names {
            let as_name = ServerName::try_from(name.as_str()).map_err(RenewalReason::Name)?;
            client
                .verify_server_cert(leaf, &[], &as_name, &[], now)
                .map_err(|error| RenewalReason::NotFor(name.clone(), error))?;
        }
        Ok(())
    }
}

/// What the certificate of the authority says, the same for the same key whenever it is made.
fn authority(key: &KeyPair, now: i64) -> CertificateParams {
    let mut params = CertificateParams::default();
    // Several servers' authorities must be told apart in one list.
    let id = hex(params.key_identifier(key).get(..4).unwrap_or_default());
    params.distinguished_name = DistinguishedName::new();
    params
        .distinguished_name
        .push(DnType::CommonName, format!("Terracrawler authority {id}"));
    lasts(&mut params, now - BACK, now + AUTHORITY);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params
}

fn write_authority(path: &Path, key: &KeyPair, now: i64) -> Result<(), TlsError> {
    let certificate = authority(key, now).self_signed(key)?;
    files::write(path, &certificate.pem(), false)
}

fn load_key(path: &Path) -> Result<KeyPair, TlsError> {
    let wrong = |text: String| TlsError::Content {
        path: path.to_owned(),
        text,
    };
    let text = String::from_utf8(files::read(path)?).map_err(|error| wrong(error.to_string()))?;
    KeyPair::from_pem(&text).map_err(|error| wrong(format!("holds no usable key: {error}")))
}

/// Sets when a certificate is valid.
fn lasts(params: &mut CertificateParams, from: i64, until: i64) {
    let since = |time: i64| Duration::from_secs(time.try_into().unwrap_or(0));
    params.not_before = rcgen::date_time_ymd(1970, 1, 1) + since(from);
    params.not_after = rcgen::date_time_ymd(1970, 1, 1) + since(until);
}
