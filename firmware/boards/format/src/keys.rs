//! The keys that a program takes releases by: a table in its constants.
//!
//! A program is built without any, and takes no updates. Whoever packs it for robots writes keys into the table, so
//! that the same program serves everybody and a change of keys compiles nothing. The table is found by its
//! [`MARKER`], in an ELF file as well as in an image; a signature over an image covers its keys.

use core::hint::black_box;

/// Bytes of a key: an uncompressed point of P-256 (SEC 1, section 2.3.3).
pub const KEY: usize = 65;
/// How many keys a program can have: the one in use, and the next.
pub const KEYS: usize = 2;
/// What stands before the keys: 16 bytes drawn at random.
pub const MARKER: [u8; 16] = [
    0x5b, 0xd1, 0x9c, 0x07, 0xe4, 0x3a, 0xf8, 0x62, 0x81, 0x2e, 0xb7, 0x4d, 0xc9, 0x10, 0x6f, 0xa5,
];

/// The table. A key whose first byte is 0 is none: that of a point is 4.
#[derive(Debug)]
#[repr(C)]
pub struct KeyTable {
    marker: [u8; 16],
    keys: [[u8; KEY]; KEYS],
}

impl KeyTable {
    /// A table without keys.
    #[must_use]
    pub const fn empty() -> Self {
        Self {
            marker: MARKER,
            keys: [[0; KEY]; KEYS],
        }
    }

    /// The keys.
    pub fn keys(&'static self) -> impl Iterator<Item = &'static [u8; KEY]> {
        // The compiler must not go by what it knows of the table: it is written after it is compiled.
        let table: &'static Self = black_box(self);
        table.keys.iter().filter(|key| key[0] != 0)
    }
}

/// Why no keys were written.
#[cfg(any(test, feature = "std"))]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum KeysError {
    /// The program has no table, or more than one thing that looks like it.
    NoTable,
    /// There are more than [`KEYS`].
    TooMany,
    /// One is no uncompressed point.
    NoPoint,
}

#[cfg(any(test, feature = "std"))]
impl core::fmt::Display for KeysError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NoTable => f.write_str("the program has no table for release keys"),
            Self::TooMany => write!(f, "a program takes {KEYS} release keys at most"),
            Self::NoPoint => f.write_str("a release key is no point of P-256"),
        }
    }
}

#[cfg(any(test, feature = "std"))]
impl core::error::Error for KeysError {}

/// Writes `keys` into the table in `program`, an ELF file or the program alone, in place of those that it has.
///
/// # Errors
/// [`KeysError`]; nothing is changed then.
#[cfg(any(test, feature = "std"))]
pub fn set(program: &mut [u8], keys: &[[u8; KEY]]) -> Result<(), KeysError> {
    if keys.len() > KEYS {
        return Err(KeysError::TooMany);
    }
    if keys.iter().any(|key| key[0] != 4) {
        return Err(KeysError::NoPoint);
    }
    let mut places = program.windows(MARKER.len()).enumerate();
    let mut next = || {
        places
            .find(|(_, bytes)| **bytes == MARKER)
            .map(|(at, _)| at)
    };
    let (Some(at), None) = (next(), next()) else {
        return Err(KeysError::NoTable);
    };
    let table = program.get_mut(at + MARKER.len()..).unwrap_or_default();
    let table = table.get_mut(..KEY * KEYS).ok_or(KeysError::NoTable)?;
    table.fill(0);
    for (place, key) in table.chunks_exact_mut(KEY).zip(keys) {
        place.copy_from_slice(key);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::vec;
    use std::vec::Vec;

    use super::*;

    fn key(last: u8) -> [u8; KEY] {
        let mut key = [last; KEY];
        key[0] = 4;
        key
    }

    fn program() -> Vec<u8> {
        let mut program = vec![7; 100];
        program.extend(MARKER);
        program.extend([0; KEY * KEYS]);
        program.extend([9; 5]);
        program
    }

    #[test]
    fn a_table_holds_the_keys_that_were_written() {
        static EMPTY: KeyTable = KeyTable::empty();
        static ONE: KeyTable = KeyTable {
            marker: MARKER,
            keys: [[4; KEY], [0; KEY]],
        };
        assert_eq!(EMPTY.keys().count(), 0);
        assert_eq!(size_of::<KeyTable>(), MARKER.len() + KEY * KEYS);
        let mut written = program();
        set(&mut written, &[key(1), key(2)]).expect("two");
        assert_eq!(written[116..181], key(1));
        assert_eq!(written[181..246], key(2));
        set(&mut written, &[key(3)]).expect("one");
        assert_eq!(written[116..181], key(3));
        assert_eq!((written[181], written[246]), (0, 9));
        assert_eq!(ONE.keys().collect::<Vec<_>>(), [&[4; KEY]]);
    }

    #[test]
    fn what_cannot_hold_keys_stays_as_it_is() {
        let twice = [program(), program()].concat();
        let cut = program()[..150].to_vec();
        for (program, keys, error) in [
            (vec![0; 300], &[key(1)][..], KeysError::NoTable),
            (twice, &[key(1)], KeysError::NoTable),
            (cut, &[key(1)], KeysError::NoTable),
            (program(), &[key(1); 3], KeysError::TooMany),
            (program(), &[key(1), [2; KEY]], KeysError::NoPoint),
        ] {
            let mut changed = program.clone();
            assert_eq!(set(&mut changed, keys), Err(error));
            assert_eq!(changed, program);
        }
    }
}
