//! The rules of delivery, one by one.

use crawler_delivery::{
    Class, Delivery, DeliverySink, End, Full, MOST_PER_ROBOT, Ms, RESEND_AFTER_MS, SETTINGS,
    Sending,
};
use crawler_protocol::RobotId;

/// Keeps what goes.
struct Sink {
    number: u64,
    open: bool,
    /// A command that cannot go.
    stuck: Option<u64>,
    sent: Vec<(u64, u64, bool)>,
    lives: Vec<Ms>,
    over: Vec<(u64, End)>,
}

impl Sink {
    /// A number above all before it.
    fn next(&mut self) -> u64 {
        self.number += 1;
        self.number
    }
}

impl DeliverySink for Sink {
    fn number(&mut self, _: u64, _: &RobotId, _: u64) -> u64 {
        self.next()
    }

    fn send(&mut self, sending: &Sending<'_>) -> bool {
        if self.stuck == Some(sending.id) {
            return false;
        }
        if self.open {
            self.sent.push((sending.id, sending.seq, sending.again));
            self.lives.push(sending.life_ms);
        }
        self.open
    }

    fn over(&mut self, id: u64, _: &RobotId, end: End) {
        self.over.push((id, end));
    }
}

struct Scene {
    delivery: Delivery,
    sink: Sink,
    robot: RobotId,
    now: Ms,
}

impl Scene {
    fn new() -> Self {
        let robot = RobotId::new("a").unwrap();
        let mut delivery = Delivery::new();
        delivery.status(&robot, true, 1, 0);
        Self {
            delivery,
            sink: Sink {
                number: 1_000,
                open: true,
                stuck: None,
                sent: Vec::new(),
                lives: Vec::new(),
                over: Vec::new(),
            },
            robot,
            now: 10_000,
        }
    }

    fn give(&mut self, class: Class) -> u64 {
        let id = self.sink.next();
        let robot = self.robot.clone();
        self.delivery.submit(id, &robot, class, self.now).unwrap();
        self.pass(0);
        id
    }

    fn pass(&mut self, ms: Ms) {
        self.now += ms;
        self.delivery.poll(self.now, &mut self.sink);
    }

    fn status(&mut self, online: bool, boot: u32) {
        let robot = self.robot.clone();
        self.delivery.status(&robot, online, boot, self.now);
        self.pass(0);
    }

    fn answer(&mut self, seq: u64) -> Option<u64> {
        let robot = self.robot.clone();
        let answered = self.delivery.answered(&robot, seq);
        self.pass(0);
        answered
    }

    fn sent(&mut self) -> Vec<(u64, u64, bool)> {
        std::mem::take(&mut self.sink.sent)
    }
}

#[test]
fn an_answered_command_goes_once() {
    let mut scene = Scene::new();
    let id = scene.give(Class::Plain);
    assert_eq!(scene.sent(), [(id, id, false)]);
    assert_eq!(scene.sink.lives, [60_000]);
    assert!(scene.delivery.len() == 1 && !scene.delivery.is_empty());
    assert_eq!(scene.answer(id), Some(id));
    assert_eq!(scene.answer(id), None);
    scene.pass(100_000);
    assert_eq!(scene.sent(), []);
    assert!(scene.sink.over.is_empty() && scene.delivery.is_empty());
}

#[test]
fn without_an_answer_it_goes_again_ever_less_often() {
    let mut scene = Scene::new();
    let id = scene.give(Class::Plain);
    scene.sent();
    let mut times = Vec::new();
    let start = scene.now;
    for _ in 0..600 {
        scene.pass(100);
        for sent in scene.sent() {
            assert_eq!(sent, (id, id, true));
            times.push(scene.now - start);
        }
    }
    assert_eq!(times, [1_000, 2_000, 4_000, 8_000, 16_000, 32_000]);
    assert_eq!(scene.sink.over, [(id, End::Unanswered)]);
    assert!(scene.sink.lives.iter().all(|life| *life > 0));
}

#[test]
fn motion_for_a_robot_that_is_away_expires_and_never_goes() {
    let mut scene = Scene::new();
    scene.status(false, 1);
    let id = scene.give(Class::Motion);
    scene.pass(1_999);
    assert!(scene.sink.over.is_empty());
    scene.pass(1);
    assert_eq!(scene.sink.over, [(id, End::Expired)]);
    scene.status(true, 1);
    assert_eq!(scene.sent(), []);
}

