//! The form in flash, entry by entry: also of those that another version of the program has written.

/// Keys from here on are followed by a length and so many bytes; those below by a number of four bytes, but
/// for the text that was there before this rule. So every program passes over what it does not know.
pub(super) const SIZED: u8 = 128;

/// One parameter in flash.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Entry<'a> {
    pub(super) key: u8,
    pub(super) value: &'a [u8],
    /// All of it: key, length where it has one, and value.
    pub(super) bytes: &'a [u8],
}

/// The entries of an item, up to the first one that is cut off, of which it is told.
pub(super) struct Entries<'a> {
    rest: &'a [u8],
    /// A key whose value has a length although it is below [`SIZED`].
    text: u8,
    pub(super) cut: bool,
}

impl<'a> Entries<'a> {
    pub(super) const fn new(item: &'a [u8], text: u8) -> Self {
        Self {
            rest: item,
            text,
            cut: false,
        }
    }
}

impl<'a> Iterator for Entries<'a> {
    type Item = Entry<'a>;

    fn next(&mut self) -> Option<Entry<'a>> {
        let (key, rest) = self.rest.split_first()?;
        let sized = *key >= SIZED || *key == self.text;
        let (head, length) = match rest.first() {
            Some(length) if sized => (2, usize::from(*length)),
            _ if sized => (2, 0),
            _ => (1, 4),
        };
        let all = self.rest;
        let Some((bytes, rest)) = all.split_at_checked(head + length) else {
            self.cut = true;
            self.rest = &[];
            return None;
        };
        self.rest = rest;
        Some(Entry {
            key: *key,
            value: bytes.get(head..).unwrap_or(&[]),
            bytes,
        })
    }
}
