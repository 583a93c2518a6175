//! The turn between station and access point.

use crawler_hal::{Duration, Instant};
use proptest::prelude::*;

use super::super::fallback::{Cause, Event, FALL_BACK_AFTER, RETURN_AFTER, Role};

fn at(seconds: u64) -> Instant {
    Instant::from_micros(seconds * 1_000_000)
}

fn is_access_point(role: Role) -> bool {
    matches!(role, Role::AccessPoint { .. })
}

#[test]
fn a_robot_without_settings_waits_for_a_person_for_ever() {
    let role = Role::at_boot(false, false, at(0));
    assert_eq!(role.deadline(), None);
    let later = role.step(Event::Tick, at(1_000_000));
    assert_eq!(later, role);
}

#[test]
fn the_button_opens_the_access_point_and_leaving_it_alone_closes_it() {
    let role = Role::at_boot(true, true, at(0));
    assert!(matches!(
        role,
        Role::AccessPoint {
            cause: Cause::Button,
            ..
        }
    ));
    let used = role.step(Event::PageUsed, at(200));
    assert!(is_access_point(used.step(Event::Tick, at(499))));
    assert!(!is_access_point(used.step(Event::Tick, at(500))));
    assert_eq!(used.deadline(), Some(at(500)));
}

#[test]
fn an_outage_ends_in_joining_again() {
    let mut role = Role::at_boot(true, false, at(0)).step(Event::Joined, at(3));
    assert_eq!(role.deadline(), None);
    role = role.step(Event::Failed, at(1_000));
    for second in 1_000..1_180 {
        role = role.step(Event::Failed, at(second));
        assert!(!is_access_point(role), "{second}");
    }
    role = role.step(Event::Failed, at(1_180));
    assert!(matches!(
        role,
        Role::AccessPoint {
            cause: Cause::Failing,
            ..
        }
    ));
    role = role.step(Event::Tick, at(1_479));
    assert!(is_access_point(role));
    role = role.step(Event::Tick, at(1_480));
    assert_eq!(role.deadline(), Some(at(1_480) + FALL_BACK_AFTER));
    assert_eq!(role.step(Event::Joined, at(1_485)).deadline(), None);
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        Just(Event::Joined),
        Just(Event::Failed),
        Just(Event::PageUsed),
        Just(Event::Tick),
    ]
}

proptest! {
    /// With settings, whatever has happened, nobody using the page and a network that is back
    /// mean a joined robot before long; and time never brings back what passed.
    #[test]
    fn no_robot_stays_an_access_point(
        button in any::<bool>(),
        events in prop::collection::vec((event(), 0_u64..400), 0..60),
    ) {
        let mut now = at(0);
        let mut role = Role::at_boot(true, button, now);
        for (event, seconds) in events {
            now += Duration::from_secs(seconds);
            let next = role.step(event, now);
            if is_access_point(next) && !is_access_point(role) {
                prop_assert!(matches!(event, Event::Failed | Event::Tick));
            }
            role = next;
        }
        let gone = now + RETURN_AFTER;
        role = role.step(Event::Tick, gone);
        // A station may fall back just then, once.
        if is_access_point(role) {
            role = role.step(Event::Tick, gone + RETURN_AFTER);
        }
        prop_assert!(!is_access_point(role));
        role = role.step(Event::Joined, gone + RETURN_AFTER);
        prop_assert_eq!(role, Role::Station { failing_since: None });
    }

    /// Ticks between deadlines change nothing, so that a board may sleep until the deadline.
    #[test]
    fn nothing_happens_before_the_deadline(button in any::<bool>(), early in 1_u64..1_000_000) {
        let role = Role::at_boot(true, button, at(0));
        let deadline = role.deadline().unwrap();
        let before = Instant::from_micros(deadline.as_micros() - early);
        prop_assert_eq!(role.step(Event::Tick, before), role);
        prop_assert_ne!(role.step(Event::Tick, deadline), role);
    }
}
