//! The update activity: a release into the spare slot, its trial, and the way back.
//!
//! | step | how |
//! |---|---|
//! | offered | the robot says what it has; it takes a release only while it stands in `IDLE`, with a good battery and not on trial itself, and is `UPDATING` from then on |
//! | judged | the envelope is asked for, or read from the spare slot where it lies already; everything that is asked of a release is asked before the first byte is erased |
//! | preparing | otadata names the running program as proven; the trailer of the spare slot begins anew; what is not there yet is erased, sector by sector |
//! | receiving | windows of at most 16 chunks are asked for, and asked for again; each block is held against its hash as it is in flash, and noted in the trailer |
//! | by a patch | where the server has one of the program that runs, its chunks are asked for in order, and the image is made of both; at the first thing that is wrong with it, and after a minute without it, the image comes as it is |
//! | verifying | the whole image as it is in flash |
//! | staged | noted, with the sensors that work; otadata is told, and the robot restarts in its own time |
//! | trial | the new program observes itself twice a second: [`crawler_boot::trial`] |
//! | confirmed, rolled back | noted in otadata and trailer; the reason for going back is told by the program that is back |
//!
//! Between any two of these steps, and between any two bytes of flash, the power may go: what is noted is what counts.
//! An update that was interrupted is offered again by the server, which knows from `have` how far it has come.
//!
//! A release of a model takes the same way, as far as its last steps: `models` has them.
//!
//! # What ends an update before its time
//! `stop` is obeyed as ever, and changes nothing: the robot stands already. `estop` and faults are obeyed as ever too,
//! and put the update off, as do a low battery and a server that sends nothing for two minutes: the robot leaves
//! `UPDATING`, says `deferred` with the reason, and goes on where it was with the next offer. `reboot` is a restart like
//! any other. `cancel` gives the release up as long as it was not activated. On trial all commands are obeyed.
//!
//! # Where sequence and floor are
//! In the trailer of the slot that runs: it holds the signed manifest. That suffices. A release has to be above the
//! sequence that is installed, which is at least the floor of every release confirmed before it, since each had to be
//! above those in turn; so a floor of its own could only tell more where the sequence falls: back from a trial, whose
//! floor does not count, or when a board is flashed by cable, which leaves the trailers alone. So the floor is the
//! larger one of those in both trailers whose images were confirmed, and it rises when a release is confirmed and not
//! before: a way back is never closed by what was not proven. Whoever can write a trailer can write a program.
//!
//! # Time
//! Nothing here takes longer than one operation of the flash or a slice of 256 bytes before others have their turn, but
//! for the check of the signature, 13 million instructions. Control runs above all of it.
//!
//! Memory: chunks, commands and reports are in [`Updates`]; the future of [`update`] keeps no page of its own, but what
//! reads a patch: 1.3 KB.

mod mailbox;
mod models;
mod patch;
mod proving;
mod slots;
mod steps;
#[cfg(test)]
mod tests;
mod transfer;
mod words;

use core::convert::Infallible;
use core::ops::Deref;

use crawler_boot::Trial;
use crawler_hal::{Clock, Duration, Instant, SlotPort};
use crawler_protocol::{Level, ReleaseId, RobotState, UpdateOutcome, UpdateStage};
use embassy_futures::select::select;
use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;
use rand_core::Rng;

use crate::context::Robot;
use crate::context::handles::UpdateHandle;
use crate::hold::{Hold, Inline};
use crate::order::UpdateWish;
use crate::perception::Charge;
use crate::policy::Shelf;
use crate::state::Fault;

use mailbox::Outcome;
#[cfg(test)]
pub(crate) use mailbox::Word;
pub(crate) use mailbox::{Have, Progress};
pub(crate) use mailbox::{NoUpdates, ReportKind, UpdatePort, room};
pub use mailbox::{UpdateIdentity, Updates};
pub use models::{LoadError, ModelHost, ModelLooks, NoEyes, PolicyHost};
use models::{ModelStore, NoModels, WithModels};
use slots::Slots;
pub(crate) use slots::Subject;
pub use transfer::{ASK_AFTER, ASK_AFTER_MOST, SILENT_AFTER};
use transfer::{Blocks, Failed, Refused, Shape, Transfer};

