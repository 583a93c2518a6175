//! The overhead camera of a live world as one more client of the broker.
//!
//! It publishes at QoS 0 and listens to the server's time, which fixes carry. The world hands it
//! what it sees through an [`Outlet`] that never waits: while there is no session, fixes are dropped,
//! and of each robot only the newest waits. A broker may cut off a client that floods it, so there is
//! a bound on how many go out, which large fleets share.

use std::cell::{Cell, RefCell, RefMut};
use std::collections::{BTreeMap, VecDeque};
use std::convert::Infallible;
use std::future::poll_fn;
use std::num::NonZero;
use std::rc::Rc;
use std::task::{Poll, Waker};

use crawler_app::Credentials;
use crawler_app::timesync::TimeSync;
use crawler_hal::{Clock, Duration, Instant, Network, with_deadline};
use crawler_protocol::{Fleet, Pose, RobotId, TimeMessage, Topic};
use embassy_futures::select::{Either3, select3};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_io_async::{ErrorType, Read, Write};
use rust_mqtt::Bytes;
use rust_mqtt::buffer::BufferProvider;
use rust_mqtt::client::Client;
use rust_mqtt::client::event::Event;
use rust_mqtt::client::options::{
    ConnectOptions, PublicationOptions, RetainHandling, SubscriptionOptions, TopicReference,
};
use rust_mqtt::config::KeepAlive;
use rust_mqtt::types::{MqttBinary, MqttString, TopicFilter, TopicName};

use super::pose_fix;
use crate::net::live::SecuredNetwork;
use crate::sched::SimClock;

/// Fixes that wait at most: one of each robot of the largest world.
const WAITING: usize = 10_000;
/// Time between two fixes in the long run. The embedded broker takes 500 messages a second of a
/// client.
const PACE: Duration = Duration::from_micros(2_500);
/// How much of that may be made up for: the clock of a live world wakes nobody more often than every
/// few milliseconds.
const CATCH_UP: Duration = Duration::from_millis(100);
/// Longest time for any one thing the broker is waited for.
const PATIENCE: Duration = Duration::from_secs(5);
/// Period of pings; fixes prove nothing to us, since the broker does not answer them.
const PING_PERIOD: Duration = Duration::from_secs(3);
/// Silence after which the session is given up.
const LOST_AFTER: Duration = Duration::from_secs(8);
/// Waits between two attempts.
const SHORTEST: Duration = Duration::from_millis(250);
const LONGEST: Duration = Duration::from_secs(8);
/// A session that lasted so long was a good one.
const STABLE_AFTER: Duration = Duration::from_secs(10);
/// Largest packet we take: time messages are far below.
const MAX_PACKET: u32 = 512;
/// What the client library is shown instead of a received field: text, as topics must be.
const DASHES: [u8; MAX_PACKET as usize] = [b'-'; MAX_PACKET as usize];

/// A robot as the camera saw it.
#[derive(Debug)]
struct Sighting {
    robot: RobotId,
    pose: Pose,
    at: Instant,
}

/// The hand-over of fixes from the world to the client.
#[derive(Debug, Default)]
pub(crate) struct Outlet {
    /// Robots in the order in which their turn comes.
    turns: RefCell<VecDeque<RobotId>>,
    newest: RefCell<BTreeMap<RobotId, (Pose, Instant)>>,
    open: Cell<bool>,
    waiting: RefCell<Option<Waker>>,
}

impl Outlet {
    /// Takes a sighting in place of an older one of the robot, or drops it when there is nowhere to
    /// put it.
    pub(crate) fn push(&self, robot: &RobotId, pose: Pose, at: Instant) {
        let mut newest = self.newest.borrow_mut();
        if !self.open.get() {
            return;
        }
        if let Some(known) = newest.get_mut(robot) {
            *known = (pose, at);
            return;
        }
        if newest.len() >= WAITING {
            return;
        }
        newest.insert(robot.clone(), (pose, at));
        self.turns.borrow_mut().push_back(robot.clone());
        if let Some(waker) = self.waiting.borrow_mut().take() {
            waker.wake();
        }
    }

    fn set_open(&self, open: bool) {
        self.open.set(open);
        self.turns.borrow_mut().clear();
        self.newest.borrow_mut().clear();
    }

