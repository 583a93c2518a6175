//! Random scenes as a robot sees them, with the truth about each: what a detector learns from and
//! is judged by.
//!
//! A frame depends on the seed, the split and its number, on nothing else. The splits share no
//! scenes. The test split also has floors and walls that the others do not show, and the `wild`
//! profile throughout.

pub mod scores;

use rand_core::Rng;
use rand_pcg::Pcg32;

use crate::render::{Decor, Floor, Frame, Motion, Seen, Truth, Wall, picture_key};
use crate::world::{
    Arena, Colour, Look, Object, ObjectShape, Obstacle, Parameters, Pose, Profile, Solid, Vec2,
    mix, uniform,
};

/// Colours of objects. White and black are left to floors, walls and robots.
const COLOURS: [Colour; 6] = [
    Colour::Red,
    Colour::Green,
    Colour::Blue,
    Colour::Yellow,
    Colour::Orange,
    Colour::Purple,
];
const SHAPES: [ObjectShape; 4] = [
    ObjectShape::Cylinder,
    ObjectShape::Box,
    ObjectShape::Ball,
    ObjectShape::Cone,
];

/// Distance between the lens and the surface of a thing, metres.
const NEAREST_M: f32 = 0.15;
const FARTHEST_M: f32 = 3.0;
/// Things stand at least this far apart, metres.
const APART_M: f32 = 0.06;
/// Most things of a scene.
const MOST: u32 = 6;

/// A part of a data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Split {
    /// To learn from.
    Train,
    /// To choose by, alike.
    Check,
    /// To be judged by: other seeds, other floors and walls, `wild`.
    Test,
}

impl Split {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Train, Self::Check, Self::Test];

    /// Name of its folder.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Check => "check",
            Self::Test => "test",
        }
    }

    /// Whether its pictures may look like this.
    fn allows(self, decor: &Decor) -> bool {
        let unseen = matches!(decor.floor(), Floor::Concrete | Floor::Terrazzo);
        match self {
            Self::Train | Self::Check => !unseen && decor.wall() != Wall::Bricks,
            Self::Test => unseen,
        }
    }
}

/// What a detector is to call a thing; `None` for what it is not to find.
pub const fn class(of: Seen) -> Option<&'static str> {
    match of {
        Seen::Sky | Seen::Floor | Seen::Wall => None,
        Seen::Obstacle(_) | Seen::Mover(_) => Some("obstacle"),
        Seen::Object(_) => Some("object"),
        Seen::Robot(_) => Some("robot"),
    }
}

/// Draws picture `number` of a split, and tells what it shows.
pub fn picture(seed: u64, split: Split, number: u32, frame: &mut Frame) -> Vec<Truth> {
    let place = (split as u64) << 32 | u64::from(number);
    let mut dice = Dice(Pcg32::new(mix(seed ^ mix(place)), place));
    let parameters = dice.parameters(split);
    dice.scene(&parameters).draw(&parameters, frame);
    frame.truths()
}

/// What stands in a room, around an eye.
struct Scene {
    arena: Arena,
    eye: Pose,
    robots: Vec<Pose>,
    motion: Motion,
}

impl Scene {
    /// The same picture that a [`World`](crate::devices::World) gives of the arena, where the eye is
    /// robot 0; without the cost of one.
    fn draw(&self, parameters: &Parameters, frame: &mut Frame) {
        let mut scene = core::mem::take(&mut frame.scene);
        scene.begin(self.eye, parameters, &self.arena);
        for (index, obstacle) in (0..).zip(&self.arena.obstacles) {
            scene.add_solid(&Solid::new(obstacle), Seen::Obstacle(index));
        }
        for (index, object) in (0..).zip(&self.arena.objects) {
            scene.add_object(object, index);
        }
        for (index, &robot) in (1..).zip(&self.robots) {
            scene.add_robot(robot, parameters.chassis.radius_m, index);
        }
        frame.scene = scene;
        frame.take(self.motion, picture_key(&parameters.look, 0, 0));
    }
}

/// A thing that found no room yet.
#[derive(Clone, Copy)]
enum Thing {
    Obstacle(Obstacle),
    Object(Object),
    Robot(f32),
}

