use crawler_access::topics::Principal;

use super::*;

fn clients() -> Clients {
    Clients::new(Fleet::new("swarm").expect("a fleet"))
}

fn robot(id: &str) -> RobotId {
    RobotId::new(id).expect("a robot id")
}

fn access(id: &str) -> Access {
    Access::As(Principal::Robot(robot(id)))
}

const fn key(client: &str, at: i64) -> Key<'_> {
    let made = Made { at, over: None };
    Key { client, made }
}

/// Publishes as fast as the verdicts allow, until it is cut off or `limit` has passed.
fn flood(clients: &Clients, client: &str, mut now: Instant, limit: Duration) -> (u32, Instant) {
    let start = now;
    let mut sent = 0;
    while now - start < limit {
        match clients.published(client, 100, now) {
            Spent::Pass => sent += 1,
            Spent::Wait(wait) => {
                sent += 1;
                now += wait;
            }
            Spent::CutOff | Spent::Locked => break,
        }
    }
    (sent, now)
}

#[test]
fn a_robot_never_waits() {
    let (clients, start) = (clients(), Instant::now());
    for message in 0..10_000_u64 {
        let now = start + Duration::from_millis(message * 1000 / 20);
        let spent = clients.published("a", 400, now);
        assert_eq!(spent, Spent::Pass, "message {message}");
    }
    assert_eq!(clients.link(&robot("a"), start), None);
}

#[test]
fn a_flood_is_slowed_then_cut_off_then_forgiven() {
    let (clients, start) = (clients(), Instant::now());
    let (sent, now) = flood(&clients, "a", start, Duration::from_secs(5));
    // A burst of 1,000 is free, the others come at 500 a second.
    assert!((3_400..=3_600).contains(&sent), "{sent}");
    assert_eq!(clients.link(&robot("a"), now), Some(LinkState::Throttled));
    assert_eq!(clients.link(&robot("b"), now), None);

    let (_, now) = flood(&clients, "a", now, Duration::from_mins(1));
    let took = now - start;
    assert!(took > Duration::from_secs(9), "{took:?}");
    assert!(took < Duration::from_secs(12), "{took:?}");
    assert!(clients.is_locked("a", now));
    assert_eq!(clients.link(&robot("a"), now), Some(LinkState::CutOff));
    assert_eq!(clients.published("a", 1, now), Spent::Locked);
    let again = clients.enter(key("a", 2), Some("a"), access("a"), now, now);
    assert_eq!(again, Err(Refusal::CutOff));
    assert_eq!(
        clients.published("b", 1, now),
        Spent::Pass,
        "only the flood"
    );

    let later = now + LOCKED;
    assert!(!clients.is_locked("a", later));
    assert_eq!(clients.link(&robot("a"), later), None);
    let again = clients.enter(key("a", 3), Some("a"), access("a"), later, later);
    assert_eq!(again, Ok(()));
}

#[test]
fn two_sessions_of_one_millisecond_are_told_apart() {
    let (clients, now) = (clients(), Instant::now());
    let over = |port| Some(SocketAddr::from(([127, 0, 0, 1], port)));
    let [old, new] = [1, 2].map(|port| Key {
        client: "a",
        made: Made {
            at: 7,
            over: over(port),
        },
    });
    for key in [old, new] {
        let entered = clients.enter(key, Some("a"), access("a"), now, now);
        assert_eq!(entered, Ok(()));
    }
    clients.leave(old);
    assert!(clients.may_stay(new));
    assert_eq!(clients.access(new), Some(access("a")));
    assert_eq!(clients.access(old), None);
}

#[test]
fn a_pause_makes_good() {
    let (clients, mut now) = (clients(), Instant::now());
    for _ in 0..30 {
        let (_, end) = flood(&clients, "a", now, Duration::from_secs(5));
        assert!(!clients.is_locked("a", end));
        now = end + Duration::from_secs(2);
    }
}

#[test]
fn bytes_count_too() {
    let (clients, mut now) = (clients(), Instant::now());
    let start = now;
    for _ in 0..8 {
        if let Spent::Wait(wait) = clients.published("a", 256 * 1024, now) {
            now += wait;
        }
    }
    assert!(now - start > Duration::from_secs(1), "{:?}", now - start);
}

#[test]
fn a_new_session_does_not_get_a_new_budget() {
    let (clients, now) = (clients(), Instant::now());
    let mut passed = 0;
    for session in 0..50 {
        let key = key("a", session);
        clients
            .enter(key, Some("a"), access("a"), now, now)
            .expect("not locked yet");
        while clients.published("a", 1, now) == Spent::Pass {
            passed += 1;
        }
        clients.leave(key);
    }
    assert!(passed <= 1_000, "{passed} messages at once");
}

