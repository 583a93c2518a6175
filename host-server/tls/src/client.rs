//! A connection to somebody else's listener, who must show a certificate that is trusted under the name it was called
//! by.

use std::error;
use std::fmt;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_rustls::rustls::{CertificateError, ClientConfig, Error, RootCertStore};

use crate::error::TlsError;
use crate::files;
use crate::provider::provider;

/// For connecting and the handshake.
const TIME_OUT: Duration = Duration::from_secs(10);

/// Why there is no connection to a listener, or none is tried.
#[derive(Debug)]
#[non_exhaustive]
pub enum ConnectError {
    /// The file with authorities cannot be used.
    Authorities(TlsError),
    /// This machine trusts nobody; the option that names authorities.
    NobodyTrusted(&'static str),
    /// No certificate can be for a host of this name.
    HostName(String),
    /// TLS cannot be set up here.
    SetUp(Error),
    /// The other end cannot be reached, or goes away.
    Io(io::Error),
    /// It ended the connection instead of a handshake.
    Ended(io::Error),
    /// It says what is not TLS.
    NotTls(Error),
    /// Its certificate is of an authority that is not trusted; the option that names authorities.
    UnknownAuthority(&'static str),
    /// Its certificate has expired.
    Expired,
    /// Its certificate is for another host name.
    OtherName,
    /// The handshake has failed in another way.
    Handshake(Error),
    /// It did not answer in time.
    TimedOut,
}

impl ConnectError {
    /// What went wrong while connecting; `option` is the one that names authorities.
    fn of(error: io::Error, option: &'static str) -> Self {
        let tls = error
            .get_ref()
            .and_then(|error| error.downcast_ref::<Error>());
        match tls {
            Some(Error::InvalidCertificate(CertificateError::UnknownIssuer)) => {
                Self::UnknownAuthority(option)
            }
            Some(Error::InvalidCertificate(
                CertificateError::Expired | CertificateError::ExpiredContext { .. },
            )) => Self::Expired,
            Some(Error::InvalidCertificate(
                CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. },
            )) => Self::OtherName,
            Some(error @ Error::InvalidMessage(_)) => Self::NotTls(error.clone()),
            Some(error) => Self::Handshake(error.clone()),
            None if error.kind() == io::ErrorKind::UnexpectedEof => Self::Ended(error),
            None => Self::Io(error),
        }
    }
}

impl fmt::Display for ConnectError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Authorities(error) => error.fmt(f),
            Self::NobodyTrusted(option) => write!(
                f,
                "this machine trusts no certificate authority: name one with {option}"
            ),
            Self::HostName(host) => {
                write!(f, "no certificate can be for the host name {host}")
            }
            Self::SetUp(error) => error.fmt(f),
            Self::Io(error) => error.fmt(f),
            Self::Ended(_) => {
                f.write_str("it ended the connection; it may not speak TLS at this port")
            }
            Self::NotTls(_) => f.write_str("it does not speak TLS at this port"),
            Self::UnknownAuthority(option) => write!(
                f,
                "its certificate is of an authority that is not trusted; name that with {option}"
            ),
            Self::Expired => f.write_str("its certificate has expired"),
            Self::OtherName => f.write_str("its certificate is for another host name"),
            Self::Handshake(error) => write!(f, "TLS: {error}"),
            Self::TimedOut => write!(f, "no answer within {} s", TIME_OUT.as_secs()),
        }
    }
}

impl error::Error for ConnectError {
    fn source(&self) -> Option<&(dyn error::Error + 'static)> {
        match self {
            Self::Authorities(error) => Some(error),
            Self::SetUp(error) | Self::NotTls(error) | Self::Handshake(error) => Some(error),
            Self::Io(error) | Self::Ended(error) => Some(error),
            Self::NobodyTrusted(_)
            | Self::HostName(_)
            | Self::UnknownAuthority(_)
            | Self::Expired
            | Self::OtherName
            | Self::TimedOut => None,
        }
    }
}

/// Connects to one listener.
pub struct TlsClient {
    host: String,
    port: u16,
    name: ServerName<'static>,
    connector: TlsConnector,
    option: &'static str,
}

impl TlsClient {
    /// Does not connect yet. The other end is trusted by the authorities in `ca`, or else by those that this machine
    /// trusts. `option` is the one that names `ca`, for messages.
    ///
    /// # Errors
    /// [`ConnectError`]: a file that holds no authorities, or a host that no certificate can be for.
    pub fn new(
        host: &str,
        port: u16,
        ca: Option<&Path>,
        option: &'static str,
    ) -> Result<Self, ConnectError> {
        let roots = match ca {
            Some(path) => files::authorities(path).map_err(ConnectError::Authorities)?,
            None => of_this_machine(option)?,
        };
        let config = ClientConfig::builder_with_provider(provider())
            .with_safe_default_protocol_versions()
            .map_err(ConnectError::SetUp)?
            .with_root_certificates(roots)
            .with_no_client_auth();
        let name = ServerName::try_from(host.to_owned())
            .map_err(|_| ConnectError::HostName(host.to_owned()))?;
        Ok(Self {
            host: host.to_owned(),
            port,
            name,
            connector: TlsConnector::from(Arc::new(config)),
            option,
        })
    }

    /// A connection.
    ///
    /// # Errors
    /// [`ConnectError`]
    pub async fn connect(&self) -> Result<TlsStream<TcpStream>, ConnectError> {
        let connecting = async {
            let tcp = TcpStream::connect((self.host.as_str(), self.port)).await?;
            // Only costs latency when it fails.
            let _ = tcp.set_nodelay(true);
            self.connector.connect(self.name.clone(), tcp).await
        };
        match tokio::time::timeout(TIME_OUT, connecting).await {
            Ok(Ok(stream)) => Ok(stream),
            Ok(Err(error)) => Err(ConnectError::of(error, self.option)),
            Err(_) => Err(ConnectError::TimedOut),
        }
    }
}

fn of_this_machine(option: &'static str) -> Result<RootCertStore, ConnectError> {
    let mut roots = RootCertStore::empty();
    let found = rustls_native_certs::load_native_certs();
    roots.add_parsable_certificates(found.certs);
    if roots.is_empty() {
        return Err(ConnectError::NobodyTrusted(option));
    }
    Ok(roots)
}
