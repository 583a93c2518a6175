//! HTTP to one engine: connections that are kept, requests that end in time.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use http_body_util::{BodyExt as _, Full, LengthLimitError, Limited};
use hyper::body::Bytes;
use hyper::client::conn::http1::{self, SendRequest};
use hyper::header::{
    ACCEPT, AUTHORIZATION, CONTENT_TYPE, HOST, HeaderMap, HeaderValue, USER_AGENT,
};
use hyper::{Method, Request, StatusCode};
use hyper_util::rt::TokioIo;
use serde::de::DeserializeOwned;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{self, ClientConfig, RootCertStore};

use crate::address::Address;
use crate::error::EngineError;

/// For a request, with connecting and the whole answer.
pub(crate) const TIME_OUT: Duration = Duration::from_secs(5);
/// Longest answer; that to the largest question has about 14 MB.
const LONGEST: usize = 32 * 1024 * 1024;
/// Connections kept for the next request.
const IDLE: usize = 8;
/// Characters of an engine's complaint that are told on.
const COMPLAINT: usize = 300;

/// `InfluxDB` writes answers in it at half the cost of JSON.
const PACKED: &str = "application/x-msgpack";

type Sender = SendRequest<Full<Bytes>>;

/// What an engine answered.
pub(crate) struct Answer {
    pub(crate) status: StatusCode,
    pub(crate) headers: HeaderMap,
    pub(crate) body: Bytes,
}

impl Answer {
    /// What it complains of, in one short line.
    pub(crate) fn complaint(&self) -> String {
        #[derive(serde::Deserialize)]
        struct Complaint {
            #[serde(alias = "message")]
            error: String,
        }
        let text = self.read::<Complaint>().map_or_else(
            |_| String::from_utf8_lossy(&self.body).into_owned(),
            |complaint| complaint.error,
        );
        one_line(&text, self.status.as_str())
    }

    /// What it says, in the form that it is in.
    pub(crate) fn read<T: DeserializeOwned>(&self) -> Result<T, EngineError> {
        let kind = self.headers.get(CONTENT_TYPE).map(HeaderValue::as_bytes);
        if kind.is_some_and(|kind| kind.starts_with(PACKED.as_bytes())) {
            rmp_serde::from_slice(&self.body)
                .map_err(|error| EngineError::Nonsense(error.to_string()))
        } else {
            serde_json::from_slice(&self.body)
                .map_err(|error| EngineError::Nonsense(error.to_string()))
        }
    }

    /// The answer, where it is one: the status says so.
    pub(crate) fn accepted(self) -> Result<Self, EngineError> {
        let status = self.status.as_u16();
        let said = || self.complaint();
        Err(match status {
            200..=299 => return Ok(self),
            401 | 403 => EngineError::Denied(said()),
            404 if said().contains("database not found") || said().contains("bucket") => {
                EngineError::NoDatabase(said())
            }
            404 | 405 => EngineError::Nonsense(format!("{status} {}", said())),
            300..=399 => EngineError::Nonsense(format!("{status}, a redirection")),
            408 | 429 | 500.. => EngineError::Busy(format!("{status} {}", said())),
            _ => EngineError::Refused(format!("{status} {}", said())),
        })
    }
}

/// `text` without what would end a line of a log, and not too long; `or` when nothing is left.
pub(crate) fn one_line(text: &str, or: &str) -> String {
    let line: String = text
        .trim()
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .take(COMPLAINT)
        .collect();
    if line.is_empty() { or.to_owned() } else { line }
}

/// Speaks HTTP with one engine.
pub(crate) struct Client {
    address: Address,
    tls: Option<(TlsConnector, ServerName<'static>)>,
    idle: Mutex<Vec<Sender>>,
}

fn trusted(ca: Option<&Path>) -> Result<RootCertStore, EngineError> {
    let mut roots = RootCertStore::empty();
    if let Some(path) = ca {
        let said = |error: &dyn std::fmt::Display| {
            EngineError::Certificates(format!("{}: {error}", path.display()))
        };
        let certificates = CertificateDer::pem_file_iter(path).map_err(|error| said(&error))?;
        for certificate in certificates {
            let certificate = certificate.map_err(|error| said(&error))?;
            roots.add(certificate).map_err(|error| said(&error))?;
        }
        if roots.is_empty() {
            let text = format!("{} has no certificate", path.display());
            return Err(EngineError::Certificates(text));
        }
        return Ok(roots);
    }
    roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
    if roots.is_empty() {
        let text = "this machine trusts no certificate authority".to_owned();
        return Err(EngineError::Certificates(text));
    }
    Ok(roots)
}

fn connector(address: &Address) -> Result<(TlsConnector, ServerName<'static>), EngineError> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|error| EngineError::Certificates(error.to_string()))?
        .with_root_certificates(trusted(address.ca.as_deref())?)
        .with_no_client_auth();
    let name = ServerName::try_from(address.host.clone()).map_err(|_| {
        let text = format!("no certificate can be for the host name {}", address.host);
        EngineError::Certificates(text)
    })?;
    Ok((TlsConnector::from(Arc::new(config)), name))
}

impl Client {
    /// Does not connect yet.
    ///
    /// # Errors
    /// [`EngineError::Certificates`] when TLS is wanted and nobody is trusted.
    pub(crate) fn new(address: Address) -> Result<Self, EngineError> {
        let tls = if address.tls {
            Some(connector(&address)?)
        } else {
            None
        };
        Ok(Self {
            address,
            tls,
            idle: Mutex::default(),
        })
    }

