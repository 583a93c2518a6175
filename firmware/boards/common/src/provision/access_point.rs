//! What an access point owes its guests: an address, and an answer to every name.
//!
//! Addresses come from a pool of [`LEASES`], each lent for ten minutes, so that memory is bounded
//! whoever asks. Every name has the address of the board: that is how a phone finds the page.

use core::convert::Infallible;
use core::net::Ipv4Addr;

use crawler_hal::Clock;
use edge_dhcp::server::{Server, ServerOptions};
use edge_dhcp::{Options, Packet};
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{IpAddress, IpEndpoint, Ipv4Cidr, Stack, StaticConfigV4};

/// Address of the board on its own access point.
pub const ADDRESS: Ipv4Addr = Ipv4Addr::new(192, 168, 4, 1);
/// Guests that have an address at a time.
pub const LEASES: usize = 8;
/// First address that is lent.
const FIRST: Ipv4Addr = Ipv4Addr::new(192, 168, 4, 10);
/// Last address that is lent.
const LAST: Ipv4Addr = Ipv4Addr::new(192, 168, 4, 10 + LEASES as u8 - 1);
/// For how long. Guests are here for minutes.
const LENT_FOR_S: u32 = 600;
/// Longest datagram that is read or written: the least that every DHCP client takes (RFC 2131,
/// section 2), and more than DNS over UDP has (RFC 1035, section 2.3.4).
pub const DATAGRAM: usize = 576;

const DHCP_SERVER: u16 = 67;
const DHCP_CLIENT: u16 = 68;
const DNS: u16 = 53;

/// The addresses of the access point's network, for its stack.
#[must_use]
pub fn configuration() -> StaticConfigV4 {
    StaticConfigV4 {
        address: Ipv4Cidr::new(ADDRESS, 24),
        gateway: None,
        dns_servers: heapless::Vec::new(),
    }
}

/// The addresses that are lent.
pub struct Lender<F>(Server<F, LEASES>);

impl<F> core::fmt::Debug for Lender<F> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Lender")
            .field("lent", &self.0.leases.len())
            .finish()
    }
}

impl<F: FnMut() -> u64> Lender<F> {
    /// Nothing lent yet; `now` tells seconds.
    pub const fn new(now: F) -> Self {
        let mut server = Server::new(now, ADDRESS);
        server.range_start = FIRST;
        server.range_end = LAST;
        Self(server)
    }

    /// Answers a request: the part of `out` to send, and where to. `None` for what needs no
    /// answer or makes no sense.
    pub fn answer<'o>(
        &mut self,
        request: &[u8],
        out: &'o mut [u8; DATAGRAM],
    ) -> Option<(&'o [u8], Ipv4Addr)> {
        let request = Packet::decode(request).ok()?;
        let mut gateway = [ADDRESS];
        let mut terms = ServerOptions::new(ADDRESS, Some(&mut gateway));
        let names = [ADDRESS];
        terms.dns = &names;
        terms.lease_duration_secs = LENT_FOR_S;
        let mut fields = Options::buf();
        let reply = self.0.handle_request(&mut fields, &terms, &request)?;
        // Who has an address is told there; anyone else hears what is said to all. There are no
        // relays here.
        let has_address = !request.ciaddr.is_unspecified() && !request.broadcast;
        let to = if has_address {
            request.ciaddr
        } else {
            Ipv4Addr::BROADCAST
        };
        reply.encode(out).ok().map(|bytes| (bytes, to))
    }

    /// Addresses lent at present.
    pub fn lent(&self) -> usize {
        self.0.leases.len()
    }
}

/// Length of the head of a DNS message.
const DNS_HEAD: usize = 12;
/// For how long a phone may remember where a name is: it goes back to other networks soon.
const NAME_FOR_S: u32 = 5;

