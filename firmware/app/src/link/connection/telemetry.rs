//! Sending telemetry.

use crawler_hal::{Clock, LinkMonitor, LinkState};
use crawler_protocol::{TelemetryEncoding, Topic};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};

use super::{Connection, following};
use crate::hold::Hold;
use crate::link::batch::Wish;
use crate::link::loss::Loss;
use crate::link::messages::{self, Look};

impl<H, M, C, L, S> Connection<'_, '_, H, M, C, L, S>
where
    H: Hold,
    M: RawMutex,
    C: Clock,
    L: LinkMonitor,
    S: Read + Write,
{
    /// Takes a sample when one is due, and sends what is to be sent.
    pub(super) async fn send_telemetry(&mut self) -> Result<(), Loss> {
        let robot = self.robot;
        let now = self.clock.now();
        if now < self.state.next_telemetry {
            return Ok(());
        }
        let wish = robot.with_parameters(Wish::of);
        self.state.next_telemetry = following(self.state.next_telemetry, wish.period, now);
        let look = Look {
            seq: self.counters.telemetry,
            rssi_dbm: match self.monitor.state() {
                LinkState::Up { rssi_dbm, .. } => rssi_dbm,
                LinkState::Down => None,
            },
            now,
        };
        self.counters.telemetry += 1;
        let how = wish.encoding;
        if self.batch.encoding != how {
            self.flush().await?;
        }
        if !how.is_sequence() {
            self.batch.encoding = how;
            let written = self.write(|page| {
                let written = messages::telemetry(robot, &look, how, page, 0);
                written.ok().map(|(len, _)| len)
            });
            return self.send_samples(written).await;
        }
        if !self.batch.add(robot, &look, how) {
            self.flush().await?;
            // Alone it fits, or never will.
            self.batch.add(robot, &look, how);
        }
        let timeless = robot.unix_ms(now).is_none();
        if timeless || self.batch.is_due(wish.size, self.state.next_telemetry) {
            self.flush().await?;
        }
        Ok(())
    }

    /// Sends what has been collected.
    async fn flush(&mut self) -> Result<(), Loss> {
        let written = self.write(|page| self.batch.copy_to(page));
        self.batch.clear();
        self.send_samples(written).await
    }

    /// Publishes what was written to the page of the packet, if anything was.
    async fn send_samples(&mut self, written: Option<usize>) -> Result<(), Loss> {
        let Some(len) = written else {
            return Ok(());
        };
        // Not needed for what has always been sent, and so left out.
        let how = Some(self.batch.encoding).filter(|how| *how != TelemetryEncoding::Json);
        let topic = Topic::Telemetry(self.robot.config().id.clone());
        let content_type = how.map(TelemetryEncoding::content_type);
        self.publish(&topic, len, None, content_type).await
    }
}
