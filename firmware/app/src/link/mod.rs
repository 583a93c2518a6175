//! The link activity: network, MQTT session, and what travels over it.
//!
//! One session at a time, and every wait has a deadline:
//!
//! | wait | at most | then |
//! |---|---|---|
//! | joining the network | [`JOINED_WITHIN`] | back-off |
//! | opening the stream, CONNACK | [`OPENED_WITHIN`] each | back-off |
//! | subscriptions confirmed | [`SUBSCRIBED_WITHIN`] | back-off |
//! | writing one packet, reading the rest of one | [`WRITTEN_WITHIN`] | link lost |
//! | silence of the broker | ping after [`PING_AFTER`], lost after [`LOST_AFTER`] | link lost |
//! | a place for a chunk of a release | [`ROOM_WITHIN`] | the chunks that come are dropped |
//! | PUBACK | [`ACKNOWLEDGED_WITHIN`] | link lost: MQTT allows to send again only on a new connection |
//!
//! Whatever keeps the robot from its broker has a name ([`LinkTrouble`](crate::trouble::LinkTrouble)), a log record that waits
//! until there is a session again, and a pattern of the lamp.
//!
//! Link lost means that control knows it at once ([`LinkHealth::Lost`]). From the last byte of
//! the broker that takes at most [`LOST_AFTER`] and a write of up to a second, which together
//! stay below one and a half times [`KEEP_ALIVE`].
//!
//! The connection is dropped, never closed politely, so the broker publishes the last will (the
//! retained status, `"online": false`) and keeps the session for [`SESSION_EXPIRY`]. After a
//! reconnection the subscriptions are made again; if the broker kept the session, what it has
//! not acknowledged is sent again under its old number, else everything in the outbox is sent
//! anew. The first session after boot is always a new one: commands queued for a program that
//! has since restarted are not for this one.
//!
//! Retained commands are not asked for. What a session queued for a robot that was away arrives
//! late, and meets the clock at intake like anything else; a late `stop` still stops.
//!
//! Memory: samples of telemetry that wait for others 1,024 bytes, the packet that arrives, or the message to be sent, 1,390 bytes, write and read buffers
//! 576, session and client a few hundred; with what the compiler keeps of each step the future of
//! [`link`] measures about 6 KB on a 64-bit host over a plain socket, unoptimised. Outbox and
//! intake in the shared context add 2.2 and 0.8 KB. Kept elsewhere ([`Hold`]), packet, write buffer
//! and the rarer steps take memory only while they are in use.

mod backoff;
mod batch;
mod buffered;
mod cells;
mod connection;
mod flow;
mod images;
mod limits;
mod loss;
mod messages;
mod packet;
mod session;

#[cfg(test)]
mod tests;

use core::cell::RefCell;
use core::convert::Infallible;
use core::num::NonZero;
use core::ops::Deref;
use core::pin::pin;

use crawler_hal::{Clock, Duration, Network, with_deadline};
use crawler_protocol::{Level, MAX_MESSAGE, Topic};
use embassy_sync::blocking_mutex::raw::RawMutex;
use rand_core::Rng;
use rust_mqtt::client::options::{ConnectOptions, WillOptions};
use rust_mqtt::config::{KeepAlive, SessionExpiryInterval};
use rust_mqtt::types::{MqttBinary, MqttString, ReasonCode, TopicName};

use crate::camera::ImageSlot;
use crate::context::Robot;
use crate::hold::{Hold, Inline};
use crate::perception::LinkHealth;
use crate::trouble::LINK_LOST;
use crate::update::{NoUpdates, UpdatePort, Updates};

use backoff::Backoff;
pub use backoff::{
    LONGEST, REFUSED, SHORTEST, STABLE_AFTER, SUSPICIOUS, TAKEN_OVER, TAKEN_OVER_LONGEST,
};
pub use batch::BATCH_AGE;
use batch::Batch;
use buffered::Buffered;
use connection::{Connection, Counters, Mqtt, State};
use flow::Flow;
use images::{FromSlot, Images, NoImages};
pub use limits::{
    ACKNOWLEDGED_WITHIN, HEARTBEAT_PERIOD, JOINED_WITHIN, KEEP_ALIVE, LOST_AFTER, OPENED_WITHIN,
    PING_AFTER, ROOM_WITHIN, SESSION_EXPIRY, SUBSCRIBED_WITHIN, WRITTEN_WITHIN,
};
use loss::Loss;
use packet::{BufferLender, MAX_PACKET, PacketBuffer};

