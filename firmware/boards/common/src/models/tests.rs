//! Models that are changed while eyes look, and whatever comes in their way.

use core::cell::Cell;
use core::future::pending;
use std::vec;
use std::vec::Vec as Bytes;

use crawler_app::vision::arena_bytes;
use crawler_detector::{BLOB, FRAMES};
use crawler_hal::{Duration, Instant, SlotRegion};
use embassy_futures::select::{Either, select};
use embassy_futures::{block_on, yield_now};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_storage_async::nor_flash::{ErrorType, NorFlashError, NorFlashErrorKind};
use proptest::prelude::*;

use super::*;
use crate::sight::{BYTES, FORMAT, SIZE};

/// Where a model begins in [`Flash`].
const AT: u32 = 8;
/// Where a blob says how large a step of the output is.
const EXPONENT: usize = 23;

/// A flash with one model in it.
#[derive(Debug)]
struct Flash {
    bytes: Bytes<u8>,
    /// Where it cannot be read any more.
    broken: Option<usize>,
    /// Where it never comes to an end.
    stuck: Option<usize>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Broken;

impl NorFlashError for Broken {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl ErrorType for Flash {
    type Error = Broken;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 4;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Broken> {
        assert!(offset.is_multiple_of(4) && bytes.len().is_multiple_of(4));
        let range = offset as usize..offset as usize + bytes.len();
        if self.stuck.is_some_and(|at| range.contains(&at)) {
            pending::<()>().await;
        }
        if self.broken.is_some_and(|at| range.contains(&at)) {
            return Err(Broken);
        }
        bytes.copy_from_slice(&self.bytes[range]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

fn flash(model: &[u8]) -> Flash {
    let mut bytes = vec![0xFF; AT as usize];
    bytes.extend_from_slice(model);
    bytes.resize(bytes.len().next_multiple_of(4) + 4, 0xFF);
    Flash {
        bytes,
        broken: None,
        stuck: None,
    }
}

/// The shipped detector, changed and whole.
fn changed(change: impl FnOnce(&mut [u8])) -> Bytes<u8> {
    let mut blob = BLOB.to_vec();
    change(&mut blob);
    let sum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&blob[16..]);
    blob[12..16].copy_from_slice(&sum.to_le_bytes());
    blob
}

/// One with steps of this size, which says which one it is.
fn model(exponent: i8) -> Bytes<u8> {
    changed(|blob| blob[EXPONENT] = exponent as u8)
}

/// One whose last layer has the same output everywhere, so that nothing stands out.
fn blind() -> Bytes<u8> {
    changed(|blob| {
        let layers = usize::from(u16::from_le_bytes([blob[6], blob[7]]));
        // 32 bytes of header, and 32 for each layer before it.
        let last = 32 * layers;
        blob[last + 6] = blob[last + 7];
    })
}

/// A clock that has gone on by a millisecond whenever it is looked at.
#[derive(Debug, Clone)]
struct Ticking<'t>(&'t Cell<u64>);

impl Clock for Ticking<'_> {
    fn now(&self) -> Instant {
        self.0.set(self.0.get() + 1);
        Instant::from_millis(self.0.get())
    }

