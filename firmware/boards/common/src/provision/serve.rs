//! Serving the page: connections one request long, each with a deadline and a fixed buffer.

use core::cell::Cell;

use crawler_hal::{Clock, Duration, Elapsed, Instant, with_deadline};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::mutex::Mutex;
use embassy_sync::signal::Signal;
use embedded_io_async::{Read, Write};
use embedded_storage_async::nor_flash::NorFlash;

use super::http::{
    Kind, Render, Request, ResponseHead, Status, head_end, length, may_be_request, part,
};
use super::page::{Page, Word, form_of};
use super::portal::{Admission, Answer, Portal};
use super::scan::{Networks, Scanner};
use crate::settings::{Kept, Settings, Vault};

/// Memory for a request, and then for the parts of its response.
pub const BUFFER: usize = 3_072;
/// How long a request may take to arrive, however slowly its bytes drip: a page on a phone takes
/// a few milliseconds.
pub const ARRIVED_WITHIN: Duration = Duration::from_secs(5);
/// How long a connection may stay open without a byte. Browsers open some in advance.
pub const BEGUN_WITHIN: Duration = Duration::from_secs(2);
/// How long a response may take to be taken.
pub const TAKEN_WITHIN: Duration = Duration::from_secs(8);
/// How long the radio may look around.
pub const SCANNED_WITHIN: Duration = Duration::from_secs(6);
/// How long a scan is news: asked again before, the same networks are told.
const SCAN_IS_NEWS: Duration = Duration::from_secs(5);
/// How long the other end may take to close, so that it reads a refusal before it hears that the
/// rest of its request is not wanted.
pub(super) const CLOSED_WITHIN: Duration = Duration::from_millis(500);

/// What became of a connection.
#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(
    clippy::large_enum_variant,
    reason = "one lives per connection, at a known place"
)]
pub enum Outcome {
    /// Answered, and nothing has changed.
    Answered,
    /// Nothing usable arrived, or the other end went away.
    Abandoned,
    /// New settings are stored: restart.
    Saved(Settings),
}

/// What a scan has found, and when.
struct Scanned {
    networks: Networks,
    at: Option<Instant>,
}

/// The page of one boot, with what it needs.
pub struct Server<F, N, C> {
    portal: Portal,
    vault: Mutex<NoopRawMutex, Vault<F>>,
    scanner: Mutex<NoopRawMutex, (N, Scanned)>,
    pub(super) clock: C,
    used: Cell<Option<Instant>>,
    pub(super) saved: Signal<NoopRawMutex, Settings>,
}

impl<F, N, C> core::fmt::Debug for Server<F, N, C> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Server")
            .field("portal", &self.portal)
            .finish_non_exhaustive()
    }
}

impl<F: NorFlash, N: Scanner, C: Clock> Server<F, N, C> {
    /// A page that keeps what it is told in `vault`.
    pub const fn new(portal: Portal, vault: Vault<F>, scanner: N, clock: C) -> Self {
        let scanned = Scanned {
            networks: Networks::new(),
            at: None,
        };
        Self {
            portal,
            vault: Mutex::new(vault),
            scanner: Mutex::new((scanner, scanned)),
            clock,
            used: Cell::new(None),
            saved: Signal::new(),
        }
    }

    /// When a person last used the page. What a phone asks on its own does not count.
    pub fn last_used(&self) -> Option<Instant> {
        self.used.get()
    }

