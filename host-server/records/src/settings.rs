//! Values that must survive a restart and are of no kind of their own, such as the key that signs
//! tokens.

use crate::RecordsError;
use crate::query::query;
use crate::store::Store;

/// Longest key of a setting, in bytes.
pub const MAX_SETTING_KEY: usize = 64;
/// Longest value of a setting, in bytes.
pub const MAX_SETTING: usize = 64 * 1024;

/// The settings among the records.
#[derive(Debug, Clone, Copy)]
pub struct Settings<'r>(pub(crate) &'r Store);

impl Settings<'_> {
    /// The value of `key`.
    ///
    /// # Errors
    /// [`RecordsError`] when it cannot be read.
    pub async fn get(self, key: &str) -> Result<Option<Vec<u8>>, RecordsError> {
        let key = key.to_owned();
        self.0
            .read(move |connection| {
                Box::pin(async move {
                    let row: Option<(Vec<u8>,)> = query("SELECT value FROM setting WHERE key = $1")
                        .bind(key)
                        .fetch_optional(connection)
                        .await?;
                    Ok(row.map(|(value,)| value))
                })
            })
            .await
    }

    /// Makes `value` the value of `key`.
    ///
    /// # Errors
    /// [`RecordsError::Invalid`] when one of the two is too long.
    pub async fn set(self, key: &str, value: &[u8]) -> Result<(), RecordsError> {
        if key.is_empty() || key.len() > MAX_SETTING_KEY {
            return Err(RecordsError::Invalid("a setting's key has 1 to 64 bytes"));
        }
        if value.len() > MAX_SETTING {
            return Err(RecordsError::Invalid("a setting has at most 64 KiB"));
        }
        let (key, value) = (key.to_owned(), value.to_vec());
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    query(
                        "INSERT INTO setting (key, value) VALUES ($1, $2)
                         ON CONFLICT (key) DO UPDATE SET value = excluded.value",
                    )
                    .bind(key)
                    .bind(value)
                    .execute(connection)
                    .await?;
                    Ok(())
                })
            })
            .await
    }

    /// The value of `key`, which becomes `value` if there is none yet. Of several that ask at once,
    /// all get the same.
    ///
    /// # Errors
    /// As for [`Settings::set`].
    pub async fn get_or_set(self, key: &str, value: &[u8]) -> Result<Vec<u8>, RecordsError> {
        if key.is_empty() || key.len() > MAX_SETTING_KEY {
            return Err(RecordsError::Invalid("a setting's key has 1 to 64 bytes"));
        }
        if value.len() > MAX_SETTING {
            return Err(RecordsError::Invalid("a setting has at most 64 KiB"));
        }
        let (key, value) = (key.to_owned(), value.to_vec());
        self.0
            .write(move |connection| {
                Box::pin(async move {
                    query(
                        "INSERT INTO setting (key, value) VALUES ($1, $2) ON CONFLICT DO NOTHING",
                    )
                    .bind(&key)
                    .bind(value)
                    .execute(&mut *connection)
                    .await?;
                    let (value,): (Vec<u8>,) = query("SELECT value FROM setting WHERE key = $1")
                        .bind(key)
                        .fetch_one(connection)
                        .await?;
                    Ok(value)
                })
            })
            .await
    }
}