impl Thing {
    /// Radius of a disc around it.
    fn reach(&self, robot_m: f32) -> f32 {
        match *self {
            Self::Obstacle(Obstacle::Circle { r, .. }) => r,
            Self::Obstacle(Obstacle::Box { w, h, .. }) => Vec2::new(w, h).length() * 0.5,
            Self::Object(Object { shape, size, .. }) => match shape {
                ObjectShape::Box => size * core::f32::consts::FRAC_1_SQRT_2,
                ObjectShape::Cylinder | ObjectShape::Ball | ObjectShape::Cone => size * 0.5,
            },
            Self::Robot(_) => robot_m,
        }
    }
}

struct Dice(Pcg32);

impl Dice {
    fn between(&mut self, least: f32, most: f32) -> f32 {
        least + (most - least) * uniform(&mut self.0)
    }

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.0.next_u32() as usize % all.len()]
    }

    fn angle(&mut self) -> f32 {
        self.between(-core::f32::consts::PI, core::f32::consts::PI)
    }

    fn parameters(&mut self, split: Split) -> Parameters {
        let profile = match (split, self.0.next_u32() % 100) {
            (Split::Test, _) | (_, 50..) => Profile::Wild,
            (_, 15..50) => Profile::Mild,
            // Worlds that are not randomised have to be understood as well.
            (_, ..15) => return Parameters::default(),
        };
        let mut parameters = Parameters::default().randomised(profile, self.0.next_u64());
        while !split.allows(&Decor::new(&parameters.look)) {
            parameters.look = Look {
                seed: self.0.next_u32() >> 8,
                ..parameters.look
            };
        }
        parameters
    }

    fn scene(&mut self, parameters: &Parameters) -> Scene {
        let robot_m = parameters.chassis.radius_m;
        let mut arena = Arena::empty(self.between(1.5, 7.0), self.between(1.5, 7.0));
        if self.0.next_u32() % 100 < 25 {
            arena.paint = Some(self.of(&COLOURS));
        }
        let half = [arena.width * 0.5, arena.height * 0.5];
        let margin = robot_m + 0.05;
        let within = |dice: &mut Self, half: f32| dice.between(margin - half, half - margin);
        let (x, y) = (within(self, half[0]), within(self, half[1]));
        let eye = Pose::new(x, y, self.angle());
        let mut scene = Scene {
            arena,
            eye,
            robots: Vec::new(),
            motion: self.motion(),
        };
        let lens = eye
            .position()
            .plus(Vec2::unit(eye.theta).times(parameters.camera.forward_m));
        let mut taken = vec![(eye.position(), robot_m)];
        let wanted = match self.0.next_u32() % 100 {
            ..8 => 0,
            _ => 1 + self.0.next_u32() % MOST,
        };
        for _ in 0..wanted {
            let thing = self.thing();
            let reach = thing.reach(robot_m);
            for _ in 0..20 {
                let share = uniform(&mut self.0);
                let away = NEAREST_M + (FARTHEST_M - NEAREST_M) * share * share.sqrt() + reach;
                let sweep = parameters.camera.half_view + 0.1;
                let bearing = eye.theta + self.between(-sweep, sweep);
                let at = lens.plus(Vec2::unit(bearing).times(away));
                let inside = at.x.abs() + reach < half[0] && at.y.abs() + reach < half[1];
                let free = taken
                    .iter()
                    .all(|&(other, radius)| other.minus(at).length() > radius + reach + APART_M);
                if inside && free {
                    taken.push((at, reach));
                    scene.put(thing, at);
                    break;
                }
            }
        }
        scene
    }

    fn motion(&mut self) -> Motion {
        match self.0.next_u32() % 3 {
            0 => Motion::default(),
            1 => Motion {
                v: self.between(-0.15, 0.4),
                w: self.between(-0.3, 0.3),
            },
            _ => Motion {
                v: 0.0,
                w: self.between(-1.8, 1.8),
            },
        }
    }

    fn thing(&mut self) -> Thing {
        let (x, y) = (0.0, 0.0);
        match self.0.next_u32() % 100 {
            ..18 => Thing::Obstacle(Obstacle::Circle {
                x,
                y,
                r: self.between(0.07, 0.2),
            }),
            18..38 => Thing::Obstacle(Obstacle::Box {
                x,
                y,
                w: self.between(0.12, 0.45),
                h: self.between(0.12, 0.45),
                theta: self.angle(),
            }),
            38..72 => Thing::Object(Object {
                shape: self.of(&SHAPES),
                x,
                y,
                size: self.between(0.06, 0.16),
                colour: self.of(&COLOURS),
            }),
            72.. => Thing::Robot(self.angle()),
        }
    }
}

