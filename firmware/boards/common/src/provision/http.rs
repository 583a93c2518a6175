//! Reading requests and writing responses: as much of HTTP/1.1 as a page with a form needs.
//!
//! The syntax of a head is read by `httparse`; this module decides what it means, strictly. Each
//! connection serves one request.

use core::fmt;
use core::net::Ipv4Addr;

/// Most header fields of a request. Browsers send about fifteen.
const MAX_FIELDS: usize = 32;
/// Longest name of a host, with its port.
const MAX_HOST: usize = 64;

/// What is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Path {
    /// `/`
    Page,
    /// `/networks`
    Networks,
    /// `/settings`
    Settings,
    /// Anything else.
    Other,
}

/// How it is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// GET
    Get,
    /// HEAD: as GET, without the body.
    Head,
    /// POST
    Post,
    /// Any other method.
    Other,
}

/// Whom the client believes to talk to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Host {
    /// An address. Only names can be made to point here by someone else.
    Address,
    /// A name, which somebody's name server resolved to this board.
    Name,
}

/// Whose page the request comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// The client does not say: no browser, or no form.
    Absent,
    /// Our own page.
    Same,
    /// Somebody else's page.
    Foreign,
}

/// A request, without its body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    /// How it is asked.
    pub method: Method,
    /// For what.
    pub path: Path,
    /// Whom.
    pub host: Host,
    /// From where.
    pub origin: Origin,
    /// Length of the body; `None` when not stated.
    pub content_length: Option<usize>,
    /// Whether the body is said to be a form.
    pub form: bool,
    /// Length of the head, its empty line included.
    pub head: usize,
}

/// Where the head ends in `bytes`, given that it does not end within the first `seen` of them.
pub(super) fn head_end(bytes: &[u8], seen: usize) -> Option<usize> {
    let from = seen.saturating_sub(3);
    let tail = bytes.get(from..)?;
    let at = tail.windows(4).position(|four| four == b"\r\n\r\n")?;
    Some(from + at + 4)
}

/// Whether this can become a request. What begins otherwise, such as a TLS handshake, need not be
/// waited for.
pub(super) fn may_be_request(bytes: &[u8]) -> bool {
    bytes
        .iter()
        .take_while(|byte| **byte != b' ')
        .all(u8::is_ascii_uppercase)
}

impl Request {
    /// Reads a complete head.
    ///
    /// # Errors
    /// The [`Status`] to refuse the request with.
    pub fn parse(head: &[u8]) -> Result<Self, Status> {
        let mut fields = [httparse::EMPTY_HEADER; MAX_FIELDS];
        let mut parsed = httparse::Request::new(&mut fields);
        match parsed.parse(head) {
            Ok(httparse::Status::Complete(length)) if length == head.len() => {}
            Err(httparse::Error::TooManyHeaders) => return Err(Status::HeadTooLarge),
            Err(httparse::Error::Version) => return Err(Status::Version),
            Ok(_) | Err(_) => return Err(Status::BadRequest),
        }
        let (Some(method), Some(target)) = (parsed.method, parsed.path) else {
            return Err(Status::BadRequest);
        };
        let fields = Fields(parsed.headers);
        let host = fields.one("host")?.ok_or(Status::BadRequest)?;
        let host_kind = classify_host(host).ok_or(Status::BadRequest)?;
        if fields.one("transfer-encoding")?.is_some() {
            return Err(Status::NotImplemented);
        }
        if fields.one("expect")?.is_some() {
            return Err(Status::Expectation);
        }
        let content_length = fields
            .one("content-length")?
            .map(parse_length)
            .transpose()?;
        let origin = match fields.one("origin")? {
            None => Origin::Absent,
            Some(origin) if origin.strip_prefix("http://") == Some(host) => Origin::Same,
            Some(_) => Origin::Foreign,
        };
        let form = fields.one("content-type")?.is_some_and(|kind| {
            let kind = kind.split(';').next().unwrap_or(kind).trim();
            kind.eq_ignore_ascii_case("application/x-www-form-urlencoded")
        });
        Ok(Self {
            method: match method {
                "GET" => Method::Get,
                "HEAD" => Method::Head,
                "POST" => Method::Post,
                _ => Method::Other,
            },
            path: match target.split('?').next().unwrap_or(target) {
                "/" => Path::Page,
                "/networks" => Path::Networks,
                "/settings" => Path::Settings,
                path if path.starts_with('/') => Path::Other,
                // Asked as a proxy, which this is not.
                _ => return Err(Status::BadRequest),
            },
            host: host_kind,
            origin,
            content_length,
            form,
            head: head.len(),
        })
    }
}

