//! Roles, names, passwords and secrets, as other crates use them.

use std::collections::HashSet;

use crawler_access::password::{self, HashError, Memory, Weak};
use crawler_access::{Digest, Role, Secret, UserName, UserNameError};
use proptest::prelude::*;

fn name(text: &str) -> UserName {
    text.parse().expect(text)
}

#[test]
fn a_role_has_one_spelling_and_a_rank() {
    for role in Role::ALL {
        assert_eq!(role.to_string().parse(), Ok(role));
        assert_eq!(
            serde_json::to_string(&role).expect("JSON"),
            format!("\"{role}\"")
        );
    }
    assert!(Role::Viewer < Role::Operator && Role::Operator < Role::Admin);
    for text in ["", "Admin", "admin ", "root", "viewer\0"] {
        assert!(text.parse::<Role>().is_err(), "{text:?}");
        assert!(serde_json::from_str::<Role>(&format!("{text:?}")).is_err());
    }
}

#[test]
fn a_name_is_what_the_documents_say() {
    for text in [
        "a",
        "ada",
        "a.b_c-d",
        "z9",
        &"a".repeat(32),
        "serverless",
        "simulators",
        "learners",
    ] {
        assert_eq!(name(text).to_string(), text);
    }
    for (text, error) in [
        ("", UserNameError::Empty),
        (&*"a".repeat(33), UserNameError::TooLong),
        ("9a", UserNameError::First),
        (".a", UserNameError::First),
        ("Ada", UserNameError::First),
        ("aDa", UserNameError::Alphabet),
        ("a b", UserNameError::Alphabet),
        ("a/b", UserNameError::Alphabet),
        ("a\0", UserNameError::Alphabet),
        ("adä", UserNameError::Alphabet),
        ("server", UserNameError::Reserved),
        ("server-77", UserNameError::Reserved),
        ("simulator", UserNameError::Reserved),
        ("simulator-desk", UserNameError::Reserved),
        ("learner", UserNameError::Reserved),
        ("learner-desk", UserNameError::Reserved),
    ] {
        assert_eq!(text.parse::<UserName>(), Err(error), "{text:?}");
        let json = serde_json::to_string(text).expect("JSON");
        assert!(serde_json::from_str::<UserName>(&json).is_err(), "{text:?}");
    }
    assert_eq!(
        serde_json::to_string(&name("ada")).expect("JSON"),
        "\"ada\""
    );
}

#[test]
fn a_password_is_long_but_not_too_long_and_not_the_name() {
    let check = |text: &str| password::check(&name("adalovelace"), text);
    assert_eq!(check("123456789"), Err(Weak::TooShort));
    assert_eq!(
        check("ääääääääa"),
        Err(Weak::TooShort),
        "characters, not bytes"
    );
    assert_eq!(check("1234567890"), Ok(()));
    assert_eq!(check(&"ü".repeat(256)), Ok(()));
    assert_eq!(check(&"ü".repeat(257)), Err(Weak::TooLong));
    assert_eq!(check(&"x".repeat(10_000_000)), Err(Weak::TooLong));
    assert_eq!(check("adalovelace"), Err(Weak::Name));
    assert_eq!(check("AdaLovelace"), Err(Weak::Name));
}

#[test]
fn a_hash_belongs_to_one_password_and_says_how_it_was_made() {
    let hash = Memory::new().hash("correct horse").expect("a hash");
    assert!(
        hash.starts_with("$argon2id$v=19$m=19456,t=2,p=1$"),
        "{hash}"
    );
    assert!(Memory::new().verify("correct horse", &hash));
    assert!(!Memory::new().verify("correct horsf", &hash));
    assert!(!Memory::new().verify("", &hash));
    assert_ne!(
        Memory::new().hash("correct horse").expect("a hash"),
        hash,
        "the salt is random"
    );
    assert_eq!(
        Memory::new().hash(&"x".repeat(2_000)),
        Err(HashError::TooLong)
    );
    assert!(!Memory::new().verify(&"x".repeat(2_000), &hash));
}

/// A hash made by another program, the reference implementation in C.
#[test]
fn a_hash_from_elsewhere_with_our_settings_is_read() {
    let hash = "$argon2id$v=19$m=19456,t=2,p=1$MDEyMzQ1Njc4OWFiY2RlZg$69I7qCjDTsQwhQqFvpQJiqEI0lGQvxC84fXE0Ktxca4";
    assert!(Memory::new().verify("correct horse battery", hash));
    assert!(!Memory::new().verify("correct horse batterx", hash));
}

/// Right hashes of the password, made elsewhere with other settings. A hash must not choose its own
/// cost: that could be all memory and all day, or so little that guessing is cheap.
#[test]
fn a_hash_with_other_settings_belongs_to_no_password() {
    for hash in [
        "$argon2id$v=19$m=8,t=1,p=1$MDEyMzQ1Njc4OWFiY2RlZg$M7jw0GQI4Kfcxf+xPldfNRYttP89scc9XVAYAcaZ0U0",
        "$argon2id$v=19$m=19456,t=3,p=1$MDEyMzQ1Njc4OWFiY2RlZg$Z+4B9w+00xHbpvsBogUOLW8mqS7cIBnA4SH0xM0X0rA",
        "$argon2id$v=19$m=19456,t=2,p=2$MDEyMzQ1Njc4OWFiY2RlZg$AcRZNYGqbaEP4Y1jZzc3f/o18jMXJ2GeucVdFTf/m1c",
        "$argon2id$v=19$m=20000,t=2,p=1$MDEyMzQ1Njc4OWFiY2RlZg$l8UwZ1BF1bVv/dFXc1t66atT9zLArq9jZ4xbDWZBiOU",
        "$argon2i$v=19$m=19456,t=2,p=1$MDEyMzQ1Njc4OWFiY2RlZg$k3A0Ke+5sl7ZwafSXeKqxs+yQZnuzL2o0YbQttdD+7g",
        "$argon2d$v=19$m=19456,t=2,p=1$MDEyMzQ1Njc4OWFiY2RlZg$ehhukC+zLV/ynXWcd/EW/fbTdSD8qV3qRmsYmalQHzI",
    ] {
        assert!(!Memory::new().verify("correct horse", hash), "{hash}");
    }
}