impl Scene {
    fn put(&mut self, thing: Thing, at: Vec2) {
        match thing {
            Thing::Obstacle(Obstacle::Circle { r, .. }) => {
                let (x, y) = (at.x, at.y);
                self.arena.obstacles.push(Obstacle::Circle { x, y, r });
            }
            Thing::Obstacle(Obstacle::Box { w, h, theta, .. }) => {
                let (x, y) = (at.x, at.y);
                let put = Obstacle::Box { x, y, w, h, theta };
                self.arena.obstacles.push(put);
            }
            Thing::Object(object) => self.arena.objects.push(Object {
                x: at.x,
                y: at.y,
                ..object
            }),
            Thing::Robot(theta) => self.robots.push(Pose::new(at.x, at.y, theta)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::devices::World;
    use crate::sched::SimClock;

    #[test]
    fn a_world_gives_the_same_pictures() {
        let (mut one, mut two) = (Frame::square(), Frame::square());
        let mut shown = 0;
        for number in 0..60 {
            let mut dice = Dice(Pcg32::new(number, 3));
            let parameters = dice.parameters(Split::Test);
            let scene = dice.scene(&parameters);
            scene.draw(&parameters, &mut one);
            let clock = SimClock::new();
            let mut world = World::with_parameters(scene.arena.clone(), parameters, 1, &clock)
                .expect("a sound arena");
            let (eye, _) = world.add_robot(scene.eye).expect("free");
            for &robot in &scene.robots {
                let (_, _) = world.add_robot(robot).expect("free");
            }
            assert!(world.render_moving(eye, scene.motion, &mut two));
            assert_eq!(one.spots(), two.spots(), "{number}");
            assert!(one.rgb() == two.rgb(), "{number}");
            shown += one.spots().len();
        }
        assert!(shown > 60, "{shown}");
    }

    #[test]
    fn a_picture_comes_from_seed_split_and_number_alone() {
        let mut fresh = Frame::square();
        let mut used = Frame::square();
        for number in 0..30 {
            let one = picture(7, Split::Train, number, &mut fresh);
            let _ = picture(8, Split::Test, number, &mut used);
            assert!(used.rgb() != fresh.rgb(), "{number}");
            let two = picture(7, Split::Train, number, &mut used);
            assert_eq!(one, two);
            assert_eq!(fresh.rgb(), used.rgb());
            fresh = Frame::square();
        }
    }

    #[test]
    fn the_test_split_shows_floors_that_the_others_do_not() {
        let floors = |split| {
            let mut floors: Vec<Floor> = Vec::new();
            for number in 0..300 {
                let mut dice = Dice(Pcg32::new(number, 1));
                let look = dice.parameters(split).look;
                assert!(split != Split::Test || look.variety >= 0.3);
                let floor = Decor::new(&look).floor();
                if !floors.contains(&floor) {
                    floors.push(floor);
                }
            }
            floors
        };
        let (train, test) = (floors(Split::Train), floors(Split::Test));
        assert_eq!((train.len(), test.len()), (7, 2));
        assert!(test.iter().all(|floor| !train.contains(floor)));
    }

    #[test]
    fn there_is_some_of_everything() {
        let mut frame = Frame::square();
        let mut classes = std::collections::BTreeMap::new();
        let (mut hidden, mut cut, mut empty) = (0, 0, 0);
        for number in 0..400 {
            let truths = picture(1, Split::Train, number, &mut frame);
            empty += usize::from(truths.is_empty());
            for truth in truths {
                let class = class(truth.spot.of).expect("a thing");
                *classes.entry(class).or_insert(0) += 1;
                hidden += usize::from(truth.visible < 0.9);
                cut += usize::from(truth.inside < 0.9);
                assert!(truth.visible > 0.0 && truth.visible <= 1.0, "{truth:?}");
                assert!(truth.inside > 0.0 && truth.inside <= 1.0, "{truth:?}");
            }
        }
        assert_eq!(classes.len(), 3);
        assert!(classes.values().all(|&count| count > 100), "{classes:?}");
        assert!(
            hidden > 30 && cut > 30 && empty > 10,
            "{hidden} {cut} {empty}"
        );
    }
}