/// How often a program on trial observes itself.
const LOOK: Duration = Duration::from_millis(500);
/// How often the state of the robot is looked at before and while a release is received: control takes it out of
/// `UPDATING` when there is a fault.
const LOOK_UPDATING: Duration = Duration::from_millis(100);
/// How long control may take to let the robot stand for an update.
const STANDS_WITHIN: Duration = Duration::from_secs(1);
/// How long a restart waits for what was said last to reach the broker.
const TOLD_WITHIN: Duration = Duration::from_secs(3);

/// Event of log records about updates.
const EVENT: &str = "update";

/// Takes updates, for ever.
///
/// # Cancellation Safety
/// As safe as a power cut, which costs the block that was being received and nothing else.
pub fn update<M: RawMutex, F: MultiwriteNorFlash, R: Rng, C: Clock, const MODELS: usize>(
    robot: impl Deref<Target = Robot<M>>,
    updates: impl Deref<Target = Updates<M, MODELS>>,
    port: SlotPort<F>,
    rng: R,
    clock: C,
) -> impl Future<Output = Infallible> {
    update_held::<Inline, M, F, R, C, MODELS>(robot, updates, port, rng, clock)
}

/// As [`update()`], with its rare steps kept as `H` keeps them.
///
/// # Cancellation Safety
/// As [`update()`].
pub fn update_held<
    H: Hold,
    M: RawMutex,
    F: MultiwriteNorFlash,
    R: Rng,
    C: Clock,
    const MODELS: usize,
>(
    robot: impl Deref<Target = Robot<M>>,
    updates: impl Deref<Target = Updates<M, MODELS>>,
    port: SlotPort<F>,
    rng: R,
    clock: C,
) -> impl Future<Output = Infallible> {
    run::<H, M, F, R, C, _, MODELS>(robot, updates, (port, NoModels), rng, clock)
}

/// As [`update_held()`], on a body that takes policies, and models for its detector where there are `eyes`, of [`NoEyes`]
/// where there never are: `policies` says where in the flash of `port` their places are, and holds the one that is in use. `MODELS` is how many
/// of the two it takes.
///
/// # Cancellation Safety
/// As [`update()`].
pub fn update_with_policies_held<
    H: Hold,
    M: RawMutex,
    F: MultiwriteNorFlash,
    R: Rng,
    C: Clock,
    B: ModelHost,
    S: Hold,
    const MODELS: usize,
>(
    robot: impl Deref<Target = Robot<M>>,
    updates: impl Deref<Target = Updates<M, MODELS>>,
    port: SlotPort<F>,
    (eyes, policies): (Option<B>, PolicyHost<impl Deref<Target = Shelf<M, S>>>),
    rng: R,
    clock: C,
) -> impl Future<Output = Infallible> {
    let flash = (port, WithModels::new(eyes, policies));
    run::<H, M, F, R, C, _, MODELS>(robot, updates, flash, rng, clock)
}

// Not an `async fn`, which would keep its arguments twice: as they came and as they are used.
#[allow(clippy::manual_async_fn)]
fn run<H: Hold, M: RawMutex, F, R: Rng, C: Clock, N: ModelStore, const MODELS: usize>(
    robot: impl Deref<Target = Robot<M>>,
    updates: impl Deref<Target = Updates<M, MODELS>>,
    (port, models): (SlotPort<F>, N),
    mut rng: R,
    clock: C,
) -> impl Future<Output = Infallible>
where
    F: MultiwriteNorFlash,
{
    async move {
        let robot = robot.update_handle();
        let slots = Slots::of(port, |programs| models.sites(programs));
        let Some(slots) = slots.usable() else {
            let text = format_args!("the slots cannot be as the body says");
            robot.log(Level::Error, EVENT, text, clock.now());
            for subject in Subject::MODELS {
                updates.set_model(subject, None);
            }
            return core::future::pending().await;
        };
        let mut activity = Activity {
            robot,
            updates: &*updates,
            slots,
            clock: &clock,
            random: rng.next_u32(),
            programs: Stock::default(),
            models,
            trial: None,
            asked: None,
            transfer: None,
            envelope: None,
            told: None,
            told_by: None,
            leaving: false,
        };
        H::hold(N::start(&mut activity)).await;
        loop {
            let next = H::hold(N::turn(&mut activity)).await;
            match next {
                Next::Soon => yield_now().await,
                Next::Word => activity.updates.changed().await,
                Next::At(at) => {
                    select(activity.updates.changed(), clock.sleep_until(at)).await;
                }
            }
        }
    }
}

