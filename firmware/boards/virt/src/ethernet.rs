//! The network card: virtio over MMIO, as an embassy-net driver.
//!
//! The device reads and writes the buffers it was lent; a buffer is either in the hands of the
//! device or in its [`Cell`], never both.

use core::cell::{Cell, RefCell, UnsafeCell};
use core::ptr::NonNull;
use core::sync::atomic::{Ordering, fence};
use core::task::Context;

use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState, RxToken, TxToken};
use embassy_sync::waitqueue::AtomicWaker;
use portable_atomic::AtomicUsize;
use riscv::interrupt::Interrupt;
use static_cell::ConstStaticCell;
use virtio_drivers::device::net::VirtIONetRaw;
use virtio_drivers::transport::mmio::{MmioTransport, VirtIOHeader};
use virtio_drivers::transport::{DeviceType, Transport};
use virtio_drivers::{BufferDirection, Hal, PAGE_SIZE, PhysAddr};

use crate::machine::{PLIC, VIRTIO, VIRTIO_SLOTS, VIRTIO_STRIDE};

/// Descriptors of each ring.
const RING: usize = 8;
const RECEIVE_BUFFERS: usize = 4;
const TRANSMIT_BUFFERS: usize = 2;
/// Header of virtio, Ethernet frame, and room to the next power of two of nothing in particular.
const BUFFER: usize = 1_536;
/// Largest Ethernet frame.
const MTU: usize = 1_514;
/// Two rings of two pages each: descriptors with the available ring, and the used ring.
const DMA_PAGES: usize = 4;

const INTERRUPT_STATUS: usize = 0x60;
const INTERRUPT_ACK: usize = 0x64;
/// In the configuration space: link status, bit 0 for up (virtio 1.1, section 5.1.4).
const NET_STATUS: usize = 0x106;

type Buffer = [u8; BUFFER];
type Card = VirtIONetRaw<Dma, MmioTransport<'static>, RING>;
type Slot = Cell<Option<&'static mut Buffer>>;

static RECEIVE: ConstStaticCell<[Buffer; RECEIVE_BUFFERS]> =
    ConstStaticCell::new([[0; BUFFER]; RECEIVE_BUFFERS]);
static TRANSMIT: ConstStaticCell<[Buffer; TRANSMIT_BUFFERS]> =
    ConstStaticCell::new([[0; BUFFER]; TRANSMIT_BUFFERS]);

static WAKER: AtomicWaker = AtomicWaker::new();
/// Address of the device whose interrupt it is; 0 for none.
static DEVICE: AtomicUsize = AtomicUsize::new(0);

/// Why there is no network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, defmt::Format)]
pub enum EthernetError {
    /// No slot holds a network card.
    NotFound,
    /// It does not start.
    NotStarted,
}

/// Not in a cell with a flag, which would take a page of its own.
#[repr(C, align(4096))]
struct Pages(UnsafeCell<[u8; DMA_PAGES * PAGE_SIZE]>);

// SAFETY: each page is handed out once, by the count in `LEFT`.
unsafe impl Sync for Pages {}

static PAGES: Pages = Pages(UnsafeCell::new([0; DMA_PAGES * PAGE_SIZE]));
/// Pages not handed out yet, the last ones.
static LEFT: critical_section::Mutex<Cell<usize>> =
    critical_section::Mutex::new(Cell::new(DMA_PAGES));

/// Memory for the device: physical addresses are ours.
struct Dma;

// SAFETY: pages are handed out once, aligned and zeroed, and never taken back; there is no
// translation between addresses.
unsafe impl Hal for Dma {
    fn dma_alloc(pages: usize, _direction: BufferDirection) -> (PhysAddr, NonNull<u8>) {
        let start = PAGES.0.get().cast::<u8>();
        critical_section::with(|cs| {
            let cell = LEFT.borrow(cs);
            let used = DMA_PAGES - cell.get();
            let place = NonNull::new(start.wrapping_add(used * PAGE_SIZE));
            match (cell.get().checked_sub(pages), place) {
                (Some(rest), Some(place)) => {
                    cell.set(rest);
                    (place.as_ptr().expose_provenance() as PhysAddr, place)
                }
                // Address 0 says that there is none.
                _ => (0, NonNull::dangling()),
            }
        })
    }

    unsafe fn dma_dealloc(_paddr: PhysAddr, _vaddr: NonNull<u8>, _pages: usize) -> i32 {
        0
    }

    unsafe fn mmio_phys_to_virt(paddr: PhysAddr, _size: usize) -> NonNull<u8> {
        NonNull::new(core::ptr::with_exposed_provenance_mut(paddr as usize))
            .unwrap_or(NonNull::dangling())
    }

    unsafe fn share(buffer: NonNull<[u8]>, _direction: BufferDirection) -> PhysAddr {
        buffer.cast::<u8>().as_ptr().expose_provenance() as PhysAddr
    }

    unsafe fn unshare(_paddr: PhysAddr, _buffer: NonNull<[u8]>, _direction: BufferDirection) {}
}