    /// The next sighting. A dropped call takes none.
    async fn next(&self) -> Sighting {
        poll_fn(|cx| {
            let robot = self.turns.borrow_mut().pop_front();
            if let Some(robot) = robot
                && let Some((pose, at)) = self.newest.borrow_mut().remove(&robot)
            {
                return Poll::Ready(Sighting { robot, pose, at });
            }
            *self.waiting.borrow_mut() = Some(cx.waker().clone());
            Poll::Pending
        })
        .await
    }
}

/// The last field received: the payload, of a message. The library wants to lend out the memory of
/// a field for as long as the connection lives, which without `unsafe` would never be free again;
/// so it is lent something else of that length.
struct LastField<'a>(&'a RefCell<Vec<u8>>);

struct Field<'a>(RefMut<'a, Vec<u8>>);

/// The field is too long, or another one is being received.
#[derive(Debug)]
struct NoSpace;

impl AsMut<[u8]> for Field<'_> {
    fn as_mut(&mut self) -> &mut [u8] {
        &mut self.0
    }
}

impl<'a> From<Field<'a>> for Bytes<'a> {
    fn from(field: Field<'a>) -> Self {
        Bytes::Borrowed(&DASHES[..field.0.len()])
    }
}

impl<'a> BufferProvider<'a> for LastField<'a> {
    type Buffer = Field<'a>;
    type ProvisionError = NoSpace;

    fn provide_buffer(&mut self, len: usize) -> Result<Field<'a>, NoSpace> {
        if len > DASHES.len() {
            return Err(NoSpace);
        }
        let mut field = self.0.try_borrow_mut().map_err(|_| NoSpace)?;
        field.clear();
        field.resize(len, 0);
        Ok(Field(field))
    }
}

/// Gathers the pieces of a packet until it is flushed.
struct Gathered<S> {
    stream: S,
    output: Vec<u8>,
}

impl<S: ErrorType> ErrorType for Gathered<S> {
    type Error = S::Error;
}

impl<S: Read> Read for Gathered<S> {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, S::Error> {
        self.stream.read(buf).await
    }
}

impl<S: Write> Write for Gathered<S> {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, S::Error> {
        self.output.extend_from_slice(buf);
        Ok(buf.len())
    }

    async fn flush(&mut self) -> Result<(), S::Error> {
        let result = self.stream.write_all(&self.output).await;
        self.output.clear();
        result?;
        self.stream.flush().await
    }
}

/// Keeps the camera connected. Dropping the future drops the connection.
pub(crate) async fn run(
    fleet: Fleet,
    credentials: Option<Credentials>,
    outlet: Rc<Outlet>,
    mut network: SecuredNetwork,
    host: heapless::String<64>,
    clock: SimClock,
) {
    let mut wait = SHORTEST;
    loop {
        let began = clock.now();
        // Whatever ended it, the answer is to try again.
        let _ = session(
            &fleet,
            credentials.as_ref(),
            &outlet,
            (&mut network, &host),
            &clock,
        )
        .await;
        outlet.set_open(false);
        wait = if clock.now() - began >= STABLE_AFTER {
            SHORTEST
        } else {
            (wait * 2).min(LONGEST)
        };
        clock.sleep(wait).await;
    }
}

