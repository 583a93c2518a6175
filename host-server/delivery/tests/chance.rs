//! Delivery over a network that loses, repeats and forgets, to robots with the memory of real ones.

use std::collections::{BTreeMap, VecDeque};

use crawler_delivery::{Class, Delivery, DeliverySink, End, Ms, Sending};
use crawler_protocol::RobotId;
use proptest::prelude::*;

/// What happens next.
#[derive(Debug, Clone)]
enum Happening {
    Give(Class),
    Pass(u16),
    /// The network hands on so many messages, if it still has them.
    Arrive(u8),
    /// All that is under way is lost.
    Forget,
    /// The first message under way is there twice.
    Repeat,
    /// The next answer is lost.
    Swallow,
    BrokerRestart(u16),
    RobotAway,
    RobotBack,
    Reboot,
}

fn class() -> impl Strategy<Value = Class> {
    prop_oneof![
        2 => Just(Class::Plain),
        2 => Just(Class::Setting),
        2 => Just(Class::Motion),
        1 => Just(Class::Halt),
    ]
}

fn happening() -> impl Strategy<Value = Happening> {
    prop_oneof![
        6 => class().prop_map(Happening::Give),
        6 => (0_u16..3_000).prop_map(Happening::Pass),
        8 => (1_u8..4).prop_map(Happening::Arrive),
        1 => Just(Happening::Forget),
        1 => Just(Happening::Repeat),
        1 => Just(Happening::Swallow),
        1 => (0_u16..3_000).prop_map(Happening::BrokerRestart),
        1 => Just(Happening::RobotAway),
        2 => Just(Happening::RobotBack),
        1 => Just(Happening::Reboot),
    ]
}

#[derive(Default)]
struct Net {
    number: u64,
    now: Ms,
    /// To the robot: whose command, number, until when it may arrive.
    wire: VecDeque<(u64, u64, Ms)>,
    over: BTreeMap<u64, End>,
    given: BTreeMap<u64, (Class, Ms)>,
}

impl Net {
    /// A number above all before it.
    fn next(&mut self) -> u64 {
        self.number += 1;
        self.number
    }
}

impl DeliverySink for Net {
    fn number(&mut self, _: u64, _: &RobotId, _: u64) -> u64 {
        self.next()
    }

    fn send(&mut self, sending: &Sending<'_>) -> bool {
        let (class, at) = self.given[&sending.id];
        assert!(self.now < at + class.life_ms(), "sent late");
        assert_eq!(sending.life_ms, at + class.life_ms() - self.now);
        self.wire
            .push_back((sending.id, sending.seq, self.now + sending.life_ms));
        true
    }

    fn over(&mut self, id: u64, _: &RobotId, end: End) {
        assert!(self.over.insert(id, end).is_none(), "{id} ended twice");
    }
}

/// A robot's ledger: the newest number of each of the two sources.
#[derive(Default)]
struct Robot {
    newest: [u64; 2],
    /// Commands that ran, in order, with the boot they ran in.
    ran: Vec<(u64, u32)>,
    boot: u32,
}

impl Robot {
    /// Whether the answer is `stale`.
    fn take(&mut self, id: u64, seq: u64, class: Class) -> bool {
        let newest = &mut self.newest[usize::from(class == Class::Setting)];
        if class == Class::Halt || seq > *newest {
            self.ran.push((id, self.boot));
        }
        *newest = seq.max(*newest);
        class != Class::Halt && seq < *newest
    }
}

struct Scene {
    id: RobotId,
    delivery: Delivery,
    net: Net,
    robot: Robot,
    online: bool,
    swallow: bool,
    answered: BTreeMap<u64, bool>,
}

impl Scene {
    fn new() -> Self {
        let id = RobotId::new("a").unwrap();
        let mut delivery = Delivery::new();
        delivery.status(&id, true, 0, 0);
        Self {
            id,
            delivery,
            net: Net::default(),
            robot: Robot::default(),
            online: true,
            swallow: false,
            answered: BTreeMap::new(),
        }
    }