struct Fields<'a, 'b>(&'a [httparse::Header<'b>]);

impl<'b> Fields<'_, 'b> {
    /// The value of a field that may stand once. Two of them, and two readers could take the
    /// request for different ones.
    fn one(&self, name: &str) -> Result<Option<&'b str>, Status> {
        let mut found = self
            .0
            .iter()
            .filter(|field| field.name.eq_ignore_ascii_case(name));
        let first = found.next();
        if found.next().is_some() {
            return Err(Status::BadRequest);
        }
        first
            .map(|field| core::str::from_utf8(field.value).map_err(|_| Status::BadRequest))
            .transpose()
    }
}

/// Digits alone: neither sign nor list.
fn parse_length(text: &str) -> Result<usize, Status> {
    if text.is_empty() || !text.bytes().all(|byte| byte.is_ascii_digit()) {
        return Err(Status::BadRequest);
    }
    // More digits than a number has are too large, too.
    text.parse().map_err(|_| Status::BodyTooLarge)
}

fn classify_host(host: &str) -> Option<Host> {
    let (name, port) = host.split_once(':').unwrap_or((host, "80"));
    let fits = !name.is_empty()
        && host.len() <= MAX_HOST
        && name
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b'_'))
        && port.bytes().all(|byte| byte.is_ascii_digit());
    if !fits {
        // A captive-portal probe may carry any name, an IPv6 address among them; but not this.
        let other = host.len() <= 255 && host.bytes().all(|byte| matches!(byte, b'!'..=b'~'));
        return (other && !host.is_empty()).then_some(Host::Name);
    }
    Some(if name.parse::<Ipv4Addr>().is_ok() {
        Host::Address
    } else {
        Host::Name
    })
}

macro_rules! statuses {
    ($($(#[$doc:meta])* $name:ident = $code:literal $phrase:literal $advice:literal;)*) => {
        /// What a response says in its first line.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[non_exhaustive]
        pub enum Status {
            $($(#[$doc])* $name,)*
        }

        impl Status {
            /// The number.
            #[must_use]
            pub const fn code(self) -> u16 {
                match self { $(Self::$name => $code,)* }
            }

            /// The words beside the number.
            #[must_use]
            pub const fn phrase(self) -> &'static str {
                match self { $(Self::$name => $phrase,)* }
            }

            /// What it means to a person.
            #[must_use]
            pub const fn advice(self) -> &'static str {
                match self { $(Self::$name => $advice,)* }
            }
        }
    };
}

statuses! {
    /// Here it is.
    Ok = 200 "OK" "";
    /// The page is elsewhere.
    Found = 302 "Found" "The page is at the address of the robot.";
    /// Not HTTP/1.1 as it should be.
    BadRequest = 400 "Bad Request" "The robot did not understand this request.";
    /// Not from our page.
    Forbidden = 403 "Forbidden" "Settings are taken from the robot's own page only.";
    /// No such page.
    NotFound = 404 "Not Found" "There is nothing at this address.";
    /// Not in this way.
    MethodNotAllowed = 405 "Method Not Allowed" "This address does not do that.";
    /// The request took too long.
    Timeout = 408 "Request Timeout" "The request took too long to arrive.";
    /// A body without its length.
    LengthRequired = 411 "Length Required" "The length of the form is missing.";
    /// A body that is too long.
    BodyTooLarge = 413 "Content Too Large" "The form is longer than any settings.";
    /// A body that is no form.
    UnsupportedType = 415 "Unsupported Media Type" "This is not a form.";
    /// We do not negotiate.
    Expectation = 417 "Expectation Failed" "Send the form at once.";
    /// A name that is not ours.
    Misdirected = 421 "Misdirected Request" "Please use the address of the robot, not a name.";
    /// Something entered is not acceptable.
    Unprocessable = 422 "Unprocessable Content" "";
    /// A head that is too long.
    HeadTooLarge = 431 "Request Header Fields Too Large" "The request has too many headers.";
    /// The flash did not take the settings.
    StorageFailed = 500 "Internal Server Error" "The robot could not store its settings.";
    /// A transfer encoding.
    NotImplemented = 501 "Not Implemented" "The robot does not read requests in pieces.";
    /// The radio is busy.
    Unavailable = 503 "Service Unavailable" "The robot could not look for networks. Try again.";
    /// Not HTTP/1.
    Version = 505 "HTTP Version Not Supported" "The robot speaks HTTP/1.1.";
}

/// Something that can be written as often as one likes and is the same every time.
pub(super) trait Render {
    /// Writes all of it.
    fn render(&self, out: &mut dyn fmt::Write) -> fmt::Result;
}

impl Render for str {
    fn render(&self, out: &mut dyn fmt::Write) -> fmt::Result {
        out.write_str(self)
    }
}

/// Counts bytes.
struct Count(usize);

impl fmt::Write for Count {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0 += text.len();
        Ok(())
    }
}

/// Keeps the part of a text that begins at `skip` and fits the buffer. A response is rendered
/// once per part, which costs time that nobody notices, and no memory.
struct Window<'a> {
    skip: usize,
    buffer: &'a mut [u8],
    len: usize,
}