/// Everything that outlives a connection, lent to it. Held together by value it would be built on
/// the stack before it is moved to where it lives.
struct Kept<'k, H: Hold> {
    packet: &'k RefCell<PacketBuffer<H>>,
    flow: &'k mut Flow,
    counters: &'k mut Counters,
    batch: &'k mut Batch<H>,
}

/// Keeps the robot connected. Never returns.
///
/// # Cancellation Safety
/// Dropping the future drops the connection: the broker publishes the last will.
pub fn link<M: RawMutex, N: Network, R: Rng, C: Clock>(
    robot: impl Deref<Target = Robot<M>>,
    network: N,
    rng: R,
    clock: C,
) -> impl Future<Output = Infallible> {
    link_held::<Inline, M, N, R, C>(robot, network, rng, clock)
}

/// As [`link()`], with its rare steps kept as `H` keeps them.
///
/// # Cancellation Safety
/// As [`link()`].
pub fn link_held<H: Hold, M: RawMutex, N: Network, R: Rng, C: Clock>(
    robot: impl Deref<Target = Robot<M>>,
    network: N,
    rng: R,
    clock: C,
) -> impl Future<Output = Infallible> {
    run::<H, M, N, R, C>(robot, NoImages, &NoUpdates, network, rng, clock)
}

/// The same for a robot whose program can be replaced: carries what [`update()`](crate::update()) and the server say
/// to each other.
///
/// # Cancellation Safety
/// As [`link()`].
pub fn link_with_updates_held<
    H: Hold,
    M: RawMutex,
    N: Network,
    R: Rng,
    C: Clock,
    const MODELS: usize,
>(
    robot: impl Deref<Target = Robot<M>>,
    updates: impl Deref<Target = Updates<M, MODELS>>,
    network: N,
    rng: R,
    clock: C,
) -> impl Future<Output = Infallible> {
    run::<H, M, N, R, C>(robot, NoImages, updates, network, rng, clock)
}

/// The same for a body with a camera: delivers the images that [`camera()`](crate::camera())
/// leaves in `images`.
///
/// # Cancellation Safety
/// As [`link()`]; an image on its way is lost, and its buffer with it.
pub fn link_with_images<M: RawMutex, B: AsRef<[u8]>, N: Network, R: Rng, C: Clock>(
    robot: impl Deref<Target = Robot<M>>,
    images: &ImageSlot<M, B>,
    network: N,
    rng: R,
    clock: C,
) -> impl Future<Output = Infallible> {
    link_with_images_held::<Inline, M, B, N, R, C>(robot, images, network, rng, clock)
}

/// As [`link_with_images()`], with its rare steps kept as `H` keeps them.
///
/// # Cancellation Safety
/// As [`link_with_images()`].
pub fn link_with_images_held<H: Hold, M: RawMutex, B: AsRef<[u8]>, N: Network, R: Rng, C: Clock>(
    robot: impl Deref<Target = Robot<M>>,
    images: &ImageSlot<M, B>,
    network: N,
    rng: R,
    clock: C,
) -> impl Future<Output = Infallible> {
    run::<H, M, N, R, C>(
        robot,
        FromSlot::new(images),
        &NoUpdates,
        network,
        rng,
        clock,
    )
}

/// [`link_with_images_held()`] and [`link_with_updates_held()`] in one.
///
/// # Cancellation Safety
/// As [`link_with_images()`].
pub fn link_with_images_and_updates_held<
    H: Hold,
    M: RawMutex,
    B: AsRef<[u8]>,
    N: Network,
    R: Rng,
    C: Clock,
    const MODELS: usize,
