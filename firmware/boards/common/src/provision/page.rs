//! The page: one self-contained document, filled in place by place.
//!
//! `{{name}}` in the document is a value, `{{?name}}` … `{{/}}` a part that stands only where it
//! applies. All values are escaped; passwords have no place at all.

use core::fmt::{self, Write as _};

use super::Features;
use super::check::Flaws;
use super::fallback::FALL_BACK_AFTER;
use super::form::{Form, Value};
use super::http::{Render, Status};
use super::portal::Token;
use crate::settings::{Flaw, RangerMode, Settings};

pub(super) const PAGE: &str = include_str!("page.html");
pub(super) const SAVED: &str = include_str!("saved.html");

/// A text within an element or a quoted attribute.
struct Escaped<'a>(&'a str);

impl fmt::Display for Escaped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for letter in self.0.chars() {
            match letter {
                '&' => f.write_str("&amp;")?,
                '<' => f.write_str("&lt;")?,
                '>' => f.write_str("&gt;")?,
                '"' => f.write_str("&quot;")?,
                '\'' => f.write_str("&#39;")?,
                letter => f.write_char(letter)?,
            }
        }
        Ok(())
    }
}

/// Fills `document`: asks `applies` about parts and `value` for values.
fn fill(
    document: &str,
    out: &mut dyn fmt::Write,
    applies: impl Fn(&str) -> bool,
    value: impl Fn(&str, &mut dyn fmt::Write) -> fmt::Result,
) -> fmt::Result {
    let mut pieces = document.split("{{");
    out.write_str(pieces.next().unwrap_or_default())?;
    let mut shown = true;
    for piece in pieces {
        let (name, text) = piece.split_once("}}").unwrap_or(("", piece));
        if let Some(part) = name.strip_prefix('?') {
            shown = applies(part);
        } else if name == "/" {
            shown = true;
        } else if shown {
            value(name, out)?;
        }
        if shown {
            out.write_str(text)?;
        }
    }
    Ok(())
}

/// The form of `settings`, with empty places for passwords.
pub(super) fn form_of(settings: Option<&Settings>, suggestion: &Settings) -> Form {
    let known = settings.unwrap_or(suggestion);
    let wifi = known.wifi.as_ref();
    let open = wifi.is_some_and(|wifi| wifi.passphrase.is_none());
    let account = known.credentials.as_ref();
    let mut broker = heapless::String::<{ super::form::VALUE_MAX }>::new();
    // Without a broker to suggest the field is empty. A broker fits: 64 + 1 + 5.
    if settings.is_some() {
        let _ = write!(broker, "{}", known.broker);
    }
    let mut authority = heapless::String::<{ super::form::VALUE_MAX }>::new();
    if let Some(known) = &known.broker.authority {
        // 66 digits, which fit.
        let _ = write!(authority, "{known}");
    }
    Form {
        ssid: Value::shown(wifi.map_or("", |wifi| wifi.ssid.as_str())),
        wifi_open: Value::shown(if open { "1" } else { "" }),
        broker: Value::shown(&broker),
        authority: Value::shown(&authority),
        id: Value::shown(known.id.as_str()),
        fleet: Value::shown(known.fleet.as_str()),
        username: Value::shown(account.map_or("", |account| &account.username)),
        ranger: Value::shown(known.ranger.as_str()),
        ..Form::default()
    }
}

/// The page with the form.
pub(super) struct Page<'a> {
    pub(super) features: Features,
    pub(super) token: &'a Token,
    pub(super) form: &'a Form,
    pub(super) flaws: Flaws,
    pub(super) current: Option<&'a Settings>,
    /// Name of the robot, as it is now.
    pub(super) robot: &'a str,
    /// What to say above the form.
    pub(super) notice: Option<&'a str>,
}

