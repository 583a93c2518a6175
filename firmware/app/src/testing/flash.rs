//! A NOR flash that is stricter than a real one, and can be cut off or wear out.

use core::cell::RefCell;
use std::rc::Rc;
use std::vec::Vec;

use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

pub(crate) const PAGE: usize = 1024;
const WORD: usize = 4;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct FlashFailure;

impl NorFlashError for FlashFailure {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

pub(crate) struct Cells {
    pub(crate) bytes: Vec<u8>,
    /// Bytes that may still be written or erased before the power goes; `None` is for ever.
    pub(crate) power: Option<usize>,
    /// Every write and erase is refused.
    pub(crate) worn: bool,
    /// Every read is refused.
    pub(crate) deaf: bool,
    /// Content was spoiled behind the program's back: writing over it is the flash's fault.
    pub(crate) spoiled: bool,
    /// Writes and erasures that reached the flash.
    pub(crate) changes: usize,
}

/// Two handles are the same flash, as before and after a boot.
#[derive(Clone)]
pub(crate) struct TestFlash(pub(crate) Rc<RefCell<Cells>>);

impl TestFlash {
    pub(crate) fn new(pages: usize) -> Self {
        Self(Rc::new(RefCell::new(Cells {
            bytes: std::vec![0xff; pages * PAGE],
            power: None,
            worn: false,
            deaf: false,
            spoiled: false,
            changes: 0,
        })))
    }
}

impl Cells {
    /// How many of `len` bytes are still changed before the power goes.
    fn spend(&mut self, len: usize) -> usize {
        self.changes += 1;
        match &mut self.power {
            None => len,
            Some(left) => {
                let done = len.min(*left);
                *left -= done;
                done
            }
        }
    }
}

impl ErrorType for TestFlash {
    type Error = FlashFailure;
}

impl ReadNorFlash for TestFlash {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashFailure> {
        let cells = self.0.borrow();
        if cells.deaf {
            return Err(FlashFailure);
        }
        let from = offset as usize;
        bytes.copy_from_slice(&cells.bytes[from..from + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.borrow().bytes.len()
    }
}

impl NorFlash for TestFlash {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashFailure> {
        let mut cells = self.0.borrow_mut();
        assert!((from as usize).is_multiple_of(PAGE) && (to as usize).is_multiple_of(PAGE));
        if cells.worn {
            return Err(FlashFailure);
        }
        let (from, len) = (from as usize, (to - from) as usize);
        let done = cells.spend(len);
        cells.bytes[from..from + done].fill(0xff);
        if done < len {
            Err(FlashFailure)
        } else {
            Ok(())
        }
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashFailure> {
        let mut cells = self.0.borrow_mut();
        assert!((offset as usize).is_multiple_of(WORD) && bytes.len().is_multiple_of(WORD));
        if cells.worn {
            return Err(FlashFailure);
        }
        let from = offset as usize;
        let done = cells.spend(bytes.len());
        let spoiled = cells.spoiled;
        for (cell, byte) in cells.bytes[from..].iter_mut().zip(&bytes[..done]) {
            assert!(
                spoiled || *cell & byte == *byte,
                "written without having been erased"
            );
            *cell &= byte;
        }
        if done < bytes.len() {
            Err(FlashFailure)
        } else {
            Ok(())
        }
    }
}
