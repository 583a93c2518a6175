//! A pull reader over JSON text (RFC 8259). Reads forwards only and keeps nothing.

use heapless::String;

use super::{DecodeError, MAX_DEPTH};

/// Shorthand: everything this module finds wrong is a matter of syntax.
type Result<T> = core::result::Result<T, DecodeError>;
const MALFORMED: DecodeError = DecodeError::Malformed;

/// A string as it stands between its quotation marks. Its escapes are known to be valid.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Text<'a> {
    raw: &'a str,
    escaped: bool,
}

impl<'a> Text<'a> {
    /// The text itself where it has no escapes.
    pub(crate) fn plain(self) -> Option<&'a str> {
        (!self.escaped).then_some(self.raw)
    }

    /// A decoded copy; `None` when it is longer than `N` bytes.
    pub(crate) fn decode<const N: usize>(self) -> Option<String<N>> {
        let mut text = String::new();
        if let Some(plain) = self.plain() {
            return text.push_str(plain).ok().map(|()| text);
        }
        let mut rest = self.raw.chars();
        while let Some(character) = rest.next() {
            let character = match character {
                '\\' => unescape(&mut rest)?,
                other => other,
            };
            text.push(character).ok()?;
        }
        Some(text)
    }
}

/// The character of an escape whose backslash is already read; `None` when it is none.
fn unescape(rest: &mut core::str::Chars<'_>) -> Option<char> {
    match rest.next()? {
        '"' => Some('"'),
        '\\' => Some('\\'),
        '/' => Some('/'),
        'b' => Some('\u{8}'),
        'f' => Some('\u{c}'),
        'n' => Some('\n'),
        'r' => Some('\r'),
        't' => Some('\t'),
        'u' => match hex4(rest)? {
            high @ 0xd800..=0xdbff => {
                if rest.next()? != '\\' || rest.next()? != 'u' {
                    return None;
                }
                match hex4(rest)? {
                    low @ 0xdc00..=0xdfff => {
                        char::from_u32(0x1_0000 + ((high - 0xd800) << 10) + (low - 0xdc00))
                    }
                    _ => None,
                }
            }
            // A low surrogate alone is no character: `from_u32` says so.
            code => char::from_u32(code),
        },
        _ => None,
    }
}

fn hex4(rest: &mut core::str::Chars<'_>) -> Option<u32> {
    let mut code = 0;
    for _ in 0..4 {
        code = code << 4 | rest.next()?.to_digit(16)?;
    }
    Some(code)
}

