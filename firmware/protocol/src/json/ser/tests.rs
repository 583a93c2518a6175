//! Numbers and texts are written as everyone writes them, and never beyond the end.

use std::format;

use super::*;

fn written(
    write: impl FnOnce(&mut Serializer<'_>) -> Result<(), EncodeError>,
) -> std::string::String {
    let mut buf = [0; 64];
    let mut serializer = Serializer::new(&mut buf);
    write(&mut serializer).unwrap();
    let len = serializer.written();
    core::str::from_utf8(&buf[..len]).unwrap().into()
}

#[test]
fn integers_are_written_as_everyone_writes_them() {
    let mut value: u64 = 1;
    for _ in 0..64 {
        for near in [value - 1, value, value + 1] {
            assert_eq!(written(|s| s.unsigned(near)), format!("{near}"));
            let signed = near as i64;
            assert_eq!(written(|s| s.signed(signed)), format!("{signed}"));
            let negative = signed.wrapping_neg();
            assert_eq!(written(|s| s.signed(negative)), format!("{negative}"));
        }
        value = value.wrapping_mul(10).max(1);
    }
    for extreme in [0, u64::MAX, 999_999_999, 1_000_000_000, 1_000_000_005] {
        assert_eq!(written(|s| s.unsigned(extreme)), format!("{extreme}"));
    }
    assert_eq!(written(|s| s.signed(i64::MIN)), format!("{}", i64::MIN));
}

#[test]
fn nothing_is_written_beyond_the_end() {
    let mut buf = [0; 4];
    let mut serializer = Serializer::new(&mut buf);
    assert_eq!(serializer.unsigned(12_345), Err(EncodeError::TooLarge));
    assert_eq!(serializer.string("abc"), Err(EncodeError::TooLarge));
    assert!(Serializer::new(&mut buf).string("ab").is_ok());
}

#[test]
fn texts_are_escaped_where_they_must_be_and_nowhere_else() {
    for (text, expected) in [
        ("", r#""""#),
        ("plain, ~ and é", r#""plain, ~ and é""#),
        ("a\"b", r#""a\"b""#),
        ("a\\b", r#""a\\b""#),
        ("\u{0}\n", r#""\u0000\n""#),
        ("at the end\u{1f}", r#""at the end\u001f""#),
    ] {
        assert_eq!(written(|s| s.string(text)), expected);
    }
}