    pub(crate) const fn address(&self) -> &Address {
        &self.address
    }

    /// The answer to one request, whatever its status. `target` is path and query.
    pub(crate) async fn send(
        &self,
        method: Method,
        target: &str,
        body: Bytes,
    ) -> Result<Answer, EngineError> {
        let request = self.request(method, target).body(Full::new(body));
        self.timely(request).await
    }

    /// The answer to a question, packed where the engine can.
    pub(crate) async fn get_packed(&self, target: &str) -> Result<Answer, EngineError> {
        let request = self.request(Method::GET, target).header(ACCEPT, PACKED);
        self.timely(request.body(Full::default())).await
    }

    async fn timely(
        &self,
        request: Result<Request<Full<Bytes>>, hyper::http::Error>,
    ) -> Result<Answer, EngineError> {
        let request = request.map_err(|error| EngineError::Invalid(error.to_string()))?;
        match tokio::time::timeout(TIME_OUT, self.exchange(request)).await {
            Ok(answer) => answer,
            Err(_) => Err(EngineError::Unreachable(format!(
                "nothing within {} s",
                TIME_OUT.as_secs()
            ))),
        }
    }

    pub(crate) async fn get(&self, target: &str) -> Result<Answer, EngineError> {
        self.send(Method::GET, target, Bytes::new()).await
    }

    fn request(&self, method: Method, target: &str) -> hyper::http::request::Builder {
        let request = Request::builder()
            .method(method)
            .uri(target)
            .header(HOST, self.address.authority())
            .header(
                USER_AGENT,
                concat!("terracrawler/", env!("CARGO_PKG_VERSION")),
            )
            .header(CONTENT_TYPE, "text/plain; charset=utf-8");
        match &self.address.authorization {
            Some(authorization) => request.header(AUTHORIZATION, authorization),
            None => request,
        }
    }

    async fn exchange(&self, mut request: Request<Full<Bytes>>) -> Result<Answer, EngineError> {
        let lost = |error: hyper::Error| EngineError::Unreachable(error.to_string());
        loop {
            let kept = self.idle().pop();
            let fresh = kept.is_none();
            let mut sender = match kept {
                Some(sender) => sender,
                None => self.connect().await?,
            };
            let response = match sender.try_send_request(request).await {
                Ok(response) => response,
                Err(mut error) => match error.take_message() {
                    // It was closed while nobody used it, and nothing of this was sent.
                    Some(unsent) if !fresh => {
                        request = unsent;
                        continue;
                    }
                    _ => return Err(lost(error.into_error())),
                },
            };
            let (parts, body) = response.into_parts();
            let body = Limited::new(body, LONGEST).collect().await;
            let body = body.map_err(|error| {
                if error.is::<LengthLimitError>() {
                    EngineError::Nonsense(format!("it is longer than {LONGEST} bytes"))
                } else {
                    EngineError::Unreachable(error.to_string())
                }
            })?;
            self.keep(sender);
            return Ok(Answer {
                status: parts.status,
                headers: parts.headers,
                body: body.to_bytes(),
            });
        }
    }

    fn idle(&self) -> std::sync::MutexGuard<'_, Vec<Sender>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn keep(&self, sender: Sender) {
        let mut idle = self.idle();
        idle.retain(|sender| !sender.is_closed());
        if !sender.is_closed() && idle.len() < IDLE {
            idle.push(sender);
        }
    }

    async fn connect(&self) -> Result<Sender, EngineError> {
        let lost = |error: std::io::Error| {
            let tls = error.get_ref().and_then(|error| error.downcast_ref());
            match tls {
                Some(rustls::Error::InvalidCertificate(why)) => {
                    EngineError::Certificates(format!("its certificate is not trusted: {why}"))
                }
                _ => EngineError::Unreachable(error.to_string()),
            }
        };
        let tcp = TcpStream::connect((self.address.host.as_str(), self.address.port))
            .await
            .map_err(lost)?;
        // Only costs latency when it fails.
        let _ = tcp.set_nodelay(true);
        match &self.tls {
            None => handshake(tcp).await,
            Some((connector, name)) => {
                handshake(connector.connect(name.clone(), tcp).await.map_err(lost)?).await
            }
        }
    }
}

async fn handshake<S>(stream: S) -> Result<Sender, EngineError>
where
    S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
{
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream))
        .await
        .map_err(|error| EngineError::Unreachable(error.to_string()))?;
    // Ends with the sender, or with the engine's side; what went wrong the sender is told.
    tokio::spawn(async move {
        let _ = connection.await;
    });
    sender
        .ready()
        .await
        .map_err(|error| EngineError::Unreachable(error.to_string()))?;
    Ok(sender)
}