/// One connection; `None` when it is lost.
async fn session(
    fleet: &Fleet,
    credentials: Option<&Credentials>,
    outlet: &Outlet,
    (network, host): (&mut SecuredNetwork, &str),
    clock: &SimClock,
) -> Option<Infallible> {
    let soon = || clock.now() + PATIENCE;
    let stream = with_deadline(clock, soon(), network.connect(host, 0));
    let mut stream = Gathered {
        stream: stream.await.ok()?.ok()?,
        output: Vec::new(),
    };
    let last = RefCell::new(Vec::new());
    let mut buffer = LastField(&last);
    let mut client: Client<'_, '_, _, _, 1, 1, 1, 0, 0, 0, 0> = Client::new(&mut buffer);
    let name = format!("tracker-{fleet}");
    let id = MqttString::from_str(&name).ok()?;
    let mut options = ConnectOptions::new().clean_start();
    options = options.keep_alive(KeepAlive::Seconds(NonZero::new(6)?));
    options = options.maximum_packet_size(NonZero::new(MAX_PACKET)?);
    if let Some(credentials) = credentials {
        let password = MqttBinary::from_slice(credentials.password.as_bytes()).ok()?;
        options = options
            .user_name(MqttString::from_str(&credentials.username).ok()?)
            .password(password);
    }
    let work = client.connect(&mut stream, &options, Some(id));
    with_deadline(clock, soon(), work).await.ok()?.ok()?;
    let time_topic = Topic::Time.render(fleet);
    let filter = TopicFilter::new(MqttString::from_str(&time_topic).ok()?)?;
    let options = SubscriptionOptions::new().retain_handling(RetainHandling::NeverSend);
    let work = client.subscribe(filter, &options);
    with_deadline(clock, soon(), work).await.ok()?.ok()?;
    let time = TimeSync::<NoopRawMutex>::new();
    let mut heard = clock.now();
    let mut next_ping = heard + PING_PERIOD;
    let mut next_fix = heard;
    outlet.set_open(true);
    loop {
        let wake = next_ping.min(heard + LOST_AFTER);
        let fix = async {
            clock.sleep_until(next_fix).await;
            outlet.next().await
        };
        // Only `poll_header` and `fix` may be dropped half-way.
        match select3(client.poll_header(), fix, clock.sleep_until(wake)).await {
            Either3::First(header) => {
                let work = client.poll_body(header.ok()?);
                let event = with_deadline(clock, soon(), work).await.ok()?.ok()?;
                heard = clock.now();
                if let Event::Publish(_) = event
                    && let Ok(message) = TimeMessage::from_json(&last.borrow())
                {
                    time.observe(message.timestamp, heard);
                }
            }
            Either3::Second(seen) => {
                // Robots take a fix without a date only while they have no clock themselves.
                let Some(timestamp) = time.unix_ms(seen.at) else {
                    continue;
                };
                let behind = clock.now().as_micros().saturating_sub(CATCH_UP.as_micros());
                next_fix = next_fix.max(Instant::from_micros(behind)) + PACE;
                let payload = pose_fix(&seen.robot, timestamp, seen.pose)?;
                let topic = Topic::Pose(seen.robot).render(fleet);
                let topic = TopicName::new(MqttString::from_str(&topic).ok()?)?;
                let options = PublicationOptions::new(TopicReference::Name(topic));
                let work = client.publish(&options, Bytes::Borrowed(&payload));
                with_deadline(clock, soon(), work).await.ok()?.ok()?;
            }
            Either3::Third(()) => {
                let now = clock.now();
                if now >= heard + LOST_AFTER {
                    return None;
                }
                if now >= next_ping {
                    next_ping = now + PING_PERIOD;
                    with_deadline(clock, soon(), client.ping())
                        .await
                        .ok()?
                        .ok()?;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use embassy_futures::poll_once;

    use super::*;

    #[test]
    fn robots_take_turns_and_the_newest_of_each_goes() {
        let outlet = Outlet::default();
        let pose = |x| Pose {
            x,
            y: 0.0,
            theta: 0.0,
            sigma: 0.0,
        };
        let names = ["a", "b"].map(|name| RobotId::new(name).unwrap());
        let see = |robot: usize, x, ms| {
            outlet.push(&names[robot], pose(x), Instant::from_millis(ms));
        };
        see(0, 1.0, 1);
        assert!(poll_once(outlet.next()).is_pending(), "nobody is there yet");
        outlet.set_open(true);
        see(0, 2.0, 2);
        see(1, 3.0, 3);
        see(0, 4.0, 4);
        let next = || match poll_once(outlet.next()) {
            Poll::Ready(seen) => Some((seen.robot, seen.pose.x, seen.at.as_millis())),
            Poll::Pending => None,
        };
        assert_eq!(next(), Some((names[0].clone(), 4.0, 4)));
        see(0, 5.0, 5);
        assert_eq!(next(), Some((names[1].clone(), 3.0, 3)));
        assert_eq!(next(), Some((names[0].clone(), 5.0, 5)));
        assert_eq!(next(), None);
    }
}
