//! What is said and heard once the connection is open.

use super::{CLOSE_NOTIFY, Connection, KEY_UPDATE, MOST, WARNING};
use crate::error::TlsError;
use crate::record::{ALERT, DATA, HANDSHAKE, HEADER, Keys, head};

impl Connection<'_> {
    /// What the server has said, until it is taken.
    #[must_use]
    pub fn plaintext(&self) -> &[u8] {
        if !self.is_data {
            return &[];
        }
        let range = self.from..self.kept;
        self.buffers.input.get(range).unwrap_or_default()
    }

    /// Takes that many bytes of [`Connection::plaintext`].
    pub fn consume(&mut self, count: usize) {
        if self.is_data {
            self.from = self.kept.min(self.from.saturating_add(count));
            if self.from == self.kept {
                (self.from, self.kept, self.filled) = (0, 0, 0);
                self.is_data = false;
            }
        }
    }

    /// Encrypts as much of `data` as a record takes, once nothing is [`Connection::pending`]; how
    /// many bytes of it.
    ///
    /// # Errors
    /// [`TlsError::Unusable`] when the connection is not open or something is pending.
    pub fn say(&mut self, data: &[u8]) -> Result<usize, TlsError> {
        if !self.is_open() || self.out_to > 0 {
            return Err(TlsError::Unusable);
        }
        if self.update_due {
            self.update_due = false;
            self.put(HANDSHAKE, &[KEY_UPDATE, 0, 0, 1, 0])?;
            self.write.as_mut().map_or(Ok(()), Keys::update)?;
        }
        let most = MOST.min(self.limit - 1).min(data.len());
        let (now, _) = data.split_at_checked(most).ok_or(TlsError::Unusable)?;
        if !now.is_empty() {
            self.put(DATA, now)?;
        }
        Ok(most)
    }

    /// Says good-bye.
    ///
    /// # Errors
    /// [`TlsError::Unusable`] when too much is pending.
    pub fn close(&mut self) -> Result<(), TlsError> {
        self.put(ALERT, &[WARNING, CLOSE_NOTIFY])
    }

    /// Puts a record into the output.
    pub(super) fn put(&mut self, kind: u8, content: &[u8]) -> Result<(), TlsError> {
        let out = self.buffers.output.get_mut(self.out_to..);
        let out = out.ok_or(TlsError::Unusable)?;
        self.out_to += if let Some(keys) = &mut self.write {
            keys.seal(kind, content, out)?
        } else {
            let total = HEADER + content.len();
            let record = out.get_mut(..total).ok_or(TlsError::Unusable)?;
            let (header, body) = record.split_at_mut(HEADER);
            header.copy_from_slice(&head(kind, content.len()));
            body.copy_from_slice(content);
            total
        };
        Ok(())
    }
}
