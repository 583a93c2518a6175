//! The protocol without input and output.

mod data;

use rand_core::CryptoRng;

use crate::error::TlsError;
use crate::expected::Expected;
use crate::handshake::{Handshake, Outcome, check_ticket};
use crate::record::{ALERT, CHANGE_CIPHER_SPEC, DATA, HANDSHAKE, HEADER, Keys, OVERHEAD, head};
use crate::sizes::{INPUT, OUTPUT};

/// Content of our records, beside a change of keys.
const MOST: usize = OUTPUT - OVERHEAD - KEY_UPDATE_RECORD;
const KEY_UPDATE_RECORD: usize = OVERHEAD + 5;
/// Records in a row that may bring nothing: tickets, changes of keys, emptiness.
const MOST_IDLE: u8 = 32;

const NEW_SESSION_TICKET: u8 = 4;
const KEY_UPDATE: u8 = 24;
const CLOSE_NOTIFY: u8 = 0;
const USER_CANCELED: u8 = 90;
const WARNING: u8 = 1;
const FATAL: u8 = 2;

/// Memory of a connection; see [`INPUT`] and [`OUTPUT`].
pub struct Buffers {
    input: [u8; INPUT],
    output: [u8; OUTPUT],
}

impl Buffers {
    /// Memory, for one connection at a time.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            input: [0; INPUT],
            output: [0; OUTPUT],
        }
    }
}

impl Default for Buffers {
    fn default() -> Self {
        Self::new()
    }
}

impl core::fmt::Debug for Buffers {
    /// Tells nothing of what is said.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Buffers").finish_non_exhaustive()
    }
}

/// What [`Connection::step`] came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// More bytes are needed: [`Connection::space`].
    Hungry,
    /// Something was done; there may be more to do. A message of the handshake can take some
    /// fifteen million instructions: others may want their turn.
    Worked,
    /// There is [`Connection::plaintext`].
    Data,
    /// The server has said good-bye; nothing will come any more.
    Ended,
}

// Of which the one is over soon, and there is one connection at a time.
#[allow(clippy::large_enum_variant)]
enum Phase {
    Handshake(Handshake),
    Open,
}

/// A connection. Bytes of the stream go in by [`Connection::space`] and [`Connection::received`],
/// and come out by [`Connection::pending`] and [`Connection::sent`].
///
/// After an error it must be given up: what is [`Connection::pending`] then is an alert for the
/// server.
pub struct Connection<'b> {
    buffers: &'b mut Buffers,
    phase: Phase,
    read: Option<Keys>,
    write: Option<Keys>,
    /// Input from here to `kept` is plaintext: of messages, or data when the next is set.
    from: usize,
    kept: usize,
    is_data: bool,
    /// Input from `kept` to here is the beginning of a record.
    filled: usize,
    /// Output from here to there waits.
    out_from: usize,
    out_to: usize,
    /// Content and type of our records.
    limit: usize,
    idle: u8,
    ended: bool,
    /// The server asked for new keys.
    update_due: bool,
}

impl core::fmt::Debug for Connection<'_> {
    /// Tells nothing of keys and of what is said.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Connection")
            .field("open", &self.is_open())
            .field("ended", &self.ended)
            .finish_non_exhaustive()
    }
}

impl<'b> Connection<'b> {
    /// Begins: the first message is [`Connection::pending`]. Draws a key, which takes some ten
    /// million instructions. What is drawn from `rng` nobody may be able to guess.
    ///
    /// # Errors
    /// [`TlsError::Unusable`] when the host is neither a name nor an address.
    pub fn start(
        buffers: &'b mut Buffers,
        expected: &Expected<'_>,
        rng: &mut impl CryptoRng,
    ) -> Result<Self, TlsError> {
        let (header, message) = buffers
            .output
            .split_first_chunk_mut::<HEADER>()
            .ok_or(TlsError::Unusable)?;
        let (handshake, length) = Handshake::start(expected, rng, message)?;
        *header = head(HANDSHAKE, length);
        Ok(Self {
            buffers,
            phase: Phase::Handshake(handshake),
            read: None,
            write: None,
            from: 0,
            kept: 0,
            is_data: false,
            filled: 0,
            out_from: 0,
            out_to: HEADER + length,
            limit: MOST + 1,
            idle: 0,
            ended: false,
            update_due: false,
        })
    }

    /// Whether the server has proved who it is: only then is there anything to say and to hear.
    #[must_use]
    pub const fn is_open(&self) -> bool {
        matches!(self.phase, Phase::Open)
    }

