//! `formation` with a shape: a line, a wedge, a lattice or a circle, which may move along a path.
//!
//! The places of a shape are the same for everyone, since all know its middle, its heading and its size. Of line, wedge
//! and lattice a place belongs to whoever is nearest to it, and everyone goes to the free place nearest to the middle
//! among its own and those next to it: see [`swarm`](crate::behaviour::swarm) for why that comes to rest without holes
//! and closes up when one is lost. On a circle everyone goes to the middle between the next two (Martínez and Bullo, "Optimal sensor
//! placement and motion coordination for target tracking", Automatica 42(4), 2006).
//!
//! The two arms of a line or a wedge are to be as long as each other. From the ends inwards everyone says how many robots
//! are beyond it, so the one in the middle knows both arms, and that is said from there to the ends. Whoever is at the end of an arm
//! that is longer by two goes over to the other one, one at a time: the one in the middle says so only while
//! nobody is missing of those that it has counted within [`MISSED`].
//!
//! The middle moves along the path: a virtual structure (Lewis and Tan, "High precision formation control of mobile
//! robots using virtual structures", Autonomous Robots 4, 1997) whose progress is agreed on among neighbours, with
//! feedback from the robots to it (Ren and Beard, "Decentralized scheme for spacecraft formation flying via the virtual
//! structure approach", J. Guidance 27(1), 2004). Everyone says how far along it takes the middle to be, and whether it is in its place. Who
//! is not takes over the farthest that it hears. Who is goes on while nobody near is out of place, and is never more
//! than [`LEAD_MM`] ahead of the hindmost that it hears: so all wait for who is held up, for [`PATIENCE`] at most.

mod arms;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{BehaviourName, Formation, Says, Shape};

use super::{MissionNews, Scene, Wish};
use crate::behaviour::swarm::{FULL, VAGUE, from, lattice};
use crate::motion::angle::{Angle, ONE_BITS, TURN, length, millimetres, turned, unit};
use crate::neighbours::Neighbour;
use arms::Arms;

/// Others that are looked at in one step.
const EACH: usize = 4;
/// How far a robot in its place may be ahead of another one along the path, in millimetres.
const LEAD_MM: i32 = 80;
/// The formation sets out when nobody near has been out of place for so long,
const CALM: Duration = Duration::from_secs(3);
/// and waits for nobody longer than this.
const PATIENCE: Duration = Duration::from_secs(20);
/// So long somebody who went over from one arm to the other may be missing.
const MISSED: Duration = Duration::from_secs(40);
/// Off its place by this a robot hurries, in millimetres.
const HURRY_MM: i32 = 250;
/// Within this of its place a robot has come to it, and beyond the other it has left it, in millimetres.
const IN_PLACE_MM: [i32; 2] = [120, 300];
/// A robot counts on the circle to make room for it from so near on, in millimetres.
const JOINS_MM: i32 = 700;
/// As far as a robot hears at least, in millimetres: who is not heard is no nearer along a circle.
const HEARS_MM: i32 = 2_000;
/// Share of the permitted speed at which the middle moves, as a shift: half.
const PACE: u32 = 1;
/// Farthest from the middle that is reckoned with, in millimetres.
const FARTHEST_MM: i32 = 28_000;
/// Distances in a shape are in 1/256 of its spacing.
const UNIT: i32 = lattice::ONE;
/// Within this of a place somebody stands in it.
const STANDS_IN: i32 = UNIT * 3 / 10;
/// So far beside them robots pass by others in their places.
const BESIDE: i32 = UNIT * 3 / 4;
/// √½ of that spacing.
const SLANT: i32 = 181;

/// Numbers of a place along two axes; a line and a wedge have one.
type Place = [i32; 2];

/// A robot in a formation.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Shaped {
    formation: Formation,
    /// Stands for it where only sameness counts.
    list: i32,
    /// Spacing or radius in millimetres.
    size: i32,
    /// Where the shape heads, as a direction in 1/[`ONE`](crate::motion::angle::ONE).
    ahead: [i32; 2],
    /// How far the middle is along the path, in millimetres,
    along: i32,
    /// and the way that it is on.
    way: Way,
    /// How long the path is.
    end: i32,
    /// Where the robot goes, from the middle in the axes of the shape, in millimetres.
    target: Option<[i32; 2]>,
    in_place: bool,
    goes: bool,
    /// Since when nobody near is out of place, itself included.
    calm: Option<Instant>,
    /// Since when it waits for somebody near.
    held: Option<Instant>,
    stepped: Option<Instant>,
    arms: Arms,
    /// On its way to the arm on this side.
    crosses: Option<i8>,
    /// The most robots beside it that the one in the middle has counted, and when.
    counted: Option<(u8, Instant)>,
    /// What it has seen of the others since it began to look.
    round: Round,
}

