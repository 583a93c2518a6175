//! The detector looks at frames, on the board.
//!
//! Runs what the camera activity runs, `crawler_app::vision`, with arena and frame in statics as a
//! board has them, and counts retired instructions; see `counts.rs` for why they are exact. Prints
//! as plain text on the serial line
//!
//! - what it saw in every frame, see [`crawler_board::sight`],
//! - `count vision_look N`: instructions of the dearest look, from a frame to its things,
//! - `count vision_row N`: most instructions between two chances for others to run,
//! - `figure WHAT N`: bytes, and multiplications of a look,
//!
//! and ends with code 0; with any other when something did not come to its end.
#![no_std]
#![no_main]

use core::cell::UnsafeCell;
use core::fmt::Write;
use core::mem::size_of_val;
use core::pin::pin;
use core::task::{Context, Poll, Waker};

use crawler_app::vision::{Detector, Finder, arena_bytes};
use crawler_board::sight::{BYTES, Frame, MADE, Sight, look};
use crawler_detector::{BLOB, FRAMES};
use crawler_virt::machine::{self, ExitCode};
use crawler_virt::{log, stack, system, time};
use riscv::register::minstret;

const ARENA_BYTES: usize = match arena_bytes(BLOB) {
    Ok(bytes) => bytes,
    Err(_) => panic!("the detector is no model"),
};

struct Memory<T>(UnsafeCell<T>);

// SAFETY: used by `main` alone, which runs once.
unsafe impl<T> Sync for Memory<T> {}

static ARENA: Memory<[i8; ARENA_BYTES]> = Memory(UnsafeCell::new([0; ARENA_BYTES]));
static FRAME: Memory<[u8; BYTES]> = Memory(UnsafeCell::new([0; BYTES]));

fn fail(why: &str) -> ! {
    // The line is plain text here; a failure to write has nowhere to go.
    let _ = writeln!(log::Text, "failed: {why}");
    machine::exit(ExitCode::Measurement)
}

/// Most instructions of a look, of a poll of it, and bytes that one takes.
#[derive(Default)]
struct Costs {
    look: u64,
    row: u64,
    future: usize,
}

impl Costs {
    /// Looks at a frame and notes what it cost.
    #[inline(never)]
    fn look<'f>(
        &mut self,
        finder: &mut Finder<'_, '_>,
        frame: Frame<'f>,
        bytes: &[u8; BYTES],
    ) -> Sight<'f> {
        let mut looking = pin!(look(finder, frame.name(), bytes));
        self.future = size_of_val(&*looking);
        let mut context = Context::from_waker(Waker::noop());
        let mut all = 0;
        loop {
            let before = minstret::read64();
            let polled = looking.as_mut().poll(&mut context);
            let row = minstret::read64() - before;
            all += row;
            self.row = self.row.max(row);
            match polled {
                Poll::Pending => {}
                Poll::Ready(Some(sight)) => {
                    self.look = self.look.max(all);
                    return sight;
                }
                Poll::Ready(None) => fail("a frame has the wrong length"),
            }
        }
    }
}

#[riscv_rt::entry]
fn main(_hart: usize, _tree: usize) -> ! {
    log::init();
    time::init();
    system::end_on_panic();
    // SAFETY: nobody else uses them, and this runs once.
    let (arena, bytes) = unsafe { (&mut *ARENA.0.get(), &mut *FRAME.0.get()) };
    let Ok(detector) = Detector::new(BLOB) else {
        fail("the model is no detector")
    };
    let Ok(mut finder) = detector.run_in(arena) else {
        fail("the arena is too small")
    };
    let mut costs = Costs::default();
    // Painted here: what is in use above is this function's, and not of a look.
    stack::paint();
    let before = stack::used();
    let taken = FRAMES.iter().map(|(name, bytes)| Frame::Taken(name, bytes));
    for frame in MADE.into_iter().chain(taken) {
        frame.write(bytes);
        let sight = costs.look(&mut finder, frame, bytes);
        let _ = writeln!(log::Text, "{sight}");
    }
    for (name, instructions) in [("vision_look", costs.look), ("vision_row", costs.row)] {
        let _ = writeln!(log::Text, "count {name} {instructions}");
    }
    for (name, size) in [
        ("multiplications", detector.multiplications() as usize),
        ("blob", BLOB.len()),
        ("arena", ARENA_BYTES),
        ("frame", BYTES),
        ("finder", size_of_val(&finder)),
        ("future", costs.future),
        ("stack", stack::used() - before),
    ] {
        let _ = writeln!(log::Text, "figure {name} {size}");
    }
    let _ = writeln!(log::Text, "done");
    machine::exit(ExitCode::Done)
}
