//! Looks with a camera and eyes that follow a script.

use core::cell::{Cell, RefCell};
use core::future::pending;
use std::boxed::Box;
use std::rc::Rc;
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;

use crawler_hal::{Camera, CameraErrorKind, Clock, Duration, FrameFormat, Instant};
use crawler_protocol::{BehaviourName, ParameterValue, ParameterValues, Reason, RobotState};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;

use super::{FRAME_WITHIN, ILL_PERIOD, SCAN_PERIOD};
use crate::camera::{ImageSlot, Outcome, camera_with_eyes};
use crate::testing::{Executor, TestClock, TestRobot, robot_with};
use crate::vision::{Class, Eyes, Lens, Look, PictureError, Spot, Spots};

const JPEG: [u8; 5] = [0xFF, 0xD8, 0xFF, 0xFF, 0xD9];
const FRAME: usize = 96 * 96;
const PERIOD: Duration = Duration::from_millis(500);
/// How long the scripted detector takes.
const THINKING: Duration = Duration::from_millis(100);

#[derive(Clone, Copy, PartialEq)]
enum Act {
    Work,
    Fail(CameraErrorKind),
    Hang,
}

/// What the parts do, and what they were asked to.
#[derive(Clone)]
struct Script {
    clock: TestClock,
    act: Rc<Cell<Act>>,
    size: Rc<Cell<(u16, u16)>>,
    /// When frames were asked for.
    frames: Rc<RefCell<Vec<Instant>>>,
    shown: Rc<RefCell<Spots>>,
    /// Frames in memory, now.
    open: Rc<Cell<usize>>,
}

impl Camera for Script {
    type Error = CameraErrorKind;

    fn size(&self) -> (u16, u16) {
        self.size.get()
    }

    fn format(&self) -> FrameFormat {
        FrameFormat::Grey8
    }

    async fn capture(&mut self, frame: &mut [u8]) -> Result<(), CameraErrorKind> {
        self.frames.borrow_mut().push(self.clock.now());
        match self.act.get() {
            Act::Work => {
                frame.fill(7);
                Ok(())
            }
            Act::Fail(kind) => Err(kind),
            Act::Hang => pending().await,
        }
    }

    async fn still(&mut self, jpeg: &mut [u8]) -> Result<usize, CameraErrorKind> {
        jpeg[..JPEG.len()].copy_from_slice(&JPEG);
        Ok(JPEG.len())
    }
}

struct Glance {
    script: Script,
    frame: Vec<u8>,
}

impl Drop for Glance {
    fn drop(&mut self) {
        self.script.open.set(self.script.open.get() - 1);
    }
}

impl Eyes for Script {
    type Look<'e> = Glance;

    fn open(&mut self, bytes: usize) -> Option<Glance> {
        if bytes > FRAME {
            return None;
        }
        self.open.set(self.open.get() + 1);
        Some(Glance {
            script: self.clone(),
            frame: vec![0; bytes],
        })
    }
}

impl Look for Glance {
    fn frame(&mut self) -> &mut [u8] {
        &mut self.frame
    }

    async fn find(self, size: (u16, u16), _: FrameFormat) -> Result<Spots, PictureError> {
        assert_eq!(size, (96, 96));
        assert!(
            self.frame.iter().all(|pixel| *pixel == 7),
            "the frame is there"
        );
        self.script.clock.sleep(THINKING).await;
        Ok(self.script.shown.borrow().clone())
    }
}

type Slot = ImageSlot<NoopRawMutex, Box<[u8]>>;

struct Bench<'a> {
    robot: &'a TestRobot,
    slot: &'a Slot,
    script: Script,
    executor: Executor<'a>,
}

