//! A recorded handshake of TLS, played to the client of the program.

use core::convert::Infallible;

use crawler_tls::{Authority, Buffers, Connection, Expected, Step};
use rand_core::{TryCryptoRng, TryRng};

use super::{count, fail, tell};

/// What a server said to a client that drew these numbers, behind the key of its authority.
const HANDSHAKE: &[u8] = include_bytes!("../../../../../tls/src/tests/handshake.bin");

/// One after the other, as when it was recorded.
struct Counting(u8);

impl TryRng for Counting {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        let mut bytes = [0; 4];
        self.try_fill_bytes(&mut bytes)?;
        Ok(u32::from_le_bytes(bytes))
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        let mut bytes = [0; 8];
        self.try_fill_bytes(&mut bytes)?;
        Ok(u64::from_le_bytes(bytes))
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        for byte in bytes {
            self.0 = self.0.wrapping_add(1);
            *byte = self.0;
        }
        Ok(())
    }
}

impl TryCryptoRng for Counting {}

/// A handshake of TLS: all of it, and its longest piece, for which other activities wait; then a
/// record of telemetry.
pub(super) fn measure() {
    let authority = HANDSHAKE.first_chunk().map(|bytes| Authority::new(*bytes));
    let Some(Ok(authority)) = authority else {
        fail("no authority")
    };
    let mut said = HANDSHAKE.get(33..).unwrap_or_default();
    let expected = Expected {
        host: "broker.lan",
        authority,
        now: Some(1_798_761_600),
    };
    let mut buffers = Buffers::new();
    let (mut total, started) =
        count(|| Connection::start(&mut buffers, &expected, &mut Counting(0)));
    let mut longest = total;
    let Ok(mut client) = started else {
        fail("no hello")
    };
    client.sent(client.pending().len());
    while !client.is_open() {
        let (instructions, step) = count(|| client.shake(&expected));
        total += instructions;
        longest = longest.max(instructions);
        match step {
            Ok(Step::Hungry) => {
                let Ok(space) = client.space() else {
                    fail("a record is too big")
                };
                let (now, later) = said.split_at(space.len().min(said.len()));
                if now.is_empty() {
                    fail("the handshake is not all there");
                }
                space[..now.len()].copy_from_slice(now);
                said = later;
                client.received(now.len());
            }
            Ok(_) => {}
            Err(error) => fail(error.reason()),
        }
    }
    tell("tls_handshake", total);
    tell("tls_longest_step", longest);
    client.sent(client.pending().len());
    let (instructions, sealed) = count(|| client.say(&[0x20; 256]));
    if sealed != Ok(256) {
        fail("a record does not fit");
    }
    tell("tls_record_256", instructions);
}
