//! Texts of bounded length.

/// What is left of `text` in `most` bytes; an ellipsis says that something is missing. NUL, which
/// `PostgreSQL` does not take in texts, becomes a question mark; what else would begin a line or steer a
/// terminal where the text is shown becomes a space or the replacement character.
pub(crate) fn cut(text: &str, most: usize) -> String {
    const MARK: &str = "…";
    let tame = |c: char| match c {
        '\0' => '?',
        '\n' | '\r' | '\t' => ' ',
        c if c.is_control() => char::REPLACEMENT_CHARACTER,
        c => c,
    };
    let text: String = text.chars().map(tame).collect();
    if text.len() <= most {
        return text;
    }
    let end = text.floor_char_boundary(most.saturating_sub(MARK.len()));
    format!("{}{MARK}", &text[..end])
}

/// Bytes as hexadecimal digits.
pub(crate) fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write as _;
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a String does not fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cut_text_fits_and_says_so() {
        assert_eq!(cut("short", 5), "short");
        assert_eq!(cut("longer", 5), "lo…");
        assert_eq!(cut("a\0b", 5), "a?b");
        assert_eq!(cut("a\nb\r\tc", 9), "a b  c");
        assert_eq!(cut("\u{1b}[2J\u{9b}m", 20), "\u{fffd}[2J\u{fffd}m");
        // The boundary falls inside of an umlaut.
        assert_eq!(cut("öööö", 6), "ö…");
        for most in 3..20 {
            assert!(cut("the quick brown fox jumps", most).len() <= most);
        }
    }

    #[test]
    fn hexadecimal_has_two_digits_per_byte() {
        assert_eq!(hex(&[0, 10, 255]), "000aff");
    }
}