fn bench(test: impl FnOnce(Bench<'_>)) {
    let robot = robot_with("ada-1", |config| {
        config.camera = true;
        config.eyes = Some(Lens::default());
    });
    let slot = Slot::new(vec![0; 64].into_boxed_slice());
    let mut executor = Executor::default();
    let script = Script {
        clock: executor.clock.clone(),
        act: Rc::new(Cell::new(Act::Work)),
        size: Rc::new(Cell::new((96, 96))),
        frames: Rc::default(),
        shown: Rc::default(),
        open: Rc::default(),
    };
    let (camera, eyes) = (script.clone(), Some(script.clone()));
    let clock = executor.clock.clone();
    executor.spawn(camera_with_eyes(&robot, camera, &slot, eyes, clock));
    executor.run_woken();
    test(Bench {
        robot: &robot,
        slot: &slot,
        script,
        executor,
    });
}

impl Bench<'_> {
    fn run(&mut self, span: Duration) {
        self.executor.run_for(span);
    }

    /// Milliseconds from one frame to the next, since the last call.
    fn intervals(&self) -> Vec<u64> {
        let frames = core::mem::take(&mut *self.script.frames.borrow_mut());
        frames
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).as_millis())
            .collect()
    }

    fn show(&self, spots: &[Spot]) {
        *self.script.shown.borrow_mut() = spots.iter().copied().collect();
    }

    fn state(&self, state: RobotState) {
        let mut snapshot = self.robot.snapshot();
        snapshot.state = state;
        snapshot.behaviour = BehaviourName::Manual;
        self.robot.control_handle().publish(&snapshot);
    }

    /// Whether the link would have had something to tell every 100 ms for `span`: the places.
    fn news(&mut self, span: Duration) -> Vec<usize> {
        let mut told = Vec::new();
        for _ in 0..span.as_millis() / 100 {
            self.run(Duration::from_millis(100));
            let now = self.executor.clock.now();
            if self.robot.has_news() {
                let view = self.robot.link_handle().take_news(now).expect("is fresh");
                told.push(view.things.len());
            }
        }
        told
    }

    fn told(&self) -> Vec<String> {
        let now = self.executor.clock.now();
        core::iter::from_fn(|| self.robot.outbox.next_log(0, now))
            .filter(|entry| entry.event == "camera")
            .map(|entry| entry.text.to_string())
            .collect()
    }
}

const SPOT: Spot = Spot {
    class: Class::Object,
    x: 0.5,
    y: 0.6,
    margin: 20,
};

#[test]
fn nobody_looks_unless_somebody_wants_to_know() {
    bench(|mut bench| {
        bench.run(Duration::from_secs(20));
        let polls = bench.executor.polls(0);
        bench.run(Duration::from_secs(20));
        assert_eq!(bench.executor.polls(0), polls, "nor wakes up for it");
        assert!(bench.script.frames.borrow().is_empty());
        bench.robot.control_handle().want_views(true);
        bench.run(PERIOD * 10 + THINKING);
        assert_eq!(bench.intervals(), [500; 10]);
        assert_eq!(bench.script.open.get(), 0, "memory is free between looks");
        bench.robot.control_handle().want_views(false);
        bench.run(Duration::from_secs(20));
        assert!(bench.script.frames.borrow().is_empty());
    });
}

#[test]
fn the_period_is_a_parameter_and_a_scan_looks_often_enough() {
    bench(|mut bench| {
        let mut values = ParameterValues::new();
        let name = "vision_period_ms".try_into().expect("short");
        values
            .push((name, ParameterValue::Number(2_000.0)))
            .expect("room");
        bench.robot.adjust(&values).expect("legal");
        bench.robot.control_handle().want_views(true);
        bench.run(Duration::from_secs(6));
        assert_eq!(bench.intervals(), [2_000; 3]);
        bench.state(RobotState::Scanning);
        bench.robot.control_handle().want_views(true);
        bench.run(Duration::from_secs(3));
        let scan = SCAN_PERIOD.as_millis();
        assert!(bench.intervals().iter().all(|ms| *ms == scan));
    });
}

#[test]
fn news_is_what_comes_goes_moves_or_stays() {
    bench(|mut bench| {
        bench.robot.control_handle().want_views(true);
        assert_eq!(
            bench.news(Duration::from_secs(5)),
            [0],
            "nothing there, once"
        );
        bench.show(&[SPOT]);
        assert_eq!(bench.news(Duration::from_millis(1_900)), [1], "it came");
        assert_eq!(bench.news(Duration::from_secs(4)), [1, 1], "it is there");
        bench.show(&[Spot { x: 0.58, ..SPOT }]);
        assert_eq!(bench.news(Duration::from_millis(600)), [1], "it has moved");
        let class = Class::Robot;
        bench.show(&[Spot {
            x: 0.58,
            class,
            ..SPOT
        }]);
        assert_eq!(bench.news(Duration::from_millis(600)), [1], "it is another");
        bench.show(&[]);
        assert_eq!(bench.news(Duration::from_secs(5)), [0], "it went");
        // Whoever looks again tells what there is, be it nothing.
        bench.robot.control_handle().want_views(false);
        assert_eq!(bench.news(Duration::from_secs(1)), [0; 0]);
        bench.robot.control_handle().want_views(true);
        assert_eq!(bench.news(Duration::from_secs(1)), [0]);
    });
}

