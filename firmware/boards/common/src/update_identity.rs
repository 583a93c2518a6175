//! Who the running program is to those that update it: its build, and the keys that it believes releases by.

use crawler_app::UpdateIdentity;
use crawler_image_format::keys::KeyTable;
use crawler_protocol::BuildId;
use crawler_release::{PublicKey, PublicKeys};

/// A program of this build, with the keys of its table. A key that is no point of P-256 is left out; without any the
/// program takes no release.
///
/// `None` when `build` is no name of a build, which only a mistake of the board makes.
pub fn identity(build: &str, table: &'static KeyTable) -> Option<UpdateIdentity> {
    let mut keys = table
        .keys()
        .filter_map(|key| PublicKey::from_sec1(key).ok());
    Some(UpdateIdentity {
        build: BuildId::new(build).ok()?,
        sequence: 0,
        built_at: 0,
        keys: keys.next().map(|current| PublicKeys {
            current,
            next: keys.next(),
        }),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_without_keys_believes_nobody() {
        static EMPTY: KeyTable = KeyTable::empty();
        let identity = identity("0123456789abcdef", &EMPTY).expect("a build");
        assert_eq!(identity.build.as_str(), "0123456789abcdef");
        assert_eq!(identity.keys, None);
        assert!(super::identity("", &EMPTY).is_none());
    }
}
