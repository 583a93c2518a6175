//! The recording of a live world, where there is one.

#[cfg(feature = "recording")]
use std::sync::PoisonError;

use super::{Board, BrokerAddress, LiveError, Simulation};
#[cfg(feature = "recording")]
pub(super) use crate::tools::recording::RecordTo;
#[cfg(feature = "recording")]
use crate::tools::recording::Recorder;

/// There is nothing to record to.
#[cfg(not(feature = "recording"))]
pub(super) enum RecordTo {}

/// See the [module](self).
pub(super) struct Log {
    #[cfg(feature = "recording")]
    recorder: Option<Recorder>,
}

#[cfg(feature = "recording")]
impl Log {
    pub(super) fn open(to: Option<&RecordTo>) -> Result<Self, LiveError> {
        let recorder = to.map(Recorder::create).transpose();
        let recorder = recorder.map_err(|error| LiveError::Record(error.to_string()))?;
        Ok(Self { recorder })
    }

    /// What the robots of the recorded world are given.
    pub(super) fn given(&self, plain: &BrokerAddress) -> BrokerAddress {
        BrokerAddress {
            event_logs: self.recorder.as_ref().map(Recorder::event_logs),
            ..plain.clone()
        }
    }

    pub(super) fn observe(&mut self, simulation: &Simulation, board: &Board) {
        let due = |recorder: &&mut Recorder| recorder.is_due(simulation.now());
        let Some(recorder) = self.recorder.as_mut().filter(due) else {
            return;
        };
        if let Err(error) = recorder.observe(simulation) {
            self.recorder = None;
            tell(board, error.to_string());
        }
    }

    /// The world ends, and its recording with it.
    pub(super) fn close(&mut self, simulation: &Simulation, board: &Board) {
        if let Some(recorder) = self.recorder.take() {
            let text = match recorder.finish(simulation) {
                Ok(_) => "the recorded world has ended".to_owned(),
                Err(error) => error.to_string(),
            };
            tell(board, text);
        }
    }
}

#[cfg(feature = "recording")]
fn tell(board: &Board, text: String) {
    *board
        .recording
        .lock()
        .unwrap_or_else(PoisonError::into_inner) = Some(text);
}

#[cfg(not(feature = "recording"))]
#[allow(
    clippy::unused_self,
    clippy::unnecessary_wraps,
    reason = "there is nothing to record to"
)]
impl Log {
    pub(super) fn open(_to: Option<&RecordTo>) -> Result<Self, LiveError> {
        Ok(Self {})
    }

    pub(super) fn given(&self, plain: &BrokerAddress) -> BrokerAddress {
        plain.clone()
    }

    pub(super) fn observe(&mut self, _simulation: &Simulation, _board: &Board) {}

    pub(super) fn close(&mut self, _simulation: &Simulation, _board: &Board) {}
}