/// A straight part of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Way {
    /// Where it begins, in millimetres.
    from: [i32; 2],
    /// Its direction, likewise.
    ahead: [i32; 2],
    /// The path before it, and to its end, in millimetres.
    span: [i32; 2],
    /// Its number.
    number: u8,
}

/// What another robot of the same formation says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Heard {
    along: i32,
    in_place: bool,
    arms: Arms,
}

/// A look at all of the others.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Round {
    /// How many have been looked at.
    seen: u8,
    /// The place nearest to the robot when it began.
    here: Place,
    /// Which of that place and those next to it are somebody else's: a bit for each.
    taken: u8,
    /// The angles to the next one ahead on a circle and to the last one behind, in 1/65,536 of a turn.
    gaps: [i32; 2],
    /// The least and the farthest that others in their places are along the path.
    others: Option<[i32; 2]>,
    /// Whether one of them is out of place.
    waits: bool,
    /// What others say of the arms who stand in that place, and in the next ones on the side of higher and of lower numbers.
    beside: [Option<Arms>; 3],
}

impl Shaped {
    pub(super) fn new(formation: Formation) -> Self {
        let Formation {
            shape,
            size,
            heading,
            path,
        } = formation;
        let numbers = [size, heading];
        let numbers = numbers.iter().chain(path.as_slice().iter().flatten());
        let bytes = numbers.flat_map(|number| number.to_le_bytes());
        let hash = crate::neighbours::hash(bytes.chain([shape as u8]));
        let mut shaped = Self {
            formation,
            list: (hash & 0xFFFF) as i32,
            size: millimetres(size).clamp(500, 10_000),
            ahead: Angle::from_radians(heading).direction(),
            along: 0,
            way: Way {
                from: [0; 2],
                ahead: [0; 2],
                span: [0; 2],
                number: 0,
            },
            end: 0,
            target: None,
            in_place: false,
            goes: false,
            calm: None,
            held: None,
            stepped: None,
            arms: Arms::default(),
            crosses: None,
            counted: None,
            round: Round::default(),
        };
        let mut begins = 0;
        for number in 0..path.count().max(1) {
            begins = shaped.way(number, begins).span[1];
        }
        shaped.end = begins;
        shaped.way = shaped.way(0, 0);
        shaped
    }

    /// `[list, how far along, whether it is in its place, arms]`, without the last one of other shapes.
    pub(super) fn says(&self) -> Says {
        let place = i32::from(self.in_place);
        let all = [self.list, self.along, place, self.arms.word()];
        let count = if self.has_arms() { 4 } else { 3 };
        Says::new(
            BehaviourName::Formation,
            all.get(..count).unwrap_or_default(),
        )
    }

    const fn has_arms(&self) -> bool {
        matches!(self.formation.shape, Shape::Line | Shape::Wedge)
    }

    pub(super) fn step(&mut self, scene: &Scene<'_>) -> (Wish, Option<MissionNews>) {
        // Not sure of its place it would run into others that are elsewhere.
        if scene.pose.sigma > VAGUE {
            (self.in_place, self.goes) = (false, false);
            return (Wish::Rest, None);
        }
        self.go_on(scene);
        let own = [scene.pose.x, scene.pose.y].map(millimetres);
        let middle = self.middle();
        let at = [0, 1].map(|axis: usize| {
            let from = own[axis].saturating_sub(middle[axis]);
            from.clamp(-FARTHEST_MM, FARTHEST_MM)
        });
        let at = turned(at, self.ahead);
        if self.round.seen == 0 {
            self.round = Round {
                here: self.nearest(self.units(at)),
                gaps: [i32::MAX; 2],
                ..Round::default()
            };
        }
        if usize::from(self.round.seen) < scene.near.len() {
            self.look(scene, own, at);
        } else {
            self.decide(at, scene.now);
            self.round.seen = 0;
        }
        let wish = self.target.map_or(Wish::Rest, |to| {
            let off = [0, 1].map(|axis: usize| to[axis] - at[axis]);
            Wish::Velocity(self.wish(off))
        });
        (wish, None)
    }