#[test]
fn control_gets_every_view_once() {
    bench(|mut bench| {
        bench.show(&[Spot { y: 0.7, ..SPOT }]);
        bench.robot.control_handle().want_views(true);
        bench.run(THINKING);
        let view = bench.robot.control_handle().take_view().expect("a view");
        assert_eq!(view.frame, 1);
        assert_eq!(
            view.at,
            Instant::BOOT,
            "when the frame was taken, not when it was understood"
        );
        assert!(view.in_the_way.is_some());
        assert_eq!(bench.robot.control_handle().take_view(), None);
        bench.run(PERIOD);
        assert_eq!(
            bench
                .robot
                .control_handle()
                .take_view()
                .expect("another")
                .frame,
            2
        );
    });
}

#[test]
fn a_camera_that_fails_is_told_once_and_tried_less_often() {
    for (act, text, period) in [
        (
            Act::Fail(CameraErrorKind::Absent),
            "no camera sensor found",
            ILL_PERIOD,
        ),
        (
            Act::Fail(CameraErrorKind::Length),
            "the camera fails",
            ILL_PERIOD,
        ),
        (Act::Hang, "the camera does not answer", ILL_PERIOD),
    ] {
        bench(|mut bench| {
            bench.script.act.set(act);
            bench.robot.control_handle().want_views(true);
            bench.run(FRAME_WITHIN + period * 2);
            assert_eq!(bench.told(), [text]);
            assert_eq!(bench.intervals(), [period.as_millis(); 2]);
            assert_eq!(bench.script.open.get(), 0);
            assert_eq!(bench.robot.control_handle().take_view(), None, "no view");
            bench.script.act.set(Act::Work);
            bench.run(period * 2);
            assert_eq!(bench.told(), ["the camera works again"]);
            assert!(bench.intervals().ends_with(&[500, 500]));
        });
    }
}

#[test]
fn frames_that_are_none_and_frames_without_room_are_told() {
    for (size, text) in [
        ((0, 0), "the camera's frames cannot be looked at"),
        ((3_000, 10), "the camera's frames cannot be looked at"),
        ((97, 96), "no memory for a frame"),
    ] {
        bench(|mut bench| {
            bench.script.size.set(size);
            bench.robot.control_handle().want_views(true);
            bench.run(Duration::from_secs(1));
            assert_eq!(bench.told(), [text]);
            assert!(bench.script.frames.borrow().is_empty());
        });
    }
}

#[test]
fn looks_go_on_while_an_image_waits_for_the_broker() {
    bench(|mut bench| {
        bench.robot.control_handle().want_views(true);
        let text = r#"{"command":"capture","timestamp":0,"seq":1,"source":"operator:ada"}"#;
        bench
            .robot
            .submit(text.as_bytes(), bench.executor.clock.now());
        bench.run(PERIOD * 4);
        assert_eq!(bench.intervals().len(), 4);
        let image = bench.slot.collect().expect("an image waits");
        bench.slot.settle(image.into_buffer(), Outcome::Delivered);
        bench.run(PERIOD * 4);
        assert_eq!(bench.intervals(), [500; 3]);
        let answers: Vec<_> = core::iter::from_fn(|| {
            let (ticket, answer) = bench.robot.outbox.next_answer()?;
            bench.robot.outbox.delivered(ticket);
            Some(answer.status.name())
        })
        .collect();
        assert_eq!(answers, ["accepted", "completed"]);
    });
}

#[test]
fn whoever_has_no_eyes_is_not_asked_to_look() {
    let text = br#"{"command":"set","parameters":{"vision_always":true},"timestamp":0,"seq":1,"source":"operator:ada"}"#;
    for (eyes, refused) in [(None, true), (Some(Lens::default()), false)] {
        let robot = robot_with("ada-1", |config| config.eyes = eyes);
        robot.submit(text, Instant::BOOT);
        let answer = robot.outbox.next_answer().map(|(_, answer)| answer.reason);
        let unsupported = Some(Some(Reason::Unsupported));
        assert_eq!(answer == unsupported, refused, "{answer:?}");
    }
}
