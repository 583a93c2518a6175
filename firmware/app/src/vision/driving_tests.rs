//! What the camera shows and where the robot then drives.

use crawler_hal::{Duration, Instant, Millimeters};

use super::{Class, Lens, Spot, View};
use crate::controller::{Controller, Inputs, Outputs, PERIOD};
use crate::order::Task;
use crate::parameters::Parameters;
use crate::perception::Sight;
use crate::state::{Side, State};
use crate::testing::{TestRng, asked, inputs};

struct Bench {
    controller: Controller,
    rng: TestRng,
    now: Instant,
    sight: Sight,
}

impl Bench {
    fn driving(task: Task) -> Self {
        let mut bench = Self {
            controller: Controller::new(crate::controller::Tuning::default()),
            rng: TestRng(7),
            now: Instant::BOOT,
            sight: Sight::Clear,
        };
        bench.step(None, None);
        bench.step(Some(task), None);
        for _ in 0..50 {
            bench.step(None, None);
        }
        bench
    }

    fn step(&mut self, task: Option<Task>, view: Option<&View>) -> Outputs {
        self.now += PERIOD;
        let order = task.map(|task| asked(task, self.now));
        let inputs = Inputs {
            view,
            ..inputs(self.sight, self.now, order.as_ref())
        };
        self.controller.step(&inputs, &mut self.rng, self.now)
    }

    /// A look that shows something at these places of the picture.
    fn view(&self, places: &[[f32; 2]]) -> View {
        let spots = places.iter().map(|&[x, y]| Spot {
            class: Class::Obstacle,
            x,
            y,
            margin: 20,
        });
        let heading = self.controller.pose().theta;
        let taken = (1, self.now, heading);
        View::new(&spots.collect(), &Lens::default(), 1.0, taken)
    }
}

const WANDER: Task = Task::Wander { speed: 60 };

#[test]
fn wandering_turns_away_from_what_is_low_and_near() {
    for (x, side) in [(0.45, Side::Right), (0.55, Side::Left)] {
        let mut bench = Bench::driving(WANDER);
        let view = bench.view(&[[x, 0.75]]);
        let out = bench.step(None, Some(&view));
        assert!(
            matches!(bench.controller.state(), State::Avoiding(_, escape) if escape.side == side),
            "{:?}",
            bench.controller.state()
        );
        assert_eq!(out.duties, [0.0; 2], "it stops first");
        let from = bench.controller.pose();
        let mut steps = 0;
        while matches!(bench.controller.state(), State::Avoiding(..)) {
            bench.step(None, None);
            steps += 1;
            assert!(steps < 75, "turns without end");
        }
        let to = bench.controller.pose();
        let turned = crate::motion::wrap(to.theta - from.theta);
        assert_eq!(turned > 0.0, side == Side::Left);
        assert!(turned.abs() > 0.4, "turned by {turned}");
        assert!(libm::hypotf(to.x - from.x, to.y - from.y) < 0.05);
        // And on it goes.
        for _ in 0..50 {
            bench.step(None, None);
        }
        assert!(matches!(bench.controller.state(), State::Moving(_)));
    }
}

#[test]
fn what_is_far_high_or_beside_does_not_matter() {
    let mut bench = Bench::driving(WANDER);
    for places in [
        &[][..],
        &[[0.5, 0.3]],
        &[[0.5, 0.5]],
        &[[0.5, 0.58]],
        &[[0.02, 0.65], [0.98, 0.65]],
    ] {
        let view = bench.view(places);
        bench.step(None, Some(&view));
        assert!(
            matches!(bench.controller.state(), State::Moving(_)),
            "{places:?}"
        );
    }
}

#[test]
fn a_new_look_takes_back_what_the_old_one_saw() {
    let mut bench = Bench::driving(WANDER);
    let low = bench.view(&[[0.5, 0.8]]);
    bench.step(None, Some(&low));
    let free = bench.view(&[]);
    for _ in 0..40 {
        bench.step(None, Some(&free));
    }
    assert!(matches!(bench.controller.state(), State::Moving(_)));
}