>(
    robot: impl Deref<Target = Robot<M>>,
    images: &ImageSlot<M, B>,
    updates: impl Deref<Target = Updates<M, MODELS>>,
    network: N,
    rng: R,
    clock: C,
) -> impl Future<Output = Infallible> {
    run::<H, M, N, R, C>(robot, FromSlot::new(images), updates, network, rng, clock)
}

// Not an `async fn`, which would keep its arguments twice: as they came and as they are used.
#[allow(clippy::manual_async_fn)]
fn run<H: Hold, M: RawMutex, N: Network, R: Rng, C: Clock>(
    robot: impl Deref<Target = Robot<M>>,
    mut images: impl Images,
    updates: impl Deref<Target: UpdatePort + Sized>,
    mut network: N,
    mut rng: R,
    clock: C,
) -> impl Future<Output = Infallible> {
    async move {
        let robot = &*robot;
        let updates: &dyn UpdatePort = &*updates;
        let packet = RefCell::new(PacketBuffer::<H>::new());
        let mut flow = Flow::new();
        let mut counters = Counters::default();
        let mut batch = Batch::<H>::new();
        let mut backoff = Backoff::new();
        let mut told = None;
        loop {
            let kept = Kept {
                packet: &packet,
                flow: &mut flow,
                counters: &mut counters,
                batch: &mut batch,
            };
            let besides = (&mut images as &mut dyn Images, updates);
            let ended = attempt::<H, M, N, C>(robot, &mut network, &clock, kept, besides).await;
            let Ended {
                loss,
                up_since,
                forgotten,
            } = ended;
            if forgotten {
                backoff.session_forgotten();
            }
            let now = clock.now();
            let lasted = up_since.map_or(Duration::ZERO, |since| now - since);
            let wait = match loss {
                Loss::TakenOver => {
                    // The session is another's now.
                    flow.session = None;
                    backoff.after_takeover(&mut rng)
                }
                Loss::Broken if up_since.is_some() => backoff.after_close(lasted, &mut rng),
                _ if loss.is_refusal() => backoff.after_refusal(&mut rng),
                _ => backoff.after_loss(lasted, &mut rng),
            };
            let double = if backoff.suspects_double() {
                ", perhaps by another robot with this id"
            } else {
                ""
            };
            let text = format_args!("{loss}{double}; next attempt in {} ms", wait.as_millis());
            let trouble = loss.trouble();
            if up_since.is_some() {
                robot.link_handle().set_health(LinkHealth::Lost);
                told = None;
                robot.log(Level::Warn, LINK_LOST, text, now);
            } else if told != Some(trouble) || loss.is_refusal() {
                // The others of one outage would say the same.
                told = Some(trouble);
                robot.log(Level::Warn, trouble.event(), text, now);
            }
            robot.link_handle().set_trouble(Some(trouble));
            robot.outbox.rewind_logs();
            packet.borrow_mut().discard();
            batch.discard();
            clock.sleep(wait).await;
        }
    }
}

/// How a connection ended.
struct Ended {
    loss: Loss,
    /// Since when it had been up, if it had.
    up_since: Option<crawler_hal::Instant>,
    /// The broker did not know the session that was to go on.
    forgotten: bool,
}

/// One connection, to its end.
async fn attempt<H: Hold, M: RawMutex, N: Network, C: Clock>(
    robot: &Robot<M>,
    network: &mut N,
    clock: &C,
    kept: Kept<'_, H>,
    (images, updates): (&mut dyn Images, &dyn UpdatePort),
) -> Ended {
    let monitor = network.monitor();
    let stream = match H::hold(open(robot, network, clock)).await {
        Ok(stream) => stream,
        Err(loss) => {
            return Ended {
                loss,
                up_since: None,
                forgotten: false,
            };
        }
    };
    // In one place for the life of the connection: it is lent, not moved.
    let mut stream = Buffered::new(stream);
    let Kept {
        packet,
        flow,
        counters,
        batch,
    } = kept;
    let mut lender = BufferLender(packet);
    let clean = flow.session.is_none();
    let mut client: Mqtt<'_, _, H> = match flow.session.take() {
        Some(session) => Mqtt::with_session(session, &mut lender),
        None => Mqtt::new(&mut lender),
    };
    let connected = H::hold(connect(
        robot,
        updates,
        clock,
        &mut client,
        &mut stream,
        clean,
    ))
    .await;
    let mut connection = Connection {
        robot,
        clock,
        monitor: &monitor,
        client: &mut client,
        packet,
        flow,
        counters,
        images,
        updates,
        batch,
        state: State::new(clock.now()),
    };
    let loss = match connected {
        Ok(resumed) => match connection.serve(resumed).await {
            Ok(never) => match never {},
            Err(loss) => loss,
        },
        Err(loss) => loss,
    };
    let up_since = connection.state.up_since;
    flow.keep(client.session().clone(), clock.now());
    Ended {
        loss,
        up_since,
        forgotten: !clean && matches!(connected, Ok(false)),
    }
}