    /// Serves one connection: reads one request and answers it. Closing is the caller's.
    ///
    /// Takes at most [`ARRIVED_WITHIN`], [`SCANNED_WITHIN`] and [`TAKEN_WITHIN`] together.
    ///
    /// # Cancellation Safety
    /// As safe as a power cut.
    pub async fn converse<S: Read + Write>(
        &self,
        stream: &mut S,
        buffer: &mut [u8; BUFFER],
    ) -> Outcome {
        let deadline = self.clock.now() + ARRIVED_WITHIN;
        let mut filled = 0;
        let received = with_deadline(
            &self.clock,
            deadline,
            self.receive(stream, buffer, &mut filled),
        )
        .await;
        let (answer, headless) = match received {
            Ok(Some((request, answer))) => (
                answer,
                request.is_some_and(|r| r.method == super::http::Method::Head),
            ),
            Ok(None) => return Outcome::Abandoned,
            Err(Elapsed) => (refused(Status::Timeout), false),
        };
        if matches!(
            answer,
            Answer::Page | Answer::Again { .. } | Answer::Networks | Answer::Save(_)
        ) {
            self.used.set(Some(self.clock.now()));
        }
        let mut saved = None;
        let answer = match answer {
            Answer::Save(settings) => {
                if self.save(&settings).await {
                    saved = Some(settings);
                    Answer::Page
                } else {
                    refused(Status::StorageFailed)
                }
            }
            Answer::Networks => {
                if self.look().await {
                    Answer::Networks
                } else {
                    refused(Status::Unavailable)
                }
            }
            other => other,
        };
        let deadline = self.clock.now() + TAKEN_WITHIN;
        let reply = self.reply(stream, buffer, &answer, saved.as_ref(), headless);
        let replied = with_deadline(&self.clock, deadline, reply).await;
        match (saved, replied) {
            // Stored is stored, whether or not the word of it was heard.
            (Some(settings), _) => Outcome::Saved(settings),
            (None, Ok(Ok(()))) => Outcome::Answered,
            (None, _) => Outcome::Abandoned,
        }
    }

    /// Reads a request and decides on it. `None` when the other end says nothing, or goes away.
    async fn receive<S: Read>(
        &self,
        stream: &mut S,
        buffer: &mut [u8; BUFFER],
        filled: &mut usize,
    ) -> Option<(Option<Request>, Answer)> {
        let begun = self.clock.now() + BEGUN_WITHIN;
        let head = loop {
            let read = stream.read(&mut buffer[*filled..]);
            let count = if *filled == 0 {
                with_deadline(&self.clock, begun, read).await.ok()?
            } else {
                read.await
            };
            let count = count.ok().filter(|count| *count > 0)?;
            let seen = *filled;
            *filled += count;
            if !may_be_request(&buffer[..*filled]) {
                return Some((None, refused(Status::BadRequest)));
            }
            if let Some(end) = head_end(&buffer[..*filled], seen) {
                break end;
            }
            if *filled == BUFFER {
                return Some((None, refused(Status::HeadTooLarge)));
            }
        };
        let request = match Request::parse(&buffer[..head]) {
            Ok(request) => request,
            Err(status) => return Some((None, refused(status))),
        };
        let body = match self.portal.admit(&request, BUFFER - head) {
            Admission::Body(length) => length,
            Admission::Answer(answer) => return Some((Some(request), answer)),
        };
        let end = head + body;
        while *filled < end {
            let count = stream.read(&mut buffer[*filled..end]).await.ok()?;
            if count == 0 {
                return None;
            }
            *filled += count;
        }
        let current = self.current().await;
        let answer = self
            .portal
            .submit(&request, &buffer[head..end], current.as_ref());
        Some((Some(request), answer))
    }

    /// The settings as they are stored. A flash that does not answer has none.
    async fn current(&self) -> Option<Settings> {
        let kept = self.vault.lock().await.load().await;
        kept.ok().and_then(|kept| kept.settings)
    }

    async fn save(&self, settings: &Settings) -> bool {
        let mut vault = self.vault.lock().await;
        // A flash that cannot be read is not written to either: the password on the label would
        // be lost with it.
        let Ok(kept) = vault.load().await else {
            return false;
        };
        let kept = Kept {
            settings: Some(settings.clone()),
            ..kept
        };
        vault.store(&kept).await.is_ok()
    }

