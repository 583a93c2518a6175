//! The broker's end of one connection, as scripted.

use core::cell::RefCell;
use core::future::poll_fn;
use core::task::Poll;
use std::rc::Rc;
use std::string::String;
use std::vec::Vec;

use crawler_hal::{Clock, Duration};
use embassy_futures::select::{Either, select};

use super::harness::{EPOCH_MS, Pipe, TestClock};
use super::wire::{Connect, Cursor, Packet, Publish, command, packet, split_packet, split_publish};

/// The broker's end of one connection.
pub(super) struct Peer {
    pipe: Rc<RefCell<Pipe>>,
    clock: TestClock,
    next_id: u16,
    /// Whether QoS 1 messages of the robot are acknowledged.
    pub(super) acknowledging: bool,
    /// Whether pings are answered.
    pub(super) answering_pings: bool,
}

impl Peer {
    pub(super) const fn new(pipe: Rc<RefCell<Pipe>>, clock: TestClock) -> Self {
        Self {
            pipe,
            clock,
            next_id: 0,
            acknowledging: true,
            answering_pings: true,
        }
    }

    pub(super) fn send(&self, bytes: &[u8]) {
        let mut pipe = self.pipe.borrow_mut();
        pipe.to_robot.extend(bytes);
        pipe.changed();
    }

    pub(super) fn close(&self) {
        let mut pipe = self.pipe.borrow_mut();
        pipe.closed = true;
        pipe.changed();
    }

    pub(super) fn stall(&self) {
        self.pipe.borrow_mut().stalled = true;
    }

    /// Returns when the robot has dropped the connection.
    pub(super) async fn dropped(&self) {
        poll_fn(|context| {
            let mut pipe = self.pipe.borrow_mut();
            if pipe.dropped {
                return Poll::Ready(());
            }
            pipe.wakers.push(context.waker().clone());
            Poll::Pending
        })
        .await;
    }

    /// The next packet; `None` when the robot has dropped the connection.
    pub(super) async fn packet(&self) -> Option<Packet> {
        poll_fn(|context| {
            let mut pipe = self.pipe.borrow_mut();
            let bytes: Vec<u8> = pipe.to_broker.iter().copied().collect();
            if let Some((used, packet)) = split_packet(&bytes) {
                pipe.to_broker.drain(..used);
                return Poll::Ready(Some(packet));
            }
            if pipe.dropped {
                return Poll::Ready(None);
            }
            pipe.wakers.push(context.waker().clone());
            Poll::Pending
        })
        .await
    }

    pub(super) async fn connect(&self) -> Connect {
        let packet = self.packet().await.expect("CONNECT");
        assert_eq!(packet.kind(), 1);
        let mut body = Cursor(&packet.body);
        assert_eq!((body.text().as_str(), body.byte()), ("MQTT", 5));
        let flags = body.byte();
        assert_eq!(flags & 0b0000_0100, 0b0000_0100, "a will");
        let keep_alive_s = body.short();
        body.skip_properties();
        let client_id = body.text();
        body.skip_properties();
        let will_topic = body.text();
        let will = serde_json::from_slice(body.bytes()).expect("JSON");
        let username = (flags & 0b1000_0000 != 0).then(|| body.text());
        let password = (flags & 0b0100_0000 != 0).then(|| body.bytes().to_vec());
        assert!(body.0.is_empty(), "nothing after the password");
        Connect {
            clean: flags & 2 != 0,
            keep_alive_s,
            client_id,
            will_qos: flags >> 3 & 3,
            will_retained: flags & 0b10_0000 != 0,
            will_topic,
            will,
            username,
            password,
        }
    }

    /// Answers CONNECT and the five SUBSCRIBEs. The robot is connected then.
    pub(super) async fn accept(&mut self, session_present: bool) -> (Connect, Vec<String>) {
        self.accept_with(session_present, 5).await
    }

    /// The same with so many SUBSCRIBEs.
    pub(super) async fn accept_with(
        &mut self,
        session_present: bool,
        subscriptions: usize,
    ) -> (Connect, Vec<String>) {
        let connect = self.connect().await;
        self.send(&[0x20, 3, u8::from(session_present), 0, 0]);
        let mut filters = Vec::new();
        while filters.len() < subscriptions {
            let packet = self.packet().await.expect("SUBSCRIBE");
            if packet.kind() == 8 {
                filters.push(self.grant(&packet));
            } else {
                self.serve(&packet);
            }
        }
        (connect, filters)
    }

