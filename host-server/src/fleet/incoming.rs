//! One message, as it arrives.

/// One message from the broker.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Incoming<'a> {
    pub(crate) topic: &'a [u8],
    pub(crate) payload: &'a [u8],
    pub(crate) retained: bool,
    pub(crate) content_type: Option<&'a str>,
    /// User properties.
    pub(crate) properties: &'a [(String, String)],
}

impl Incoming<'_> {
    /// The value of a user property that is there once.
    pub(crate) fn property(&self, name: &str) -> Option<&str> {
        let mut values = self.properties.iter().filter(|(known, _)| known == name);
        match (values.next(), values.next()) {
            (Some((_, value)), None) => Some(value),
            _ => None,
        }
    }
}