impl fmt::Write for Window<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let skipped = self.skip.min(text.len());
        self.skip -= skipped;
        let rest = &text.as_bytes()[skipped..];
        let room = &mut self.buffer[self.len..];
        let count = rest.len().min(room.len());
        room[..count].copy_from_slice(&rest[..count]);
        self.len += count;
        Ok(())
    }
}

/// Length of what is rendered, in bytes.
pub(super) fn length(body: &(impl Render + ?Sized)) -> usize {
    let mut count = Count(0);
    // A counter takes everything.
    let _ = body.render(&mut count);
    count.0
}

/// The part of what is rendered that begins at `from`; empty at the end.
pub(super) fn part<'a>(
    body: &(impl Render + ?Sized),
    from: usize,
    buffer: &'a mut [u8],
) -> &'a [u8] {
    let mut window = Window {
        skip: from,
        buffer,
        len: 0,
    };
    let _ = body.render(&mut window);
    let len = window.len;
    &buffer[..len]
}

/// What the body of a response is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Html,
    Json,
}

/// Hash of the page's style, and of its script. A test computes them.
pub(super) const STYLE_HASH: &str = "sha256-gk87kI/fmIs7eUJ1YmFHPE4LhGl6qEOXu2l5HIDLBQM=";
pub(super) const SCRIPT_HASH: &str = "sha256-mMRFjslGf8zsI7kRkDAh5icflE+H/jG6xiHOZtc0VBM=";

/// The head of a response.
pub(super) struct ResponseHead {
    pub(super) status: Status,
    pub(super) kind: Kind,
    pub(super) length: usize,
    /// Where to look instead.
    pub(super) location: Option<Ipv4Addr>,
    /// How to ask instead.
    pub(super) allow: Option<&'static str>,
}

impl Render for ResponseHead {
    fn render(&self, out: &mut dyn fmt::Write) -> fmt::Result {
        let Self { status, length, .. } = self;
        let kind = match self.kind {
            Kind::Html => "text/html; charset=utf-8",
            Kind::Json => "application/json",
        };
        write!(
            out,
            "HTTP/1.1 {} {}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\n",
            status.code(),
            status.phrase(),
        )?;
        if let Some(location) = self.location {
            write!(out, "Location: http://{location}/\r\n")?;
        }
        if let Some(allow) = self.allow {
            write!(out, "Allow: {allow}\r\n")?;
        }
        if *status == Status::Unavailable {
            out.write_str("Retry-After: 3\r\n")?;
        }
        write!(
            out,
            "Connection: close\r\n\
             Cache-Control: no-store\r\n\
             X-Content-Type-Options: nosniff\r\n\
             Referrer-Policy: same-origin\r\n\
             Content-Security-Policy: default-src 'none'; style-src '{STYLE_HASH}'; \
             script-src '{SCRIPT_HASH}'; connect-src 'self'; form-action 'self'; \
             base-uri 'none'; frame-ancestors 'none'\r\n\r\n"
        )
    }
}
