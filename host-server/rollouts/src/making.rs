//! Makes patches, one at a time and beside everything else.

use std::sync::Arc;

use crawler_records::Records;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::image::Blob;
use crate::patches::Pair;

/// What makes patches; those that are not done are given up with it.
pub(crate) struct Maker {
    making: JoinSet<(Pair, Option<Vec<u8>>)>,
    /// Whoever has it is at work: what is needed for a pair is ten times as much as both images.
    turn: Arc<Semaphore>,
}

impl Default for Maker {
    fn default() -> Self {
        Self {
            making: JoinSet::new(),
            turn: Arc::new(Semaphore::new(1)),
        }
    }
}

impl Maker {
    /// Begins to make the patch of a pair, to the release of `blob`.
    pub(crate) fn begin(&mut self, records: &Records, pair: Pair, blob: Arc<Blob>) {
        let (records, turn) = (records.clone(), Arc::clone(&self.turn));
        self.making.spawn(async move {
            let patch = match turn.acquire().await {
                Ok(_turn) => make(&records, &pair, blob).await,
                Err(_) => None,
            };
            (pair, patch)
        });
    }

    /// The next patch that is made, or that there is none for a pair; `None` while none is being made.
    ///
    /// # Cancellation Safety
    /// A dropped call loses nothing.
    pub(crate) async fn next(&mut self) -> Option<(Pair, Option<Vec<u8>>)> {
        while let Some(done) = self.making.join_next().await {
            match done {
                Ok(made) => return Some(made),
                Err(error) => tracing::error!(%error, "a delta was not made"),
            }
        }
        None
    }
}

async fn make(records: &Records, pair: &Pair, blob: Arc<Blob>) -> Option<Vec<u8>> {
    let base = match blob.base(records.releases(), &pair.from).await {
        Ok(base) => base?,
        Err(error) => {
            tracing::warn!(from = %pair.from, to = %pair.to, %error, "images come as they are");
            return None;
        }
    };
    let made = tokio::task::spawn_blocking(move || blob.patch(&base)).await;
    made.ok().flatten()
}