/// When the next turn is due.
enum Next {
    /// As soon as others have had theirs.
    Soon,
    /// When something has arrived.
    Word,
    /// Then, or when something has arrived.
    At(Instant),
}

/// What is installed in the slot that runs, or as a model that is in use.
#[derive(Debug, Clone, Copy)]
struct Installed {
    /// The release, if it came as one.
    release: Option<ReleaseId>,
    sequence: u32,
    floor: u32,
    /// The floor once the release is confirmed.
    next_floor: u32,
}

/// What is known of two slots, or of the two places for a model.
#[derive(Debug, Clone, Copy, Default)]
struct Stock {
    /// `None` when the flash could not be read: then nothing is taken.
    installed: Option<Installed>,
    /// What lies in the spare slot was tried and given up.
    given_up: Option<Outcome>,
    /// What lies in the spare slot, not tried, and how much of it.
    unfinished: Option<(ReleaseId, u32)>,
}

impl Stock {
    /// The release that is installed, if it came as one.
    fn release(&self) -> Option<ReleaseId> {
        self.installed?.release
    }
}

/// A release that control was asked to stand for.
#[derive(Debug, Clone, Copy)]
struct Asked {
    release: ReleaseId,
    /// Bytes of the patch that makes it out of the program that runs.
    patch: Option<u32>,
    until: Instant,
}

struct Activity<'a, M: RawMutex, F, C, N: ModelStore, const MODELS: usize> {
    robot: UpdateHandle<'a, M>,
    updates: &'a Updates<M, MODELS>,
    slots: Slots<F, N::Sites>,
    clock: &'a C,
    random: u32,
    programs: Stock,
    models: N,
    /// Of the program that runs.
    trial: Option<Trial>,
    asked: Option<Asked>,
    transfer: Option<Transfer>,
    /// Length of the envelope that lies where chunks arrive.
    envelope: Option<usize>,
    /// Stage and bytes that were reported last.
    told: Option<(UpdateStage, u32)>,
    /// Until when a restart waits for what was said last to arrive.
    told_by: Option<Instant>,
    /// A restart was asked for.
    leaving: bool,
}