    /// Bytes for the stream.
    #[must_use]
    pub fn pending(&self) -> &[u8] {
        let range = self.out_from..self.out_to;
        self.buffers.output.get(range).unwrap_or_default()
    }

    /// The stream has taken that many.
    pub fn sent(&mut self, count: usize) {
        self.out_from = self.out_to.min(self.out_from.saturating_add(count));
        if self.out_from == self.out_to {
            (self.out_from, self.out_to) = (0, 0);
        }
    }

    /// Where the next bytes of the stream belong. As many as the record under way still needs, so
    /// that what follows stays in the stream.
    ///
    /// # Errors
    /// [`TlsError::TooBig`] when the record does not fit.
    pub fn space(&mut self) -> Result<&mut [u8], TlsError> {
        let result = self.wanted();
        let wanted = self.tell(result)?;
        let end = self.filled + wanted;
        let space = self.buffers.input.get_mut(self.filled..end);
        space.ok_or(TlsError::TooBig)
    }

    /// That many have been put there.
    pub fn received(&mut self, count: usize) {
        self.filled = INPUT.min(self.filled.saturating_add(count));
    }

    /// The header of the record under way.
    fn header(&self) -> Option<[u8; HEADER]> {
        let record = self.buffers.input.get(self.kept..self.filled)?;
        record.first_chunk().copied()
    }

    /// How many bytes the record under way still needs.
    fn wanted(&self) -> Result<usize, TlsError> {
        let have = self.filled - self.kept;
        let whole = match self.header() {
            None => HEADER,
            Some([kind, _, _, high, low]) => {
                if !(CHANGE_CIPHER_SPEC..=DATA).contains(&kind) {
                    // Not TLS at all, most likely.
                    return Err(TlsError::Unexpected);
                }
                HEADER + usize::from(u16::from_be_bytes([high, low]))
            }
        };
        if self.kept + whole > INPUT {
            return Err(TlsError::TooBig);
        }
        Ok(whole.saturating_sub(have))
    }

    /// Does the next piece of the handshake that the input allows.
    ///
    /// # Errors
    /// See [`TlsError`].
    pub fn shake(&mut self, expected: &Expected<'_>) -> Result<Step, TlsError> {
        self.work(Some(expected))
    }

    /// Does the next piece of work that the input allows, once the connection is open.
    ///
    /// # Errors
    /// See [`TlsError`]; [`TlsError::Unusable`] for a handshake that is not over.
    pub fn step(&mut self) -> Result<Step, TlsError> {
        self.work(None)
    }

    fn work(&mut self, expected: Option<&Expected<'_>>) -> Result<Step, TlsError> {
        if self.ended {
            return Ok(Step::Ended);
        }
        let result = self.try_step(expected);
        self.tell(result)
    }

    /// Leaves an alert for the server where something is wrong.
    fn tell<T>(&mut self, result: Result<T, TlsError>) -> Result<T, TlsError> {
        if let Err(error) = &result
            && !self.ended
        {
            self.ended = true;
            if let Some(code) = error.alert() {
                // Whoever cannot be told finds out by the end of the stream.
                let _ = self.put(ALERT, &[FATAL, code]);
            }
        }
        result
    }

    fn try_step(&mut self, expected: Option<&Expected<'_>>) -> Result<Step, TlsError> {
        if self.is_data {
            return Ok(Step::Data);
        }
        if let Some(length) = self.message()? {
            let end = self.from + length;
            self.take_message(end, expected)?;
            self.from = end;
            if self.from == self.kept {
                (self.from, self.kept, self.filled) = (0, 0, 0);
            }
            return Ok(Step::Worked);
        }
        self.make_room();
        if self.header().is_none() || self.wanted()? > 0 {
            return Ok(Step::Hungry);
        }
        self.take_record()?;
        Ok(Step::Worked)
    }

    /// Length of the message in the plaintext, when it is there as a whole.
    fn message(&self) -> Result<Option<usize>, TlsError> {
        let kept = self.buffers.input.get(self.from..self.kept);
        let Some([_, a, b, c]) = kept.and_then(|kept| kept.first_chunk()) else {
            return Ok(None);
        };
        let length = 4 + u32::from_be_bytes([0, *a, *b, *c]) as usize;
        // A record of one byte at least has to fit behind what is there of it.
        if length > INPUT - OVERHEAD {
            return Err(TlsError::TooBig);
        }
        Ok((length <= self.kept - self.from).then_some(length))
    }

