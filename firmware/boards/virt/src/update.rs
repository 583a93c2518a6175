//! The slots of the board, which of them runs, and the guard in the first lines of `main`.

use core::cell::Cell;

use crawler_app::policy::Shelf;
use crawler_app::{Inline, PolicyHost, Updates};
use crawler_board::guard::{self, Next};
use crawler_board::update_identity;
use crawler_hal::{ModelRegion, SlotPort, SlotRegion, System as _};
use crawler_image_format::header::{BUILD, Header};
use crawler_image_format::keys::KeyTable;
use crawler_image_format::layout::{
    OTADATA, POLICIES, POLICY_BYTES, POLICY_SELECT, SLOT_BYTES, SLOTS,
};
use crawler_image_format::start;
use crawler_protocol::BuildId;
use crawler_release::Chip;
use critical_section::Mutex;
use embassy_futures::block_on;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embedded_storage_async::nor_flash::ReadNorFlash as _;
use static_cell::StaticCell;

use crate::flash::{self, Programs};
use crate::system::{self, VirtSystem};

/// The keys that releases must be signed with. Whoever packs the program writes them in.
#[used]
static RELEASE_KEYS: KeyTable = KeyTable::empty();

/// The slot that the boot stage started; `None` when the program was started without it.
static RUNNING: Mutex<Cell<Option<u8>>> = Mutex::new(Cell::new(None));

/// Whether the program started on trial.
static ON_TRIAL: Mutex<Cell<bool>> = Mutex::new(Cell::new(false));

/// Whether the program started on trial.
pub fn is_on_trial() -> bool {
    critical_section::with(|cs| ON_TRIAL.borrow(cs).get())
}

/// Takes over what the boot stage told in the third register, and decides whether this program runs. Does not
/// come back when it does not: the program before is started then.
pub fn guard(started: usize) {
    let Some(running) = start::told(started) else {
        return;
    };
    critical_section::with(|cs| RUNNING.borrow(cs).set(Some(running)));
    if let Err(error) = flash::probe() {
        defmt::error!("flash: {}", defmt::Display2Format(&error));
        return;
    }
    let Some(mut port) = slots() else {
        return;
    };
    let keys = RELEASE_KEYS.keys().count();
    defmt::info!("build {=str}, {} release keys", build().as_str(), keys);
    let cause = VirtSystem::new().reset_cause();
    match block_on(guard::guard(&mut port, cause)) {
        Ok(Next::Run) => defmt::info!("slot {}, proven", running),
        Ok(Next::Try) => {
            defmt::info!("slot {}, on trial", running);
            critical_section::with(|cs| ON_TRIAL.borrow(cs).set(true));
        }
        Ok(Next::RunAgain(reason)) => {
            defmt::warn!(
                "slot {}: the other one does not start: {=str}",
                running,
                reason.code()
            );
        }
        Ok(Next::Restart(reason)) => {
            defmt::warn!("slot {} is given up: {=str}", running, reason.code());
            system::restart();
        }
        Err(error) => {
            let error = error.as_ref().map(defmt::Display2Format);
            defmt::error!("slot {}: the flash does not keep it: {}", running, error);
        }
    }
}

/// The slots, when the boot stage started the program from one of them. Whatever this gives shares one lock for each
/// operation of the flash. The guard is done with it before the update activity has it, and nobody else writes.
pub fn slots() -> Option<SlotPort<Programs>> {
    let running = critical_section::with(|cs| RUNNING.borrow(cs).get())?;
    Some(SlotPort {
        flash: flash::programs(),
        otadata: OTADATA,
        slots: SLOTS.map(|start| SlotRegion {
            start,
            length: SLOT_BYTES,
        }),
        running,
        chip: Chip::NONE.0,
    })
}

/// The place of a policy that a release has brought.
pub static SHELF: Shelf<CriticalSectionRawMutex, Inline> = Shelf::new();

/// Where policies are: in the flash of the slots.
pub fn policies() -> Policies {
    PolicyHost::new(
        &SHELF,
        Some(ModelRegion {
            select: POLICY_SELECT,
            places: POLICIES.map(|start| SlotRegion {
                start,
                length: POLICY_BYTES,
            }),
        }),
    )
}

/// What holds policies.
pub type Policies = PolicyHost<&'static Shelf<CriticalSectionRawMutex, Inline>>;

/// What the link and the update activity share. Releases may bring a policy.
pub type SharedUpdates = Updates<CriticalSectionRawMutex, 1>;

/// What the link and the update activity share. There may be one call.
pub fn updates() -> &'static SharedUpdates {
    static UPDATES: StaticCell<SharedUpdates> = StaticCell::new();
    UPDATES.init_with(|| Updates::new(update_identity::identity(build(), &RELEASE_KEYS)))
}

/// What names this program: no other has the same. Started without the boot stage it goes by its version.
pub fn build() -> BuildId {
    let digits = packed();
    let digits = digits
        .as_ref()
        .and_then(|digits| core::str::from_utf8(digits).ok());
    update_identity::build(digits, env!("CARGO_PKG_VERSION"))
}

/// The build in the header of the slot that runs; `None` when the program was started without the boot stage.
fn packed() -> Option<[u8; BUILD]> {
    let mut port = slots()?;
    let start = SLOTS.get(usize::from(port.running))?;
    let mut head = [0; Header::BYTES];
    block_on(port.flash.read(*start, &mut head)).ok()?;
    Header::parse(&head).map(|header| header.build())
}
