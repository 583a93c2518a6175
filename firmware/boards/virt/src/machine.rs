//! Addresses of the machine, and what its command line said.
//!
//! Source of the addresses: the machine's own device tree (`-M virt,dumpdtb=…`, QEMU 7.2).

use core::slice;

use crawler_board::devicetree::{self, TreeError};

/// Power off and reset (the "test finisher").
const FINISHER: *mut u32 = 0x0010_0000 as *mut u32;
/// Serial line, compatible with the 16550.
pub(crate) const UART: *mut u8 = 0x1000_0000 as *mut u8;
/// Software interrupt of hart 0.
pub(crate) const MSIP: *mut u32 = 0x0200_0000 as *mut u32;
/// Compare register of the machine timer, two words.
pub(crate) const MTIMECMP: *mut u32 = 0x0200_4000 as *mut u32;
/// Machine timer, two words, 10 MHz.
pub(crate) const MTIME: *const u32 = 0x0200_BFF8 as *const u32;
/// Interrupt controller.
pub(crate) const PLIC: usize = 0x0C00_0000;
/// First of eight slots for virtio devices, and the distance between them.
pub(crate) const VIRTIO: usize = 0x1000_1000;
pub(crate) const VIRTIO_STRIDE: usize = 0x1000;
pub(crate) const VIRTIO_SLOTS: usize = 8;

/// Why the emulator ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, defmt::Format)]
#[repr(u16)]
pub enum ExitCode {
    /// Done. Only the measuring program ever is.
    Done = 0,
    /// The command line is not understood.
    Arguments = 2,
    /// There is no network card, or it does not start.
    NoNetworkCard = 3,
    /// A measurement did not come to its end.
    Measurement = 4,
    /// No slot holds a whole program: the boot stage says so.
    NoProgram = 5,
    /// The boot stage failed.
    BootStage = 6,
}

/// Ends the emulator with `code`.
pub fn exit(code: ExitCode) -> ! {
    let word = match code {
        ExitCode::Done => 0x5555,
        code => (code as u32) << 16 | 0x3333,
    };
    finish(word)
}

/// Resets the machine. RAM keeps its content but for what the loader puts there again.
pub fn reset() -> ! {
    finish(0x7777)
}

fn finish(word: u32) -> ! {
    // SAFETY: a register of this machine; writing it ends the program.
    unsafe { FINISHER.write_volatile(word) };
    riscv::interrupt::disable();
    loop {
        riscv::asm::wfi();
    }
}

/// What the firmware left about the machine.
#[derive(Debug, Clone, Copy)]
pub struct Description {
    tree: &'static [u8],
}

/// Why the command line cannot be told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, defmt::Format)]
pub enum DescriptionError {
    /// There is no device tree where the firmware says.
    NoTree,
    /// It ends before it should.
    Malformed,
    /// The command line is not UTF-8.
    NotText,
}

impl From<TreeError> for DescriptionError {
    fn from(error: TreeError) -> Self {
        match error {
            TreeError::NotATree => Self::NoTree,
            _ => Self::Malformed,
        }
    }
}

impl Description {
    /// The device tree at `address`.
    ///
    /// # Errors
    /// [`DescriptionError::NoTree`] when there is none.
    ///
    /// # Safety
    /// `address` must be what the firmware handed over at start, and nothing may have written
    /// there since.
    pub unsafe fn at(address: usize) -> Result<Self, DescriptionError> {
        // Eight bytes is what the format asks for (section 5.1).
        if address == 0 || !address.is_multiple_of(8) {
            return Err(DescriptionError::NoTree);
        }
        let start = address as *const u8;
        // SAFETY: the caller vouches for the address; the firmware leaves at least a header.
        let head = unsafe { start.cast::<[u8; 8]>().read() };
        let len = devicetree::length(head)?;
        // SAFETY: as above, and the tree says how long it is; it lies beyond our memory regions,
        // so nobody writes there.
        let tree = unsafe { slice::from_raw_parts(start, len) };
        Ok(Self { tree })
    }

    /// What `-append` said; empty when it was not there.
    ///
    /// # Errors
    /// See [`DescriptionError`].
    pub fn arguments(&self) -> Result<&'static str, DescriptionError> {
        let bytes = devicetree::chosen(self.tree, "bootargs")?.unwrap_or_default();
        let text = core::str::from_utf8(bytes).map_err(|_| DescriptionError::NotText)?;
        Ok(text.trim_end_matches('\0'))
    }

    /// As much randomness from the host as keys want; `None` where this version of the machine hands
    /// out less.
    pub fn secret_entropy(&self) -> Option<[u8; 32]> {
        let seed = devicetree::chosen(self.tree, "rng-seed").ok().flatten()?;
        seed.first_chunk().copied()
    }

    /// Randomness from the host; `None` where this version of the machine hands out none.
    pub fn entropy(&self) -> Option<u64> {
        let seed = devicetree::chosen(self.tree, "rng-seed").ok().flatten()?;
        seed.first_chunk().map(|bytes| u64::from_le_bytes(*bytes))
    }
}
