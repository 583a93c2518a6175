//! A connection to somebody else's listener, who must show a certificate that is trusted under the name it was called
//! by.

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_rustls::rustls::{CertificateError, ClientConfig, Error, RootCertStore};

use crate::{files, provider};

/// For connecting and the handshake.
const TIME_OUT: Duration = Duration::from_secs(10);

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
    /// One line: a file that holds no authorities, or a host that no certificate can be for.
    pub fn new(
        host: &str,
        port: u16,
        ca: Option<&Path>,
        option: &'static str,
    ) -> Result<Self, String> {
        let roots = match ca {
            Some(path) => files::authorities(path).map_err(|error| error.to_string())?,
            None => of_this_machine(option)?,
        };
        let config = ClientConfig::builder_with_provider(provider())
            .with_safe_default_protocol_versions()
            .map_err(|error| error.to_string())?
            .with_root_certificates(roots)
            .with_no_client_auth();
        let name = ServerName::try_from(host.to_owned())
            .map_err(|_| format!("no certificate can be for the host name {host}"))?;
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
    /// One line saying what is wrong, and what to do about it.
    pub async fn connect(&self) -> Result<TlsStream<TcpStream>, String> {
        let connecting = async {
            let tcp = TcpStream::connect((self.host.as_str(), self.port)).await?;
            // Only costs latency when it fails.
            let _ = tcp.set_nodelay(true);
            self.connector.connect(self.name.clone(), tcp).await
        };
        match tokio::time::timeout(TIME_OUT, connecting).await {
            Ok(Ok(stream)) => Ok(stream),
            Ok(Err(error)) => Err(describe(&error, self.option)),
            Err(_) => Err(format!("no answer within {} s", TIME_OUT.as_secs())),
        }
    }
}

fn of_this_machine(option: &str) -> Result<RootCertStore, String> {
    let mut roots = RootCertStore::empty();
    let found = rustls_native_certs::load_native_certs();
    roots.add_parsable_certificates(found.certs);
    if roots.is_empty() {
        return Err(format!(
            "this machine trusts no certificate authority: name one with {option}"
        ));
    }
    Ok(roots)
}

/// What is wrong, and what to do about it.
fn describe(error: &io::Error, option: &str) -> String {
    let tls = error
        .get_ref()
        .and_then(|error| error.downcast_ref::<Error>());
    match tls {
        Some(Error::InvalidCertificate(CertificateError::UnknownIssuer)) => format!(
            "its certificate is of an authority that is not trusted; name that with {option}"
        ),
        Some(Error::InvalidCertificate(
            CertificateError::Expired | CertificateError::ExpiredContext { .. },
        )) => "its certificate has expired".into(),
        Some(Error::InvalidCertificate(
            CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. },
        )) => "its certificate is for another host name".into(),
        Some(Error::InvalidMessage(_)) => "it does not speak TLS at this port".into(),
        Some(error) => format!("TLS: {error}"),
        None if error.kind() == io::ErrorKind::UnexpectedEof => {
            "it ended the connection; it may not speak TLS at this port".into()
        }
        None => error.to_string(),
    }
}
