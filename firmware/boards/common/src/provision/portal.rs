//! What to answer: a function of the request, the form and the settings, without any I/O.

use core::fmt;
use core::net::Ipv4Addr;

use heapless::String;
use rand_core::Rng;

use super::Features;
use super::check::Flaws;
use super::form::Form;
use super::http::{Host, Method, Origin, Path, Request, Status};
use crate::settings::Settings;

/// Digits of a token: 128 bits.
const TOKEN: usize = 32;

/// A secret that stands in the form and has to come back with it, drawn anew at every boot. A
/// page of someone else can make a browser send a form here, but cannot read ours.
#[derive(Clone)]
pub struct Token(String<TOKEN>);

impl Token {
    /// Draws one. `rng` has to be the chip's true random generator.
    pub fn draw(rng: &mut impl Rng) -> Self {
        let mut text = String::new();
        for _ in 0..TOKEN {
            let digit = char::from_digit(rng.next_u32() >> 28, 16).unwrap_or('0');
            // As many pushes as there is room for.
            let _ = text.push(digit);
        }
        Self(text)
    }

    /// The token as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Whether `other` is this token, in a time that does not tell how much of it is right.
    fn is(&self, other: &str) -> bool {
        let pairs = self.0.bytes().zip(other.bytes());
        let differing = pairs.fold(0, |differing, (a, b)| differing | (a ^ b));
        self.0.len() == other.len() && differing == 0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

/// What the page of this boot is.
#[derive(Debug, Clone)]
pub struct Portal {
    /// What the board has to be told.
    pub features: Features,
    /// Proof of having read the page.
    pub token: Token,
    /// Address of the board as an access point: whoever asks for another host by name is sent
    /// there, which is how phones find the page. `None` on a network of others, where such a
    /// request is refused.
    pub captive: Option<Ipv4Addr>,
    /// What to enter for a person as long as there are no settings. Its broker is not shown.
    pub suggestion: Settings,
}

/// What to do with a request.
#[allow(
    clippy::large_enum_variant,
    reason = "one lives per connection, at a known place"
)]
pub(super) enum Admission {
    /// Read a body of this length, and decide then.
    Body(usize),
    /// Answer at once.
    Answer(Answer),
}

/// What to answer.
#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(
    clippy::large_enum_variant,
    reason = "one lives per connection, at a known place"
)]
pub(super) enum Answer {
    /// The page, as it is.
    Page,
    /// The page again, with what was entered.
    Again {
        status: Status,
        form: Form,
        flaws: Flaws,
        notice: &'static str,
    },
    /// Networks nearby.
    Networks,
    /// New settings.
    Save(Settings),
    /// The page is elsewhere.
    Home(Ipv4Addr),
    /// No.
    Refused {
        status: Status,
        allow: Option<&'static str>,
    },
}

const fn refused(status: Status) -> Answer {
    Answer::Refused {
        status,
        allow: None,
    }
}

const fn not_allowed(allow: &'static str) -> Answer {
    Answer::Refused {
        status: Status::MethodNotAllowed,
        allow: Some(allow),
    }
}

impl Portal {
    /// Decides on a request before its body is read. `room` is the longest body there is memory
    /// for.
    pub(super) fn admit(&self, request: &Request, room: usize) -> Admission {
        let answer = match (request.path, request.method) {
            _ if request.host == Host::Name => match (self.captive, request.method) {
                (Some(home), Method::Get | Method::Head) => Answer::Home(home),
                _ => refused(Status::Misdirected),
            },
            (Path::Page, Method::Get | Method::Head) => Answer::Page,
            (Path::Page, _) => not_allowed("GET, HEAD"),
            (Path::Networks, _) if !(self.features.wifi && self.features.scan) => {
                refused(Status::NotFound)
            }
            (Path::Networks, Method::Get) => Answer::Networks,
            (Path::Networks, _) => not_allowed("GET"),
            (Path::Settings, Method::Post) => match request.content_length {
                _ if request.origin == Origin::Foreign => refused(Status::Forbidden),
                _ if !request.form => refused(Status::UnsupportedType),
                None => refused(Status::LengthRequired),
                Some(length) if length > room => refused(Status::BodyTooLarge),
                Some(length) => return Admission::Body(length),
            },
            (Path::Settings, _) => not_allowed("POST"),
            (Path::Other, _) => refused(Status::NotFound),
        };
        Admission::Answer(answer)
    }

    /// Decides on a form.
    pub(super) fn submit(
        &self,
        request: &Request,
        body: &[u8],
        current: Option<&Settings>,
    ) -> Answer {
        let Ok(form) = Form::parse(body) else {
            return refused(Status::BadRequest);
        };
        if form.token.is_cut() || !self.token.is(form.token.as_str()) {
            // Ours, but from before a restart: nothing that was entered is lost. Anything else
            // gets no form to show to a person.
            if request.origin == Origin::Same {
                return Answer::Again {
                    status: Status::Forbidden,
                    form,
                    flaws: Flaws::default(),
                    notice: "The robot has restarted meanwhile. Please enter the passwords again, \
                             check the rest, and save once more.",
                };
            }
            return refused(Status::Forbidden);
        }
        match form.check(self.features, current) {
            Ok(settings) => Answer::Save(settings),
            Err(flaws) => Answer::Again {
                status: Status::Unprocessable,
                form,
                flaws,
                notice: "Nothing was saved yet. Please correct the marked fields. Passwords have \
                         to be entered again.",
            },
        }
    }
}
