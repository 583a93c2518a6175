//! One message, as it arrives.

/// One message from the broker.
#[derive(Debug, Clone, Copy)]
pub struct Incoming<'a> {
    /// As it stands in the message, well-formed or not.
    pub topic: &'a [u8],
    /// Its body.
    pub payload: &'a [u8],
    /// Whether the broker had kept it.
    pub retained: bool,
    /// What its sender says that the body is.
    pub content_type: Option<&'a str>,
    /// User properties.
    pub properties: &'a [(String, String)],
}

impl Incoming<'_> {
    /// The value of a user property that is there once.
    pub fn property(&self, name: &str) -> Option<&str> {
        let mut values = self.properties.iter().filter(|(known, _)| known == name);
        match (values.next(), values.next()) {
            (Some((_, value)), None) => Some(value),
            _ => None,
        }
    }
}
