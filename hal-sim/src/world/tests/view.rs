//! What robots see of each other and of the things between them.

use super::*;
use crate::render::{Frame, Seen};

fn object(shape: ObjectShape, x: f32, y: f32, colour: Colour) -> Object {
    Object {
        shape,
        x,
        y,
        size: 0.12,
        colour,
    }
}

fn look(arena: Arena, robots: &[Pose]) -> Frame {
    let mut bench = TestWorld::new(arena, alike(), 1);
    for pose in robots {
        bench.add(pose.x, pose.y, pose.theta);
    }
    let mut frame = Frame::square();
    assert!(bench.world.render(RobotIndex::new(0), &mut frame));
    assert!(!bench.world.render(RobotIndex::new(99), &mut frame));
    frame
}

fn place_of(frame: &Frame, of: Seen) -> Option<[f32; 2]> {
    let spots = frame.spots();
    let spot = spots.iter().find(|spot| spot.of == of)?;
    Some([spot.x, spot.y])
}

#[test]
fn a_robot_ahead_is_seen_where_it_stands_and_where_it_looks() {
    let eye = Pose::new(-1.0, 0.5, 0.4);
    let ahead = |along: f32, aside: f32, theta: f32| {
        let place = Vec2::new(along, aside).out_of_frame(Vec2::unit(eye.theta));
        Pose::new(eye.x + place.x, eye.y + place.y, theta)
    };
    let frame = look(Arena::empty(6.0, 6.0), &[eye, ahead(1.0, 0.2, 0.0)]);
    let [x, y] = place_of(&frame, Seen::Robot(1)).expect("it is seen");
    // Focal length 83 pixels; 60 mm is the middle of what shows, 70 mm the height of the lens.
    assert!((x - (48.0 - 0.2 * 83.1)).abs() < 1.5, "{x}");
    assert!((y - (48.0 + 0.01 * 83.1)).abs() < 1.5, "{y}");
    let behind = look(Arena::empty(6.0, 6.0), &[eye, ahead(-0.5, 0.0, 0.0)]);
    assert_eq!(place_of(&behind, Seen::Robot(1)), None);
    // Its front is lighter than its back.
    let light = |theta: f32| {
        let frame = look(Arena::empty(6.0, 6.0), &[eye, ahead(0.6, 0.0, theta)]);
        let colour = frame.colour(48, 49).expect("within the frame");
        colour.map(u32::from).iter().sum::<u32>()
    };
    let turned = eye.theta + core::f32::consts::PI;
    assert!(light(turned) > light(eye.theta) + 100);
}

#[test]
fn things_are_seen_in_their_colours_and_hide_each_other() {
    let mut arena = Arena::empty(6.0, 6.0);
    arena.objects = vec![
        object(ObjectShape::Ball, 1.0, 0.25, Colour::Red),
        object(ObjectShape::Box, 1.0, -0.25, Colour::Green),
        object(ObjectShape::Cone, 2.0, 0.0, Colour::Blue),
    ];
    let eye = Pose::new(0.0, 0.0, 0.0);
    let frame = look(arena.clone(), &[eye]);
    for (index, channel) in [(0, 0), (1, 1), (2, 2)] {
        let [x, y] = place_of(&frame, Seen::Object(index)).expect("it is seen");
        let colour = frame.colour(x as u16, y as u16).expect("within the frame");
        let most = colour.iter().max().expect("three");
        assert_eq!(colour[channel], *most, "object {index}: {colour:?}");
    }
    arena.obstacles = vec![Obstacle::Box {
        x: 1.5,
        y: 0.0,
        w: 0.1,
        h: 0.3,
        theta: 0.0,
    }];
    let hidden = look(arena, &[eye]);
    assert_eq!(place_of(&hidden, Seen::Object(2)), None);
    assert!(place_of(&hidden, Seen::Obstacle(0)).is_some());
    assert!(
        place_of(&hidden, Seen::Object(0)).is_some(),
        "objects keep their numbers"
    );
}

#[test]
fn a_picture_depends_on_the_world_alone() {
    let mut arena = Arena::empty(6.0, 6.0);
    arena.objects = vec![object(ObjectShape::Ball, 1.0, 0.1, Colour::Yellow)];
    let robots = [Pose::new(0.0, 0.0, 0.1), Pose::new(1.2, -0.3, 2.0)];
    let one = look(arena.clone(), &robots);
    let two = look(arena, &robots);
    assert_eq!(one.rgb(), two.rgb());
}

#[test]
fn a_ranger_hears_objects() {
    let mut arena = Arena::empty(10.0, 10.0);
    arena.objects = vec![object(ObjectShape::Cylinder, 0.0, 2.06, Colour::White)];
    let mut bench = TestWorld::new(arena, alike(), 1);
    bench.add(0.0, 1.0, core::f32::consts::FRAC_PI_2);
    let told = bench.world.true_range(RobotIndex::new(0));
    assert!(
        told.is_some_and(|range| (range - 0.94).abs() < 1e-3),
        "{told:?}"
    );
}