    /// Looks for networks, unless that was done a moment ago. While another connection does, this
    /// one waits for it.
    async fn look(&self) -> bool {
        let mut scanner = self.scanner.lock().await;
        let now = self.clock.now();
        let (radio, scanned) = &mut *scanner;
        if scanned
            .at
            .is_some_and(|at| now.saturating_since(at) < SCAN_IS_NEWS)
        {
            return true;
        }
        let mut networks = Networks::new();
        let found = with_deadline(&self.clock, now + SCANNED_WITHIN, radio.scan(&mut networks));
        if !matches!(found.await, Ok(Ok(()))) {
            return false;
        }
        *scanned = Scanned {
            networks,
            at: Some(self.clock.now()),
        };
        true
    }

    async fn reply<S: Write>(
        &self,
        stream: &mut S,
        buffer: &mut [u8; BUFFER],
        answer: &Answer,
        saved: Option<&Settings>,
        headless: bool,
    ) -> Result<(), S::Error> {
        let mut response = Response {
            stream,
            buffer,
            headless,
            location: None,
            allow: None,
        };
        if let Some(settings) = saved {
            let body = Word::Saved(settings);
            return response.send(Status::Ok, Kind::Html, &body).await;
        }
        match answer {
            Answer::Page => {
                let current = self.current().await;
                let form = form_of(current.as_ref(), &self.portal.suggestion);
                let page = self.page(current.as_ref(), &form);
                response.send(Status::Ok, Kind::Html, &page).await
            }
            Answer::Again {
                status,
                form,
                flaws,
                notice,
            } => {
                let current = self.current().await;
                let mut page = self.page(current.as_ref(), form);
                page.flaws = *flaws;
                page.notice = Some(notice);
                response.send(*status, Kind::Html, &page).await
            }
            Answer::Networks => {
                let networks = self.scanner.lock().await.1.networks.clone();
                response.send(Status::Ok, Kind::Json, &networks).await
            }
            Answer::Home(address) => {
                response.location = Some(*address);
                let body = Word::Refused(Status::Found);
                response.send(Status::Found, Kind::Html, &body).await
            }
            Answer::Refused { status, allow } => {
                response.allow = *allow;
                let body = Word::Refused(*status);
                response.send(*status, Kind::Html, &body).await
            }
            // Became one of the others when it was stored, or was not.
            Answer::Save(_) => Ok(()),
        }
    }

    fn page<'a>(&'a self, current: Option<&'a Settings>, form: &'a super::Form) -> Page<'a> {
        let named = current.unwrap_or(&self.portal.suggestion);
        Page {
            features: self.portal.features,
            token: &self.portal.token,
            form,
            flaws: super::Flaws::default(),
            current,
            robot: named.id.as_str(),
            notice: None,
        }
    }
}

const fn refused(status: Status) -> Answer {
    Answer::Refused {
        status,
        allow: None,
    }
}

/// A response on its way.
struct Response<'a, S> {
    stream: &'a mut S,
    buffer: &'a mut [u8; BUFFER],
    headless: bool,
    location: Option<core::net::Ipv4Addr>,
    allow: Option<&'static str>,
}

impl<S: Write> Response<'_, S> {
    async fn send(
        &mut self,
        status: Status,
        kind: Kind,
        body: &impl Render,
    ) -> Result<(), S::Error> {
        let head = ResponseHead {
            status,
            kind,
            length: length(body),
            location: self.location,
            allow: self.allow,
        };
        self.stream_out(&head).await?;
        if !self.headless {
            self.stream_out(body).await?;
        }
        self.stream.flush().await
    }

    async fn stream_out(&mut self, text: &impl Render) -> Result<(), S::Error> {
        let mut sent = 0;
        loop {
            let mut rest = part(text, sent, self.buffer);
            if rest.is_empty() {
                return Ok(());
            }
            sent += rest.len();
            while !rest.is_empty() {
                let count = self.stream.write(rest).await?;
                // A stream that takes nothing has ended; the deadline of the caller is the end
                // of the other case.
                if count == 0 {
                    return Ok(());
                }
                rest = &rest[count.min(rest.len())..];
            }
        }
    }
}