impl Page<'_> {
    fn flaw(&self, field: &str) -> Option<Flaw> {
        match field {
            "ssid" => self.flaws.ssid,
            "wifi_password" => self.flaws.wifi_password,
            "broker" => self.flaws.broker,
            "authority" => self.flaws.authority,
            "id" => self.flaws.id,
            "fleet" => self.flaws.fleet,
            "username" => self.flaws.username,
            "password" => self.flaws.password,
            "ranger" => self.flaws.ranger,
            _ => None,
        }
    }

    fn hint(&self, field: &str) -> &'static str {
        let wifi = self.current.and_then(|settings| settings.wifi.as_ref());
        let account = self
            .current
            .and_then(|settings| settings.credentials.as_ref());
        match field {
            "wifi_password" if wifi.is_some_and(|wifi| wifi.passphrase.is_some()) => {
                "Stored, and not shown. Leave empty to keep it, as long as the network stays the same."
            }
            "wifi_password" => "8 to 63 characters.",
            "password" if account.is_some() => {
                "Stored, and not shown. Leave empty to keep it, as long as broker and user stay the same."
            }
            "password" => {
                "Without an authority it is sent to the broker unencrypted: use it for robots only."
            }
            _ => "",
        }
    }

    fn value(&self, name: &str, out: &mut dyn fmt::Write) -> fmt::Result {
        let selected = |mode: RangerMode| {
            if self.form.ranger.as_str() == mode.as_str() {
                " selected"
            } else {
                ""
            }
        };
        if let Some((field, aspect)) = name.split_once('.') {
            return match aspect {
                "flaw" => match self.flaw(field) {
                    Some(flaw) => write!(out, "{flaw}"),
                    None => Ok(()),
                },
                "state" => {
                    if self.flaw(field).is_some() {
                        write!(
                            out,
                            " aria-invalid=\"true\" aria-describedby=\"{field}-flaw\""
                        )?;
                    }
                    Ok(())
                }
                "hint" => out.write_str(self.hint(field)),
                "uart" => out.write_str(selected(RangerMode::Uart)),
                "pulse" => out.write_str(selected(RangerMode::Pulse)),
                _ => Err(fmt::Error),
            };
        }
        let value = match name {
            "title" => return write!(out, "Set up robot {}", Escaped(self.robot)),
            "token" => return out.write_str(self.token.as_str()),
            "minutes" => return write!(out, "{}", FALL_BACK_AFTER.as_micros() / 60_000_000),
            "notice" => {
                return match self.notice {
                    Some(notice) => write!(
                        out,
                        "<p class=\"card flaw\" role=\"alert\">{}</p>",
                        Escaped(notice)
                    ),
                    None => Ok(()),
                };
            }
            "wifi_open" => {
                let checked = if self.form.wifi_open.is_empty() {
                    ""
                } else {
                    " checked"
                };
                return out.write_str(checked);
            }
            "ssid" => &self.form.ssid,
            "broker" => &self.form.broker,
            "authority" => &self.form.authority,
            "id" => &self.form.id,
            "fleet" => &self.form.fleet,
            "username" => &self.form.username,
            // A name that stands nowhere in the document, as a test makes sure.
            _ => return Err(fmt::Error),
        };
        write!(out, "{}", Escaped(value.as_str()))
    }
}

impl Render for Page<'_> {
    fn render(&self, out: &mut dyn fmt::Write) -> fmt::Result {
        let Features { wifi, scan, ranger } = self.features;
        fill(
            PAGE,
            out,
            |part| match part {
                "wifi" => wifi,
                "scan" => wifi && scan,
                "ranger" => ranger,
                "wired" => !wifi,
                _ => false,
            },
            |name, out| self.value(name, out),
        )
    }
}

/// The style of the page, for the other document.
pub(super) fn style() -> &'static str {
    PAGE.split_once("<style>\n")
        .and_then(|(_, rest)| rest.split_once("\n</style>"))
        .map_or("", |(style, _)| style)
}

/// A short page: settings were stored, or a request was refused.
pub(super) enum Word<'a> {
    /// Settings were stored.
    Saved(&'a Settings),
    /// A request was refused.
    Refused(Status),
}

impl Render for Word<'_> {
    fn render(&self, out: &mut dyn fmt::Write) -> fmt::Result {
        fill(
            SAVED,
            out,
            |_| true,
            |name, out| match (name, self) {
                ("style", _) => out.write_str(style()),
                ("title", Self::Saved(settings)) => {
                    write!(out, "Robot {} restarts", Escaped(settings.id.as_str()))
                }
                ("title", Self::Refused(status)) => out.write_str(status.phrase()),
                ("text", Self::Saved(settings)) => saved(settings, out),
                ("text", Self::Refused(status)) => write!(
                    out,
                    "<p>{}</p><p><a href=\"/\">To the page of the robot</a></p>",
                    status.advice()
                ),
                _ => Err(fmt::Error),
            },
        )
    }
}

fn saved(settings: &Settings, out: &mut dyn fmt::Write) -> fmt::Result {
    out.write_str("<p>The settings are stored, and the robot restarts now.</p><ol>")?;
    if let Some(wifi) = &settings.wifi {
        write!(
            out,
            "<li>This access point closes. The robot joins the network <strong>{}</strong>.</li>",
            Escaped(wifi.ssid.as_str())
        )?;
    }
    write!(
        out,
        "<li>It connects to the broker at <code>{}</code> and appears in the control room as \
         <strong>{}</strong>, usually within half a minute.</li>",
        settings.broker,
        Escaped(settings.id.as_str())
    )?;
    if settings.wifi.is_some() {
        write!(
            out,
            "<li>If it cannot join within {} minutes, this access point opens again. To open it \
             at once, press the button on the board just after it starts.</li>",
            FALL_BACK_AFTER.as_micros() / 60_000_000
        )?;
    }
    out.write_str("</ol>")
}
