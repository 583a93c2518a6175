//! A byte stream with a small buffer in each direction.
//!
//! The MQTT client writes a packet in seven or eight pieces and reads headers byte by byte. On a
//! board each piece would cost a pass through the network stack, on a host a system call.

use embedded_io_async::{ErrorType, Read, Write};

use crate::hold::{Hold, Room};

/// Bytes gathered before they are written: a telemetry message with its topic.
pub(super) const WRITE_BUFFER: usize = 512;
/// Bytes read at once: some acknowledgements, or all of a message but its payload. Longer pieces
/// are read to where they belong.
pub(super) const READ_BUFFER: usize = 64;

/// See the [module](self).
pub(super) struct Buffered<S, H: Hold> {
    stream: S,
    /// Entered while something is gathered.
    output: H::Room<[u8; WRITE_BUFFER]>,
    gathered: usize,
    input: [u8; READ_BUFFER],
    read_from: usize,
    read_to: usize,
    /// The stream took nothing once: it has ended, which only `write` and `read` can say.
    ended: bool,
}

impl<S, H: Hold> Buffered<S, H> {
    pub(super) const fn new(stream: S) -> Self {
        Self {
            stream,
            output: Room::EMPTY,
            gathered: 0,
            input: [0; READ_BUFFER],
            read_from: 0,
            read_to: 0,
            ended: false,
        }
    }
}

impl<S: Write, H: Hold> Buffered<S, H> {
    async fn write_out(&mut self) -> Result<(), S::Error> {
        let mut written = 0;
        while written < self.gathered {
            let output = self.output.enter();
            match self.stream.write(&output[written..self.gathered]).await? {
                0 => {
                    self.ended = true;
                    break;
                }
                n => written += n,
            }
        }
        self.gathered = 0;
        self.output.leave();
        Ok(())
    }
}

impl<S: ErrorType, H: Hold> ErrorType for Buffered<S, H> {
    type Error = S::Error;
}

impl<S: Write, H: Hold> Write for Buffered<S, H> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, S::Error> {
        if bytes.len() > WRITE_BUFFER - self.gathered {
            self.write_out().await?;
        }
        if self.ended {
            return Ok(0);
        }
        if bytes.len() >= WRITE_BUFFER {
            return self.stream.write(bytes).await;
        }
        let output = self.output.enter();
        output[self.gathered..self.gathered + bytes.len()].copy_from_slice(bytes);
        self.gathered += bytes.len();
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), S::Error> {
        self.write_out().await?;
        self.stream.flush().await
    }
}

impl<S: Read, H: Hold> Read for Buffered<S, H> {
    /// As cancel-safe as the stream beneath: bytes are taken over only after it has returned.
    async fn read(&mut self, bytes: &mut [u8]) -> Result<usize, S::Error> {
        if self.read_from == self.read_to {
            if self.ended {
                return Ok(0);
            }
            if bytes.len() >= READ_BUFFER {
                return self.stream.read(bytes).await;
            }
            let count = self.stream.read(&mut self.input).await?;
            (self.read_from, self.read_to) = (0, count.min(READ_BUFFER));
        }
        let count = bytes.len().min(self.read_to - self.read_from);
        bytes[..count].copy_from_slice(&self.input[self.read_from..self.read_from + count]);
        self.read_from += count;
        Ok(count)
    }
}