    async fn sleep_until(&self, at: Instant) {
        while self.now() < at {
            yield_now().await;
        }
    }
}

/// All memory that models and eyes need, with buffers of `room` bytes.
struct Memory {
    buffers: [Bytes<u8>; BUFFERS],
    arena: Bytes<i8>,
    frame: Bytes<u8>,
    ticks: Cell<u64>,
}

impl Memory {
    fn new(room: usize) -> Self {
        Self {
            buffers: [(); BUFFERS].map(|()| vec![0xA5; room]),
            arena: vec![0; arena_bytes(BLOB).expect("a model")],
            frame: vec![0; BYTES],
            ticks: Cell::new(0),
        }
    }
}

const fn region() -> ModelRegion {
    const NONE: SlotRegion = SlotRegion {
        start: 0,
        length: 0,
    };
    ModelRegion {
        select: 0,
        places: [NONE, NONE],
    }
}

fn loader<'s, 'b>(
    models: &'s Models<'b, NoopRawMutex>,
    arena_bytes: usize,
) -> ModelLoader<'s, 'b, NoopRawMutex> {
    let name = ModelName::new("eyes").expect("a name");
    ModelLoader::new(models, name, region(), arena_bytes)
}

type TestEyes<'s, 'b> = ChangingEyes<'s, 'b, NoopRawMutex, Ticking<'b>>;

fn eyes<'s, 'b>(
    models: &'s Models<'b, NoopRawMutex>,
    arena: &'b mut [i8],
    frame: &'b mut [u8],
    ticks: &'b Cell<u64>,
) -> TestEyes<'s, 'b> {
    ChangingEyes::new(models, BLOB, arena, frame, Ticking(ticks)).expect("the shipped detector")
}

/// How many things the eyes see in a frame that shows some.
fn look(eyes: &mut TestEyes<'_, '_>) -> usize {
    let mut look = eyes.open(BYTES).expect("room");
    look.frame().copy_from_slice(FRAMES[0].1);
    block_on(look.find(SIZE, FORMAT)).expect("a picture").len()
}

fn load(
    loader: &mut ModelLoader<'_, '_, NoopRawMutex>,
    model: &[u8],
) -> Result<(), LoadError<Broken>> {
    block_on(loader.load(&mut flash(model), AT, model.len() as u32))
}

#[test]
fn the_next_look_goes_by_what_was_adopted() {
    let mut memory = Memory::new(BLOB.len());
    let models = Models::new(memory.buffers.each_mut().map(Bytes::as_mut_slice));
    let mut loader = loader(&models, memory.arena.len());
    let mut eyes = eyes(&models, &mut memory.arena, &mut memory.frame, &memory.ticks);
    let seen = look(&mut eyes);
    assert!(seen > 0, "the frame shows something");
    assert_eq!(loader.looks().taken, 1);

    load(&mut loader, &blind()).expect("a model");
    assert_eq!(look(&mut eyes), seen, "what is at hand is not in use");
    assert_eq!(loader.looks().taken, 2);
    let mut under_way = eyes.open(BYTES).expect("room");
    under_way.frame().copy_from_slice(FRAMES[0].1);
    loader.adopt();
    let spots = block_on(under_way.find(SIZE, FORMAT)).expect("a picture");
    assert_eq!(
        spots.len(),
        seen,
        "a look ends with the model that it has begun with"
    );
    assert_eq!(
        loader.looks(),
        ModelLooks::default(),
        "and counts for that one"
    );

    assert_eq!(look(&mut eyes), 0);
    let looks = loader.looks();
    assert_eq!((looks.taken, looks.slowest), (1, Duration::from_millis(1)));
    loader.use_own();
    assert_eq!(loader.looks().taken, 0);
    assert_eq!(look(&mut eyes), seen);
    assert_eq!(loader.looks().taken, 1);
}

#[test]
fn what_is_no_model_or_cannot_be_read_changes_nothing() {
    let mut memory = Memory::new(BLOB.len() + 8);
    let models = Models::new(memory.buffers.each_mut().map(Bytes::as_mut_slice));
    let mut tight = loader(&models, memory.arena.len() - 1);
    let needed = memory.arena.len();
    assert_eq!(
        load(&mut tight, &blind()),
        Err(LoadError::Unfit(ModelError::Arena { needed }.into()))
    );
    tight.use_own();
    let mut loader = loader(&models, memory.arena.len());
    let mut eyes = eyes(&models, &mut memory.arena, &mut memory.frame, &memory.ticks);
    load(&mut loader, &blind()).expect("a model");
    loader.adopt();

    let mut damaged = blind();
    damaged[20_000] ^= 1;
    let unfit = |error: ModelError| Err(LoadError::Unfit(DetectorError::Model(error)));
    assert_eq!(load(&mut loader, &damaged), unfit(ModelError::Checksum));
    loader.adopt();
    assert_eq!(load(&mut loader, b"no model"), unfit(ModelError::Truncated));
    loader.adopt();
    let large = [&blind()[..], &[0; 12]].concat();
    assert_eq!(load(&mut loader, &large), unfit(ModelError::Full));
    loader.adopt();
    for at in [AT as usize, 300, BLOB.len()] {
        let mut flash = flash(&blind());
        flash.broken = Some(at);
        let read = block_on(loader.load(&mut flash, AT, BLOB.len() as u32));
        assert_eq!(read, Err(LoadError::Flash(Broken)));
        loader.adopt();
        // Whoever gives up waiting loses no buffer either.
        (flash.broken, flash.stuck) = (None, Some(at));
        let read = select(loader.load(&mut flash, AT, BLOB.len() as u32), yield_now());
        assert!(matches!(block_on(read), Either::Second(())));
        loader.adopt();
    }
    assert_eq!(look(&mut eyes), 0, "the one that is in use stays so");
    load(&mut loader, &model(-7)).expect("a buffer is left");
}

/// What may happen, in any order.
#[derive(Debug, Clone, Copy)]
enum Step {
    Load(i8),
    LoadDamaged,
    Adopt,
    UseOwn,
    Look,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        (-9_i8..-6).prop_map(Step::Load),
        Just(Step::LoadDamaged),
        Just(Step::Adopt),
        Just(Step::UseOwn),
        Just(Step::Look),
    ]
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]

    /// However changes and looks alternate, every look goes by the last word before it, and no buffer is lost.
    #[test]
    fn looks_go_by_the_last_word(steps in prop::collection::vec(step(), 1..30)) {
        let mut memory = Memory::new(BLOB.len());
        let models = Models::new(memory.buffers.each_mut().map(Bytes::as_mut_slice));
        let mut loader = loader(&models, memory.arena.len());
        let mut eyes = eyes(&models, &mut memory.arena, &mut memory.frame, &memory.ticks);
        let (mut at_hand, mut wanted) = (None, None);
        for step in steps {
            match step {
                Step::Load(exponent) => {
                    prop_assert_eq!(load(&mut loader, &model(exponent)), Ok(()));
                    at_hand = Some(exponent);
                }
                Step::LoadDamaged => {
                    prop_assert!(load(&mut loader, &BLOB[..BLOB.len() - 1]).is_err());
                    at_hand = None;
                }
                Step::Adopt => {
                    loader.adopt();
                    if let Some(exponent) = at_hand.take() {
                        wanted = Some(exponent);
                    }
                }
                Step::UseOwn => {
                    loader.use_own();
                    (at_hand, wanted) = (None, None);
                }
                Step::Look => {
                    assert!(eyes.open(BYTES).is_some());
                    let used = eyes.used.as_ref().map(|loaded| loaded.blob()[EXPONENT] as i8);
                    prop_assert_eq!(used, wanted);
                }
            }
            let elsewhere = usize::from(loader.at_hand.is_some()) + usize::from(eyes.used.is_some());
            let shared = models.with(|shared| {
                shared.spare.len() + usize::from(matches!(shared.next, Some(Use::Given(_))))
            });
            prop_assert_eq!(elsewhere + shared, BUFFERS);
        }
    }
}