/// A new number may have to be written down first. A halt does not wait with it; everything else does.
#[test]
fn a_halt_passes_a_command_that_cannot_go_yet() {
    let mut scene = Scene::new();
    scene.status(false, 1);
    let setting = scene.give(Class::Setting);
    let first = scene.give(Class::Halt);
    assert_eq!(scene.sent(), [(first, first, false)]);
    assert_eq!(scene.answer(first), Some(first));
    scene.sink.stuck = Some(setting);
    scene.status(true, 1);
    let halt = scene.give(Class::Halt);
    scene.give(Class::Motion);
    assert_eq!(scene.sent(), [(halt, halt, false)]);
    scene.sink.stuck = None;
    scene.pass(0);
    let sent = scene.sent();
    let [(id, seq, false)] = sent[..] else {
        panic!("the setting alone: {sent:?}")
    };
    assert!(id == setting && seq > halt, "{sent:?}");
}

#[test]
fn a_setting_waits_for_its_robot_for_55_minutes() {
    let mut scene = Scene::new();
    scene.status(false, 1);
    let first = scene.give(Class::Setting);
    let second = scene.give(Class::Setting);
    let stop = scene.give(Class::Halt);
    assert_eq!(scene.sent(), [(stop, stop, false)], "a halt goes at once");
    scene.pass(54 * 60_000);
    scene.status(true, 2);
    // Under a new number: that of the halt was higher.
    let sent = scene.sent();
    let &(id, seq, again) = sent.first().unwrap();
    assert_eq!((id, again, sent.len()), (first, false, 1));
    assert!(seq > stop, "{seq} after {stop}");
    assert_eq!(scene.answer(seq), Some(first));
    assert_eq!(scene.sent().len(), 1, "then the next");
    scene.pass(2 * 60_000);
    assert!(scene.sink.over.contains(&(second, End::Unanswered)));

    scene.status(false, 2);
    let third = scene.give(Class::Setting);
    scene.pass(55 * 60_000);
    assert!(scene.sink.over.contains(&(third, End::Expired)));
}

#[test]
fn whatever_matters_waits_for_what_is_before_it() {
    let mut scene = Scene::new();
    let set = scene.give(Class::Setting);
    let motion = scene.give(Class::Motion);
    assert_eq!(scene.sent(), [(set, set, false)]);
    scene.answer(set);
    assert_eq!(scene.sent(), [(motion, motion, false)]);
    let newer = scene.give(Class::Motion);
    assert_eq!(
        scene.sent(),
        [(newer, newer, false)],
        "motion follows motion"
    );
    let stop = scene.give(Class::Halt);
    assert_eq!(scene.sent(), [(stop, stop, false)]);
    let after = scene.give(Class::Motion);
    assert_eq!(scene.sent(), [], "not before it is known to have stopped");
    scene.answer(motion);
    scene.answer(newer);
    scene.answer(stop);
    assert_eq!(scene.sent(), [(after, after, false)]);
}

#[test]
fn what_is_owed_goes_at_once_when_robot_or_broker_is_back() {
    let mut scene = Scene::new();
    let [one, two] = [scene.give(Class::Motion), scene.give(Class::Motion)];
    scene.sent();
    scene.pass(300);
    scene.status(false, 1);
    scene.pass(300);
    assert_eq!(scene.sent(), []);
    scene.status(true, 1);
    assert_eq!(
        scene.sent(),
        [(one, one, true), (two, two, true)],
        "in order"
    );
    scene.delivery.connection(false, scene.now);
    scene.pass(500);
    assert_eq!(scene.sent(), []);
    scene.delivery.connection(true, scene.now);
    scene.pass(0);
    assert_eq!(scene.sent().len(), 2);
}

#[test]
fn a_late_will_does_not_hide_a_robot_that_speaks() {
    let mut scene = Scene::new();
    scene.status(false, 1);
    let id = scene.give(Class::Plain);
    assert_eq!(scene.sent(), []);
    let robot = scene.robot.clone();
    scene.delivery.heard(&robot, scene.now);
    scene.pass(0);
    assert_eq!(scene.sent(), [(id, id, false)]);
}