#[test]
fn a_session_has_what_its_own_login_brought() {
    let (clients, now) = (clients(), Instant::now());
    assert_eq!(clients.access(key("a", 1)), None, "nobody yet");
    let (old, new) = (key("a", 1), key("a", 2));
    for session in [old, new] {
        clients
            .enter(session, Some("a"), access("a"), now, now)
            .expect("let in");
    }
    assert!(clients.access(old).is_some(), "until it has ended");
    clients.leave(old);
    assert_eq!(clients.access(old), None);
    assert_eq!(clients.access(new), Some(access("a")));
    assert!(clients.may_stay(new));
    assert_eq!(clients.access(key("b", 2)), None);

    // Handshakes that come to nothing leave no more than a few behind.
    for ghost in 3..100 {
        clients
            .enter(key("a", ghost), Some("a"), access("a"), now, now)
            .expect("let in");
    }
    assert_eq!(clients.lock().sessions["a"].len(), MAX_SESSIONS);
}

#[test]
fn who_is_dropped_is_not_heard_and_does_not_slip_back_in() {
    let (clients, start) = (clients(), Instant::now());
    let later = |ms| start + Duration::from_millis(ms);
    for (client, user) in [
        ("sim-0001", "simulator-lab"),
        ("sim-0002", "simulator-lab"),
        ("b", "b"),
    ] {
        clients
            .enter(key(client, 1), Some(user), access(client), start, later(1))
            .expect("let in");
    }
    let mut expelled = clients.expel(Kind::Machine, "simulator-lab", later(10));
    expelled.sort();
    assert_eq!(expelled, ["sim-0001", "sim-0002"]);
    assert_eq!(clients.access(key("sim-0001", 1)), None);
    assert!(clients.access(key("b", 1)).is_some());
    assert!(!clients.may_stay(key("sim-0002", 1)));

    // This login had read the old records.
    let slow = clients.enter(
        key("sim-0001", 2),
        Some("simulator-lab"),
        access("sim-0001"),
        later(9),
        later(20),
    );
    assert_eq!(slow, Err(Refusal::Credentials));
    let fresh = clients.enter(
        key("sim-0001", 3),
        Some("simulator-lab"),
        access("sim-0001"),
        later(30),
        later(31),
    );
    assert_eq!(fresh, Ok(()));
    assert!(clients.may_stay(key("sim-0001", 3)));
    // And this one is set up when its name goes.
    clients.expel(Kind::Machine, "b", later(50));
    assert!(!clients.may_stay(key("b", 1)));
}

#[test]
fn memory_stays_bounded() {
    let (clients, start) = (clients(), Instant::now());
    let mut now = start;
    for number in 0..60_000_u32 {
        now += Duration::from_micros(200);
        let client = format!("c{number}");
        clients.published(&client, 1, now);
    }
    assert!(clients.lock().meters.len() <= MAX_METERS);
    for number in 0..3_000_u64 {
        let later = now + Duration::from_secs(number);
        clients.expel(Kind::Machine, &format!("c{number}"), later);
    }
    assert!(clients.lock().drops.len() <= MANY_DROPS);
    for number in 0..60_000_u32 {
        let client = format!("c{number}");
        let entered = clients.enter(key(&client, 1), None, Access::Everything, now, now);
        if clients.is_full() {
            clients.prune(|client| client.len() < 3);
        } else {
            assert_eq!(entered, Ok(()));
        }
    }
    assert!(clients.lock().sessions.len() <= MAX_CLIENTS);
}

#[test]
fn a_halt_waits_for_nothing_that_was_sent_before() {
    let (clients, start) = (clients(), Instant::now());
    let (_, now) = flood(&clients, "a", start, Duration::from_secs(5));
    assert!(matches!(clients.published("a", 100, now), Spent::Wait(_)));
    assert!(clients.halted("a", now), "it is slowed down");
    let (_, now) = flood(&clients, "a", now, Duration::from_mins(1));
    assert_eq!(clients.published("a", 100, now), Spent::Locked);
    assert!(clients.halted("a", now), "it is being cut off");
    // A flood of halts is one all the same.
    let passed = (0..10_000).filter(|_| clients.halted("b", now)).count();
    assert_eq!(passed, 200);
    assert_eq!(clients.published("b", 100, now), Spent::Pass);
    assert!(clients.halted("b", now + Duration::from_secs(1)));
}
