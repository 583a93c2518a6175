//! The client as `BoGo`, the runner of TLS tests of `BoringSSL`, wants to have it: `docs/tls.md`.
//!
//! The runner starts this program once for each test, with options that say what to do. It connects to
//! the runner, shakes hands, and gives back every byte it is told with its bits inverted. Code 0 is a
//! connection that was closed in order, 1 an error, which stands on stderr in angle brackets, and 89 a
//! test of something that this client does not have.

use std::convert::Infallible;
use std::fmt;
use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Ipv6Addr, Shutdown, SocketAddr, TcpStream};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crawler_tls::{Authority, Buffers, Connection, Expected, Step, TlsError};
use rand_core::{TryCryptoRng, TryRng};
use tokio_rustls::rustls::crypto;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;

/// What the runner takes for "there is no such thing here".
const UNIMPLEMENTED: u8 = 89;
/// The name that the runner's certificates are for.
const HOST: &str = "test";
/// TLS 1.3 on the wire, and what else this client knows one of: P-256, ECDSA with it and SHA-256.
const TLS13: &str = "772";
const P256: &str = "23";
const ECDSA_P256: &str = "1027";
/// Alerts with which a server refuses what was offered.
const HANDSHAKE_FAILURE: u8 = 40;
const PROTOCOL_VERSION: u8 = 70;
/// The outer type of encrypted records.
const APPLICATION_DATA: u8 = 23;
const CHANGE_CIPHER_SPEC: [u8; 6] = [20, 3, 3, 0, 1, 1];
/// The runner gives a test up after 15 s.
const PATIENCE: Duration = Duration::from_secs(20);

/// What a test asks for.
// Each is one option of the runner's.
#[allow(clippy::struct_excessive_bools)]
#[derive(Default)]
struct Options {
    port: u16,
    id: u64,
    ipv6: bool,
    authority: Option<Authority>,
    /// Bytes of a read.
    chunk: Option<usize>,
    writes_first: bool,
    shuts_down: bool,
    /// Whether an end without a good-bye is an error.
    check_close: bool,
}

/// Why a test does not apply.
struct Unimplemented(String);

fn parse(mut args: impl Iterator<Item = String>) -> Result<Options, Unimplemented> {
    let mut options = Options::default();
    let lacks = |what: &str| Err(Unimplemented(what.to_owned()));
    while let Some(arg) = args.next() {
        let mut value = || {
            args.next()
                .ok_or(Unimplemented(format!("{arg} of nothing")))
        };
        match arg.as_str() {
            "-port" => options.port = number(&value()?)?,
            "-shim-id" => options.id = number(&value()?)?,
            "-ipv6" => options.ipv6 = true,
            "-trust-cert" => options.authority = Some(authority(&value()?)?),
            // A byte at a time is what an asynchronous stream comes to at worst.
            "-async" => options.chunk = Some(1),
            "-read-size" => options.chunk = Some(number(&value()?)?),
            "-shim-writes-first" => options.writes_first = true,
            "-shim-shuts-down" => options.shuts_down = true,
            "-check-close-notify" => options.check_close = true,
            // What it does anyway.
            "-no-tls1"
            | "-no-tls11"
            | "-no-tls12"
            | "-verify-peer"
            | "-implicit-handshake"
            | "-use-early-callback"
            | "-use-custom-verify-callback"
            | "-no-ticket"
            | "-no-op-extra-handshake"
            | "-decline-alpn"
            | "-renegotiate-ignore" => {}
            "-min-version" | "-max-version" | "-expect-version" => {
                let version = value()?;
                let older = number::<u16>(&version)? < number(TLS13)?;
                if version != TLS13 && !(older && arg == "-min-version") {
                    return lacks(&arg);
                }
            }
            "-curves" | "-expect-curve-id" if value()? == P256 => {}
            "-verify-prefs" | "-expect-peer-signature-algorithm" if value()? == ECDSA_P256 => {}
            _ => return lacks(&arg),
        }
    }
    Ok(options)
}

fn number<T: std::str::FromStr>(text: &str) -> Result<T, Unimplemented> {
    text.parse()
        .map_err(|_| Unimplemented(format!("{text}, which is no number of that kind")))
}

/// The key of the certificate in a PEM file.
fn authority(path: &str) -> Result<Authority, Unimplemented> {
    let der = CertificateDer::from_pem_file(path)
        .map_err(|error| Unimplemented(format!("{path}: {error}")))?;
    Authority::of_certificate(&der)
        .map_err(|error| Unimplemented(format!("an authority without P-256: {error}")))
}

/// Numbers that nobody can guess.
struct Unguessable(Arc<crypto::CryptoProvider>);

impl TryRng for Unguessable {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        let mut bytes = [0; 4];
        self.try_fill_bytes(&mut bytes)?;
        Ok(u32::from_le_bytes(bytes))
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        let mut bytes = [0; 8];
        self.try_fill_bytes(&mut bytes)?;
        Ok(u64::from_le_bytes(bytes))
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        let filled = self.0.secure_random.fill(bytes);
        filled.expect("the system has random numbers");
        Ok(())
    }
}

impl TryCryptoRng for Unguessable {}

/// How a test went wrong.
#[derive(Debug)]
enum Failure {
    Stream(io::Error),
    Tls(TlsError),
}

impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        Self::Stream(error)
    }
}