#[test]
fn a_robot_that_has_started_anew_is_not_told_twice() {
    let mut scene = Scene::new();
    let reboot = scene.give(Class::Plain);
    scene.sent();
    scene.status(true, 2);
    assert_eq!(scene.sent(), []);
    assert_eq!(scene.sink.over, [(reboot, End::Unanswered)]);
    let set = scene.give(Class::Setting);
    scene.sent();
    scene.status(true, 3);
    let sent = scene.sent();
    assert_eq!(sent.len(), 1);
    assert_eq!((sent[0].0, sent[0].2), (set, false));
    assert!(sent[0].1 > set, "a new number");
}

#[test]
fn a_halt_is_not_repeated_after_something_newer() {
    let mut scene = Scene::new();
    let stop = scene.give(Class::Halt);
    scene.pass(RESEND_AFTER_MS);
    assert_eq!(scene.sent(), [(stop, stop, false), (stop, stop, true)]);
    let all = scene.sink.next();
    let robot = scene.robot.clone();
    scene
        .delivery
        .broadcast(all, [robot], Class::Motion, scene.now);
    scene.pass(10_000);
    assert!(scene.sent().iter().all(|(id, ..)| *id != stop));
    assert!(scene.sink.over.contains(&(stop, End::Unanswered)));
}

#[test]
fn a_setting_that_was_overtaken_goes_again_under_its_number() {
    let mut scene = Scene::new();
    let set = scene.give(Class::Setting);
    let halt = scene.give(Class::Halt);
    scene.answer(halt);
    scene.sent();
    scene.pass(RESEND_AFTER_MS);
    assert_eq!(scene.sent(), [(set, set, true)]);
    assert_eq!(scene.answer(set), Some(set));
}

#[test]
fn the_swarm_hears_once_and_who_is_silent_again() {
    let mut scene = Scene::new();
    let other = RobotId::new("b").unwrap();
    scene.delivery.status(&other, true, 1, 0);
    let id = scene.sink.next();
    let robots = [scene.robot.clone(), other.clone()];
    scene
        .delivery
        .broadcast(id, robots, Class::Plain, scene.now);
    scene.pass(0);
    assert_eq!(scene.sent(), []);
    scene.delivery.answered(&other, id);
    scene.pass(1_000);
    assert_eq!(scene.sent(), [(id, id, true)]);
}

#[test]
fn after_a_restart_it_goes_on_where_it_was() {
    let mut scene = Scene::new();
    let mut delivery = Delivery::new();
    let robot = scene.robot.clone();
    let end = scene.now + 30_000;
    delivery.resume(7, &robot, Class::Plain, (7, Some(4)), (scene.now, end));
    delivery.resume(8, &robot, Class::Setting, (8, Some(4)), (scene.now, end));
    scene.delivery = delivery;
    scene.pass(0);
    assert_eq!(scene.sent(), [], "nobody knows yet which program is there");
    scene.status(true, 4);
    assert_eq!(scene.sent(), [(7, 7, true), (8, 8, true)]);
    scene.status(true, 5);
    assert_eq!(scene.sink.over, [(7, End::Unanswered)]);
    assert_eq!(scene.sent(), [(8, 1_001, false)]);
    scene.pass(30_000);
    assert!(scene.delivery.is_empty());
}

#[test]
fn a_closed_post_keeps_the_order() {
    let mut scene = Scene::new();
    scene.sink.open = false;
    let [one, two] = [scene.give(Class::Motion), scene.give(Class::Motion)];
    scene.sink.open = true;
    scene.pass(1);
    assert_eq!(scene.sent(), [(one, one, false), (two, two, false)]);
    let robot = scene.robot.clone();
    scene.delivery.withdraw(one, &robot);
    scene.delivery.withdraw(two, &robot);
    assert!(scene.delivery.is_empty());
}

#[test]
fn there_is_an_end_to_what_can_wait_but_not_for_halts() {
    let mut scene = Scene::new();
    scene.status(false, 1);
    for _ in 0..MOST_PER_ROBOT {
        scene.give(Class::Setting);
    }
    let robot = scene.robot.clone();
    let full = scene
        .delivery
        .submit(9_999, &robot, Class::Setting, scene.now);
    assert_eq!(full, Err(Full));
    scene.give(Class::Halt);
    assert_eq!(scene.delivery.len(), MOST_PER_ROBOT + 1);
}

#[test]
fn robots_take_the_source_of_settings() {
    assert!(crawler_protocol::Source::new(SETTINGS).is_ok());
}
