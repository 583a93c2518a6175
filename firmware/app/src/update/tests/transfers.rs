//! The transfer alone, against a model that it must agree with whatever happens.

use std::vec::Vec;

use crawler_hal::{Duration, Instant};
use crawler_protocol::ReleaseId;
use crawler_release::WINDOW;
use crawler_release::chunk::{PAYLOAD, Part};
use proptest::prelude::*;

use super::releases::Draft;
use crate::update::transfer::{Blocks, Failed, Shape, Step, Transfer};

const SIZE: u32 = 150_001;
const BLOCK: u32 = 65_536;

fn shape() -> Shape {
    let release = Draft::new("new", 12).release();
    let signed = crawler_release::Signed::parse(&release.envelope).expect("an envelope");
    Shape::of(&signed.unverified().expect("a manifest"))
}

/// What may happen next.
#[derive(Debug, Clone, Copy)]
enum Happening {
    /// The step is asked for, and done.
    Step,
    /// It is asked for, and fails.
    Fail {
        content: bool,
    },
    /// A chunk of the window arrives: which one, and of which length.
    Chunk {
        which: u32,
        short: bool,
    },
    /// A chunk of anywhere.
    Stray(u32),
    Envelope,
    Time(u64),
    Reboot,
    Session,
}

fn happenings() -> impl Strategy<Value = Happening> {
    prop_oneof![
        30 => Just(Happening::Step),
        2 => any::<bool>().prop_map(|content| Happening::Fail { content }),
        60 => (0..WINDOW, prop::bool::weighted(0.02))
            .prop_map(|(which, short)| Happening::Chunk { which, short }),
        4 => (0..200_u32).prop_map(Happening::Stray),
        3 => Just(Happening::Envelope),
        6 => (0..5_000_u64).prop_map(Happening::Time),
        1 => Just(Happening::Reboot),
        1 => Just(Happening::Session),
    ]
}

/// The flash and the trailer, as far as the transfer has to do with them.
#[derive(Debug, Default)]
#[allow(clippy::struct_excessive_bools)] // each is something that has happened
struct Model {
    believed: bool,
    kept: bool,
    /// The trailer has the envelope.
    begun: bool,
    noted: Vec<u8>,
    /// Blocks of which every byte was written since they were erased.
    written: Vec<Vec<u32>>,
    checked: Vec<u8>,
    whole: bool,
    staged: bool,
    /// Otadata may name the release.
    activating: bool,
    /// Bytes of the patch that the robot was offered.
    patch: Option<u32>,
    /// Chunks of the patch that were read since it was begun, and bytes of the image that it has made.
    read: u32,
    made: u32,
}