    /// Confirms a subscription; the filter and its options, as text.
    pub(super) fn grant(&self, packet: &Packet) -> String {
        let mut body = Cursor(&packet.body);
        let id = body.short().to_be_bytes();
        body.skip_properties();
        let filter = body.text();
        let options = body.byte();
        assert!(body.0.is_empty(), "one filter in one SUBSCRIBE");
        self.send(&[0x90, 4, id[0], id[1], 0, options & 3]);
        std::format!("{filter} {options:#04x}")
    }

    /// Takes one packet; true when it was the last of the five SUBSCRIBEs.
    pub(super) async fn is_subscribed(&mut self) -> bool {
        let next = self.packet().await.expect("the connection stays open");
        if next.kind() == 8 {
            return self.grant(&next).contains("/pose/");
        }
        self.serve(&next);
        false
    }

    /// Acknowledges and answers what a broker would.
    pub(super) fn serve(&self, packet: &Packet) -> Option<Publish> {
        match packet.kind() {
            3 => {
                let publish = split_publish(packet);
                if let (Some(id), true) = (publish.id, self.acknowledging) {
                    self.acknowledge(id);
                }
                Some(publish)
            }
            12 => {
                if self.answering_pings {
                    self.send(&[0xd0, 0]);
                }
                None
            }
            4 => None,
            other => panic!("packet of type {other} from the robot"),
        }
    }

    pub(super) fn acknowledge(&self, id: u16) {
        let [high, low] = id.to_be_bytes();
        self.send(&[0x40, 2, high, low]);
    }

    /// The next message of the robot whose topic begins with `prefix`.
    pub(super) async fn publish(&self, prefix: &str) -> Publish {
        loop {
            let packet = self.packet().await.expect("the connection stays open");
            match self.serve(&packet) {
                Some(publish) if publish.topic.starts_with(prefix) => return publish,
                Some(_) | None => {}
            }
        }
    }

    /// All messages until `span` has passed, or the robot has dropped the connection.
    pub(super) async fn publishes_for(&self, span: Duration) -> Vec<Publish> {
        let mut all = Vec::new();
        let end = self.clock.now() + span;
        loop {
            match select(self.packet(), self.clock.sleep_until(end)).await {
                Either::First(Some(packet)) => all.extend(self.serve(&packet)),
                Either::First(None) | Either::Second(()) => return all,
            }
        }
    }

    /// Sends a message at QoS 0.
    pub(super) fn throw(&self, topic: &str, payload: &[u8]) {
        self.throw_with(topic, &[], payload);
    }

    /// The same with fewer than 128 bytes of properties.
    pub(super) fn throw_with(&self, topic: &str, properties: &[u8], payload: &[u8]) {
        let mut body = Vec::new();
        body.extend((topic.len() as u16).to_be_bytes());
        body.extend(topic.as_bytes());
        body.push(properties.len() as u8);
        body.extend(properties);
        body.extend(payload);
        self.send(&packet(0x30, &body));
    }

    /// Sends a message at QoS 1.
    pub(super) fn deliver(&mut self, topic: &str, payload: &[u8]) {
        self.deliver_with(topic, &[], payload);
    }

    /// The same with fewer than 128 bytes of properties.
    fn deliver_with(&mut self, topic: &str, properties: &[u8], payload: &[u8]) {
        self.next_id += 1;
        let mut body = Vec::new();
        body.extend((topic.len() as u16).to_be_bytes());
        body.extend(topic.as_bytes());
        body.extend(self.next_id.to_be_bytes());
        body.push(properties.len() as u8);
        body.extend(properties);
        body.extend(payload);
        self.send(&packet(0x32, &body));
    }

    /// Tells the time.
    pub(super) fn deliver_time(&mut self) {
        let now = EPOCH_MS + self.clock.now().as_millis();
        self.deliver(
            "swarm/time",
            std::format!("{{\"timestamp\":{now}}}").as_bytes(),
        );
    }

    /// Sends a command of `operator:ada` that was given now.
    pub(super) fn command(&mut self, seq: u64, name: &str, parameters: &str) {
        let now = EPOCH_MS + self.clock.now().as_millis();
        let text = command(name, parameters, now, seq);
        self.deliver("swarm/command/robot/sim-0001", text.as_bytes());
    }

    /// The same without parameters, and with properties of the message.
    pub(super) fn command_with(&mut self, seq: u64, name: &str, properties: &[u8]) {
        let now = EPOCH_MS + self.clock.now().as_millis();
        let text = command(name, "", now, seq);
        self.deliver_with("swarm/command/robot/sim-0001", properties, text.as_bytes());
    }
}