/// The network card.
pub struct Ethernet {
    card: RefCell<Card>,
    address: usize,
    mac: [u8; 6],
    /// Buffers that the device does not have; by descriptor, the buffers it has.
    receive: [Slot; RING],
    transmit: [Slot; RING],
    idle: [Slot; TRANSMIT_BUFFERS],
    /// A ring said what cannot be; the card is not used any more.
    broken: Cell<bool>,
}

impl core::fmt::Debug for Ethernet {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Ethernet")
            .field("address", &self.address)
            .finish_non_exhaustive()
    }
}

impl Ethernet {
    /// The first network card among the slots, started.
    ///
    /// # Errors
    /// See [`EthernetError`].
    pub fn find() -> Result<Self, EthernetError> {
        for slot in 0..VIRTIO_SLOTS {
            let address = VIRTIO + slot * VIRTIO_STRIDE;
            let place = core::ptr::with_exposed_provenance_mut::<VirtIOHeader>(address);
            let Some(header) = NonNull::new(place) else {
                continue;
            };
            // SAFETY: each slot is such a region of this machine, there for good; only this
            // function makes transports.
            let Ok(transport) = (unsafe { MmioTransport::new(header, VIRTIO_STRIDE) }) else {
                continue;
            };
            if transport.device_type() == DeviceType::Network {
                return Self::start(transport, address, slot as u32 + 1);
            }
        }
        Err(EthernetError::NotFound)
    }

    fn start(
        transport: MmioTransport<'static>,
        address: usize,
        interrupt: u32,
    ) -> Result<Self, EthernetError> {
        let card = Card::new(transport).map_err(|_| EthernetError::NotStarted)?;
        let receive = RECEIVE.try_take().ok_or(EthernetError::NotStarted)?;
        let transmit = TRANSMIT.try_take().ok_or(EthernetError::NotStarted)?;
        let mut buffers = transmit.iter_mut();
        let ethernet = Self {
            mac: card.mac_address(),
            card: RefCell::new(card),
            address,
            receive: core::array::from_fn(|_| Cell::new(None)),
            transmit: core::array::from_fn(|_| Cell::new(None)),
            idle: core::array::from_fn(|_| Cell::new(buffers.next())),
            broken: Cell::new(false),
        };
        for buffer in receive {
            ethernet.lend(buffer);
        }
        if ethernet.broken.get() {
            return Err(EthernetError::NotStarted);
        }
        DEVICE.store(address, Ordering::Release);
        enable_interrupt(interrupt);
        Ok(ethernet)
    }

    fn break_down(&self, what: &str) {
        if !self.broken.replace(true) {
            defmt::error!("network card: {}; not used any more", what);
        }
    }

    /// Gives the device a buffer to receive into.
    fn lend(&self, buffer: &'static mut Buffer) {
        // SAFETY: the buffer rests in its slot until the device has returned it.
        let token = unsafe { self.card.borrow_mut().receive_begin(buffer) };
        match token
            .ok()
            .and_then(|token| self.receive.get(token as usize))
        {
            Some(slot) => slot.set(Some(buffer)),
            None => self.break_down("the receive ring takes no buffer"),
        }
    }

    /// The next frame, with its length and where it starts.
    fn received(&self) -> Option<(&'static mut Buffer, usize, usize)> {
        let token = self.card.borrow().poll_receive()?;
        let Some(buffer) = self.receive.get(token as usize).and_then(Cell::take) else {
            self.break_down("the receive ring names a buffer it does not have");
            return None;
        };
        // SAFETY: the buffer that was lent with this token.
        let outcome = unsafe { self.card.borrow_mut().receive_complete(token, buffer) };
        match outcome {
            Ok((start, len)) if start + len <= BUFFER => Some((buffer, start, len)),
            _ => {
                self.break_down("the receive ring makes no sense");
                None
            }
        }
    }

    /// Takes back what the device has sent.
    fn reclaim(&self) {
        loop {
            let Some(token) = self.card.borrow_mut().poll_transmit() else {
                return;
            };
            let Some(buffer) = self.transmit.get(token as usize).and_then(Cell::take) else {
                return self.break_down("the transmit ring names a buffer it does not have");
            };
            // SAFETY: the buffer that was sent with this token.
            let outcome = unsafe { self.card.borrow_mut().transmit_complete(token, buffer) };
            if outcome.is_err() {
                return self.break_down("the transmit ring makes no sense");
            }
            self.rest(buffer);
        }
    }

    /// Puts a transmit buffer back.
    fn rest(&self, buffer: &'static mut Buffer) {
        let mut buffer = Some(buffer);
        for slot in &self.idle {
            let content = slot.take();
            slot.set(content.or_else(|| buffer.take()));
        }
    }

    fn idle_buffer(&self) -> Option<&'static mut Buffer> {
        self.idle.iter().find_map(Cell::take)
    }

    fn send(&self, buffer: &'static mut Buffer, len: usize) {
        // SAFETY: the buffer rests in its slot until the device has returned it.
        let token = unsafe { self.card.borrow_mut().transmit_begin(&buffer[..len]) };
        match token
            .ok()
            .and_then(|token| self.transmit.get(token as usize))
        {
            Some(slot) => slot.set(Some(buffer)),
            None => self.break_down("the transmit ring takes no buffer"),
        }
    }
}