impl<M: RawMutex, F: MultiwriteNorFlash, C: Clock, N: ModelStore, const MODELS: usize>
    Activity<'_, M, F, C, N, MODELS>
{
    /// Does one thing that is to be done.
    async fn turn(&mut self) -> Next {
        if self.leaving {
            return Next::Word;
        }
        if self.updates.take_session() {
            self.greet();
        }
        while let Some(word) = self.updates.take_word() {
            self.obey(word);
        }
        if self.trial.is_some() {
            return self.prove().await;
        }
        if self.asked.is_some() {
            return self.await_standing().await;
        }
        if self.transfer.is_some() {
            return self.advance().await;
        }
        Next::Word
    }

    /// Whether there is something to do about programs, or a release is under way.
    fn is_at_work(&self) -> bool {
        self.leaving || self.trial.is_some() || self.asked.is_some() || self.transfer.is_some()
    }

    /// Why the robot cannot take an update now.
    fn hindrance(&self) -> Option<&'static str> {
        let battery = self.robot.battery();
        let snapshot = self.robot.snapshot();
        let by_state = match snapshot.state {
            RobotState::Idle | RobotState::Updating => None,
            RobotState::Initializing => Some("initializing"),
            RobotState::Moving
            | RobotState::Scanning
            | RobotState::Caution
            | RobotState::Avoiding => Some("driving"),
            RobotState::Error if snapshot.fault == Some(Fault::EmergencyStop) => Some("estopped"),
            RobotState::Error => Some("fault"),
        };
        let by_battery = match battery.charge {
            Charge::Good if !battery.brown_out => None,
            Charge::Unknown => Some("battery_unknown"),
            Charge::Good | Charge::Low | Charge::Critical => Some("low_battery"),
        };
        by_state.or(by_battery)
    }

    /// Waits for control to let the robot stand.
    async fn await_standing(&mut self) -> Next {
        let Some(asked) = self.asked else {
            return Next::Soon;
        };
        let now = self.clock.now();
        if self.robot.snapshot().state == RobotState::Updating {
            self.asked = None;
            self.random = self
                .random
                .wrapping_mul(1_664_525)
                .wrapping_add(1_013_904_223);
            let lying = N::lying(self, asked.release).await;
            self.transfer = Some(Transfer::new(
                asked.release,
                lying,
                asked.patch,
                self.random,
                now,
            ));
            self.told = None;
            self.told_by = None;
            return Next::Soon;
        }
        let hindrance = self.hindrance();
        if hindrance.is_some() || now >= asked.until {
            self.asked = None;
            self.robot.wish(UpdateWish::None);
            self.defer(asked.release, hindrance.unwrap_or("driving"));
            return Next::Soon;
        }
        Next::At((now + LOOK_UPDATING).min(asked.until))
    }

    /// Ends the update without a release.
    fn leave(&mut self) {
        self.updates.close();
        self.transfer = None;
        self.asked = None;
        self.envelope = None;
        self.robot.wish(UpdateWish::None);
    }

    fn defer(&self, release: ReleaseId, why: &'static str) {
        self.tell(Progress {
            release,
            stage: UpdateStage::Deferred,
            reason: Some(why),
            bytes: self.bytes_of(release),
            of: Subject::Program,
        });
        self.log(Level::Info, release, format_args!("put off: {why}"));
    }

    /// Bytes of a release that lie unfinished in flash.
    fn bytes_of(&self, release: ReleaseId) -> u32 {
        let of = |stock: &Stock| match stock.unfinished {
            Some((lying, bytes)) if lying == release => bytes,
            Some(_) | None => 0,
        };
        let models = self.models.stocks().iter().map(of);
        models.fold(of(&self.programs), u32::max)
    }

    /// What is known where the release that is at work belongs.
    fn stock(&mut self) -> &mut Stock {
        let subject = self.slots.subject();
        self.models.stock_mut(subject).unwrap_or(&mut self.programs)
    }

    /// What is known of what this replaces.
    fn stock_of(&self, subject: Subject) -> &Stock {
        let model = subject.model();
        let stock = model.and_then(|model| self.models.stocks().get(model));
        stock.unwrap_or(&self.programs)
    }

    fn refuse(&mut self, release: ReleaseId, why: Refused) {
        self.leave();
        self.tell_outcome(Outcome {
            release,
            came_to: UpdateOutcome::Refused,
            reason: Some(why.code),
            lasting: Some(why.lasting),
            of: Subject::Program,
        });
        self.log(Level::Warn, release, format_args!("refused: {}", why.code));
    }

    fn tell(&self, progress: Progress) {
        self.updates.tell_progress(progress);
        self.robot.outbox.nudge();
    }

    fn tell_outcome(&self, outcome: Outcome) {
        self.updates.tell_outcome(outcome);
        self.robot.outbox.nudge();
    }

    fn tell_have(&self) {
        let (sequence, floor) = self
            .programs
            .installed
            .map_or((0, 0), |installed| (installed.sequence, installed.floor));
        let mut unfinished = self.programs.unfinished;
        for stock in self.models.stocks() {
            unfinished = unfinished.or(stock.unfinished);
        }
        self.updates.tell_have(Have {
            sequence,
            floor,
            unfinished,
        });
        self.robot.outbox.nudge();
    }

    fn log(&self, level: Level, release: ReleaseId, text: core::fmt::Arguments<'_>) {
        let now = self.clock.now();
        self.robot
            .log(level, EVENT, format_args!("{release} {text}"), now);
    }
}