#[test]
fn what_is_no_hash_belongs_to_no_password() {
    let good = Memory::new().hash("correct horse").expect("a hash");
    for hash in [
        String::new(),
        "correct horse".to_owned(),
        "$".repeat(10_000),
        good.replace("v=19", "v=16"),
        good[..good.len() - 20].to_owned(),
        good.rsplit_once('$').expect("parts").0.to_owned(),
        format!("{good} "),
        format!("{good}{}", " ".repeat(300)),
        "$argon2id$v=19$m=19456,t=2,p=1$c29tZXNhbHQ$".to_owned(),
    ] {
        assert!(!Memory::new().verify("correct horse", &hash), "{hash}");
    }
}

/// Nanoseconds that this thread has had a core. What else the machine does costs it none.
#[cfg(target_os = "linux")]
fn worked() -> u64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux tells");
    let first = told.split(' ').next().expect("three numbers");
    first.parse().expect("a number")
}

/// Counted in work, not in time. Without any the ratio would be in the thousands.
#[cfg(target_os = "linux")]
#[test]
fn an_unknown_name_costs_the_work_of_a_wrong_password() {
    let hash = Memory::new().hash("correct horse").expect("a hash");
    let begin = worked();
    for _ in 0..5 {
        assert!(!Memory::new().verify("wrong horse", &hash));
    }
    let known = worked() - begin;
    for _ in 0..5 {
        Memory::new().verify_nobody("wrong horse");
    }
    let unknown = worked() - begin - known;
    let ratio = known as f64 / unknown as f64;
    assert!((0.1..10.0).contains(&ratio), "{known} against {unknown} ns");
}

#[test]
fn a_secret_is_random_shown_once_and_known_by_its_digest() {
    let secret = Secret::from(std::array::from_fn(|i| i as u8));
    let text = "AAECAwQFBgcICQoLDA0ODxAREhMUFRYXGBkaGxwdHh8";
    assert_eq!(secret.to_string(), text);
    assert_eq!(format!("{secret:?}"), "Secret(hidden)");
    // As `sha256sum` says.
    assert_eq!(
        secret.digest().0[..8],
        [0x63, 0x0d, 0xcd, 0x29, 0x66, 0xc4, 0x33, 0x66]
    );
    let again: Secret = text.parse().expect("a secret");
    assert!(secret.digest().matches(&again));
    assert!(!Digest([0; 32]).matches(&secret));
    let many: HashSet<_> = (0..100)
        .map(|_| Secret::generate().expect("randomness").to_string())
        .collect();
    assert_eq!(many.len(), 100);
    assert!(many.iter().all(|text| text.len() == 43));
}

#[test]
fn a_secret_has_one_spelling() {
    let text = "AAECAwQFBgcICQoLDA0ODxAREhMUFRYXGBkaGxwdHh8";
    for other in [
        String::new(),
        format!("{text}="),
        format!("{text}A"),
        text[..42].to_owned(),
        // The same bytes with bits left over.
        format!("{}9", &text[..42]),
        text.replace('A', "+"),
        text.replace('A', "/"),
        format!(" {}", &text[..42]),
        format!("{}é", &text[..41]),
        "A".repeat(1_000_000),
    ] {
        assert!(other.parse::<Secret>().is_err(), "{other:.60}");
    }
}

proptest! {
    #[test]
    fn parsers_take_what_they_write_and_nothing_makes_them_panic(text in ".{0,64}") {
        if let Ok(name) = text.parse::<UserName>() {
            prop_assert_eq!(name.as_ref(), &text);
            prop_assert!(text.len() <= 32 && text.is_ascii());
        }
        if let Ok(role) = text.parse::<Role>() {
            prop_assert_eq!(role.to_string(), text.clone());
        }
        if let Ok(secret) = text.parse::<Secret>() {
            prop_assert_eq!(secret.to_string(), text.clone());
        }
        let _ = password::check(&name("ada"), &text);
        prop_assert!(!Memory::new().verify("correct horse", &text));
    }

    #[test]
    fn every_secret_is_read_again(bytes in any::<[u8; 32]>(), other in any::<[u8; 32]>()) {
        let secret = Secret::from(bytes);
        let again: Secret = secret.to_string().parse().expect("our own text");
        prop_assert_eq!(again.as_bytes(), &bytes);
        prop_assert!(secret.digest().matches(&again));
        prop_assert_eq!(secret.digest().matches(&Secret::from(other)), bytes == other);
    }

    #[test]
    fn names_of_the_alphabet_are_names(text in "[a-r][a-z0-9._-]{0,31}") {
        prop_assert_eq!(text.parse::<UserName>().expect("a name").to_string(), text);
    }
}
