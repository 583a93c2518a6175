//! Tests of access tokens.

use proptest::prelude::*;

use super::*;

const NOW: i64 = 1_700_000_000;

/// Made with the HMAC of another language: key 0, 1, … 31, and the claims of [`claims`].
const TOKEN: &str = concat!(
    "eyJhbGciOiJIUzI1NiIsInR5cCI6IkpXVCJ9.",
    "eyJzdWIiOiJhZGEiLCJyb2xlIjoib3BlcmF0b3IiLCJzaWQiOjcsImlhdCI6MTcwMDAwMDAwMCwiZXhwIjoxNzAwMDAwOTAwfQ.",
    "E5FehF8e8rkzN5Ar1Qf_aaVJgKpF9ZNgHvsmgr2zj1I"
);

fn key() -> Key {
    Key::from_secret(Secret::from(core::array::from_fn(|i| i as u8)))
}

fn claims() -> Claims {
    Claims {
        user: "ada".parse().expect("a name"),
        role: Role::Operator,
        session: 7,
        issued: NOW,
        expires: NOW + LIFETIME,
    }
}

/// A token as somebody with the key could make it: any header, any claims.
fn forge(header: &str, claims: &str) -> String {
    let header = URL_SAFE_NO_PAD.encode(header);
    seal(&format!("{header}.{}", URL_SAFE_NO_PAD.encode(claims)))
}

fn seal(signed: &str) -> String {
    let signature = key().mac(signed).finalize().into_bytes();
    format!("{signed}.{}", URL_SAFE_NO_PAD.encode(signature))
}