impl From<TlsError> for Failure {
    fn from(error: TlsError) -> Self {
        Self::Tls(error)
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stream(error) => error.fmt(f),
            Self::Tls(TlsError::Alert(code)) => write!(f, "<alert-{code}>"),
            Self::Tls(error) => write!(f, "<{error}>"),
        }
    }
}

/// Both ends of a connection to the runner.
struct Session<'b> {
    stream: TcpStream,
    client: Connection<'b>,
    chunk: usize,
    /// Whether the runner has had the record that it wants before the first encrypted one.
    greeted: bool,
}

impl Session<'_> {
    fn flush(&mut self) -> io::Result<()> {
        // To fool middleboxes (RFC 8446, appendix D.4), which robots do not do, and which is no part of
        // the protocol; but the runner reads nothing else from a client of TLS 1.3.
        if !self.greeted && self.client.pending().first() == Some(&APPLICATION_DATA) {
            self.greeted = true;
            self.stream.write_all(&CHANGE_CIPHER_SPEC)?;
        }
        while !self.client.pending().is_empty() {
            let count = self.stream.write(self.client.pending())?;
            self.client.sent(count);
        }
        Ok(())
    }

    /// Reads some of the record under way; whether there was any.
    fn feed(&mut self) -> Result<bool, Failure> {
        let space = self.client.space()?;
        let most = space.len().min(self.chunk);
        let space = space.get_mut(..most).unwrap_or_default();
        let count = self.stream.read(space)?;
        self.client.received(count);
        Ok(count > 0)
    }

    fn say(&mut self, mut data: &[u8]) -> Result<(), Failure> {
        while !data.is_empty() {
            self.flush()?;
            let count = self.client.say(data)?;
            data = data.get(count..).unwrap_or_default();
        }
        Ok(self.flush()?)
    }

    fn shake(&mut self, expected: &Expected<'_>) -> Result<(), Failure> {
        while !self.client.is_open() {
            self.flush()?;
            if self.client.shake(expected)? == Step::Hungry && !self.feed()? {
                return Err(TlsError::Closed.into());
            }
        }
        Ok(self.flush()?)
    }

    /// Gives back what comes until the runner has said good-bye.
    fn echo(&mut self, options: &Options) -> Result<(), Failure> {
        loop {
            match self.client.step()? {
                Step::Ended => return Ok(()),
                Step::Worked => {}
                Step::Hungry => match self.feed() {
                    Ok(true) => {}
                    Ok(false) if options.check_close => return Err(TlsError::Closed.into()),
                    Ok(false) => return Ok(()),
                    Err(failure) => return Err(failure),
                },
                Step::Data => {
                    let data = self.client.plaintext();
                    let inverted: Vec<u8> = data.iter().map(|byte| !byte).collect();
                    self.client.consume(inverted.len());
                    self.say(&inverted)?;
                }
            }
        }
    }

    fn run(&mut self, options: &Options, expected: &Expected<'_>) -> Result<(), Failure> {
        self.shake(expected)?;
        if options.writes_first {
            self.say(b"hello")?;
        }
        if options.shuts_down {
            self.client.close()?;
            self.flush()?;
        }
        if options.shuts_down && !options.check_close {
            return Ok(());
        }
        self.echo(options)?;
        if !options.shuts_down {
            self.client.close()?;
            self.flush()?;
        }
        Ok(())
    }
}

fn test(options: &Options, authority: Authority) -> Result<(), Failure> {
    let address = if options.ipv6 {
        SocketAddr::from((Ipv6Addr::LOCALHOST, options.port))
    } else {
        SocketAddr::from((Ipv4Addr::LOCALHOST, options.port))
    };
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_nodelay(true)?;
    stream.write_all(&options.id.to_le_bytes())?;
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH);
    let expected = Expected {
        host: HOST,
        authority,
        now: since_1970.ok().map(|since| since.as_secs()),
    };
    let mut rng = Unguessable(Arc::new(crypto::ring::default_provider()));
    let mut buffers = Buffers::new();
    let mut session = Session {
        stream,
        client: Connection::start(&mut buffers, &expected, &mut rng)?,
        chunk: options.chunk.unwrap_or(usize::MAX),
        greeted: false,
    };
    let result = session.run(options, &expected);
    // An alert is to arrive: the runner wants to see which. It is lost when the stream goes with
    // something unread in it.
    let _ = session.flush();
    let _ = session.stream.shutdown(Shutdown::Write);
    let _ = io::copy(&mut session.stream, &mut io::sink());
    result
}

fn main() -> ExitCode {
    let mut args = std::env::args().skip(1).peekable();
    if args
        .peek()
        .is_some_and(|arg| arg == "-is-handshaker-supported")
    {
        println!("No");
        return ExitCode::SUCCESS;
    }
    let options = match parse(args) {
        Ok(options) => options,
        Err(Unimplemented(what)) => {
            eprintln!("there is no {what}");
            return ExitCode::from(UNIMPLEMENTED);
        }
    };
    let Some(authority) = options.authority else {
        eprintln!("there is nothing without an authority");
        return ExitCode::from(UNIMPLEMENTED);
    };
    match test(&options, authority) {
        Ok(()) => ExitCode::SUCCESS,
        // The runner's server was told to speak nothing that was offered to it: older versions, AES,
        // other curves.
        Err(Failure::Tls(TlsError::Alert(HANDSHAKE_FAILURE | PROTOCOL_VERSION))) => {
            eprintln!("nothing in common with that server");
            ExitCode::from(UNIMPLEMENTED)
        }
        Err(failure) => {
            eprintln!("{failure}");
            ExitCode::FAILURE
        }
    }
}
