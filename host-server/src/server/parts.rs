//! What a server has started, and how that ends: what was started last ends first.
//!
//! A server is its parts in their order. Whoever fails to start one ends those before it, the same way as
//! a server that is told to stop.

use std::pin::Pin;
use std::time::Duration;

use tokio::task::JoinHandle;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::StartError;

/// For one task to come to its end.
pub(super) const PATIENCE: Duration = Duration::from_secs(5);

struct Part {
    /// Tells it to end; so does dropping it.
    stop: DropGuard,
    /// Returns when it has ended.
    end: Pin<Box<dyn Future<Output = ()> + Send>>,
}

/// See the [module](self).
///
/// Dropped without [`Parts::stop`], they end the same way, in the background. Where there is no runtime any
/// more, each is told to end, and that is all.
#[derive(Default)]
pub(super) struct Parts {
    parts: Vec<Part>,
    /// After how many parts a test has the start fail.
    fail_after: Option<usize>,
}

impl Parts {
    /// Parts of a server that fails to start when it has so many.
    #[cfg(test)]
    pub(super) fn failing_after(count: usize) -> Self {
        Self {
            parts: Vec::new(),
            fail_after: Some(count),
        }
    }

    /// Starts a task that ends some time after it is told to.
    ///
    /// # Errors
    /// None but what a test asked for; the task is among the parts all the same.
    pub(super) fn task<F>(
        &mut self,
        what: &'static str,
        run: impl FnOnce(CancellationToken) -> F,
    ) -> Result<(), StartError>
    where
        F: Future<Output = ()> + Send + 'static,
    {
        let stop = CancellationToken::new();
        let task = tokio::spawn(run(stop.clone()));
        self.add(stop, finish(what, task))
    }

    /// Adds what has been started. It is told to end by `stop`, and has ended when `end` returns, which
    /// must not take for ever.
    ///
    /// # Errors
    /// As [`Parts::task`].
    pub(super) fn add(
        &mut self,
        stop: CancellationToken,
        end: impl Future<Output = ()> + Send + 'static,
    ) -> Result<(), StartError> {
        self.parts.push(Part {
            stop: stop.drop_guard(),
            end: Box::pin(end),
        });
        if self.fail_after == Some(self.parts.len()) {
            return Err(StartError::Internal("what a test asked for"));
        }
        Ok(())
    }

    /// Adds what has been started and ends by `end` alone.
    ///
    /// # Errors
    /// As [`Parts::task`].
    pub(super) fn end_with(
        &mut self,
        end: impl Future<Output = ()> + Send + 'static,
    ) -> Result<(), StartError> {
        self.add(CancellationToken::new(), end)
    }

    /// Ends every part, the last one first, and returns when they have ended.
    ///
    /// # Cancellation safety
    /// Parts whose turn has not come by then end in the background.
    pub(super) async fn stop(mut self) {
        while let Some(part) = self.parts.pop() {
            part.stop().await;
        }
    }
}

impl Part {
    async fn stop(self) {
        self.stop.disarm().cancel();
        self.end.await;
    }
}

impl Drop for Parts {
    fn drop(&mut self) {
        let parts = std::mem::take(&mut self.parts);
        if let Ok(runtime) = tokio::runtime::Handle::try_current()
            && !parts.is_empty()
        {
            runtime.spawn(async move {
                for part in parts.into_iter().rev() {
                    part.stop().await;
                }
            });
        }
    }
}

/// Returns when `task` has ended, if need be by force.
pub(super) async fn finish(what: &'static str, mut task: JoinHandle<()>) {
    match tokio::time::timeout(PATIENCE, &mut task).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::error!(%error, "{what} ended badly"),
        Err(_) => {
            tracing::warn!("{what} does not stop and is cut short");
            task.abort();
            // One that does not come to the end of a step is left behind.
            let _ = tokio::time::timeout(PATIENCE, task).await;
        }
    }
}
