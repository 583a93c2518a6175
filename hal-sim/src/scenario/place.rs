//! Where in a file a key stands.

use std::fmt;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A place in a text, counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Line.
    pub line: usize,
    /// Column, in characters.
    pub column: usize,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, column {}", self.line, self.column)
    }
}

impl Place {
    /// The place of the byte at `offset`.
    pub(super) fn of(text: &str, offset: usize) -> Self {
        let mut end = offset.min(text.len());
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let before = &text[..end];
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        Self {
            line: before.bytes().filter(|&byte| byte == b'\n').count() + 1,
            column: before[line_start..].chars().count() + 1,
        }
    }

    /// The place of `key` (like `arena.obstacles[2].x`), or of as much of it as the text has.
    /// `None` when it has nothing of it.
    pub(super) fn of_key(text: &str, key: &str) -> Option<Self> {
        let document = DeTable::parse(text).ok()?;
        let mut offset = None;
        let mut table = Some(document.get_ref());
        let mut value: Option<&Spanned<DeValue<'_>>> = None;
        for step in steps(key) {
            let next = match step {
                Step::Key(name) => table.and_then(|table| {
                    let mut entries = table.iter();
                    entries.find_map(|(key, value)| {
                        let found = key.get_ref().as_ref() == name;
                        found.then_some((key.span().start, value))
                    })
                }),
                Step::Index(index) => value.and_then(|value| match value.get_ref() {
                    DeValue::Array(array) => {
                        let item: &Spanned<DeValue<'_>> = array.get(index)?;
                        Some((item.span().start, item))
                    }
                    _ => None,
                }),
            };
            let Some((start, inner)) = next else { break };
            offset = Some(start);
            value = Some(inner);
            table = match inner.get_ref() {
                DeValue::Table(table) => Some(table),
                _ => None,
            };
        }
        offset.map(|offset| Self::of(text, offset))
    }
}

/// One step down a dotted key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step<'a> {
    Key(&'a str),
    Index(usize),
}

/// The steps of a key like `goals[2].x` or `goals.2.x`.
pub(super) fn steps(key: &str) -> impl Iterator<Item = Step<'_>> {
    key.split(['.', '[', ']'])
        .filter(|part| !part.is_empty())
        .map(|part| {
            part.parse()
                .map_or_else(|_| Step::Key(part.trim()), Step::Index)
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found_where_they_stand() {
        let text = "name = \"a\"\n[arena]\nwidth = 3.0\n\n[[goals]]\nx = 1.0\n[[goals]]\nx = 2\n  y = [1, 2]\n";
        let at = |key| Place::of_key(text, key).map(|place| (place.line, place.column));
        assert_eq!(at("name"), Some((1, 1)));
        assert_eq!(at("arena.width"), Some((3, 1)));
        assert_eq!(at("goals[0].x"), Some((6, 1)));
        assert_eq!(at("goals[1].x"), Some((8, 1)));
        assert_eq!(at("goals.1.y[1]"), Some((9, 11)));
        // What is not there is told by what it would stand in.
        assert_eq!(at("arena.height"), at("arena"));
        assert_eq!(at("robots"), None);
        assert_eq!(Place::of_key("not toml", "name"), None);
    }

    #[test]
    fn columns_count_characters() {
        assert_eq!(Place::of("äö = 1", 5), Place { line: 1, column: 4 });
        assert_eq!(Place::of("a\nb", 99), Place { line: 2, column: 2 });
    }
}
