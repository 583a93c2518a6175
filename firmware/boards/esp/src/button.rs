//! The BOOT button.

use embassy_time::{Duration, Instant, Timer};
use esp_hal::gpio::{AnyPin, Input, InputConfig, Pull};

/// How long after the start the button counts. Held *during* the reset it makes the chip wait for
/// a new program instead of starting this one.
const WINDOW: Duration = Duration::from_millis(2_000);
/// How long it has to be held.
const HOLD: Duration = Duration::from_millis(500);
/// Time between two looks; longer than contacts bounce.
const LOOK: Duration = Duration::from_millis(20);

/// Whether the button is held soon after the start: a person wants to provision the robot anew.
pub(crate) async fn held(pin: AnyPin<'static>) -> bool {
    let button = Input::new(pin, InputConfig::default().with_pull(Pull::Up));
    let end = Instant::now() + WINDOW;
    let mut since = None;
    loop {
        let now = Instant::now();
        if button.is_low() {
            let since = *since.get_or_insert(now);
            if now - since >= HOLD {
                return true;
            }
        } else {
            since = None;
        }
        // A button that went down within the window is seen through.
        if since.is_none() && now >= end {
            return false;
        }
        Timer::after(LOOK).await;
    }
}
