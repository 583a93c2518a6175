//! Which server a rollout belongs to.

use super::{KeptRollout, Rollouts, find, robots};
use crate::RecordsError;
use crate::query::{Connection, query};
use crate::text::cut;

/// Longest name of a server, in bytes; the rest is cut off.
pub(super) const MAX_OWNER: usize = 64;

/// Whose a rollout is that is not over.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// The rollout.
    pub id: i64,
    /// The server.
    pub owner: String,
    /// Rises each time it goes to another server.
    pub epoch: u64,
    /// Rises while that server lives.
    pub beat: u64,
}

/// A rollout that was taken over, and the entries of its robots.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Taken {
    /// The rollout, under its new epoch.
    pub rollout: KeptRollout,
    /// The entries of its robots, by name of the robot.
    pub robots: Vec<String>,
}

async fn take(
    connection: &mut Connection<'_>,
    id: i64,
    epoch: u64,
    owner: String,
) -> Result<Option<Taken>, RecordsError> {
    let taken = query(
        "UPDATE rollout SET owner = $1, epoch = epoch + 1, beat = 0
         WHERE id = $2 AND epoch = $3 AND ended IS NULL",
    )
    .bind(owner)
    .bind(id)
    .bind(epoch.cast_signed())
    .execute(connection)
    .await?;
    if taken == 0 {
        return Ok(None);
    }
    let rollout = find(connection, id).await?.ok_or(RecordsError::NotFound)?;
    let robots = robots(connection, id).await?;
    Ok(Some(Taken { rollout, robots }))
}

impl Rollouts<'_> {
    /// Whose the rollouts are that are not over, the oldest first.
    ///
    /// # Errors
    /// [`RecordsError`] when they cannot be read.
    pub async fn leases(self) -> Result<Vec<Lease>, RecordsError> {
        let rows: Vec<(i64, String, i64, i64)> = self
            .0
            .read(|connection| {
                Box::pin(async move {
                    query(
                        "SELECT id, owner, epoch, beat FROM rollout WHERE ended IS NULL
                         ORDER BY id",
                    )
                    .fetch_all(connection)
                    .await
                })
            })
            .await?;
        let lease = |(id, owner, epoch, beat): (i64, String, i64, i64)| Lease {
            id,
            owner,
            epoch: epoch.cast_unsigned(),
            beat: beat.cast_unsigned(),
        };
        Ok(rows.into_iter().map(lease).collect())
    }

    /// Makes the rollout `id` that of the server `owner`, if it is still under `epoch` and not over, and returns it
    /// as it is then. From then on nobody writes under the earlier epoch.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be written.
    pub async fn take(
        self,
        id: i64,
        epoch: u64,
        owner: &str,
    ) -> Result<Option<Taken>, RecordsError> {
        let owner = cut(owner, MAX_OWNER);
        self.0
            .write(move |connection| Box::pin(take(connection, id, epoch, owner)))
            .await
    }

    /// Tells that the server of these rollouts lives, each under its epoch, and returns those of them that are
    /// another's by now, or gone.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be written.
    pub async fn renew(self, own: Vec<(i64, u64)>) -> Result<Vec<i64>, RecordsError> {
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    let mut lost = Vec::new();
                    for (id, epoch) in own {
                        let renewed = query(
                            "UPDATE rollout SET beat = beat + 1 WHERE id = $1 AND epoch = $2",
                        )
                        .bind(id)
                        .bind(epoch.cast_signed())
                        .execute(&mut *connection)
                        .await?;
                        if renewed == 0 {
                            lost.push(id);
                        }
                    }
                    Ok(lost)
                })
            })
            .await
    }
}
