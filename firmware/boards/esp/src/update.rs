//! The guard in the first lines of `main`, and who this program is.

use core::fmt::Write as _;
use core::hint::black_box;

use crawler_board::boot_record::{BootRecord, End};
use crawler_board::guard::{self, Next};
use crawler_board::update_identity;
use crawler_hal::SlotPort;
use crawler_image_format::keys::KeyTable;
use crawler_protocol::BuildId;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use heapless::String;
use static_cell::StaticCell;

use crate::flash::Region;
use crate::system::Start;
use crate::{ESP_APP_DESC, kept, system};

/// How many models updates may bring: that of the detector and a policy, on the chip that has room for them.
const MODELS: usize = if cfg!(feature = "esp32s3") { 2 } else { 0 };

/// What the link and the update activity share.
pub(crate) type Updates = crawler_app::Updates<CriticalSectionRawMutex, MODELS>;

/// The keys that releases must be signed with. Whoever packs the program writes them in.
#[used]
static RELEASE_KEYS: KeyTable = KeyTable::empty();

/// Decides whether this program runs. Does not come back when it does not: the program before is started then.
pub(crate) async fn guard(slots: Option<&mut SlotPort<Region>>, start: Start) {
    let keys = RELEASE_KEYS.keys().count();
    defmt::info!("build {=str}, {} release keys", build().as_str(), keys);
    let Some(port) = slots else {
        return;
    };
    match guard::guard(port, start.cause()).await {
        Ok(Next::Run) => defmt::info!("slot {}, proven", port.running),
        Ok(Next::Try) => defmt::info!("slot {}, on trial", port.running),
        Ok(Next::RunAgain(reason)) => defmt::warn!(
            "slot {}: the other one does not start: {=str}",
            port.running,
            reason.code()
        ),
        Ok(Next::Restart(reason)) => {
            defmt::warn!("slot {} is given up: {=str}", port.running, reason.code());
            kept::put(BootRecord::ending(End::Reset, None));
            system::restart();
        }
        Err(error) => defmt::error!(
            "slot {}: the flash does not keep it: {}",
            port.running,
            error
        ),
    }
}

/// What the link and the update activity share. There may be one call.
pub(crate) fn updates() -> &'static Updates {
    static UPDATES: StaticCell<Updates> = StaticCell::new();
    UPDATES.init_with(|| Updates::new(update_identity::identity(build(), &RELEASE_KEYS)))
}

/// What names this program: no other has the same, and it has no other. The first bytes of the hash of the ELF file,
/// which whoever packs the program writes into its descriptor.
pub(crate) fn build() -> BuildId {
    // The compiler must not go by what it knows of the descriptor.
    let hash = black_box(&ESP_APP_DESC).app_elf_sha256();
    let hash = hash.first_chunk().copied().map_or(0, u64::from_be_bytes);
    let mut digits = String::<16>::new();
    // They are sixteen.
    let _ = write!(digits, "{hash:016x}");
    // Zeros are what nobody wrote.
    let digits = (hash != 0).then_some(digits.as_str());
    update_identity::build(digits, env!("CARGO_PKG_VERSION"))
}
