//! A sector of flash, and the pages that many chips share.

use std::collections::BTreeMap;
use std::sync::Arc;

use crawler_bundle::Digest;

use super::{BLANK, ERASE_BYTES};

/// The contents of a sector that was written to its end: sectors with equal ones share them.
#[derive(Debug)]
pub(super) struct Page {
    bytes: Box<[u8]>,
    hash: u64,
}

/// The pages of a world. Robots that hold the same program hold it once.
#[derive(Debug, Default)]
pub(crate) struct Pages {
    by_hash: BTreeMap<u64, Vec<Arc<Page>>>,
    held: usize,
    /// At how many pages those that no sector holds any more are looked for.
    sweep_at: usize,
}

/// At how many pages it is looked for the first time.
const FIRST_SWEEP: usize = 64;

impl Pages {
    /// The page with these contents.
    fn share(&mut self, bytes: &[u8]) -> Arc<Page> {
        let mut digest = Digest::new();
        digest.update(bytes);
        let hash = u64::from_le_bytes(digest.finish());
        let alike = self.by_hash.get(&hash).into_iter().flatten();
        if let Some(page) = alike.into_iter().find(|page| *page.bytes == *bytes) {
            return Arc::clone(page);
        }
        if self.held >= self.sweep_at.max(FIRST_SWEEP) {
            self.sweep();
        }
        let page = Arc::new(Page {
            bytes: bytes.into(),
            hash,
        });
        self.by_hash
            .entry(hash)
            .or_default()
            .push(Arc::clone(&page));
        self.held += 1;
        page
    }

    /// Drops what no sector holds any more.
    fn sweep(&mut self) {
        self.held = 0;
        self.by_hash.retain(|_, pages| {
            pages.retain(|page| Arc::strong_count(page) > 1);
            self.held += pages.len();
            !pages.is_empty()
        });
        self.sweep_at = 2 * self.held;
    }

    /// Memory of the host that the pages take, in bytes.
    pub(crate) fn footprint(&self) -> usize {
        self.held * (ERASE_BYTES + size_of::<Page>())
    }
}

/// What is in a sector.
#[derive(Debug, Clone)]
enum Bytes {
    /// What was written from the start of the sector on; the rest is blank. Stores that append, as they all
    /// do on flash, leave this short.
    Own(Vec<u8>),
    /// The same as in sectors of others.
    Shared(Arc<Page>),
}

/// One erase block.
#[derive(Debug, Clone)]
pub(super) struct Sector {
    bytes: Bytes,
    pub(super) erases: u32,
}

impl Default for Sector {
    fn default() -> Self {
        Self {
            bytes: Bytes::Own(Vec::new()),
            erases: 0,
        }
    }
}

impl Sector {
    /// What was written; the rest is blank.
    pub(super) fn written(&self) -> &[u8] {
        match &self.bytes {
            Bytes::Own(bytes) => bytes,
            Bytes::Shared(page) => &page.bytes,
        }
    }

    pub(super) fn byte(&self, at: usize) -> u8 {
        self.written().get(at).copied().unwrap_or(BLANK)
    }

    pub(super) fn set(&mut self, at: usize, byte: u8) {
        if at >= self.written().len() && byte == BLANK {
            return;
        }
        let own = self.own();
        if at >= own.len() {
            own.resize(at + 1, BLANK);
        }
        own[at] = byte;
    }

    /// Lets the bits fall that are 0 in `bytes`, from byte `at` on.
    pub(super) fn program(&mut self, at: usize, bytes: &[u8]) {
        let own = self.own();
        let (before, end) = (own.len(), at + bytes.len());
        if before < end {
            own.resize(end, BLANK);
        }
        for (old, new) in own[at..end].iter_mut().zip(bytes) {
            *old &= new;
        }
        while own.len() > before && own.last() == Some(&BLANK) {
            own.pop();
        }
    }