    /// Moves the middle on.
    fn go_on(&mut self, scene: &Scene<'_>) {
        let before = self.stepped.replace(scene.now);
        let Some(before) = before.filter(|_| self.goes) else {
            return;
        };
        // At most a tenth of a second, and 10 m/s.
        let micros = (scene.now - before).as_micros().min(100_000) as i32;
        let pace = millimetres(scene.speed).min(10_000) >> PACE;
        self.reach(self.along + pace * (micros >> 6) / 15_625);
    }

    /// Takes the middle to be so far along the path, but no farther than to the end of the next part of it.
    fn reach(&mut self, along: i32) {
        let ends = self.way.span[1];
        if along > ends && ends < self.end {
            self.way = self.way(self.way.number + 1, ends);
        }
        self.along = along.min(self.way.span[1]);
    }

    /// The way of this number, which begins so far along the path.
    fn way(&self, number: u8, begins: i32) -> Way {
        let path = self.formation.path.as_slice();
        let place = |number: usize| path.get(number).map(|place| place.map(millimetres));
        let from = place(number.into()).unwrap_or_default();
        let to = place(usize::from(number) + 1).unwrap_or(from);
        let way = [0, 1].map(|axis: usize| to[axis].saturating_sub(from[axis]));
        Way {
            from,
            ahead: if way == [0; 2] { way } else { unit(way) },
            span: [begins, begins.saturating_add(length(way))],
            number,
        }
    }

    /// Where the middle is, in millimetres.
    fn middle(&self) -> [i32; 2] {
        let done = i64::from(self.along - self.way.span[0]);
        [0, 1].map(|axis: usize| {
            let way = (i64::from(self.way.ahead[axis]) * done) >> ONE_BITS;
            self.way.from[axis].saturating_add(way as i32)
        })
    }

    /// The wanted velocity of a robot that is so far off, in the axes of the shape, in 1/[`FULL`] of the permitted speed.
    fn wish(&self, off: [i32; 2]) -> [i32; 2] {
        let [x, y] = off.map(|off| off.clamp(-8 * HURRY_MM, 8 * HURRY_MM) * FULL / HURRY_MM);
        // Back to the axes of the floor.
        let wish = turned([x, y], [self.ahead[0], -self.ahead[1]]);
        let pace = if self.goes { FULL >> (PACE + 1) } else { 0 };
        [0, 1].map(|axis: usize| wish[axis] + ((self.way.ahead[axis] * pace) >> ONE_BITS))
    }

    /// Looks at the next few of the others.
    fn look(&mut self, scene: &Scene<'_>, own: [i32; 2], own_at: [i32; 2]) {
        let own_units = self.units(own_at);
        let here = self.round.here;
        for other in scene.near.iter().skip(self.round.seen.into()).take(EACH) {
            let said = self.heard(other);
            match said {
                Some(Heard {
                    along,
                    in_place: true,
                    ..
                }) => {
                    let [least, most] = self.round.others.unwrap_or([along; 2]);
                    self.round.others = Some([least.min(along), most.max(along)]);
                }
                Some(_) => self.round.waits = true,
                None => {}
            }
            let Some(way) = from(own, other) else {
                continue;
            };
            let way = turned(way, self.ahead);
            let at = [0, 1].map(|axis: usize| own_at[axis] + way[axis]);
            if self.formation.shape == Shape::Circle {
                if said.is_some() {
                    self.meet(own_at, at, other.who > scene.own);
                }
                continue;
            }
            let units = self.units(at);
            let its = self.nearest(units);
            let step = [its[0] - here[0], its[1] - here[1]];
            let next = self.next().iter().position(|next| *next == step);
            let Some(index) = next else {
                continue;
            };
            let place = self.position(its);
            let away = off(units, place);
            if let Some(said) = said
                && let Some(beside) = self.round.beside.get_mut(index)
                && away < STANDS_IN * STANDS_IN
            {
                *beside = Some(said.arms);
            }
            // Whoever is not in the formation has a place that it stands in, but takes none away.
            let takes = match said {
                Some(_) => away < off(own_units, place),
                None => index > 0 && away < STANDS_IN * STANDS_IN,
            };
            self.round.taken |= u8::from(takes) << index;
        }
        self.round.seen = self.round.seen.saturating_add(EACH as u8);
    }