fn enable_interrupt(number: u32) {
    let register = |offset: usize| (PLIC + offset) as *mut u32;
    // SAFETY: registers of the interrupt controller: priority of the source, its enable bit and
    // the threshold of context 0, which is machine mode of hart 0.
    unsafe {
        register(4 * number as usize).write_volatile(1);
        register(0x2000).write_volatile(1 << number);
        register(0x20_0000).write_volatile(0);
    }
}

#[riscv_rt::core_interrupt(Interrupt::MachineExternal)]
fn machine_external() {
    let claim = (PLIC + 0x20_0004) as *mut u32;
    // SAFETY: the claim register of context 0.
    let number = unsafe { claim.read_volatile() };
    if number == 0 {
        return;
    }
    let device = DEVICE.load(Ordering::Acquire);
    if device != 0 {
        let status = (device + INTERRUPT_STATUS) as *const u32;
        let acknowledge = (device + INTERRUPT_ACK) as *mut u32;
        // SAFETY: registers of the device; acknowledging is all that happens outside of its
        // driver, and touches no ring.
        unsafe { acknowledge.write_volatile(status.read_volatile()) };
        WAKER.wake();
    }
    // SAFETY: completes what was claimed.
    unsafe { claim.write_volatile(number) };
}

/// A frame that arrived.
pub struct Received<'a> {
    ethernet: &'a Ethernet,
    buffer: &'static mut Buffer,
    start: usize,
    len: usize,
}

/// Room for a frame.
pub struct Transmit<'a> {
    ethernet: &'a Ethernet,
}

impl RxToken for Received<'_> {
    fn consume<R, F>(self, f: F) -> R
    where
        F: FnOnce(&mut [u8]) -> R,
    {
        // The stack may send from within the closure: nothing is borrowed meanwhile.
        let result = f(&mut self.buffer[self.start..self.start + self.len]);
        self.ethernet.lend(self.buffer);
        result
    }
}

impl TxToken for Transmit<'_> {
    fn consume<R, F>(self, len: usize, f: F) -> R
    where
        F: FnOnce(&mut [u8]) -> R,
    {
        let ethernet = self.ethernet;
        let mut frame = [0; 0];
        let header = |buffer: &mut Buffer| ethernet.card.borrow().fill_buffer_header(buffer);
        match ethernet.idle_buffer() {
            Some(buffer) => match header(buffer) {
                Ok(start) if start + len <= BUFFER => {
                    let result = f(&mut buffer[start..start + len]);
                    ethernet.send(buffer, start + len);
                    result
                }
                _ => {
                    // Never: the stack keeps to the largest frame. What it writes is dropped.
                    let result = f(&mut buffer[..len.min(BUFFER)]);
                    ethernet.rest(buffer);
                    result
                }
            },
            // Never: a token is handed out only while there is a buffer.
            None => f(&mut frame),
        }
    }
}

impl Driver for Ethernet {
    type RxToken<'a> = Received<'a>;
    type TxToken<'a> = Transmit<'a>;

    fn receive(&mut self, cx: &mut Context<'_>) -> Option<(Received<'_>, Transmit<'_>)> {
        let ethernet = &*self;
        ethernet.ready(cx)?;
        let (buffer, start, len) = ethernet.received()?;
        Some((
            Received {
                ethernet,
                buffer,
                start,
                len,
            },
            Transmit { ethernet },
        ))
    }

    fn transmit(&mut self, cx: &mut Context<'_>) -> Option<Transmit<'_>> {
        let ethernet = &*self;
        ethernet.ready(cx)?;
        Some(Transmit { ethernet })
    }

    fn link_state(&mut self, cx: &mut Context<'_>) -> LinkState {
        WAKER.register(cx.waker());
        let status = (self.address + NET_STATUS) as *const u16;
        // SAFETY: a register in the configuration space of the device.
        let up = unsafe { status.read_volatile() } & 1 != 0;
        if up && !self.broken.get() {
            LinkState::Up
        } else {
            LinkState::Down
        }
    }

    fn capabilities(&self) -> Capabilities {
        let mut capabilities = Capabilities::default();
        capabilities.max_transmission_unit = MTU;
        capabilities.max_burst_size = Some(TRANSMIT_BUFFERS);
        capabilities
    }

    fn hardware_address(&self) -> HardwareAddress {
        HardwareAddress::Ethernet(self.mac)
    }
}

impl Ethernet {
    /// Whether there is a buffer to send with; else the task is woken when there may be one.
    fn ready(&self, cx: &mut Context<'_>) -> Option<()> {
        // First the waker, then the look: an interrupt in between wakes.
        WAKER.register(cx.waker());
        fence(Ordering::SeqCst);
        if self.broken.get() {
            return None;
        }
        self.reclaim();
        let free = self.idle_buffer()?;
        self.rest(free);
        Some(())
    }
}