/// Answers a DNS query: every name is at `address`. Returns the length of the answer, `None` for
/// what needs none (RFC 1035, section 4).
pub fn answer_name(query: &[u8], address: Ipv4Addr, out: &mut [u8; DATAGRAM]) -> Option<usize> {
    const IS_ANSWER: u8 = 0x80;
    const OPCODE: u8 = 0x78;
    const WANTS_RECURSION: u8 = 0x01;
    const AUTHORITATIVE: u8 = 0x04;
    const FORMAT_ERROR: u8 = 1;
    const NOT_IMPLEMENTED: u8 = 4;

    let head = query.first_chunk::<DNS_HEAD>()?;
    if head[2] & IS_ANSWER != 0 {
        return None;
    }
    let question = question_end(query).filter(|_| head[4..6] == [0, 1]);
    let (error, question) = match question {
        _ if head[2] & OPCODE != 0 => (NOT_IMPLEMENTED, None),
        None => (FORMAT_ERROR, None),
        Some(end) => (0, Some(&query[DNS_HEAD..end])),
    };
    let mut answer = heapless::Vec::<u8, DATAGRAM>::new();
    let mut put = |bytes: &[u8]| answer.extend_from_slice(bytes).ok();
    let flags = IS_ANSWER | head[2] & (OPCODE | WANTS_RECURSION) | AUTHORITATIVE;
    // Any name is an IPv4 address of the internet, and nothing else.
    let found = question.is_some_and(|question| question.ends_with(&[0, 1, 0, 1]));
    put(&[head[0], head[1], flags, error])?;
    put(&[
        0,
        u8::from(question.is_some()),
        0,
        u8::from(found),
        0,
        0,
        0,
        0,
    ])?;
    put(question.unwrap_or_default())?;
    if found {
        // The name stands behind the head; type A, class IN.
        put(&[0xC0, DNS_HEAD as u8, 0, 1, 0, 1])?;
        put(&NAME_FOR_S.to_be_bytes())?;
        put(&[0, 4])?;
        put(&address.octets())?;
    }
    out[..answer.len()].copy_from_slice(&answer);
    Some(answer.len())
}

/// Where the first question of a query ends: a name of plain labels, type and class.
fn question_end(query: &[u8]) -> Option<usize> {
    const LONGEST_NAME: usize = 255;
    let mut at = DNS_HEAD;
    loop {
        match *query.get(at)? {
            0 => break,
            // Anything longer would be a pointer, and a question has nothing to point to.
            length @ 1..=63 => at += 1 + usize::from(length),
            _ => return None,
        }
        if at - DNS_HEAD > LONGEST_NAME {
            return None;
        }
    }
    let end = at + 1 + 4;
    (end <= query.len()).then_some(end)
}

/// Memory of one of the two services.
#[derive(Debug)]
pub struct Datagrams {
    receive: [u8; 2 * DATAGRAM],
    transmit: [u8; DATAGRAM],
    metadata: [PacketMetadata; 4],
    request: [u8; DATAGRAM],
    answer: [u8; DATAGRAM],
}

impl Datagrams {
    /// Memory of one service.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            receive: [0; 2 * DATAGRAM],
            transmit: [0; DATAGRAM],
            metadata: [PacketMetadata::EMPTY; 4],
            request: [0; DATAGRAM],
            answer: [0; DATAGRAM],
        }
    }
}

impl Default for Datagrams {
    fn default() -> Self {
        Self::new()
    }
}

/// Lends addresses to whoever asks. Needs one UDP socket of `stack`.
///
/// # Cancellation Safety
/// Forgets what it has lent: guests ask again.
pub async fn lend<C: Clock>(stack: Stack<'_>, clock: &C, memory: &mut Datagrams) -> Infallible {
    let mut lender = Lender::new(|| clock.now().as_micros() / 1_000_000);
    respond(stack, DHCP_SERVER, memory, |request, _, out| {
        let (answer, to) = lender.answer(request, out)?;
        let to = IpEndpoint::new(IpAddress::Ipv4(to), DHCP_CLIENT);
        Some((answer.len(), to))
    })
    .await
}

/// Answers names. Needs one UDP socket of `stack`.
///
/// # Cancellation Safety
/// Keeps nothing.
pub async fn name(stack: Stack<'_>, memory: &mut Datagrams) -> Infallible {
    respond(stack, DNS, memory, |query, from, out| {
        answer_name(query, ADDRESS, out).map(|length| (length, from))
    })
    .await
}

/// Answers the datagrams that arrive at `port`, one after the other.
async fn respond(
    stack: Stack<'_>,
    port: u16,
    memory: &mut Datagrams,
    mut answer: impl FnMut(&[u8], IpEndpoint, &mut [u8; DATAGRAM]) -> Option<(usize, IpEndpoint)>,
) -> Infallible {
    let Datagrams {
        receive,
        transmit,
        metadata,
        request,
        answer: out,
    } = memory;
    let (receive_metadata, transmit_metadata) = metadata.split_at_mut(2);
    let mut socket = UdpSocket::new(
        stack,
        receive_metadata,
        receive,
        transmit_metadata,
        transmit,
    );
    // The only service on this port, and not 0: it is free.
    let _ = socket.bind(port);
    loop {
        // What is longer than any request is dropped.
        let Ok((length, from)) = socket.recv_from(request).await else {
            continue;
        };
        if let Some((length, to)) = answer(&request[..length], from.endpoint, out) {
            // Nobody waits for an answer that cannot be sent now: they ask again.
            let _ = socket.send_to(&out[..length], to).await;
        }
    }
}