    /// What another robot says, when it is of the same formation.
    fn heard(&self, other: &Neighbour) -> Option<Heard> {
        let said = other.says.as_ref()?.by(BehaviourName::Formation)?;
        match said {
            [list, along, place, arms @ ..] if *list == self.list => Some(Heard {
                along: *along,
                in_place: *place == 1,
                arms: Arms::of_word(arms.first().copied().unwrap_or_default()),
            }),
            _ => None,
        }
    }

    /// Takes in that another robot is at `at`, for the gaps on a circle. Of two at one angle the one with the larger name
    /// is ahead.
    fn meet(&mut self, own: [i32; 2], at: [i32; 2], larger: bool) {
        if (length(at) - self.size).abs() > JOINS_MM {
            return;
        }
        let angle = Angle::of(at).minus(Angle::of(own));
        let ahead = i32::from(angle.units()).rem_euclid(TURN);
        let ahead = if ahead == 0 && !larger { TURN } else { ahead };
        let [before, behind] = &mut self.round.gaps;
        *before = (*before).min(ahead);
        *behind = (*behind).min(TURN - ahead);
    }

    /// Where to go, and whether the middle goes on, once all of the others have been looked at.
    fn decide(&mut self, at: [i32; 2], now: Instant) {
        let (target, kept) = if self.formation.shape == Shape::Circle {
            self.on_circle(at)
        } else {
            self.among_places(at)
        };
        self.target = Some(target);
        let off = [0, 1].map(|axis: usize| target[axis] - at[axis]);
        let within = IN_PLACE_MM[usize::from(self.in_place)];
        self.in_place = kept && length(off) <= within;
        if self.has_arms() {
            self.count(now);
        }
        let others = self.round.others;
        if !self.in_place {
            (self.calm, self.goes) = (None, false);
            if let Some([_, most]) = others
                && most > self.along
                && most <= self.end
            {
                self.reach(most);
            }
            return;
        }
        if self.round.waits {
            self.calm = None;
            self.held.get_or_insert(now);
        } else {
            self.calm.get_or_insert(now);
        }
        let calm = self.calm.is_some_and(|since| now - since >= CALM);
        if calm {
            self.held = None;
        }
        let tired = self.held.is_some_and(|since| now - since >= PATIENCE);
        let hindmost = others.map_or(i32::MAX, |[least, _]| least.saturating_add(LEAD_MM));
        self.goes = (calm || tired) && self.along < hindmost && self.along < self.end;
    }

    /// Takes in how long the arms are, and sets out for the other one where that is shorter.
    fn count(&mut self, now: Instant) {
        if !self.in_place {
            self.arms = Arms::default();
            self.counted = None;
            return;
        }
        let here = self.round.here[0];
        let [_, above, below] = self.round.beside;
        let beyond =
            [above, below].map(|next| next.map_or(0, |next| next.beyond.saturating_add(1)));
        if here == 0 {
            let all = beyond[0].saturating_add(beyond[1]);
            let before = self.counted.filter(|(_, at)| now - *at < MISSED);
            let settled = before.is_some_and(|(most, _)| all >= most);
            if settled || before.is_none() {
                self.counted = Some((all, now));
            }
            self.arms = Arms {
                beyond: 0,
                both: beyond,
                settled,
            };
            return;
        }
        self.counted = None;
        let (out, inwards) = if here > 0 { (0, below) } else { (1, above) };
        let told = inwards.unwrap_or_default();
        self.arms = Arms {
            beyond: beyond[out],
            ..told
        };
        self.crosses = self.arms.other_side(here);
        self.in_place = self.crosses.is_none();
    }

    /// The free place nearest to the middle, of its own and those next to it, and whether its own is its.
    fn among_places(&mut self, at: [i32; 2]) -> ([i32; 2], bool) {
        let own = self.units(at);
        let here = self.round.here;
        if let Some(side) = self.crosses {
            let over = here[0] * i32::from(side) > 0;
            if over && self.round.taken & 1 == 0 {
                self.crosses = None;
            } else {
                return (self.beside(here[0] + i32::from(side), own, here), false);
            }
        }
        let homeless = self.round.taken & 1 != 0;
        if let (true, Some(arms)) = (homeless, self.round.beside[0])
            && self.crosses.is_none()
        {
            self.crosses = arms.shorter(here[0]);
        }
        let free = (0_u8..).zip(self.next());
        let free = free.filter(|(index, _)| self.round.taken & 1 << index == 0);
        let places = free.map(|(_, step)| [here[0] + step[0], here[1] + step[1]]);
        // Who has none goes to the nearest one first: another may be behind somebody.
        let best = places.min_by_key(|place| {
            let rank = if homeless { 0 } else { lattice::rank(*place) };
            (rank, off(own, self.position(*place)))
        });
        let target = match best {
            Some(place) => self.millimetres(self.position(place)),
            None => self.outwards(here, own),
        };
        (target, !homeless && best == Some(here))
    }