async fn open<'n, M: RawMutex, N: Network, C: Clock>(
    robot: &Robot<M>,
    network: &'n mut N,
    clock: &C,
) -> Result<N::Stream<'n>, Loss> {
    if let Some(how) = robot.injected.link(clock.now()) {
        return Err(Loss::injected(how));
    }
    with_deadline(clock, clock.now() + JOINED_WITHIN, network.join())
        .await
        .map_err(|_| Loss::Unjoined)??;
    let config = robot.config();
    let work = network.connect(&config.broker_host, config.broker_port);
    Ok(with_deadline(clock, clock.now() + OPENED_WITHIN, work).await??)
}

/// Whether the broker continues the session.
async fn connect<'c, H, M, C, S>(
    robot: &Robot<M>,
    updates: &dyn UpdatePort,
    clock: &C,
    client: &mut Mqtt<'c, S, H>,
    stream: &'c mut Buffered<S, H>,
    clean: bool,
) -> Result<bool, Loss>
where
    H: Hold,
    M: RawMutex,
    C: Clock,
    S: embedded_io_async::Read + embedded_io_async::Write,
{
    let config = robot.config();
    // Not in the packet: what the broker answers arrives there.
    let mut will = [0; MAX_MESSAGE];
    let len = messages::status(robot, updates, false, &mut will).ok_or(Loss::Unsupported)?;
    let topic = Topic::Status(config.id.clone());
    let will_topic = topic.render(&config.fleet);
    let will_topic = MqttString::from_str(&will_topic)
        .ok()
        .and_then(TopicName::new)
        .ok_or(Loss::Unsupported)?;
    let message = MqttBinary::from_slice(&will[..len]).map_err(|_| Loss::Unsupported)?;
    let mut options = ConnectOptions::new()
        .keep_alive(seconds(KEEP_ALIVE).map_or(KeepAlive::Infinite, KeepAlive::Seconds))
        .session_expiry_interval(
            seconds(SESSION_EXPIRY).map_or(SessionExpiryInterval::EndOnDisconnect, |s| {
                SessionExpiryInterval::Seconds(s.into())
            }),
        )
        .will(
            WillOptions::new(will_topic, message)
                .at_least_once()
                .retain(),
        );
    if let Some(size) = NonZero::new(MAX_PACKET as u32) {
        options = options.maximum_packet_size(size);
    }
    if clean {
        options = options.clean_start();
    }
    if let Some(credentials) = &config.credentials {
        // Text that MQTT cannot carry is one that no broker accepts.
        let unusable = Loss::Credentials(ReasonCode::BadUserNameOrPassword);
        let username = MqttString::from_str(&credentials.username).map_err(|_| unusable)?;
        let password =
            MqttBinary::from_slice(credentials.password.as_bytes()).map_err(|_| unusable)?;
        options = options.user_name(username).password(password);
    }
    let id = MqttString::from_str(config.id.as_str()).map_err(|_| Loss::Unsupported)?;
    let work = pin!(client.connect(stream, &options, Some(id)));
    let connected = with_deadline(clock, clock.now() + OPENED_WITHIN, work).await??;
    Ok(connected.session_present)
}

fn seconds(span: Duration) -> Option<NonZero<u16>> {
    u16::try_from(span.as_millis() / 1_000)
        .ok()
        .and_then(NonZero::new)
}