#[test]
fn eyes_that_always_see_something_stop_wandering_and_nothing_else() {
    let mut bench = Bench::driving(WANDER);
    let mut forward = 0.0_f32;
    for step in 0..3_000 {
        let view = (step % 10 == 0).then(|| bench.view(&[[0.5, 0.9]]));
        let out = bench.step(None, view.as_ref());
        forward += (out.duties[0] + out.duties[1]).max(0.0);
        let underway = bench.controller.state().goal().is_some();
        assert!(underway, "{:?}", bench.controller.state());
    }
    // It rolled out the first time, and never set off again for more than a step.
    assert!(forward < 5.0, "{forward}");
    for task in [
        Task::Drive { v: 0.2, w: 0.0 },
        Task::Goto { x: 5.0, y: 0.0 },
    ] {
        let mut bench = Bench::driving(task);
        let view = bench.view(&[[0.5, 0.8]]);
        bench.step(Some(task), Some(&view));
        let moving = matches!(bench.controller.state(), State::Moving(_));
        assert!(moving, "{:?}", bench.controller.state());
    }
}

/// The ranger comes first, whatever the camera says.
#[test]
fn no_view_lets_the_robot_nearer_than_the_ranger_does() {
    let mut bench = Bench::driving(WANDER);
    bench.sight = Sight::Range(Millimeters(120));
    let free = bench.view(&[]);
    let out = bench.step(None, Some(&free));
    assert_eq!(out.duties, [0.0; 2]);
    assert!(matches!(bench.controller.state(), State::Avoiding(..)));
}

#[test]
fn looking_is_wanted_while_it_serves() {
    let wanted = |task| Bench::driving(task).controller.wants_eyes();
    assert!(wanted(WANDER));
    assert!(wanted(Task::Scan));
    assert!(!wanted(Task::Goto { x: 5.0, y: 0.0 }));
    assert!(!wanted(Task::Manual));
    let mut values = crawler_protocol::ParameterValues::new();
    let name = "vision_always".try_into().expect("short");
    let on = crawler_protocol::ParameterValue::Bool(true);
    values.push((name, on)).expect("room");
    let parameters = Parameters::default().with(&values).expect("legal");
    let mut bench = Bench::driving(Task::Manual);
    let geometry = crate::config::Geometry::default();
    let tuning = crate::controller::Tuning::new(&parameters, &geometry);
    bench.controller.set_tuning(tuning);
    assert!(bench.controller.wants_eyes());
}

#[test]
fn a_scan_collects_what_the_camera_recognised() {
    let mut bench = Bench::driving(Task::Scan);
    let mut found = None;
    let mut shown = 0;
    for step in 0..500 {
        let theta = bench.controller.pose().theta;
        // It stands at 100°, and is in the picture while the robot heads about there.
        let off = crate::motion::wrap(1.75 - theta);
        let x = 0.5 - 0.5 * libm::tanf(off) / libm::tanf(Lens::default().half_view);
        let inside = libm::fabsf(off) < 0.5 && step % 15 == 0;
        let view = inside.then(|| bench.view(&[[x, 0.55]]));
        shown += u32::from(view.is_some());
        let out = bench.step(None, view.as_ref());
        for note in out.notes {
            if let crate::controller::Note::Scanned(result) = note {
                found = Some(result);
            }
        }
        if found.is_some() {
            break;
        }
    }
    let result = found.expect("once around");
    assert!(shown >= 2, "{shown}");
    let sectors = (0_usize..)
        .zip(result.classes)
        .filter(|(_, classes)| !classes.is_empty());
    let sectors: std::vec::Vec<_> = sectors.map(|(sector, _)| sector).collect();
    assert_eq!(sectors, [6]);
    assert!(result.classes[6].contains(Class::Obstacle));
    assert!(bench.now - Instant::BOOT < Duration::from_secs(12));
}