impl Model {
    fn lying(&self) -> Option<Blocks> {
        let blocks = self
            .noted
            .iter()
            .fold(Blocks::default(), |all, block| all.with(*block));
        self.begun.then_some(blocks)
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(512))]

    /// Whatever happens: nothing is erased before the manifest is believed and otadata names what runs; nothing is
    /// noted that was not received and checked; nothing is started that is not whole; at most a window is asked for,
    /// and only of what is missing.
    #[test]
    fn steps_come_in_an_order_that_is_safe(
        happenings in prop::collection::vec(happenings(), 1..1_500),
        patch in prop::option::of(0..60_000_u32),
    ) {
        let (shape, release) = (shape(), ReleaseId::new([1, 2, 3, 4, 5, 6, 7, 8]));
        let mut now = Instant::BOOT;
        let mut transfer = Transfer::new(release, None, patch, 9, now);
        let mut model = Model { written: std::vec![Vec::new(); 3], patch, ..Model::default() };
        let mut asked = None;
        for happening in happenings {
            match happening {
                Happening::Time(ms) => now += Duration::from_millis(ms),
                Happening::Session => transfer.ask_again(),
                Happening::Reboot => {
                    transfer = Transfer::new(release, model.lying(), model.patch, 11, now);
                    (model.believed, model.kept, asked) = (false, false, None);
                    model.activating = false;
                    model.checked.clear();
                    model.whole = false;
                }
                Happening::Envelope => {
                    transfer.take_envelope(0);
                }
                Happening::Chunk { .. } | Happening::Stray(_) => {
                    let index = match (happening, asked) {
                        (Happening::Chunk { which, .. }, Some(first)) => first + which,
                        (Happening::Stray(index), _) => index,
                        _ => continue,
                    };
                    let whole = SIZE.saturating_sub(index * PAYLOAD as u32).min(PAYLOAD as u32);
                    let short = matches!(happening, Happening::Chunk { short: true, .. });
                    let length = whole as usize - usize::from(short && whole > 0);
                    let of_patch = patch.unwrap_or(0);
                    let next = model.read;
                    let rest = of_patch.saturating_sub(next * PAYLOAD as u32).min(PAYLOAD as u32);
                    if transfer.is_next_of_patch(index, rest as usize) {
                        prop_assert_eq!(index, next, "in order");
                        prop_assert!(rest > 0 && model.begun);
                        prop_assert_eq!(transfer.place(index, length), None);
                        // It makes as much as it is long, and the last chunk all the rest, or nothing.
                        let is_last = (next + 1) * PAYLOAD as u32 >= of_patch;
                        let made = if is_last && !of_patch.is_multiple_of(5) {
                            SIZE
                        } else {
                            (model.made + 4 * PAYLOAD as u32).min(SIZE)
                        };
                        for index in (0..SIZE.div_ceil(PAYLOAD as u32))
                            .filter(|index| (model.made..made).contains(&(index * PAYLOAD as u32)))
                        {
                            let block = index * PAYLOAD as u32 / BLOCK;
                            let written = &mut model.written[block as usize];
                            if !model.noted.contains(&(block as u8)) {
                                prop_assert!(!written.contains(&index), "written twice");
                                written.push(index);
                            }
                        }
                        (model.read, model.made) = (next + 1, made);
                        transfer.patched(index, made, now);
                        continue;
                    }
                    let Some(at) = transfer.place(index, length) else {
                        continue;
                    };
                    prop_assert!(!short);
                    prop_assert_eq!(at, index * PAYLOAD as u32);
                    let block = at / BLOCK;
                    prop_assert!(!model.noted.contains(&(block as u8)), "it is there already");
                    let written = &mut model.written[block as usize];
                    prop_assert!(!written.contains(&index), "written twice without an erase");
                    written.push(index);
                    transfer.written(index, now);
                }
                Happening::Step | Happening::Fail { .. } => {
                    let step = transfer.next(now);
                    let fails = match happening {
                        Happening::Fail { content } => Some(content),
                        _ => None,
                    };
                    match step {
                        Step::Wait(at) => {
                            prop_assert!(at > now);
                            continue;
                        }
                        Step::Ask(want) => {
                            prop_assert!(want.outstanding() <= WINDOW && want.missing != 0);
                            asked = (want.part != Part::Manifest).then_some(want.first);
                            if want.part == Part::Delta {
                                prop_assert!(model.begun && patch.is_some());
                                prop_assert!(transfer.without_patch().is_none());
                                prop_assert_eq!(want.indices().next(), Some(model.read));
                            }
                            prop_assert_eq!(want.part == Part::Manifest, transfer.stage().is_none());
                            for index in want.indices().filter(|_| want.part == Part::Image) {
                                prop_assert!(model.begun && index * (PAYLOAD as u32) < SIZE);
                                let block = index * PAYLOAD as u32 / BLOCK;
                                prop_assert!(!model.written[block as usize].contains(&index));
                            }
                            continue;
                        }
                        _ => {}
                    }
                    if let Some(content) = fails {
                        let checks = matches!(step, Step::Check(_) | Step::CheckAll);
                        let why = if content && checks { Failed::Content } else { Failed::Flash };
                        model.activating |= step == Step::Activate;
                        if transfer.failed(why).is_err() {
                            prop_assert!(!model.activating || step == Step::Keep);
                            // Given up: offered again.
                            transfer = Transfer::new(release, model.lying(), model.patch, 13, now);
                            (model.believed, model.kept, asked) = (false, false, None);
                            model.activating = false;
                        }
                        continue;
                    }
                    match step {
                        Step::Judge => {
                            model.believed = true;
                            transfer.believed(shape);
                            (model.read, model.made) = (0, 0);
                            continue;
                        }
                        Step::Keep => (model.kept, model.activating) = (true, false),
                        Step::Begin => {
                            prop_assert!(model.believed && model.kept);
                            model.begun = true;
                            model.noted.clear();
                            model.staged = false;
                        }
                        Step::Erase(sector) => {
                            prop_assert!(model.believed && model.kept && model.begun);
                            let block = sector * 4_096 / BLOCK;
                            prop_assert!(!model.noted.contains(&(block as u8)), "it is there");
                            let sectors = sector * 4..(sector + 1) * 4;
                            model.written[block as usize].retain(|index| !sectors.contains(index));
                        }
                        Step::Check(block) => {
                            let chunks = (SIZE.min((u32::from(block) + 1) * BLOCK) - u32::from(block) * BLOCK)
                                .div_ceil(PAYLOAD as u32);
                            prop_assert_eq!(model.written[usize::from(block)].len() as u32, chunks);
                            model.checked.push(block);
                        }
                        Step::Note(block) => {
                            prop_assert!(model.checked.contains(&block));
                            model.noted.push(block);
                        }
                        Step::CheckAll => {
                            prop_assert!((0..3).all(|block| model.noted.contains(&block)));
                            model.whole = true;
                        }
                        Step::Stage => {
                            prop_assert!(model.whole);
                            model.staged = true;
                        }
                        Step::Activate => {
                            prop_assert!(model.staged && model.kept && model.believed);
                            prop_assert_eq!(transfer.bytes(), SIZE);
                        }
                        Step::Wait(_) | Step::Ask(_) => {}
                    }
                    if transfer.done(now).is_err() {
                        prop_assert!(step == Step::Keep, "nothing else is waited for");
                        transfer = Transfer::new(release, model.lying(), model.patch, 15, now);
                        (model.believed, model.kept, asked) = (false, false, None);
                        model.activating = false;
                    }
                }
            }
        }
    }
}