    /// Where a robot goes that has no place: out along the arm beside the others, or between two of the places around.
    fn outwards(&self, here: Place, own: [i32; 2]) -> [i32; 2] {
        if self.formation.shape == Shape::Lattice {
            let steps = lattice::BETWEEN.iter();
            let places = steps.map(|step| [here[0] + step[0], here[1] + step[1]]);
            let out = places.max_by_key(|place| lattice::rank(*place));
            return self.millimetres(self.position(out.unwrap_or(here)));
        }
        // From the middle to the side where it is.
        let is_left = if here[0] == 0 {
            own[1] >= 0
        } else {
            here[0] > 0
        };
        let out = if is_left { here[0] + 1 } else { here[0] - 1 };
        self.beside(out, own, here)
    }

    /// Beside a place, on the side of the arm where the robot is that is nearest to `here`.
    fn beside(&self, number: i32, own: [i32; 2], here: Place) -> [i32; 2] {
        // Ahead, across the arm.
        let across = match (self.formation.shape, number) {
            (Shape::Wedge, 0..) => [SLANT, SLANT],
            (Shape::Wedge, _) => [SLANT, -SLANT],
            (Shape::Line | Shape::Circle | Shape::Lattice, _) => [UNIT, 0],
        };
        let from = self.position(here);
        let off = (own[0] - from[0]) * across[0] + (own[1] - from[1]) * across[1];
        let beside = if off >= 0 { BESIDE } else { -BESIDE };
        let to = self.position([number, 0]);
        let at = [0, 1].map(|axis: usize| to[axis] + ((beside * across[axis]) >> 8));
        self.millimetres(at)
    }

    /// The place on the circle in the middle between the next two, as far as they are heard, and whether that is near.
    fn on_circle(&self, at: [i32; 2]) -> ([i32; 2], bool) {
        // An arc as long as a robot hears.
        let deaf = (HEARS_MM * 10_430 / self.size).min(TURN / 2);
        let [before, behind] = self.round.gaps.map(|gap| gap.min(deaf));
        // Half of the way there: the other two move as well. At most an eighth of a turn.
        let turn = (before - behind) / 4;
        let to = Angle::of(at).plus(Angle::from_units(turn as i16));
        let target = to.direction().map(|along| (along * self.size) >> ONE_BITS);
        (target, true)
    }

    /// In 1/[`UNIT`] of the spacing.
    fn units(&self, at: [i32; 2]) -> [i32; 2] {
        at.map(|along| along.clamp(-FARTHEST_MM, FARTHEST_MM) * UNIT / self.size)
    }

    fn millimetres(&self, units: [i32; 2]) -> [i32; 2] {
        units.map(|along| along * self.size / UNIT)
    }

    /// Steps to a place itself and to those next to it.
    const fn next(&self) -> &'static [Place] {
        match self.formation.shape {
            Shape::Lattice => &lattice::AROUND,
            Shape::Line | Shape::Wedge | Shape::Circle => &[[0, 0], [1, 0], [-1, 0]],
        }
    }

    fn nearest(&self, [x, y]: [i32; 2]) -> Place {
        let round = |along: i32| (along + UNIT / 2).div_euclid(UNIT);
        match self.formation.shape {
            Shape::Lattice => lattice::nearest([x, y]),
            Shape::Line | Shape::Circle => [round(y), 0],
            Shape::Wedge => {
                let along = round(((y.abs() - x) * SLANT) >> 8).max(0);
                [if y < 0 { -along } else { along }, 0]
            }
        }
    }

    /// In 1/[`UNIT`] of the spacing.
    const fn position(&self, [a, b]: Place) -> [i32; 2] {
        match self.formation.shape {
            Shape::Lattice => lattice::position([a, b]),
            Shape::Line | Shape::Circle => [0, a * UNIT],
            Shape::Wedge => [-a.abs() * SLANT, a * SLANT],
        }
    }
}

/// Square of a distance.
const fn off([x, y]: [i32; 2], [to_x, to_y]: [i32; 2]) -> i32 {
    (x - to_x) * (x - to_x) + (y - to_y) * (y - to_y)
}

#[cfg(test)]
mod tests;
