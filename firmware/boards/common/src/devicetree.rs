//! The flattened device tree that firmware leaves for a program: two properties of it.
//!
//! Format: Devicetree Specification, release 0.4, chapter 5.

/// Magic number at the start.
const MAGIC: u32 = 0xD00D_FEED;
/// Length of the header.
const HEADER: usize = 40;
/// A tree of this machine is a few kilobytes.
const LONGEST: u32 = 1 << 20;

const BEGIN_NODE: u32 = 1;
const END_NODE: u32 = 2;
const PROPERTY: u32 = 3;
const NOTHING: u32 = 4;

/// Why there is no tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum TreeError {
    /// Something else is there.
    NotATree,
    /// It ends before it should, or points outside of itself.
    Malformed,
}

/// Length of the tree whose first eight bytes are `start`.
///
/// # Errors
/// [`TreeError::NotATree`] when they are not those of a tree of at most 1 MiB.
pub fn length(start: [u8; 8]) -> Result<usize, TreeError> {
    let both = u64::from_be_bytes(start);
    let (magic, total) = ((both >> 32) as u32, both as u32);
    if magic != MAGIC || !(HEADER as u32..=LONGEST).contains(&total) {
        return Err(TreeError::NotATree);
    }
    Ok(total as usize)
}

/// The value of `property` of the node `/chosen`, if it has that.
///
/// # Errors
/// See [`TreeError`].
pub fn chosen<'t>(tree: &'t [u8], property: &str) -> Result<Option<&'t [u8]>, TreeError> {
    let start = tree.first_chunk().ok_or(TreeError::NotATree)?;
    let tree = tree.get(..length(*start)?).ok_or(TreeError::Malformed)?;
    let mut at = word(tree, 8)? as usize;
    let names = word(tree, 12)? as usize;
    let mut depth = 0_u32;
    let mut inside = false;
    loop {
        let token = word(tree, at)?;
        at += 4;
        match token {
            BEGIN_NODE => {
                let name = text(tree, at)?;
                at = (at + name.len() + 1).next_multiple_of(4);
                depth += 1;
                inside = depth == 2 && name == b"chosen";
            }
            END_NODE => {
                depth = depth.checked_sub(1).ok_or(TreeError::Malformed)?;
                inside = false;
            }
            PROPERTY => {
                let len = word(tree, at)? as usize;
                let name = names
                    .checked_add(word(tree, at + 4)? as usize)
                    .ok_or(TreeError::Malformed)?;
                let end = (at + 8).checked_add(len).ok_or(TreeError::Malformed)?;
                let value = tree.get(at + 8..end).ok_or(TreeError::Malformed)?;
                if inside && text(tree, name)? == property.as_bytes() {
                    return Ok(Some(value));
                }
                at = end.next_multiple_of(4);
            }
            NOTHING => {}
            9 => return Ok(None),
            _ => return Err(TreeError::Malformed),
        }
    }
}

fn word(tree: &[u8], at: usize) -> Result<u32, TreeError> {
    tree.get(at..)
        .and_then(<[u8]>::first_chunk)
        .map(|bytes| u32::from_be_bytes(*bytes))
        .ok_or(TreeError::Malformed)
}

/// The bytes from `at` to the next zero.
fn text(tree: &[u8], at: usize) -> Result<&[u8], TreeError> {
    let rest = tree.get(at..).ok_or(TreeError::Malformed)?;
    let end = rest.iter().position(|byte| *byte == 0);
    end.and_then(|end| rest.get(..end))
        .ok_or(TreeError::Malformed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// A tree with `bootargs` in `/chosen` and a decoy deeper down.
    fn tree(arguments: &[u8]) -> Vec<u8> {
        let mut structure = Vec::new();
        let mut push = |words: &[u32]| {
            for word in words {
                structure.extend(word.to_be_bytes());
            }
        };
        push(&[BEGIN_NODE, 0]);
        push(&[BEGIN_NODE, u32::from_be_bytes(*b"soc\0")]);
        push(&[
            BEGIN_NODE,
            u32::from_be_bytes(*b"chos"),
            u32::from_be_bytes(*b"en\0\0"),
        ]);
        push(&[
            PROPERTY,
            4,
            0,
            u32::from_be_bytes(*b"no!\0"),
            END_NODE,
            END_NODE,
        ]);
        push(&[
            NOTHING,
            BEGIN_NODE,
            u32::from_be_bytes(*b"chos"),
            u32::from_be_bytes(*b"en\0\0"),
        ]);
        push(&[PROPERTY, arguments.len() as u32, 0]);
        structure.extend(arguments);
        structure.resize(structure.len().next_multiple_of(4), 0);
        for word in [END_NODE, END_NODE, 9] {
            structure.extend(u32::to_be_bytes(word));
        }
        let names = b"bootargs\0";
        let total = HEADER + structure.len() + names.len();
        let mut tree = Vec::new();
        for word in [
            MAGIC as usize,
            total,
            HEADER,
            HEADER + structure.len(),
            0,
            17,
            16,
            0,
            0,
            0,
        ] {
            tree.extend((word as u32).to_be_bytes());
        }
        tree.extend(structure);
        tree.extend(names);
        tree
    }

    #[test]
    fn the_arguments_are_those_of_the_node_chosen_at_the_root() {
        let tree = tree(b"id=a broker=b\0");
        assert_eq!(chosen(&tree, "bootargs"), Ok(Some(&b"id=a broker=b\0"[..])));
        assert_eq!(chosen(&tree, "rng-seed"), Ok(None));
        assert_eq!(
            length(*tree.first_chunk().expect("long enough")),
            Ok(tree.len())
        );
    }

    #[test]
    fn what_is_no_tree_is_told_from_a_broken_one() {
        assert_eq!(chosen(&[], "bootargs"), Err(TreeError::NotATree));
        assert_eq!(chosen(&[0; 64], "bootargs"), Err(TreeError::NotATree));
        let whole = tree(b"x");
        for len in 8..whole.len() {
            let cut = chosen(&whole[..len], "bootargs");
            assert_eq!(cut, Err(TreeError::Malformed), "cut to {len}");
        }
    }

    proptest! {
        #[test]
        fn nothing_makes_the_reader_panic_or_stay(
            at in 0_usize..200, byte: u8, arguments in prop::collection::vec(any::<u8>(), 0..40),
        ) {
            let mut tree = tree(&arguments);
            let at = at % tree.len();
            tree[at] = byte;
            let _ = chosen(&tree, "bootargs");
        }
    }
}
