//! The API of a running server, as commands call it: one connection, one request after the other.
//!
//! Whoever names an account is logged in, and logged out again when the command is done. The password comes from a
//! person or a file, never from an argument.

mod error;
mod url;

use std::path::Path;
use std::time::Duration;

use crawler_server_tls::{ConnectError, TlsClient};
use http_body_util::{BodyExt as _, Full, Limited};
use hyper::body::Bytes;
use hyper::client::conn::http1::{self, SendRequest};
use hyper::{HeaderMap, Method, Request, StatusCode, header};
use hyper_util::rt::TokioIo;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;

pub(crate) use error::CallError;
pub(crate) use url::ServerUrl;

use error::{ExchangeError, Refusal};

/// For a request, with connecting and the whole answer: three times what the server takes at most.
const TIME_OUT: Duration = Duration::from_secs(30);
/// Longest answer. The robots of a page, a thousand of them, have less than 512 KiB, and so has a plan.
const LONGEST: usize = 8 * 1024 * 1024;
/// What says that a token is no longer one, and the session may go on.
const EXPIRED: &str = "expired_token";

type Sender = SendRequest<Full<Bytes>>;

/// What somebody who has logged in goes on with.
struct Login {
    token: String,
    /// The cookie with which the session goes on, as it is sent back.
    cookie: Option<String>,
}

/// Speaks with one server.
pub(crate) struct Client {
    url: ServerUrl,
    tls: Option<TlsClient>,
    sender: Option<Sender>,
    login: Option<Login>,
}

struct Answer {
    status: StatusCode,
    headers: HeaderMap,
    body: Bytes,
}

impl Client {
    /// Does not connect yet. A server with TLS is trusted by the authorities in `ca`, or else by those of this machine.
    ///
    /// # Errors
    /// When nobody can be trusted so.
    pub(crate) fn new(url: ServerUrl, ca: Option<&Path>) -> Result<Self, ConnectError> {
        let tls = url
            .tls
            .then(|| TlsClient::new(&url.host, url.port, ca, "--ca"));
        Ok(Self {
            tls: tls.transpose()?,
            url,
            sender: None,
            login: None,
        })
    }

    /// Logs in.
    ///
    /// # Errors
    /// [`CallError`]
    pub(crate) async fn log_in(&mut self, user: &str, password: &str) -> Result<(), CallError> {
        let body = json!({ "user": user, "password": password });
        let path = "/api/v1/session";
        self.enter(path, body.to_string().into_bytes()).await
    }

    /// Takes what a call about the session answers with.
    async fn enter(&mut self, path: &str, body: Vec<u8>) -> Result<(), CallError> {
        #[derive(Deserialize)]
        struct Entered {
            token: String,
        }
        let answer = self.send(Method::POST, path, body).await?;
        let entered: Entered = read(&answer)?;
        let before = self.login.take();
        self.login = Some(Login {
            token: entered.token,
            cookie: cookie(&answer.headers).or_else(|| before?.cookie),
        });
        Ok(())
    }

    /// Ends the session, where there is one. One that cannot be ended ends by itself.
    pub(crate) async fn log_out(&mut self) {
        if self.login.is_some() {
            let path = "/api/v1/session";
            let _ = self.send(Method::DELETE, path, Vec::new()).await;
            self.login = None;
        }
    }

    /// What is at `path`.
    ///
    /// # Errors
    /// [`CallError`]
    pub(crate) async fn get(&mut self, path: &str) -> Result<Value, CallError> {
        self.call(Method::GET, path, Vec::new()).await
    }

    /// Has something done, and returns what the server answers with. `body` is JSON, or nothing.
    ///
    /// # Errors
    /// [`CallError`]. After [`CallError::Unreachable`] it may be done all the same.
    pub(crate) async fn post(&mut self, path: &str, body: Vec<u8>) -> Result<Value, CallError> {
        self.call(Method::POST, path, body).await
    }

    /// Has something ended, or taken away.
    ///
    /// # Errors
    /// As [`Self::post`].
    pub(crate) async fn delete(&mut self, path: &str) -> Result<(), CallError> {
        let answer = self.answer(Method::DELETE, path, Vec::new()).await;
        answer.map(|_| ())
    }

    async fn call(
        &mut self,
        method: Method,
        path: &str,
        body: Vec<u8>,
    ) -> Result<Value, CallError> {
        read(&self.answer(method, path, body).await?)
    }

    async fn answer(
        &mut self,
        method: Method,
        path: &str,
        body: Vec<u8>,
    ) -> Result<Answer, CallError> {
        let first = self.send(method.clone(), path, body.clone()).await;
        let expired = matches!(&first, Err(CallError::Refused(refusal)) if refusal.code == EXPIRED);
        if !expired
            || self
                .login
                .as_ref()
                .is_none_or(|login| login.cookie.is_none())
        {
            return first;
        }
        // Refused before it was looked at: nothing is done twice.
        self.enter("/api/v1/session/refresh", Vec::new()).await?;
        self.send(method, path, body).await
    }

