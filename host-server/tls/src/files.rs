//! Certificates and keys in PEM files.

use std::fs::{self, File};
use std::io::{self, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio_rustls::rustls::pki_types::pem::{self, PemObject as _};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::sign::CertifiedKey;
use tokio_rustls::rustls::{Error, InconsistentKeys, RootCertStore};

use crate::error::TlsError;
use crate::provider::provider;
use crate::validity::{Validity, day_of};

/// Far above every chain, also above the list of all public authorities.
const LONGEST: u64 = 4 * 1024 * 1024;

/// Reads a whole file, which may not be endless.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, TlsError> {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(LONGEST + 1).read_to_end(&mut bytes));
    match read {
        Ok(length) if length as u64 > LONGEST => Err(content(path, "is too long for a PEM file")),
        Ok(_) => Ok(bytes),
        Err(cause) => Err(TlsError::File {
            path: path.to_owned(),
            cause,
        }),
    }
}

/// The first certificate in a file, in DER.
///
/// # Errors
/// [`TlsError`] says what is wrong with the file.
pub fn first_certificate(path: &Path) -> Result<Vec<u8>, TlsError> {
    let certificates = certificates(path)?;
    Ok(certificates
        .first()
        .map(|der| der.to_vec())
        .unwrap_or_default())
}

/// The certificates in a file, at least one.
pub(crate) fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let certificates = CertificateDer::pem_slice_iter(&read(path)?)
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| content(path, &format!("is no PEM file: {error}")))?;
    if certificates.is_empty() {
        return Err(content(path, "holds no certificate (BEGIN CERTIFICATE)"));
    }
    Ok(certificates)
}

/// The authorities in a file, at least one.
pub(crate) fn authorities(path: &Path) -> Result<RootCertStore, TlsError> {
    let mut roots = RootCertStore::empty();
    for certificate in certificates(path)? {
        roots
            .add(certificate)
            .map_err(|error| content(path, &format!("is not usable as an authority: {error}")))?;
    }
    Ok(roots)
}

/// A certificate with its chain and its key, which belong together, and the time it is valid.
pub(crate) fn pair(
    certificate: &Path,
    key: &Path,
) -> Result<(Arc<CertifiedKey>, Validity), TlsError> {
    let chain = certificates(certificate)?;
    let validity = chain
        .first()
        .and_then(|leaf| Validity::of(leaf))
        .ok_or_else(|| content(certificate, "holds something that is no certificate"))?;
    let private = PrivateKeyDer::from_pem_slice(&read(key)?).map_err(|error| {
        let text = match error {
            pem::Error::NoItemsFound => {
                "holds no private key (BEGIN PRIVATE KEY); an encrypted one cannot be read".into()
            }
            error => format!("holds no usable private key: {error}"),
        };
        content(key, &text)
    })?;
    let pair =
        CertifiedKey::from_der(chain, private, &provider()).map_err(|error| match error {
            Error::InconsistentKeys(InconsistentKeys::KeyMismatch) => TlsError::Mismatch {
                certificate: certificate.to_owned(),
                key: key.to_owned(),
            },
            error => content(key, &format!("cannot be used: {error}")),
        })?;
    Ok((Arc::new(pair), validity))
}

/// Whether a certificate is valid at `now`, in Unix seconds.
pub(crate) fn check_time(path: &Path, validity: Validity, now: i64) -> Result<(), TlsError> {
    let text = if now > validity.until {
        format!("expired on {}", day_of(validity.until))
    } else if now < validity.from {
        format!("is not valid before {}", day_of(validity.from))
    } else {
        return Ok(());
    };
    Err(TlsError::Time {
        path: path.to_owned(),
        text,
    })
}

fn content(path: &Path, text: &str) -> TlsError {
    TlsError::Content {
        path: path.to_owned(),
        text: text.to_owned(),
    }
}

/// Makes a directory that nobody else may look into.
pub(crate) fn private_dir(path: &Path) -> Result<(), TlsError> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(path).map_err(|cause| TlsError::File {
        path: path.to_owned(),
        cause,
    })
}

/// Writes a file, whole or not at all. Others may read it unless it is `secret`.
pub(crate) fn write(path: &Path, text: &str, secret: bool) -> Result<(), TlsError> {
    let new = with_suffix(path, ".new");
    let write = || -> io::Result<()> {
        // A left-over would keep the rights it had.
        match fs::remove_file(&new) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let mut options = File::options();
        options.write(true).create_new(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, if secret { 0o600 } else { 0o644 });
        let mut file = options.open(&new)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&new, path)?;
        // The new name must survive a loss of power, too.
        match path.parent() {
            Some(directory) => File::open(directory)?.sync_all(),
            None => Ok(()),
        }
    };
    write().map_err(|cause| TlsError::File {
        path: path.to_owned(),
        cause,
    })
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// Takes from others the right to read a key of ours, should somebody have given it to them.
#[cfg(unix)]
pub(crate) fn make_private(path: &Path) -> Result<(), TlsError> {
    use std::os::unix::fs::PermissionsExt as _;
    let tighten = || -> io::Result<()> {
        let mode = fs::metadata(path)?.permissions().mode();
        if mode & 0o077 != 0 {
            tracing::warn!(path = %path.display(), "others could read this key; now they cannot");
            fs::set_permissions(path, fs::Permissions::from_mode(0o600))?;
        }
        Ok(())
    };
    tighten().map_err(|cause| TlsError::File {
        path: path.to_owned(),
        cause,
    })
}

#[cfg(not(unix))]
pub(crate) fn make_private(_: &Path) -> Result<(), TlsError> {
    Ok(())
}

/// Whether every account of this machine may read a file.
pub(crate) fn is_public(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        fs::metadata(path).is_ok_and(|data| data.permissions().mode() & 0o004 != 0)
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        false
    }
}