    /// Fills it with what `write` makes of it.
    pub(super) fn fill(&mut self, write: impl FnOnce(&mut [u8])) {
        let own = self.own();
        own.resize(ERASE_BYTES, BLANK);
        write(own);
    }

    /// Has these contents, as much of them as there is room for.
    #[cfg(feature = "recording")]
    pub(super) fn load(&mut self, bytes: &[u8]) {
        let length = bytes.len().min(ERASE_BYTES);
        self.bytes = Bytes::Own(bytes[..length].to_vec());
    }

    pub(super) fn clear(&mut self) {
        self.bytes = Bytes::Own(Vec::new());
    }

    /// Shares what is in it with other sectors. Does nothing to one that is blank.
    pub(super) fn share(&mut self, pages: &mut Pages) {
        if let Bytes::Own(bytes) = &mut self.bytes
            && !bytes.is_empty()
        {
            bytes.resize(ERASE_BYTES, BLANK);
            self.bytes = Bytes::Shared(pages.share(bytes));
        }
    }

    /// The contents, to be changed.
    fn own(&mut self) -> &mut Vec<u8> {
        if let Bytes::Shared(page) = &self.bytes {
            self.bytes = Bytes::Own(page.bytes.to_vec());
        }
        match &mut self.bytes {
            Bytes::Own(bytes) => bytes,
            Bytes::Shared(_) => unreachable!("it was made its own above"),
        }
    }

    /// Memory of the host that its own contents take, in bytes.
    pub(super) fn footprint(&self) -> usize {
        match &self.bytes {
            Bytes::Own(bytes) => bytes.capacity(),
            Bytes::Shared(_) => 0,
        }
    }

    /// Whether nothing was ever done to it.
    pub(super) fn is_unused(&self) -> bool {
        self.written().is_empty() && self.erases == 0
    }

    pub(super) fn fingerprint(&self, word: &mut impl FnMut(u64)) {
        word(u64::from(self.erases));
        match &self.bytes {
            Bytes::Own(bytes) => {
                for chunk in bytes.chunks(8) {
                    let mut bytes = [BLANK; 8];
                    bytes[..chunk.len()].copy_from_slice(chunk);
                    word(u64::from_le_bytes(bytes));
                }
            }
            Bytes::Shared(page) => word(page.hash),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn full(byte: u8) -> Sector {
        let mut sector = Sector::default();
        sector.program(0, &[byte; ERASE_BYTES]);
        sector
    }

    #[test]
    fn equal_sectors_are_held_once_until_one_changes() {
        let mut pages = Pages::default();
        let (mut one, mut other) = (full(7), full(7));
        one.share(&mut pages);
        other.share(&mut pages);
        assert_eq!(pages.held, 1);
        assert_eq!((one.footprint(), other.footprint()), (0, 0));
        other.set(9, 5);
        assert_eq!((one.byte(9), other.byte(9)), (7, 5));
        assert_eq!(other.footprint(), ERASE_BYTES);
        other.share(&mut pages);
        assert_eq!(pages.held, 2);
    }

    #[test]
    fn what_is_blank_is_not_shared() {
        let mut pages = Pages::default();
        let mut sector = Sector::default();
        sector.program(0, &[BLANK; ERASE_BYTES]);
        sector.share(&mut pages);
        assert!(sector.is_unused());
        assert_eq!(pages.footprint(), 0);
    }

    #[test]
    fn pages_that_nobody_holds_are_dropped() {
        let mut pages = Pages::default();
        let mut kept = full(0);
        kept.share(&mut pages);
        for turn in 0..1_000_u32 {
            let mut sector = Sector::default();
            sector.program(0, &turn.to_le_bytes().repeat(ERASE_BYTES / 4));
            sector.set(ERASE_BYTES - 1, 0);
            sector.share(&mut pages);
        }
        assert!(pages.held <= FIRST_SWEEP, "{}", pages.held);
        let mut again = full(0);
        again.share(&mut pages);
        assert_eq!(again.written(), kept.written());
        assert_eq!(again.footprint(), 0);
    }
}