    /// The answer, where it is one that the status calls good.
    async fn send(
        &mut self,
        method: Method,
        path: &str,
        body: Vec<u8>,
    ) -> Result<Answer, CallError> {
        let url = self.url.to_string();
        let lost = |why| CallError::Unreachable { url, why };
        let answer = tokio::time::timeout(TIME_OUT, self.exchange(method, path, body)).await;
        let answer = match answer {
            Ok(Ok(answer)) => answer,
            Ok(Err(why)) => {
                self.sender = None;
                return Err(lost(why));
            }
            Err(_) => {
                self.sender = None;
                return Err(lost(ExchangeError::TimedOut(TIME_OUT)));
            }
        };
        if answer.status.is_success() {
            return Ok(answer);
        }
        let as_whom = self.login.is_some();
        Err(match Refusal::read(answer.status, &answer.body, as_whom) {
            Some(refusal) => CallError::Refused(refusal),
            None => CallError::Strange(format!("it answers with status {}", answer.status)),
        })
    }

    async fn exchange(
        &mut self,
        method: Method,
        path: &str,
        body: Vec<u8>,
    ) -> Result<Answer, ExchangeError> {
        let mut request = self.request(method, path, body)?;
        loop {
            let kept = self.sender.take().filter(|sender| !sender.is_closed());
            let fresh = kept.is_none();
            let mut sender = match kept {
                Some(sender) => sender,
                None => self.connect().await?,
            };
            let response = match sender.try_send_request(request).await {
                Ok(response) => response,
                Err(mut error) => match error.take_message() {
                    // The connection was closed while nobody used it, and nothing of this was sent.
                    Some(unsent) if !fresh => {
                        request = unsent;
                        continue;
                    }
                    _ => return Err(ExchangeError::Http(error.into_error())),
                },
            };
            let (parts, body) = response.into_parts();
            let body = Limited::new(body, LONGEST).collect().await;
            let body = body.map_err(ExchangeError::Body)?;
            self.sender = Some(sender);
            return Ok(Answer {
                status: parts.status,
                headers: parts.headers,
                body: body.to_bytes(),
            });
        }
    }

    fn request(
        &self,
        method: Method,
        path: &str,
        body: Vec<u8>,
    ) -> Result<Request<Full<Bytes>>, ExchangeError> {
        let agent = concat!("terracrawler/", env!("CARGO_PKG_VERSION"));
        let mut request = Request::builder()
            .method(method)
            .uri(path)
            .header(header::HOST, self.url.authority())
            .header(header::USER_AGENT, agent);
        if !body.is_empty() {
            request = request.header(header::CONTENT_TYPE, "application/json");
        }
        if let Some(login) = &self.login {
            request = request.header(header::AUTHORIZATION, format!("Bearer {}", login.token));
            // Of the calls about the session alone, as browsers do.
            if let Some(cookie) = &login.cookie
                && path.starts_with("/api/v1/session")
            {
                request = request.header(header::COOKIE, cookie);
            }
        }
        let request = request.body(Full::new(Bytes::from(body)));
        request.map_err(ExchangeError::Request)
    }

    async fn connect(&self) -> Result<Sender, ExchangeError> {
        if let Some(tls) = &self.tls {
            let stream = tls.connect().await.map_err(ExchangeError::Tls)?;
            return handshake(stream).await;
        }
        let address = (self.url.host.as_str(), self.url.port);
        let stream = TcpStream::connect(address).await;
        handshake(stream.map_err(ExchangeError::Io)?).await
    }
}

async fn handshake<S>(stream: S) -> Result<Sender, ExchangeError>
where
    S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
{
    let (sender, connection) = http1::handshake(TokioIo::new(stream))
        .await
        .map_err(ExchangeError::Http)?;
    // Ends with the sender, or with the server's side; what went wrong the sender is told.
    tokio::spawn(async move {
        let _ = connection.await;
    });
    Ok(sender)
}

fn read<T: DeserializeOwned>(answer: &Answer) -> Result<T, CallError> {
    serde_json::from_slice(&answer.body)
        .map_err(|error| CallError::Strange(format!("its answer cannot be read: {error}")))
}