    /// Moves what there is of a message to the front.
    fn make_room(&mut self) {
        if self.from > 0 {
            self.buffers.input.copy_within(self.from..self.filled, 0);
            self.kept -= self.from;
            self.filled -= self.from;
            self.from = 0;
        }
    }

    fn take_message(
        &mut self,
        end: usize,
        expected: Option<&Expected<'_>>,
    ) -> Result<(), TlsError> {
        let whole = self.buffers.input.get(self.from..end);
        let whole = whole.ok_or(TlsError::Malformed)?;
        // Keys change between records (section 5.1).
        let last = end == self.kept;
        let Phase::Handshake(handshake) = &mut self.phase else {
            return match whole {
                [NEW_SESSION_TICKET, ..] => check_ticket(whole),
                [KEY_UPDATE, 0, 0, 1, asked @ 0..=1] if last => {
                    self.update_due |= *asked == 1;
                    self.read.as_mut().map_or(Ok(()), Keys::update)
                }
                [KEY_UPDATE, 0, 0, 1, _] if last => Err(TlsError::Malformed),
                _ => Err(TlsError::Unexpected),
            };
        };
        let expected = expected.ok_or(TlsError::Unusable)?;
        match handshake.message(whole, expected)? {
            Outcome::Next => {}
            Outcome::Limit(limit) => self.limit = self.limit.min(limit.into()),
            _ if !last => return Err(TlsError::Unexpected),
            Outcome::Encrypted { read, write } => {
                (self.read, self.write) = (Some(read), Some(write));
            }
            Outcome::Done {
                last,
                length,
                read,
                write,
            } => {
                self.put(HANDSHAKE, last.get(..length).unwrap_or_default())?;
                (self.read, self.write) = (Some(read), Some(write));
                self.phase = Phase::Open;
            }
        }
        self.idle = 0;
        Ok(())
    }

    /// Takes the record, and counts those that bring nothing.
    fn take_record(&mut self) -> Result<(), TlsError> {
        self.idle = if self.open_record()? {
            0
        } else {
            self.idle + 1
        };
        if self.idle > MOST_IDLE {
            return Err(TlsError::Flood);
        }
        Ok(())
    }

    /// Puts the content of the record behind the plaintext; whether it brings anything on.
    fn open_record(&mut self) -> Result<bool, TlsError> {
        let (kept, filled) = (self.kept, self.filled);
        // What comes of it is set below; the record is used up in any case.
        self.filled = kept;
        let record = self.buffers.input.get_mut(kept..filled);
        let (header, body) = record
            .and_then(|record| record.split_first_chunk_mut::<HEADER>())
            .ok_or(TlsError::Malformed)?;
        let [outer, ..] = *header;
        let encrypted = self.read.is_some();
        let open = matches!(self.phase, Phase::Open);
        if outer == CHANGE_CIPHER_SPEC {
            // Means nothing, and may stand in a handshake once the server has been heard.
            let expected = match &self.phase {
                Phase::Handshake(handshake) => handshake.is_encrypted(),
                Phase::Open => false,
            };
            let fits = expected && body == [1] && self.from == self.kept;
            return if fits {
                Ok(false)
            } else {
                Err(TlsError::Unexpected)
            };
        }
        let (kind, length) = match &mut self.read {
            Some(keys) if outer == DATA => keys.open(*header, body)?,
            None if outer != DATA => (outer, body.len()),
            _ => return Err(TlsError::Unexpected),
        };
        let content = body.get(..length).ok_or(TlsError::Malformed)?;
        // Nothing comes between the parts of a message (section 5.1).
        if kind != HANDSHAKE && self.from != self.kept {
            return Err(TlsError::Unexpected);
        }
        match (kind, content) {
            (ALERT, [_, CLOSE_NOTIFY]) if encrypted => {
                self.ended = true;
                // Before the server has proved who it is that is no good-bye.
                return if open {
                    Ok(true)
                } else {
                    Err(TlsError::Closed)
                };
            }
            (ALERT, [WARNING, USER_CANCELED]) => return Ok(false),
            (ALERT, [_, code]) => {
                self.ended = true;
                return Err(TlsError::Alert(*code));
            }
            (HANDSHAKE, [_, ..]) => {}
            (DATA, _) if open => self.is_data = length > 0,
            _ => return Err(TlsError::Unexpected),
        }
        let from = kept + HEADER;
        self.buffers.input.copy_within(from..from + length, kept);
        self.kept += length;
        self.filled = self.kept;
        // A message of many small records is bounded by its length.
        Ok(self.is_data || kind == HANDSHAKE && !open)
    }
}