#[test]
fn the_format_is_that_of_everybody_else() {
    assert_eq!(key().sign(&claims()), TOKEN);
    assert_eq!(key().verify(TOKEN, NOW), Ok(claims()));
    let header = URL_SAFE_NO_PAD.decode(HEADER).expect("base64url");
    assert_eq!(header, br#"{"alg":"HS256","typ":"JWT"}"#);
}

#[test]
fn a_token_is_good_for_its_time() {
    let verify = |now| key().verify(TOKEN, now);
    assert_eq!(verify(NOW + LIFETIME - 1), Ok(claims()));
    assert_eq!(verify(NOW + LIFETIME), Err(TokenError::Expired));
    assert_eq!(verify(i64::MAX), Err(TokenError::Expired));
    assert_eq!(verify(NOW - LEEWAY), Ok(claims()));
    assert_eq!(verify(NOW - LEEWAY - 1), Err(TokenError::NotYet));
    assert_eq!(verify(i64::MIN), Err(TokenError::NotYet));
}

#[test]
fn the_longest_token_is_short_enough() {
    let claims = Claims {
        user: "a".repeat(crate::MAX_USER_NAME).parse().expect("a name"),
        role: Role::Operator,
        session: u64::MAX,
        issued: i64::MIN,
        expires: i64::MAX,
    };
    let token = key().sign(&claims);
    assert!(token.len() < 300, "{}", token.len());
    assert_eq!(key().verify(&token, 0), Ok(claims));
}

#[test]
fn another_key_is_no_key() {
    let other = Key::from_secret(Secret::generate().expect("randomness"));
    assert_eq!(other.verify(TOKEN, NOW), Err(TokenError::Signature));
}

/// Each is signed with the right key, so it is the header alone that is refused.
#[test]
fn only_one_header_is_taken() {
    let claims = serde_json::to_string(&claims()).expect("JSON");
    let right = r#"{"alg":"HS256","typ":"JWT"}"#;
    assert!(key().verify(&forge(right, &claims), NOW).is_ok());
    for header in [
        r#"{"alg":"none","typ":"JWT"}"#,
        r#"{"alg":"None"}"#,
        r#"{"alg":"hs256","typ":"JWT"}"#,
        r#"{"alg":"HS512","typ":"JWT"}"#,
        r#"{"alg":"RS256","typ":"JWT"}"#,
        r#"{"typ":"JWT","alg":"HS256"}"#,
        r#"{"alg":"HS256"}"#,
        r#"{"alg":"HS256","typ":"jwt"}"#,
        r#"{"alg":"HS256","typ":"JWT","kid":"../../dev/null"}"#,
        r#"{"alg":"HS256","typ":"JWT","jku":"http://example.org"}"#,
        r#" {"alg":"HS256","typ":"JWT"}"#,
        r#"{"alg":"HS256","typ":"JWT"} "#,
        "{}",
        "",
    ] {
        let token = forge(header, &claims);
        assert_eq!(
            key().verify(&token, NOW),
            Err(TokenError::Malformed),
            "{header}"
        );
    }
}

/// Signed as well: even the key cannot make other claims than those of the one kind.
#[test]
fn only_one_kind_of_claims_is_taken() {
    let header = r#"{"alg":"HS256","typ":"JWT"}"#;
    for claims in [
        "",
        "{}",
        "null",
        "[]",
        r#"{"sub":"ada","role":"admin","sid":7,"iat":1700000000}"#,
        r#"{"sub":"ada","role":"root","sid":7,"iat":1700000000,"exp":1700000900}"#,
        r#"{"sub":"Ada","role":"admin","sid":7,"iat":1700000000,"exp":1700000900}"#,
        r#"{"sub":"server-1","role":"admin","sid":7,"iat":1700000000,"exp":1700000900}"#,
        r#"{"sub":"ada","role":"admin","sid":-7,"iat":1700000000,"exp":1700000900}"#,
        r#"{"sub":"ada","role":"admin","sid":7,"iat":1700000000,"exp":1e300}"#,
        r#"{"sub":"ada","role":"admin","sid":7,"iat":1700000000,"exp":99999999999999999999}"#,
        r#"{"sub":"ada","role":"admin","sid":7,"iat":1700000000,"exp":1700000900,"nbf":0}"#,
        r#"{"sub":"ada","sub":"eve","role":"admin","sid":7,"iat":1700000000,"exp":1700000900}"#,
        r#"{"sub":"ada","role":"admin","sid":7,"iat":1700000000,"exp":1700000900} {}"#,
    ] {
        let token = forge(header, claims);
        assert_eq!(
            key().verify(&token, NOW),
            Err(TokenError::Malformed),
            "{claims}"
        );
    }
}

#[test]
fn what_is_no_token_is_refused() {
    let (signed, signature) = TOKEN.rsplit_once('.').expect("two dots");
    let (_, claims) = signed.split_once('.').expect("a dot");
    for text in [
        "",
        ".",
        "..",
        "...",
        HEADER,
        signed,
        &format!("{signed}."),
        &format!("{HEADER}..{signature}"),
        &format!("{TOKEN}="),
        &format!("{TOKEN}\n"),
        &format!(" {TOKEN}"),
        &format!("Bearer {TOKEN}"),
        &format!("{TOKEN}.{signature}"),
        &format!("{HEADER}{claims}.{signature}"),
        &format!("{TOKEN}{}", "A".repeat(MAX_TOKEN)),
    ] {
        assert!(key().verify(text, NOW).is_err(), "{text}");
    }
    // Too long, but right and signed: the length alone is refused.
    let claims = serde_json::to_string(&self::claims()).expect("JSON");
    let header = r#"{"alg":"HS256","typ":"JWT"}"#;
    assert!(
        key()
            .verify(&forge(header, &format!("{claims}{:100}", ' ')), NOW)
            .is_ok()
    );
    let long = forge(header, &format!("{claims}{:400}", ' '));
    assert_eq!(key().verify(&long, NOW), Err(TokenError::Malformed));
    // Claims in a second spelling of the same bytes, signed: base64 has one spelling here.
    for end in ["=", "\n"] {
        let token = seal(&format!("{signed}{end}"));
        assert_eq!(key().verify(&token, NOW), Err(TokenError::Malformed));
    }
}

#[test]
fn a_key_does_not_show_itself() {
    assert_eq!(format!("{:?}", key()), "Key(hidden)");
}

/// Every single byte of a token, changed to every other one.
#[test]
fn a_token_with_one_other_byte_never_verifies() {
    for place in 0..TOKEN.len() {
        for byte in 0..128_u8 {
            let mut bytes = TOKEN.as_bytes().to_vec();
            if bytes[place] == byte {
                continue;
            }
            bytes[place] = byte;
            let text = String::from_utf8(bytes).expect("ASCII");
            assert!(key().verify(&text, NOW).is_err(), "{text}");
        }
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(2_000))]

    #[test]
    fn a_hostile_token_never_verifies(
        text in prop_oneof![
            ".{0,600}",
            "[A-Za-z0-9_-]{0,60}[.][A-Za-z0-9_-]{0,200}[.][A-Za-z0-9_-]{43}",
            "[A-Za-z0-9_-]{0,200}[.][A-Za-z0-9_-]{43}".prop_map(|rest| format!("{HEADER}.{rest}")),
            "[A-Za-z0-9_-]{43}".prop_map(|end| {
                format!("{}.{end}", TOKEN.rsplit_once('.').expect("a dot").0)
            }),
        ],
        now in any::<i64>(),
    ) {
        prop_assert!(text == TOKEN || key().verify(&text, now).is_err());
    }

    #[test]
    fn a_token_cut_or_joined_never_verifies(
        at in 0..TOKEN.len(), from in 0..TOKEN.len(), insert in ".{0,8}",
    ) {
        let text = format!("{}{insert}{}", &TOKEN[..at], &TOKEN[from..]);
        prop_assert!(text == TOKEN || key().verify(&text, NOW).is_err());
    }

    #[test]
    fn what_is_signed_is_read_again_by_its_own_key_alone(
        user in "[a-r][a-z0-9._-]{0,31}", role in prop::sample::select(Role::ALL.to_vec()),
        session in any::<u64>(), issued in any::<i64>(), expires in any::<i64>(),
        now in any::<i64>(), other in any::<[u8; 32]>(),
    ) {
        let user = user.parse().expect("a name");
        let claims = Claims { user, role, session, issued, expires };
        let token = key().sign(&claims);
        let expected = if now >= expires {
            Err(TokenError::Expired)
        } else if issued > now.saturating_add(LEEWAY) {
            Err(TokenError::NotYet)
        } else {
            Ok(claims)
        };
        prop_assert_eq!(key().verify(&token, now), expected);
        let other = Key::from_secret(Secret::from(other));
        prop_assert_eq!(other.verify(&token, now), Err(TokenError::Signature));
    }
}
