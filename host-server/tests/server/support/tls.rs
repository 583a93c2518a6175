//! Certificates, and clients that encrypt.
// Nobody else's, as the rest of the support.

use std::io;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;

use http_body_util::{BodyExt as _, Empty};
use hyper::Request;
use hyper::body::Bytes;
use hyper_util::rt::TokioIo;
use rcgen::{CertificateParams, ExtendedKeyUsagePurpose, KeyPair, date_time_ymd};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

/// What a certificate is to be.
#[derive(Clone, Copy)]
pub struct Made {
    pub from: (i32, u8, u8),
    pub until: (i32, u8, u8),
    pub client: bool,
}

impl Default for Made {
    fn default() -> Self {
        Self {
            from: (2020, 1, 1),
            until: (2080, 1, 1),
            client: false,
        }
    }
}

/// Makes a certificate that is its own authority: `NAME.pem` and `NAME.key`.
pub fn make(dir: &Path, name: &str, made: Made) {
    std::fs::create_dir_all(dir).expect("a directory");
    let key = KeyPair::generate().expect("key");
    let names = vec!["localhost".to_owned(), "127.0.0.1".to_owned()];
    let mut params = CertificateParams::new(names).expect("names");
    params.not_before = date_time_ymd(made.from.0, made.from.1, made.from.2);
    params.not_after = date_time_ymd(made.until.0, made.until.1, made.until.2);
    params.extended_key_usages = vec![if made.client {
        ExtendedKeyUsagePurpose::ClientAuth
    } else {
        ExtendedKeyUsagePurpose::ServerAuth
    }];
    let certificate = params.self_signed(&key).expect("certificate");
    std::fs::write(dir.join(format!("{name}.key")), key.serialize_pem()).expect("written");
    std::fs::write(dir.join(format!("{name}.pem")), certificate.pem()).expect("written");
}

/// What a client trusts, and shows.
pub type Trust = Arc<ClientConfig>;

pub fn trust(authority: &Path) -> Trust {
    trust_in(authority, None)
}

/// Shows `NAME.pem`, if any.
pub fn trust_in(authority: &Path, own: Option<&Path>) -> Trust {
    let certificate = |path: &Path| CertificateDer::from_pem_file(path).expect("a certificate");
    let mut roots = RootCertStore::empty();
    roots.add(certificate(authority)).expect("an authority");
    let config = ClientConfig::builder_with_provider(Arc::new(default_provider()))
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_root_certificates(roots);
    Arc::new(match own {
        None => config.with_no_client_auth(),
        Some(own) => {
            let key = PrivateKeyDer::from_pem_file(own.with_extension("key")).expect("a key");
            config
                .with_client_auth_cert(vec![certificate(&own.with_extension("pem"))], key)
                .expect("a pair")
        }
    })
}

/// Connects under a name.
pub async fn shake(
    address: SocketAddr,
    trust: &Trust,
    name: &str,
) -> io::Result<TlsStream<TcpStream>> {
    let name = ServerName::try_from(name.to_owned()).expect("a name");
    let tcp = TcpStream::connect(address).await?;
    TlsConnector::from(Arc::clone(trust))
        .connect(name, tcp)
        .await
}

/// One request over TLS: status and body.
pub async fn get(
    address: SocketAddr,
    trust: &Trust,
    name: &str,
    path: &str,
) -> io::Result<(u16, String)> {
    let stream = shake(address, trust, name).await?;
    let (mut sender, connection) = hyper::client::conn::http1::handshake(TokioIo::new(stream))
        .await
        .map_err(io::Error::other)?;
    tokio::spawn(connection);
    let request = Request::builder()
        .uri(path)
        .header("host", format!("localhost:{}", address.port()))
        .body(Empty::<Bytes>::new())
        .expect("request");
    let response = sender
        .send_request(request)
        .await
        .map_err(io::Error::other)?;
    let status = response.status().as_u16();
    let body = response
        .into_body()
        .collect()
        .await
        .map_err(io::Error::other)?;
    let text = String::from_utf8(body.to_bytes().to_vec()).expect("text");
    Ok((status, text))
}

/// A port that leads to another of this machine over TLS, for clients that have none.
pub async fn pipe(port: u16, trust: &Trust) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let own = listener.local_addr().expect("bound").port();
    let trust = Arc::clone(trust);
    tokio::spawn(async move {
        while let Ok((mut near, _)) = listener.accept().await {
            let trust = Arc::clone(&trust);
            tokio::spawn(async move {
                let far = shake(([127, 0, 0, 1], port).into(), &trust, "localhost").await;
                if let Ok(mut far) = far {
                    let _ = tokio::io::copy_bidirectional(&mut near, &mut far).await;
                }
            });
        }
    });
    own
}
