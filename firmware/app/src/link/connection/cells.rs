//! Listening to the cells around the robot.

use core::pin::pin;

use crawler_hal::{Clock, Instant, LinkMonitor, with_deadline};
use crawler_protocol::{Level, Topic};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};
use rust_mqtt::client::options::{RetainHandling, SubscriptionOptions, UnsubscriptionOptions};
use rust_mqtt::types::{MqttString, PacketIdentifier, TopicFilter};

use super::Connection;
use crate::hold::Hold;
use crate::link::cells::{Asked, Wish};
use crate::link::loss::Loss;
use crate::neighbours;

impl<H, M, C, L, S> Connection<'_, '_, H, M, C, L, S>
where
    H: Hold,
    M: RawMutex,
    C: Clock,
    L: LinkMonitor,
    S: Read + Write,
{
    /// Asks the broker for the next cell, when one has to be asked for.
    pub(super) async fn follow_cells(&mut self) -> Result<(), Loss> {
        if self.state.asked.is_some() || self.state.no_cells || self.state.up_since.is_none() {
            return Ok(());
        }
        let known = self.robot.snapshot();
        let place = neighbours::needed_for(known.behaviour).then_some([known.pose.x, known.pose.y]);
        let close = neighbours::only_close(known.behaviour);
        let Some(wish) = self.flow.cells.wish(place, close) else {
            return Ok(());
        };
        let (Wish::Listen((x, y)) | Wish::Leave((x, y))) = wish;
        let topic = Topic::Cell { x, y }.render(&self.robot.config().fleet);
        let filter = MqttString::from_str(&topic)
            .ok()
            .and_then(TopicFilter::new)
            .ok_or(Loss::Unsupported)?;
        let deadline = self.write_deadline();
        let id = match wish {
            Wish::Listen(_) => {
                let options = SubscriptionOptions::new().retain_handling(RetainHandling::NeverSend);
                let work = pin!(self.client.subscribe(filter, &options));
                with_deadline(self.clock, deadline, work).await
            }
            Wish::Leave(_) => {
                let options = UnsubscriptionOptions::new();
                let work = pin!(self.client.unsubscribe(filter, &options));
                with_deadline(self.clock, deadline, work).await
            }
        }
        .map_err(|_| Loss::Stalled)??;
        let at = self.clock.now();
        self.state.asked = Some(Asked { id, wish, at });
        Ok(())
    }

    /// Takes the broker's answer, when it is one about cells. A broker that refuses is not asked
    /// again on this connection; the robot then knows of nobody.
    pub(in crate::link) fn cell_answered(
        &mut self,
        id: PacketIdentifier,
        refused: bool,
        now: Instant,
    ) {
        let Some(asked) = self.state.asked.filter(|asked| asked.id == id) else {
            return;
        };
        self.state.asked = None;
        if refused && matches!(asked.wish, Wish::Listen(_)) {
            self.state.no_cells = true;
            let text = format_args!("the broker refuses to tell who is near");
            self.robot.log(Level::Warn, "no-neighbours", text, now);
        } else {
            self.flow.cells.settle(asked.wish);
        }
    }
}