#[test]
fn it_asks_less_often_while_nothing_comes_and_gives_up() {
    let mut now = Instant::BOOT;
    let mut transfer = Transfer::new(ReleaseId::new([9; 8]), None, None, 3, now);
    let mut gaps = Vec::new();
    let mut asked = now;
    while !transfer.is_silent(now) {
        match transfer.next(now) {
            Step::Ask(want) => {
                assert_eq!((want.part, want.missing), (Part::Manifest, 1));
                gaps.push((now - asked).as_millis());
                asked = now;
            }
            Step::Wait(at) => now = at,
            other => panic!("{other:?}"),
        }
    }
    assert!((2_000..=2_500).contains(&gaps[1]), "{gaps:?}");
    assert!((4_000..=5_000).contains(&gaps[2]), "{gaps:?}");
    assert!(
        gaps[5..].iter().all(|gap| (16_000..=20_000).contains(gap)),
        "{gaps:?}"
    );
}

/// A transfer of which every block of `lying` is there, as far as `until`.
fn going_on(lying: impl IntoIterator<Item = u8>, until: impl Fn(Step) -> bool) -> Transfer {
    let lying = lying.into_iter().fold(Blocks::default(), Blocks::with);
    let now = Instant::BOOT;
    let mut transfer = Transfer::new(ReleaseId::new([9; 8]), Some(lying), None, 3, now);
    for _ in 0..200 {
        match transfer.next(now) {
            step if until(step) => return transfer,
            Step::Judge => transfer.believed(shape()),
            Step::Wait(_) | Step::Ask(_) => panic!("nothing is missing"),
            _ => assert_eq!(transfer.done(now), Ok(())),
        }
    }
    panic!("it does not come to that");
}

#[test]
fn writing_fails_twice_for_each_chunk_without_a_refusal() {
    let asks = |step| matches!(step, Step::Ask(_));
    let mut transfer = going_on([0, 2], asks);
    let now = Instant::BOOT;
    for index in 64..80 {
        assert!(transfer.place(index, PAYLOAD).is_some());
        for _ in 0..2 {
            assert_eq!(transfer.failed(Failed::Flash), Ok(()), "chunk {index}");
        }
        transfer.written(index, now);
    }
    assert!(asks(transfer.next(now)), "the next window");
    for _ in 0..2 {
        assert_eq!(transfer.failed(Failed::Flash), Ok(()));
    }
    let refused = transfer.failed(Failed::Flash);
    assert_eq!(refused.map_err(|why| why.code), Err("flash_failed"));
}

#[test]
fn what_cannot_be_activated_is_refused_once_the_running_program_is_kept() {
    let now = Instant::BOOT;
    for why in [Failed::Flash, Failed::NoWayBack] {
        let mut transfer = going_on(0..3, |step| step == Step::Activate);
        for _ in 0..2 {
            assert_eq!(transfer.failed(why), Ok(()));
            for step in [Step::Keep, Step::CheckAll, Step::Stage] {
                assert_eq!(transfer.next(now), step);
                assert_eq!(transfer.done(now), Ok(()));
            }
            assert_eq!(transfer.next(now), Step::Activate);
        }
        assert_eq!(transfer.failed(why), Ok(()), "not yet");
        assert_eq!(transfer.next(now), Step::Keep);
        // The flash may be as bad as that.
        assert_eq!(transfer.failed(Failed::Flash), Ok(()));
        assert_eq!(transfer.next(now), Step::Keep);
        let refused = transfer.done(now).map_err(|why| (why.code, why.lasting));
        assert_eq!(refused, Err(("flash_failed", true)));
    }
}
