//! A robot over all its starts: its flash, what a boot stage and the first lines of `main` do, the whole program, and
//! a server that sends what is asked for, or does not.

use core::cell::{Cell, RefCell};
use core::convert::Infallible;
use core::future::{pending, poll_fn};
use std::format;
use std::rc::Rc;
use std::string::String;
use std::vec::Vec;

use crawler_boot::guard::{Decision, decide};
use crawler_boot::otadata::{Bootloader, Goal, Otadata, Slots};
use crawler_boot::trailer::{Record, Trailer};
use crawler_drivers::battery::Config as Gauge;
use crawler_hal::{
    Clock as _, Duration, Instant, Millivolts, RangerPort, ResetCause, SlotPort, SlotRegion,
};
use crawler_protocol::{Action, BuildId, Command, Reason, ReleaseId, ResponseStatus, RobotState};
use crawler_release::chunk::{CHUNK_MAX, Chunk, PAYLOAD, Part};
use crawler_release::{Chip as ChipId, PublicKeys, WINDOW};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_storage::nor_flash as blocking;
use embedded_storage_async::nor_flash::{
    ErrorType, MultiwriteNorFlash, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use rand_core::Rng as _;
use serde_json::Value;

use super::releases::{OLD_SIZE, Release, image, keys};
use crate::perception::LinkHealth;
use crate::testing::flash::TestFlash;
use crate::testing::ports::{BatteryPin, Chip, Line, Motor, NotWired, Ranger};
use crate::testing::{Executor, TestClock, TestRng, TestRobot, robot, source};
use crate::update::{ReportKind, UpdateIdentity, UpdatePort, Updates, update};
use crate::{control, power, sense, store};

const OTADATA: u32 = 0;
pub(super) const SLOTS: [SlotRegion; 2] = [
    SlotRegion {
        start: 0x1_0000,
        length: 0x4_0000,
    },
    SlotRegion {
        start: 0x5_0000,
        length: 0x4_0000,
    },
];
const SECTOR: usize = 4_096;
const NOW_MS: u64 = 1_700_000_000_000;

/// The cells of a flash, and the power that is left.
pub(super) struct Cells {
    pub(super) bytes: Vec<u8>,
    /// Bytes that may still be changed before the power goes.
    pub(super) budget: Option<usize>,
    /// The power has gone.
    pub(super) dark: bool,
    pub(super) changes: usize,
    /// Bytes that were changed.
    pub(super) spent: usize,
    pub(super) erased: usize,
    pub(super) worn: bool,
    /// So many changes fail, and then no more.
    pub(super) failing: usize,
    /// What has the other slot started is written, and said to have failed.
    pub(super) denying: bool,
}

impl Cells {
    /// How many of so many bytes are still changed.
    fn spend(&mut self, count: usize) -> usize {
        self.changes += 1;
        self.spent += count;
        let Some(left) = &mut self.budget else {
            return count;
        };
        let done = count.min(*left);
        *left -= done;
        self.dark |= done < count;
        done
    }

    fn erase(&mut self, from: usize, to: usize) {
        assert!(from.is_multiple_of(SECTOR) && to.is_multiple_of(SECTOR) && from < to);
        let done = self.spend(to - from);
        self.erased += 1;
        self.bytes[from..from + done].fill(0xFF);
    }

    /// The slot that otadata would have started.
    fn selected(&mut self) -> Option<u8> {
        let Ok(otadata) = Otadata::read(&mut Raw(self), OTADATA, Slots::TWO);
        otadata.select(Bootloader::Plain).tries(Slots::TWO).next()
    }

    fn program(&mut self, at: usize, bytes: &[u8]) {
        assert!(at.is_multiple_of(4) && bytes.len().is_multiple_of(4));
        let done = self.spend(bytes.len());
        for (cell, byte) in self.bytes[at..].iter_mut().zip(&bytes[..done]) {
            *cell &= byte;
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Worn;

impl NorFlashError for Worn {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

/// The flash as the program has it: it takes its time.
struct SlotFlash {
    cells: Rc<RefCell<Cells>>,
    clock: TestClock,
}

impl SlotFlash {
    async fn change(&self, span: Duration, change: impl FnOnce(&mut Cells)) -> Result<(), Worn> {
        self.clock.sleep(span).await;
        {
            let mut cells = self.cells.borrow_mut();
            if cells.worn || cells.failing > 0 {
                cells.failing = cells.failing.saturating_sub(1);
                return Err(Worn);
            }
            let before = cells.selected();
            change(&mut cells);
            if !cells.dark {
                let denied = cells.denying && cells.selected() == Some(1) && before != Some(1);
                return if denied { Err(Worn) } else { Ok(()) };
            }
        }
        pending().await
    }
}

impl ErrorType for SlotFlash {
    type Error = Worn;
}

impl ReadNorFlash for SlotFlash {
    const READ_SIZE: usize = 4;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Worn> {
        assert!(offset.is_multiple_of(4) && bytes.len().is_multiple_of(4));
        self.clock.sleep(Duration::from_micros(20)).await;
        let from = offset as usize;
        bytes.copy_from_slice(&self.cells.borrow().bytes[from..from + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.cells.borrow().bytes.len()
    }
}

impl NorFlash for SlotFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Worn> {
        let erase = |cells: &mut Cells| cells.erase(from as usize, to as usize);
        self.change(Duration::from_millis(45), erase).await
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Worn> {
        let program = |cells: &mut Cells| cells.program(offset as usize, bytes);
        self.change(Duration::from_micros(700), program).await
    }
}

impl MultiwriteNorFlash for SlotFlash {}

/// The flash as a boot stage has it.
struct Raw<'a>(&'a mut Cells);

impl blocking::ErrorType for Raw<'_> {
    type Error = Infallible;
}

impl blocking::ReadNorFlash for Raw<'_> {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
        let from = offset as usize;
        bytes.copy_from_slice(&self.0.bytes[from..from + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.bytes.len()
    }
}

impl blocking::NorFlash for Raw<'_> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Infallible> {
        self.0.erase(from as usize, to as usize);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
        self.0.program(offset as usize, bytes);
        Ok(())
    }
}

impl blocking::MultiwriteNorFlash for Raw<'_> {}

/// A robot, off.
pub(super) struct World {
    pub(super) cells: Rc<RefCell<Cells>>,
    settings: TestFlash,
    /// Programs that start.
    images: Vec<(String, Vec<u8>)>,
    pub(super) server: Rc<RefCell<Server>>,
    /// What its programs believe.
    pub(super) keys: Option<PublicKeys>,
}

impl World {
    /// A robot fresh from the bench, which runs the build `old`, and a server that has `release` to offer.
    pub(super) fn new(release: &Release) -> Self {
        let mut bytes = std::vec![0xFF; 0x9_0000];
        let old = image("old", OLD_SIZE);
        let start = SLOTS[0].start as usize;
        bytes[start..start + old.len()].copy_from_slice(&old);
        Self {
            cells: Rc::new(RefCell::new(Cells {
                bytes,
                budget: None,
                dark: false,
                changes: 0,
                spent: 0,
                erased: 0,
                worn: false,
                failing: 0,
                denying: false,
            })),
            settings: TestFlash::new(2),
            images: Vec::from([
                ("old".into(), old),
                (release.build.clone(), release.image.clone()),
            ]),
            server: Rc::new(RefCell::new(Server::new(release.clone()))),
            keys: Some(keys()),
        }
    }

    /// Another program that starts, once it is in a slot.
    pub(super) fn learn(&mut self, release: &Release) {
        let known = (release.build.clone(), release.image.clone());
        self.images.push(known);
    }

    fn build_in(&self, slot: u8) -> Option<String> {
        let cells = self.cells.borrow();
        let start = SLOTS[usize::from(slot)].start as usize;
        let found = self
            .images
            .iter()
            .find(|(_, image)| cells.bytes[start..].starts_with(image));
        found.map(|(build, _)| build.clone())
    }

    pub(super) fn trailer(&self, slot: usize) -> Trailer {
        let end = (SLOTS[slot].start + SLOTS[slot].length) as usize;
        Trailer::of(&self.cells.borrow().bytes[end - SECTOR..end])
    }

    /// What a boot stage and the first lines of `main` do: the slot that runs, and its build.
    fn boot(&self, mut cause: ResetCause) -> (u8, String, ResetCause) {
        for _ in 0..8 {
            let otadata = {
                let mut cells = self.cells.borrow_mut();
                Otadata::read(&mut Raw(&mut cells), OTADATA, Slots::TWO).expect("read")
            };
            let selection = otadata.select(Bootloader::Plain);
            let (slot, build) = selection
                .tries(Slots::TWO)
                .find_map(|slot| Some((slot, self.build_in(slot)?)))
                .expect("a robot always has a program that starts");
            let recorded = self.trailer(usize::from(slot)).rolled_back();
            let mut cells = self.cells.borrow_mut();
            let flash = &mut Raw(&mut cells);
            let trailer = |slot: u8| {
                let region = SLOTS[usize::from(slot)];
                region.start + region.length - SECTOR as u32
            };
            match decide(cause, otadata.standing(slot), recorded) {
                Decision::Confirmed => return (slot, build, cause),
                Decision::Returned(reason) => {
                    let _ = Trailer::record(flash, trailer(1 - slot), Record::RolledBack(reason));
                    let goal = Goal::Keep { running: slot };
                    let _ = Otadata::reach(flash, OTADATA, Slots::TWO, goal);
                    return (slot, build, cause);
                }
                Decision::Run(counter) => {
                    if let Some(operation) = otadata.count(slot, counter) {
                        operation.execute(flash, OTADATA).expect("counted");
                    }
                    return (slot, build, cause);
                }
                Decision::RollBack(reason) => {
                    let _ = Trailer::record(flash, trailer(slot), Record::RolledBack(reason));
                    let goal = Goal::GiveUp { running: slot };
                    let _ = Otadata::reach(flash, OTADATA, Slots::TWO, goal);
                    cause = ResetCause::Software;
                }
            }
        }
        panic!("it goes round and round");
    }

    /// Starts the robot.
    pub(super) fn start(&self, cause: ResetCause) -> Life {
        {
            let mut cells = self.cells.borrow_mut();
            cells.dark = false;
        }
        let (slot, build, _) = self.boot(cause);
        Life::new(self, slot, &build)
    }

    /// Starts it and lets it run until it restarts or is off, again and again; the life in which `done` holds.
    pub(super) fn run_until(&self, mut done: impl FnMut(&Life) -> bool) -> Life {
        let mut cause = ResetCause::PowerOn;
        for _ in 0..40 {
            let mut life = self.start(cause);
            cause = match life.run_until(Duration::from_secs(600), &mut done) {
                End::Done => return life,
                End::Restart => ResetCause::Software,
                End::Dark => {
                    self.cells.borrow_mut().budget = None;
                    ResetCause::PowerOn
                }
                End::Late => panic!("nothing comes of it: {:#?}", life.server.borrow().told),
            };
        }
        panic!("it restarts for ever");
    }
}

/// How a stretch of a life ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    Done,
    Restart,
    Dark,
    Late,
}

/// From one start to the next.
pub(super) struct Life {
    pub(super) robot: Rc<TestRobot>,
    pub(super) updates: Rc<Updates<NoopRawMutex>>,
    pub(super) executor: Executor<'static>,
    pub(super) build: String,
    pub(super) slot: u8,
    pub(super) server: Rc<RefCell<Server>>,
    pub(super) battery: BatteryPin,
    pub(super) ranger: Ranger,
    cells: Rc<RefCell<Cells>>,
    chip: Chip,
    seq: u64,
}

impl Life {
    fn new(world: &World, slot: u8, build: &str) -> Self {
        let robot = Rc::new(robot("updated"));
        let updates = Rc::new(Updates::new(UpdateIdentity {
            build: BuildId::new(build).expect("a build"),
            keys: world.keys,
        }));
        let mut executor = Executor::default();
        let clock = executor.clock.clone();
        let (chip, battery) = (Chip::default(), BatteryPin::default());
        let ranger = Ranger::new(clock.clone(), 2_000);
        let full = Gauge::STANDARD.divider.pin(Millivolts(8_000));
        battery.0.set(Some(full));
        robot.time.observe(NOW_MS, Instant::BOOT);
        robot.set_link_health(LinkHealth::Up);
        let (left, right) = (Motor::default(), Motor::default());
        executor.spawn(control(
            Rc::clone(&robot),
            left.port(),
            right.port(),
            chip.clone(),
            TestRng(9),
            clock.clone(),
        ));
        let port: RangerPort<Ranger, Line, NotWired> = RangerPort::Uart(ranger.clone());
        executor.spawn({
            let (robot, clock) = (Rc::clone(&robot), clock.clone());
            async move { sense(&*robot, port, clock).await }
        });
        executor.spawn(power(Rc::clone(&robot), battery.clone(), clock.clone()));
        let settings = world.settings.clone();
        executor.spawn(store(Rc::clone(&robot), settings, clock.clone()));
        let port = SlotPort {
            flash: SlotFlash {
                cells: Rc::clone(&world.cells),
                clock: clock.clone(),
            },
            otadata: OTADATA,
            slots: SLOTS,
            running: slot,
            chip: ChipId::NONE.0,
        };
        let parts = (Rc::clone(&robot), Rc::clone(&updates));
        executor.spawn(update(parts.0, parts.1, port, TestRng(5), clock.clone()));
        executor.spawn(serve(
            Rc::clone(&world.server),
            Rc::clone(&robot),
            Rc::clone(&updates),
            clock,
        ));
        Self {
            robot,
            updates,
            executor,
            build: build.into(),
            slot,
            server: Rc::clone(&world.server),
            battery,
            ranger,
            cells: Rc::clone(&world.cells),
            chip,
            seq: 0,
        }
    }

    /// Runs until something of it happens.
    pub(super) fn run_until(&mut self, most: Duration, mut done: impl FnMut(&Self) -> bool) -> End {
        let end = self.executor.clock.now() + most;
        while self.executor.clock.now() < end {
            self.executor.run_for(Duration::from_millis(10));
            assert_eq!(self.robot.missed_periods(), 0, "control never waits");
            if self.cells.borrow().dark {
                return End::Dark;
            }
            if done(self) {
                return End::Done;
            }
            if self.chip.resets.get() > 0 {
                return End::Restart;
            }
        }
        End::Late
    }

    /// Runs until the robot has said something of this kind, with this word in it.
    pub(super) fn run_until_told(&mut self, field: &str, word: &str) {
        let end = self.run_until(Duration::from_secs(400), |life| {
            life.server.borrow().has_told(field, word)
        });
        assert_eq!(end, End::Done, "{:#?}", self.server.borrow().told);
    }

    pub(super) fn state(&self) -> RobotState {
        self.robot.snapshot().state
    }

    /// Gives a command; the answer to it.
    pub(super) fn command(&mut self, action: Action) -> Option<(ResponseStatus, Option<Reason>)> {
        self.seq += 1;
        let command = Command {
            action,
            timestamp: NOW_MS + self.executor.clock.now().as_millis(),
            seq: self.seq,
            source: source("operator:ada"),
        };
        let mut buffer = [0; 1024];
        let len = command.to_json(&mut buffer).expect("fits");
        let now = self.executor.clock.now();
        self.robot.submit(&buffer[..len], now);
        self.executor.run_for(Duration::from_millis(50));
        let mut last = None;
        while let Some((ticket, answer)) = self.robot.outbox.next_answer() {
            self.robot.outbox.sent(ticket);
            self.robot.outbox.delivered(ticket);
            last = Some((answer.status, answer.reason));
        }
        last
    }

    /// A word of the server.
    pub(super) fn say(&mut self, word: &str, release: ReleaseId) {
        say(&self.updates, word, release);
        self.executor.run_for(Duration::from_millis(50));
    }
}

fn say(updates: &Updates<NoopRawMutex>, word: &str, release: ReleaseId) {
    let text = format!(r#"{{"update":"{word}","release":"{release}"}}"#);
    updates.arrived(text.as_bytes()).expect("a word");
}

/// The server, with the link and the broker between.
#[allow(clippy::struct_excessive_bools)] // each is a switch of the tests
pub(super) struct Server {
    pub(super) release: Release,
    /// Whether it offers the release to whoever does not run it.
    pub(super) offering: bool,
    /// Whether there is a session.
    pub(super) linked: bool,
    /// Whether it sends what is asked for.
    pub(super) sending: bool,
    /// Whether it has lost the patch that it offers.
    pub(super) without_patch: bool,
    /// Of a thousand chunks so many do not arrive, and so many arrive twice.
    pub(super) lost: u32,
    pub(super) doubled: u32,
    /// Whether the chunks of a window arrive in any order.
    pub(super) shuffled: bool,
    /// What every robot has said, in order.
    pub(super) told: Vec<Value>,
    pub(super) sent: u32,
    /// Of these so many of the image, and of the patch.
    pub(super) of_image: u32,
    pub(super) of_patch: u32,
    /// Largest number of chunks that were asked for and not sent.
    pub(super) most_asked: u32,
    chances: TestRng,
}

impl Server {
    fn new(release: Release) -> Self {
        Self {
            release,
            offering: true,
            linked: true,
            sending: true,
            without_patch: false,
            lost: 0,
            doubled: 0,
            shuffled: false,
            told: Vec::new(),
            sent: 0,
            of_image: 0,
            of_patch: 0,
            most_asked: 0,
            chances: TestRng(77),
        }
    }

    pub(super) fn has_told(&self, field: &str, word: &str) -> bool {
        self.told.iter().any(|report| report[field] == word)
    }

    /// The reason with which something was told last.
    pub(super) fn reason(&self, field: &str, word: &str) -> Option<&str> {
        let said = self.told.iter().rfind(|report| report[field] == word);
        said?["reason"].as_str()
    }

    fn offer(&self) -> String {
        let release = self.release.id();
        let patch = self.release.patch.as_ref().map(Vec::len);
        let delta = patch.map_or_else(String::new, |bytes| {
            format!(r#","delta":{{"base":"old","bytes":{bytes}}}"#)
        });
        format!(r#"{{"update":"offer","release":"{release}"{delta}}}"#)
    }

    fn happens(&mut self, of_thousand: u32) -> bool {
        self.chances.next_u32() % 1_000 < of_thousand
    }

    /// The chunks that are asked for, as they arrive.
    fn chunks(&mut self, want: &Value) -> Vec<Vec<u8>> {
        let number = |field: &str| want[field].as_u64().expect("a number") as u32;
        let (part, bytes) = match want["part"].as_str() {
            Some("manifest") => (Part::Manifest, self.release.envelope.clone()),
            Some("image") => (Part::Image, self.release.image.clone()),
            Some("delta") => (Part::Delta, self.release.patch.clone().expect("offered")),
            other => panic!("{other:?}"),
        };
        if part == Part::Delta && self.without_patch {
            return Vec::new();
        }
        let missing = number("missing");
        self.most_asked = self.most_asked.max(missing.count_ones());
        let mut chunks = Vec::new();
        for bit in (0..WINDOW).filter(|bit| missing >> bit & 1 == 1) {
            let index = number("first") + bit;
            let payload = bytes
                .chunks(PAYLOAD)
                .nth(index as usize)
                .expect("nothing is asked for beyond the end");
            let chunk = Chunk {
                part,
                tag: number("tag"),
                index,
                payload,
            };
            let mut encoded = [0; CHUNK_MAX];
            let length = chunk.encode(&mut encoded).expect("fits");
            for _ in 0..=u32::from(self.happens(self.doubled)) {
                if !self.happens(self.lost) {
                    chunks.push(encoded[..length].to_vec());
                }
            }
        }
        if self.shuffled {
            for last in (1..chunks.len()).rev() {
                let other = self.chances.next_u32() as usize % (last + 1);
                chunks.swap(last, other);
            }
        }
        chunks
    }
}

/// Does what link, broker and server do together.
async fn serve(
    server: Rc<RefCell<Server>>,
    robot: Rc<TestRobot>,
    updates: Rc<Updates<NoopRawMutex>>,
    clock: TestClock,
) -> Infallible {
    let port: &dyn UpdatePort = &*updates;
    let mut linked = false;
    let offer_at = Cell::new(Instant::FAR_FUTURE);
    loop {
        clock.sleep(Duration::from_millis(2)).await;
        let up = server.borrow().linked;
        if up != linked {
            linked = up;
            if up {
                robot.set_link_health(LinkHealth::Up);
                port.session_began();
                offer_at.set(clock.now() + Duration::from_secs(1));
            } else {
                robot.set_link_health(LinkHealth::Lost);
                port.rewind();
            }
        }
        if !linked {
            continue;
        }
        port.heard();
        if server.borrow().offering && clock.now() >= offer_at.get() {
            offer_at.set(Instant::FAR_FUTURE);
            let offer = server.borrow().offer();
            updates.arrived(offer.as_bytes()).expect("an offer");
        }
        while let Some(kind) = port.next_report(&|_| true) {
            let mut page = [0; 1_024];
            let length = compose(port, kind, &robot, &mut page);
            let report: Value = serde_json::from_slice(&page[..length]).expect("JSON");
            port.settled(kind);
            port.reached();
            if report["state"] == "deferred" {
                // It waits, and offers it again.
                offer_at.set(clock.now() + Duration::from_secs(5));
            }
            let wanted = report["update"] == "want" && server.borrow().sending;
            if wanted {
                let chunks = server.borrow_mut().chunks(&report);
                for chunk in chunks {
                    // As the link does: nothing is taken from the stream while there is no room.
                    poll_fn(|context| port.poll_room(context)).await;
                    clock.sleep(Duration::from_micros(800)).await;
                    if !server.borrow().linked {
                        break;
                    }
                    {
                        let mut server = server.borrow_mut();
                        server.sent += 1;
                        server.of_image += u32::from(chunk[1] == Part::Image as u8);
                        server.of_patch += u32::from(chunk[1] == Part::Delta as u8);
                    }
                    port.arrived(&chunk).expect("a chunk");
                }
            }
            server.borrow_mut().told.push(report);
        }
    }
}

fn compose(port: &dyn UpdatePort, kind: ReportKind, robot: &TestRobot, page: &mut [u8]) -> usize {
    port.compose(kind, &robot.config().id, page)
        .expect("every report fits")
}