/// Name and value of the cookie that an answer sets.
fn cookie(headers: &HeaderMap) -> Option<String> {
    let set = headers.get(header::SET_COOKIE)?.to_str().ok()?;
    let pair = set.split(';').next()?.trim();
    pair.contains('=').then(|| pair.to_owned())
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    use tokio::net::TcpListener;

    use super::*;

    /// Whether the head of a request is there, and as much of its body as that says.
    fn is_whole(text: &str) -> bool {
        let Some((head, body)) = text.split_once("\r\n\r\n") else {
            return false;
        };
        let mut lines = head.lines();
        let length = lines.find_map(|line| line.strip_prefix("content-length: "));
        length.is_none_or(|length| length.parse() == Ok(body.len()))
    }

    /// A server that gives these answers, one after the other, and what it was asked.
    async fn scripted(answers: Vec<String>) -> (ServerUrl, tokio::task::JoinHandle<Vec<String>>) {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let served = tokio::spawn(async move {
            let mut asked = Vec::new();
            let mut answers = answers.into_iter();
            while answers.len() > 0 {
                let (mut stream, _) = listener.accept().await.expect("a connection");
                let mut text = String::new();
                let mut bytes = [0; 4_096];
                for answer in answers.by_ref() {
                    while !is_whole(&text) {
                        let length = stream.read(&mut bytes).await.expect("a request");
                        text.push_str(&String::from_utf8_lossy(&bytes[..length]));
                        assert!(length > 0, "half a request: {text}");
                    }
                    asked.push(std::mem::take(&mut text));
                    stream.write_all(answer.as_bytes()).await.expect("sent");
                    if answer.contains("connection: close") {
                        break;
                    }
                }
            }
            asked
        });
        let url = format!("http://{address}").parse().expect("an address");
        (url, served)
    }

    fn answer(status: &str, more: &str, body: &str) -> String {
        let length = body.len();
        format!("HTTP/1.1 {status}\r\n{more}content-length: {length}\r\n\r\n{body}")
    }

    #[tokio::test]
    async fn a_session_goes_on_when_its_token_has_expired() {
        let expired =
            r#"{"status": 401, "code": "expired_token", "detail": "the token has expired"}"#;
        let (url, served) = scripted(vec![
            answer(
                "200 OK",
                "set-cookie: refresh=one; HttpOnly\r\n",
                r#"{"token": "a"}"#,
            ),
            answer("401 Unauthorized", "", expired),
            answer(
                "200 OK",
                "set-cookie: refresh=two; HttpOnly\r\n",
                r#"{"token": "b"}"#,
            ),
            answer("200 OK", "", "[5]"),
            answer("204 No Content", "", ""),
        ])
        .await;
        let mut client = Client::new(url, None).expect("a client");
        client.log_in("ada", "secret").await.expect("in");
        assert_eq!(client.get("/x").await.expect("an answer"), json!([5]));
        client.log_out().await;
        let asked = served.await.expect("all was asked");
        let has = |at: usize, texts: &[&str]| {
            let request = &asked[at];
            for text in texts {
                assert!(request.contains(text), "{text}: {request}");
            }
        };
        has(0, &["POST /api/v1/session HTTP", r#""password":"secret""#]);
        has(1, &["GET /x HTTP", "authorization: Bearer a\r\n"]);
        assert!(!asked[1].contains("cookie"), "{}", asked[1]);
        has(
            2,
            &[
                "POST /api/v1/session/refresh HTTP",
                "cookie: refresh=one\r\n",
            ],
        );
        has(3, &["GET /x HTTP", "authorization: Bearer b\r\n"]);
        has(
            4,
            &["DELETE /api/v1/session HTTP", "cookie: refresh=two\r\n"],
        );
    }

    #[tokio::test]
    async fn what_is_refused_is_one_sentence_with_its_code() {
        let problem = r#"{"status": 429, "code": "too_\u001b[2J", "detail": "wait\nplease", "retry_after": 7}"#;
        let (url, served) = scripted(vec![
            answer("429 Too Many Requests", "connection: close\r\n", problem),
            answer(
                "401 Unauthorized",
                "",
                r#"{"code": "unauthenticated", "detail": "log in first"}"#,
            ),
            answer("502 Bad Gateway", "", "<html>"),
            answer("200 OK", "", "<html>"),
        ])
        .await;
        let mut client = Client::new(url, None).expect("a client");
        let mut texts = Vec::new();
        for _ in 0..4 {
            texts.push(client.get("/").await.expect_err("refused").to_string());
        }
        assert_eq!(texts[0], "wait\\nplease (too_\\u{1b}[2J); try again in 7 s");
        assert_eq!(
            texts[1],
            "log in first (unauthenticated); --user names an account"
        );
        assert_eq!(
            texts[2],
            "no server of robots: it answers with status 502 Bad Gateway"
        );
        assert!(
            texts[3].starts_with("no server of robots: its answer cannot be read"),
            "{}",
            texts[3]
        );
        served.await.expect("all was asked");
    }

    #[tokio::test]
    async fn a_server_that_is_not_there_is_named() {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        drop(listener);
        let url = format!("http://{address}/").parse().expect("an address");
        let mut client = Client::new(url, None).expect("a client");
        let text = client.get("/").await.expect_err("nobody").to_string();
        assert!(
            text.starts_with(&format!("http://{address}/ cannot be reached: ")),
            "{text}"
        );
        assert!(
            text.ends_with("does the server run? --server names another one"),
            "{text}"
        );
    }
}