/// One value. Scalars are read; of an object or array only the first byte is seen.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Value<'a> {
    Null,
    Bool(bool),
    /// The text of a number, as the grammar has it.
    Number(&'a str),
    Text(Text<'a>),
    Object,
    Array,
}

/// The place reached in a text.
#[derive(Debug, Clone)]
pub(crate) struct Reader<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Reader<'a> {
    pub(crate) const fn new(text: &'a str) -> Self {
        Self { text, at: 0 }
    }

    fn byte(&self) -> Option<u8> {
        self.text.as_bytes().get(self.at).copied()
    }

    fn since(&self, start: usize) -> Result<&'a str> {
        self.text.get(start..self.at).ok_or(MALFORMED)
    }

    /// The next byte that is not white space, without taking it.
    fn peek(&mut self) -> Option<u8> {
        while let Some(b' ' | b'\t' | b'\n' | b'\r') = self.byte() {
            self.at += 1;
        }
        self.byte()
    }

    fn take(&mut self, wanted: u8) -> Result<()> {
        if self.peek() == Some(wanted) {
            self.at += 1;
            Ok(())
        } else {
            Err(MALFORMED)
        }
    }

    /// Proves that nothing but white space is left.
    pub(crate) fn end(&mut self) -> Result<()> {
        match self.peek() {
            None => Ok(()),
            Some(_) => Err(MALFORMED),
        }
    }

    /// Whether anything follows. Where not, what was read last may have been cut off.
    pub(crate) fn goes_on(&mut self) -> bool {
        self.peek().is_some()
    }

    /// Reads a scalar, or sees that an object or array begins.
    pub(crate) fn value(&mut self) -> Result<Value<'a>> {
        match self.peek().ok_or(MALFORMED)? {
            b'{' => Ok(Value::Object),
            b'[' => Ok(Value::Array),
            b'"' => self.string().map(Value::Text),
            b'-' | b'0'..=b'9' => self.number().map(Value::Number),
            b't' => self.word("true").map(|()| Value::Bool(true)),
            b'f' => self.word("false").map(|()| Value::Bool(false)),
            b'n' => self.word("null").map(|()| Value::Null),
            _ => Err(MALFORMED),
        }
    }

    /// Enters the object that [`Self::value`] saw.
    pub(crate) fn open_object(&mut self) -> Result<()> {
        self.take(b'{')
    }

    /// Enters the array that [`Self::value`] saw.
    pub(crate) fn open_array(&mut self) -> Result<()> {
        self.take(b'[')
    }

    /// The name of the next member, up to its colon; `None` after leaving the object.
    pub(crate) fn member(&mut self, first: bool) -> Result<Option<Text<'a>>> {
        if self.peek() == Some(b'}') {
            self.at += 1;
            return Ok(None);
        }
        if !first {
            self.take(b',')?;
        }
        if self.peek() != Some(b'"') {
            return Err(MALFORMED);
        }
        let name = self.string()?;
        self.take(b':')?;
        Ok(Some(name))
    }

    /// Whether another element follows; `false` after leaving the array.
    pub(crate) fn element(&mut self, first: bool) -> Result<bool> {
        if self.peek() == Some(b']') {
            self.at += 1;
            return Ok(false);
        }
        if !first {
            self.take(b',')?;
        }
        Ok(true)
    }

    /// Reads one value of any kind and forgets it. Calls itself at most `depth` times.
    pub(crate) fn skip(&mut self, depth: u8) -> Result<()> {
        debug_assert!(depth <= MAX_DEPTH, "the stack is sized for this depth");
        match self.value()? {
            Value::Object => {
                let depth = depth.checked_sub(1).ok_or(MALFORMED)?;
                self.open_object()?;
                let mut first = true;
                while self.member(first)?.is_some() {
                    first = false;
                    self.skip(depth)?;
                }
                Ok(())
            }
            Value::Array => {
                let depth = depth.checked_sub(1).ok_or(MALFORMED)?;
                self.open_array()?;
                let mut first = true;
                while self.element(first)? {
                    first = false;
                    self.skip(depth)?;
                }
                Ok(())
            }
            Value::Null | Value::Bool(_) | Value::Number(_) | Value::Text(_) => Ok(()),
        }
    }

    fn word(&mut self, word: &str) -> Result<()> {
        let rest = self.text.get(self.at..).ok_or(MALFORMED)?;
        if rest.starts_with(word) {
            self.at += word.len();
            self.delimited()
        } else {
            Err(MALFORMED)
        }
    }

    /// A number or word ends where something else may follow. At the end of a truncated text it
    /// does so too; the object around it then misses its brace.
    fn delimited(&self) -> Result<()> {
        match self.byte() {
            None | Some(b' ' | b'\t' | b'\n' | b'\r' | b',' | b']' | b'}') => Ok(()),
            Some(_) => Err(MALFORMED),
        }
    }

    fn digits(&mut self) -> Result<()> {
        let start = self.at;
        while matches!(self.byte(), Some(b'0'..=b'9')) {
            self.at += 1;
        }
        if self.at > start {
            Ok(())
        } else {
            Err(MALFORMED)
        }
    }

    fn number(&mut self) -> Result<&'a str> {
        let start = self.at;
        if self.byte() == Some(b'-') {
            self.at += 1;
        }
        if self.byte() == Some(b'0') {
            self.at += 1;
        } else {
            self.digits()?;
        }
        if self.byte() == Some(b'.') {
            self.at += 1;
            self.digits()?;
        }
        if let Some(b'e' | b'E') = self.byte() {
            self.at += 1;
            if let Some(b'+' | b'-') = self.byte() {
                self.at += 1;
            }
            self.digits()?;
        }
        self.delimited()?;
        self.since(start)
    }

    fn string(&mut self) -> Result<Text<'a>> {
        self.take(b'"')?;
        let start = self.at;
        let mut escaped = false;
        loop {
            let rest = self.text.as_bytes().get(self.at..).ok_or(MALFORMED)?;
            let special = |byte: &u8| matches!(byte, b'"' | b'\\' | 0..=0x1f);
            self.at += rest.iter().position(special).ok_or(MALFORMED)?;
            match self.byte().ok_or(MALFORMED)? {
                b'"' => break,
                b'\\' => {
                    escaped = true;
                    let rest = self.text.get(self.at + 1..).ok_or(MALFORMED)?;
                    let mut characters = rest.chars();
                    unescape(&mut characters).ok_or(MALFORMED)?;
                    self.at = self.text.len() - characters.as_str().len();
                }
                // A control character.
                _ => return Err(MALFORMED),
            }
        }
        let raw = self.since(start)?;
        self.at += 1;
        Ok(Text { raw, escaped })
    }
}
