//! Fuzz targets of what strangers send to get in: names, secrets, tokens, and filters of topics. The
//! fuzzer and the replay of its corpus in the tests of `crawler-access` include this file.

use crawler_access::token::{Claims, Key, TokenError};
use crawler_access::topics::{Act, Principal, may};
use crawler_access::{Role, Secret, UserName};
use crawler_protocol::{Fleet, RobotId};

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 3] = [
    ("token", token),
    ("filter", filter),
    ("credential", credential),
];

/// When the tokens of the corpus are good.
const NOW: i64 = 1_700_000_000;

/// What verifies is to the byte what the key signed, and what is damaged does not verify.
fn token(data: &[u8]) {
    let key = Key::from_secret(Secret::from([7; 32]));
    if let Ok(text) = core::str::from_utf8(data)
        && let Ok(claims) = key.verify(text, NOW)
    {
        assert_eq!(key.sign(&claims), text, "a second spelling of a token");
        assert!(claims.expires > NOW);
    }
    // Behind the signature, where random bytes would never get.
    if let Ok(claims) = serde_json::from_slice::<Claims>(data) {
        let token = key.sign(&claims);
        let early = key.verify(&token, claims.issued);
        if claims.expires > claims.issued {
            assert_eq!(early, Ok(claims.clone()));
        } else {
            assert_eq!(early, Err(TokenError::Expired));
        }
        let other = Key::from_secret(Secret::from([8; 32]));
        let foreign = other.verify(&token, claims.issued);
        assert_eq!(foreign, Err(TokenError::Signature));
    }
    let claims = Claims {
        user: "ada".parse().expect("a name"),
        role: Role::Viewer,
        session: 7,
        issued: NOW,
        expires: NOW + 900,
    };
    let good = key.sign(&claims);
    let mut damaged = good.clone().into_bytes();
    for change in data.chunks_exact(2).take(64) {
        let place = usize::from(change[0]) % damaged.len();
        damaged[place] = change[1];
    }
    if let Ok(text) = core::str::from_utf8(&damaged)
        && text != good
    {
        assert!(key.verify(text, NOW).is_err(), "a damaged token verifies");
    }
}

/// A name, and a secret on the next line, as they stand in a login, a ticket or an invitation: each has
/// one spelling, and none looks like one of the server's own.
fn credential(data: &[u8]) {
    let Ok(text) = core::str::from_utf8(data) else {
        return;
    };
    let (name, secret) = text.split_once('\n').unwrap_or((text, text));
    if let Ok(parsed) = name.parse::<UserName>() {
        assert_eq!(parsed.to_string(), name);
        assert!(name.len() <= 32 && !name.starts_with("server-") && !name.starts_with("learner-"));
        let json = serde_json::to_string(&parsed).expect("a name in JSON");
        assert_eq!(serde_json::from_str(&json).ok(), Some(parsed));
    } else {
        let json = serde_json::to_string(name).expect("a text in JSON");
        assert!(serde_json::from_str::<UserName>(&json).is_err());
    }
    if let Ok(parsed) = secret.parse::<Secret>() {
        assert_eq!(parsed.to_string(), secret);
        assert!(parsed.digest().matches(&parsed));
        let other = Secret::from([7; 32]);
        let same = parsed.as_bytes() == other.as_bytes();
        assert_eq!(parsed.digest().matches(&other), same);
    }
    if let Ok(role) = serde_json::from_slice::<Role>(data) {
        let json = serde_json::to_string(&role).expect("a role in JSON");
        assert_eq!(serde_json::from_str(&json).ok(), Some(role));
    }
}

/// A byte that picks who asks, a filter, and a topic on the next line: if the filter is allowed and
/// matches the topic, the topic is allowed too.
fn filter(data: &[u8]) {
    let Some((first, Ok(text))) = data
        .split_first()
        .map(|(first, rest)| (first, core::str::from_utf8(rest)))
    else {
        return;
    };
    let fleet = Fleet::default();
    let who = match first % 6 {
        0 => Principal::Robot(RobotId::new("rover-1").expect("an id")),
        1 => Principal::Simulator,
        2 => Principal::User(Role::Viewer),
        3 => Principal::User(Role::Operator),
        4 => Principal::User(Role::Admin),
        _ => Principal::Learner(RobotId::new("desk-1").expect("a name")),
    };
    let (filter, topic) = text.split_once('\n').unwrap_or((text, "swarm/time"));
    if may(&who, Act::Publish, &fleet, filter) {
        assert!(!filter.contains(['+', '#']));
        assert!(filter.starts_with("swarm/"));
        let learns = matches!(who, Principal::Learner(_));
        assert_eq!(filter.starts_with("swarm/learn/"), learns);
        assert!(!learns || filter.ends_with("/update/desk-1"));
    }
    if !may(&who, Act::Subscribe, &fleet, filter) {
        return;
    }
    assert!(
        filter.split('/').next() == Some("swarm"),
        "out of the fleet"
    );
    let plain = !topic.contains(['+', '#']) && !topic.contains(char::is_control);
    let (levels, of): (Vec<_>, Vec<_>) = (filter.split('/').collect(), topic.split('/').collect());
    if plain && topic.len() <= 128 && matches(&levels, &of) {
        assert!(
            may(&who, Act::Subscribe, &fleet, topic),
            "{filter} gave {topic} away"
        );
    }
}

/// Whether a filter matches a topic, as the standard has it.
fn matches(filter: &[&str], topic: &[&str]) -> bool {
    match (filter, topic) {
        (["#"], _) | ([], []) => true,
        (["+", filter @ ..], [_, topic @ ..]) => matches(filter, topic),
        ([one, filter @ ..], [two, topic @ ..]) => one == two && matches(filter, topic),
        _ => false,
    }
}
