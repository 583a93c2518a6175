//! The certificates of TLS and their dates.

use super::Finding;
use crate::config::Settings;
use crawler_server_tls::{Certificates, Shown};

const DAY: i64 = 24 * 60 * 60;
/// Whoever renews a certificate by hand wants to know by then.
const SOON: i64 = 14 * DAY;
/// The server renews its own long before; if this little is left, it does not run.
const OVERDUE: i64 = 7 * DAY;

pub(super) fn look(settings: &Settings) -> Finding {
    const WHAT: &str = "certificates";
    let now = crawler_system::clock::now_ms() / 1_000;
    match Certificates::shown(&settings.certificates(), now) {
        Ok(None) => Finding::ok(WHAT, "no listener speaks TLS"),
        Ok(Some(shown)) => judge(&shown, now),
        Err(error) => Finding::fail(
            WHAT,
            error.to_string(),
            "docs/tls.md says what each file is for, and how to begin afresh",
        ),
    }
}

fn judge(shown: &Shown, now: i64) -> Finding {
    const WHAT: &str = "certificates";
    let file = shown.path.display();
    let Some(until) = shown.until else {
        return Finding::ok(WHAT, "the first start with TLS makes them");
    };
    let left = until - now;
    let found = format!("{file} is valid for {} days more", left / DAY);
    match shown.own {
        true if left < OVERDUE => Finding::warn(
            WHAT,
            found,
            "the server renews it while it runs: start it, or look for `renewed` in its log",
        ),
        false if left < SOON => Finding::warn(
            WHAT,
            found,
            "renew it and write it to the same files; the server takes it up by itself",
        ),
        _ => Finding::ok(WHAT, found),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Grade;
    use super::*;

    #[test]
    fn dates_are_judged() {
        for (days, own, grade) in [
            (60, true, Grade::Ok),
            (60, false, Grade::Ok),
            (10, true, Grade::Ok),
            (10, false, Grade::Warn),
            (3, true, Grade::Warn),
            (3, false, Grade::Warn),
        ] {
            let shown = Shown {
                path: "server.pem".into(),
                until: Some(1_800_000_000 + days * DAY),
                own,
            };
            assert_eq!(judge(&shown, 1_800_000_000).grade, grade, "{days} {own}");
        }
    }
}
