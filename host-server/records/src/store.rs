//! Where the records are: in a file, or in a database that several servers share.

use crate::RecordsError;
use crate::postgres::Remote;
use crate::query::{Connection, query};
use crawler_database::{Boxed, Db};

/// Rows deleted in one transaction, and so how long others wait for it.
const DELETED: i64 = 5_000;
/// Transactions in one go; the rest waits for the next.
const ROUNDS: usize = 100;

#[derive(Debug, Clone)]
pub(crate) enum Store {
    Sqlite(Db),
    Postgres(Remote),
}

impl Store {
    /// Carries out `work` in a transaction and returns when it is committed. Writes are in one order,
    /// also those of several processes: what `work` reads holds until it is done.
    ///
    /// A caller that stops waiting does not undo it: the work is done all the same.
    pub(crate) async fn write<T, F>(&self, work: F) -> Result<T, RecordsError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Connection<'c>) -> Boxed<'c, Result<T, RecordsError>>
            + Send
            + 'static,
    {
        match self {
            Self::Sqlite(db) => {
                db.write(|connection| {
                    Box::pin(async move { work(&mut Connection::Sqlite(connection)).await })
                })
                .await
            }
            Self::Postgres(remote) => {
                remote
                    .write(|connection| {
                        Box::pin(async move { work(&mut Connection::Postgres(connection)).await })
                    })
                    .await
            }
        }
    }

    /// Carries out `work`, statements of which each may change something by itself and fits in anywhere between the
    /// writes of others: it does not wait for its turn among them.
    pub(crate) async fn apart<T, F>(&self, work: F) -> Result<T, RecordsError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Connection<'c>) -> Boxed<'c, Result<T, RecordsError>>
            + Send
            + 'static,
    {
        match self {
            // A file has one writer.
            Self::Sqlite(_) => self.write(work).await,
            Self::Postgres(_) => self.read(work).await,
        }
    }

    /// Carries out `work`, which must not write.
    pub(crate) async fn read<T, F>(&self, work: F) -> Result<T, RecordsError>
    where
        T: Send + 'static,
        F: for<'c> FnOnce(&'c mut Connection<'c>) -> Boxed<'c, Result<T, RecordsError>>
            + Send
            + 'static,
    {
        match self {
            Self::Sqlite(db) => {
                db.read(|connection| {
                    Box::pin(async move { work(&mut Connection::Sqlite(connection)).await })
                })
                .await
            }
            Self::Postgres(remote) => {
                remote
                    .read(|connection| {
                        Box::pin(async move { work(&mut Connection::Postgres(connection)).await })
                    })
                    .await
            }
        }
    }

    /// Carries out `delete`, which takes a bound and how many rows it may delete, until nothing is left to delete or
    /// it is enough for one call, and returns how many went.
    pub(crate) async fn delete_some(
        &self,
        delete: &'static str,
        bound: i64,
    ) -> Result<u64, RecordsError> {
        let mut total = 0;
        for _ in 0..ROUNDS {
            let delete = query(delete).bind(bound).bind(DELETED);
            let deleted = self
                .write(move |connection| Box::pin(async move { delete.execute(connection).await }))
                .await?;
            total += deleted;
            if deleted < DELETED as u64 {
                break;
            }
        }
        Ok(total)
    }

    /// Lets the writer finish what waits, and lets go of the database.
    pub(crate) async fn close(&self) {
        match self {
            Self::Sqlite(db) => db.close().await,
            Self::Postgres(remote) => remote.close().await,
        }
    }
}