    fn happen(&mut self, what: &Happening) {
        match *what {
            Happening::Give(class) => {
                let id = self.net.next();
                let now = self.net.now;
                if self.delivery.submit(id, &self.id, class, now).is_ok() {
                    self.net.given.insert(id, (class, now));
                }
            }
            Happening::Pass(ms) => self.net.now += Ms::from(ms),
            Happening::Arrive(count) => self.arrive(count.into()),
            Happening::Forget => self.net.wire.clear(),
            Happening::Repeat => {
                if let Some(&first) = self.net.wire.front() {
                    self.net.wire.push_front(first);
                }
            }
            Happening::Swallow => self.swallow = true,
            Happening::BrokerRestart(ms) => {
                self.delivery.connection(false, self.net.now);
                self.net.wire.clear();
                self.poll();
                self.net.now += Ms::from(ms);
                self.poll();
                self.delivery.connection(true, self.net.now);
            }
            Happening::RobotAway => {
                self.online = false;
                self.status();
            }
            Happening::RobotBack => {
                self.online = true;
                self.status();
            }
            Happening::Reboot => {
                self.robot.boot += 1;
                self.robot.newest = [0; 2];
                // It asks for a new session.
                self.net.wire.clear();
                self.online = true;
                self.status();
            }
        }
        self.poll();
    }

    fn status(&mut self) {
        let (boot, now) = (self.robot.boot, self.net.now);
        self.delivery.status(&self.id, self.online, boot, now);
    }

    fn poll(&mut self) {
        self.delivery.poll(self.net.now, &mut self.net);
    }

    fn arrive(&mut self, count: usize) {
        if !self.online {
            return;
        }
        for _ in 0..count {
            let Some((id, seq, until)) = self.net.wire.pop_front() else {
                return;
            };
            if self.net.now >= until {
                continue;
            }
            let (class, _) = self.net.given[&id];
            let stale = self.robot.take(id, seq, class);
            if std::mem::take(&mut self.swallow) {
                continue;
            }
            if let Some(known) = self.delivery.answered(&self.id, seq) {
                assert_eq!(known, id);
                assert!(
                    self.answered.insert(id, stale).is_none(),
                    "{id} answered twice"
                );
            }
            self.poll();
        }
    }

    /// Everything works from now on.
    fn calm_down(&mut self) {
        self.swallow = false;
        self.happen(&Happening::RobotBack);
        for _ in 0..700 {
            self.happen(&Happening::Arrive(100));
            self.happen(&Happening::Pass(100));
        }
    }

    fn runs(&self, id: u64) -> usize {
        self.robot.ran.iter().filter(|(ran, _)| *ran == id).count()
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(if cfg!(miri) { 4 } else { 1_000 }))]

    /// Every command ends exactly once, with an answer or without, and none runs twice.
    #[test]
    fn nothing_is_lost_and_nothing_runs_twice(
        happenings in prop::collection::vec(happening(), 1..120),
    ) {
        let mut scene = Scene::new();
        for happening in &happenings {
            scene.happen(happening);
        }
        scene.calm_down();
        for (&id, &(class, _)) in &scene.net.given {
            let answered = scene.answered.get(&id);
            let over = scene.net.over.get(&id);
            prop_assert!(answered.is_some() != over.is_some(), "{id}: {answered:?}, {over:?}");
            let runs = scene.runs(id);
            match class {
                Class::Plain | Class::Motion => prop_assert!(runs <= 1, "{id} ran {runs} times"),
                Class::Setting if scene.robot.boot == 0 => prop_assert_eq!(runs, 1, "{} ran", id),
                Class::Setting => prop_assert!(over.is_some() || runs >= 1, "{id} never ran"),
                Class::Halt => {}
            }
            if over == Some(&End::Expired) {
                prop_assert_eq!(runs, 0, "{} ran and is said not to have", id);
            }
            if answered == Some(&false) {
                prop_assert!(runs >= 1, "{id} is said to have run");
            }
        }
        prop_assert!(scene.delivery.is_empty());
    }

    /// Settings take effect in the order in which they were given, whatever is repeated.
    #[test]
    fn settings_keep_their_order(happenings in prop::collection::vec(happening(), 1..120)) {
        let mut scene = Scene::new();
        for happening in &happenings {
            scene.happen(happening);
        }
        scene.calm_down();
        let class = |id: &u64| scene.net.given[id].0;
        let settings: Vec<u64> = scene.robot.ran.iter().map(|(id, _)| *id)
            .filter(|id| class(id) == Class::Setting)
            .collect();
        prop_assert!(settings.is_sorted(), "{settings:?}");
    }
}
