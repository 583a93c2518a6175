//! Who the running program is to those that update it: its build, and the keys that it believes releases by.

use crawler_app::UpdateIdentity;
use crawler_image_format::keys::KeyTable;
use crawler_protocol::BuildId;
use crawler_release::{PublicKey, PublicKeys};

/// What names a program: the digits that whoever packed it wrote into it, or its version where nobody did. A board
/// says the same wherever it names its program.
#[must_use]
pub fn build(digits: Option<&str>, version: &str) -> BuildId {
    let build = digits.and_then(|digits| BuildId::new(digits).ok());
    build.unwrap_or_else(|| BuildId::development(version))
}

/// A program of this build, with the keys of its table. A key that is no point of P-256 is left out; without any the
/// program takes no release.
pub fn identity(build: BuildId, table: &'static KeyTable) -> UpdateIdentity {
    let mut keys = table
        .keys()
        .filter_map(|key| PublicKey::from_sec1(key).ok());
    UpdateIdentity {
        build,
        keys: keys.next().map(|current| PublicKeys {
            current,
            next: keys.next(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_without_keys_believes_nobody() {
        static EMPTY: KeyTable = KeyTable::empty();
        let identity = identity(build(Some("0123456789abcdef"), "0.3.0"), &EMPTY);
        assert_eq!(identity.build.as_str(), "0123456789abcdef");
        assert_eq!(identity.keys, None);
    }

    #[test]
    fn a_program_that_nobody_packed_goes_by_its_version() {
        for digits in [None, Some(""), Some("no name: ä")] {
            assert_eq!(build(digits, "0.3.0").as_str(), "0.3.0+dev", "{digits:?}");
        }
    }
}
