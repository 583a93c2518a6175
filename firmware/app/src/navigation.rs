//! Finding the way: a map of what the ranger has shown, and a plan over it.
//!
//! [`Navigator`] is a value that does no I/O and draws no random number. The sense activity feeds it
//! every look of the ranger, has it plan in slices between which others run, and leaves for control
//! what comes of it: a [`Guide`], the point to drive to next. docs/navigation.md has the rule, why it ends, and
//! what it takes.
//!
//! # Reading order
//! `map`, what is where; `wave`, the way over it; `here`, when to plan anew; `next`, which point of the way is next;
//! `excerpt`, what is told of map and plan.

mod excerpt;
mod map;
mod next;
#[cfg(test)]
mod tests;
mod wave;

pub use excerpt::{EXCERPT_BYTES, EXCERPT_ROWS, Excerpt, WAY_POINTS};
use heapless::Vec;
use map::is_inside;
pub use map::{CELL_MM, COLUMNS, Cell, Look, Map, Place, ROWS};
use wave::{OTHERS, Source, Spread, Wave};

/// Robots should be within so many millimetres of where they are told to be: they are told twice a second.
const BLUR_MM: i32 = 250;
/// Radius of a robot, in millimetres.
const BODY_MM: i32 = 85;
/// From the middle of the robot to its ranger, in millimetres.
const MOUNT_MM: i32 = 60;
/// A plan is made anew after so many looks when the map has changed, and after so many in any case.
const PLAN_EVERY: u8 = 3;
const PLAN_AT_LAST: u8 = 12;
/// So often everything known may fade before there is said to be no way.
const FADES: u8 = 2;
/// Cells between the robot and the border of the window when it is moved, where the goal is beyond.
const AROUND: i32 = 20;
/// Cells left between the border of the window and the robot or the goal.
const RIM: i32 = 2;
/// So many cells the robot goes before the window moves, where the goal is beyond.
const SCROLL_AFTER: i32 = 16;
/// A goal beyond the window is approached by its border within so many cells of it.
const BORDER: i32 = 15;
/// Farther than this nothing moves between two looks: the coordinates were off, in millimetres.
const JUMP_MM: i32 = 250;
/// When they were off by more than this, or were turned, nothing known is of use.
const LOST_MM: i32 = 1_500;
/// Sine of a turn, in 4096ths, that is no turn of the robot's between two looks when it has jumped.
const TURNED: i32 = 600;
/// Something nearer than this holds the robot up, in millimetres from its ranger: a little more than what it
/// stops for by default.
const HELD_UP_MM: i32 = 280;
/// For so many looks it may go away by itself.
const HELD_UP_LOOKS: u8 = 6;

/// How a way is looked for, one after the other: so many cells away from what is blocked, and round robots that
/// stand or not.
const ATTEMPTS: [(u8, bool); 4] = [(2, true), (1, true), (1, false), (0, false)];
/// From this one on a goal beyond the window is looked for by all of its border.
const ALL_ROUND: u8 = 3;
/// Robots farther away than this, in millimetres, are nobody's business.
const NEAR_MM: i32 = 3_000;
/// Slower than this a robot stands, in millimetres per second.
const STANDING_MM: i32 = 50;

/// Another robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Other {
    /// Where it should be, in millimetres.
    pub at: [i32; 2],
    /// Millimetres per second along both axes.
    pub velocity: [i32; 2],
}

impl Other {
    fn stands(&self) -> bool {
        self.velocity.iter().all(|along| along.abs() < STANDING_MM)
    }
}

/// A place to go to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Destination {
    /// Another one for each order.
    pub number: u16,
    /// Millimetres along both axes.
    pub at: [i32; 2],
    /// How fast the robot drives there, in millimetres per second.
    pub speed: i32,
    /// How often something has kept the robot from driving on that the ranger does not see.
    pub bumps: u8,
}

/// Where to drive next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// Straight to this point, in millimetres, which may be the destination.
    To([i32; 2]),
    /// There is no way.
    Nowhere,
}

/// The plan as control has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Guide {
    /// [`Destination::number`].
    pub number: u16,
    /// What to do about it.
    pub way: Way,
}

/// What a slice of planning came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Planned {
    /// There is more to do.
    Goes,
    /// This.
    Guide(Guide),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// There is no plan.
    None,
    /// The wave spreads.
    Spreads,
    /// The wave has reached the robot.
    Stands,
}

/// Map and plan: under 4 KB.
#[derive(Debug, Clone)]
pub struct Navigator {
    map: Map,
    wave: Wave,
    here: Place,
    going: Option<Destination>,
    others: Vec<Other, OTHERS>,
    stage: Stage,
    /// Which way to plan is tried, and which is the first: what once led nowhere is not gone back to, or the robot
    /// would turn round between two ways, each of which is there only from the other.
    attempt: u8,
    first: u8,
    fades: u8,
    /// The point to drive to next, and for how many looks something has been in front of it.
    next: [i32; 2],
    held: u8,
    /// Looks since the last plan began.
    looks: u8,
    /// The cell of the robot, from the origin of coordinates, when the window was placed.
    placed: Option<Cell>,
}

impl Navigator {
    /// One that knows nothing. All of it is zeros, so that no board keeps a copy in flash.
    pub const BLANK: Self = Self {
        map: Map::BLANK,
        wave: Wave::BLANK,
        here: Place {
            at: [0; 2],
            heading: [0; 2],
        },
        going: None,
        others: Vec::new(),
        stage: Stage::None,
        attempt: 0,
        first: 0,
        fades: 0,
        next: [0; 2],
        held: 0,
        looks: 0,
        placed: None,
    };

    /// Forgets everything.
    pub fn forget(&mut self) {
        self.map.clear();
        self.going = None;
        self.stage = Stage::None;
        self.placed = None;
    }

    /// What is known.
    pub const fn map(&self) -> &Map {
        &self.map
    }

    /// Takes in where the robot is and where it is to go.
    pub fn set_out(&mut self, here: Place, going: Destination) {
        self.stay_true(&here);
        self.here = here;
        match self.going.replace(going) {
            Some(before) if before.number == going.number => {
                if before.bumps != going.bumps {
                    self.bump();
                }
            }
            Some(_) | None => {
                self.stage = Stage::None;
                self.fades = 0;
                self.first = 0;
                self.held = 0;
            }
        }
        self.place_window(going);
        self.looks = self.looks.saturating_add(1);
        let changed = self.map_has_changed() || !self.others.is_empty();
        let due = changed && self.looks >= PLAN_EVERY || self.looks >= PLAN_AT_LAST;
        if self.stage == Stage::None || self.stage == Stage::Stands && due {
            self.begin_anew();
        }
    }

    /// Takes in who is near.
    pub fn meet(&mut self, others: impl Iterator<Item = Other>) {
        self.others.clear();
        for other in others {
            let [ahead, left] = self.here.seen_from(other.at);
            if ahead.abs().max(left.abs()) <= NEAR_MM && self.others.push(other).is_err() {
                break;
            }
        }
    }

    /// Takes in one look of the ranger from where the robot is.
    pub fn look(&mut self, look: Look) {
        let is_known = match look {
            Look::Echo(mm) => is_of_robot(&self.here, mm, &self.others),
            Look::Nothing => false,
        };
        self.map.look(&self.here, look, is_known);
        match look {
            Look::Echo(mm) if mm < HELD_UP_MM && !is_known => self.be_held_up(mm + MOUNT_MM),
            Look::Echo(_) | Look::Nothing => self.held = 0,
        }
    }

    /// Blocks the next cell of the way when something has been in front of it for a while, which may be seen
    /// somewhere else on the arc. So nothing holds the robot up for ever.
    fn be_held_up(&mut self, far: i32) {
        let [ahead, left] = self.here.seen_from(self.next);
        if ahead <= 0 || left.abs() > ahead / 4 {
            self.held = 0;
            return;
        }
        self.held += 1;
        if self.held >= HELD_UP_LOOKS {
            self.held = 0;
            let own = self.map.cell(self.here.at);
            let block = (0..4)
                .map(|step| far + step * CELL_MM / 2)
                .filter(|along| *along < ahead)
                .map(|along| self.here.point(along, left * along / ahead))
                .find(|point| {
                    let cell = self.map.cell(*point);
                    cell != own && !self.map.is_blocked(cell)
                });
            self.map.block(block.unwrap_or(self.next));
        }
    }

    /// Something keeps the robot from driving on although the ranger does not see it.
    fn bump(&mut self) {
        /// From the middle of the robot, in millimetres.
        const AHEAD: i32 = 150;
        self.map.block(self.here.point(AHEAD, 0));
    }

    /// Ages what is known: it was seen when the robot was surer of where it is.
    pub fn fade(&mut self) {
        self.map.fade();
    }

    /// Plans on by one slice.
    pub fn plan(&mut self) -> Planned {
        let Some(going) = self.going else {
            return Planned::Goes;
        };
        let number = going.number;
        match self.stage {
            Stage::None => self.begin(0),
            Stage::Spreads => match self.wave.spread(&self.map) {
                Spread::Goes => {}
                Spread::There => self.stage = Stage::Stands,
                Spread::Nowhere => {
                    if !self.try_otherwise() {
                        self.stage = Stage::None;
                        let way = Way::Nowhere;
                        return Planned::Guide(Guide { number, way });
                    }
                }
            },
            Stage::Stands => {
                if let Some(at) = self.next_point(going) {
                    let at = self.keep_right(at);
                    self.next = at;
                    let way = Way::To(at);
                    return Planned::Guide(Guide { number, way });
                }
                self.begin_anew();
            }
        }
        Planned::Goes
    }

    /// Keeps the map where the world is when the coordinates jump, as far as that can be.
    fn stay_true(&mut self, here: &Place) {
        if self.going.is_none() {
            return;
        }
        let by = [0, 1].map(|axis| here.at[axis].saturating_sub(self.here.at[axis]));
        let most = by[0].saturating_abs().max(by[1].saturating_abs());
        if most <= JUMP_MM {
            return;
        }
        let ([c, s], [before_c, before_s]) = (here.heading, self.here.heading);
        let turned = (s * before_c - c * before_s) >> 12;
        if most > LOST_MM || turned.abs() > TURNED {
            self.map.clear();
        } else {
            self.map.shift(by);
        }
        self.stage = Stage::None;
    }

    /// Moves the window so that the robot and its goal are in it, or what lies towards the goal.
    fn place_window(&mut self, going: Destination) {
        let [start, goal] =
            [self.here.at, going.at].map(|at| at.map(|along| along.div_euclid(CELL_MM)));
        let size = [COLUMNS, ROWS];
        let origin = self.map.origin();
        let inside = |cell: Cell| {
            (0..2).all(|axis| (RIM..size[axis] - RIM).contains(&(cell[axis] - origin[axis])))
        };
        let fits = (0..2).all(|axis| (goal[axis] - start[axis]).abs() < size[axis] - 2 * RIM);
        let is_right = match self.placed {
            None => false,
            Some(_) if fits => inside(start) && inside(goal),
            Some(placed) => {
                let gone = (0..2).map(|axis| (start[axis] - placed[axis]).abs());
                inside(start) && gone.max().is_some_and(|gone| gone < SCROLL_AFTER)
            }
        };
        if is_right {
            return;
        }
        self.placed = Some(start);
        let origin = [0, 1].map(|axis| {
            let half = size[axis] / 2;
            let ahead = goal[axis] - start[axis];
            let middle = if ahead.abs() < size[axis] - 2 * RIM {
                start[axis] + ahead / 2
            } else {
                start[axis] + ahead.clamp(AROUND - half, half - AROUND)
            };
            middle - half
        });
        self.map.move_to(origin);
        self.stage = Stage::None;
    }

    fn map_has_changed(&mut self) -> bool {
        // Noted until the next plan begins.
        let changed = self.map.take_changed();
        if changed {
            self.map.note_changed();
        }
        changed
    }

    /// Begins with the first way to plan. Among others there is no room to keep far away from everything.
    fn begin_anew(&mut self) {
        let first = u8::from(!self.others.is_empty());
        self.begin(self.first.max(first));
    }

    fn begin(&mut self, attempt: u8) {
        let Some(going) = self.going else { return };
        self.attempt = attempt;
        self.looks = 0;
        let _ = self.map.take_changed();
        let (start, goal) = (self.map.cell(self.here.at), self.map.cell(going.at));
        let source = if is_inside(goal) {
            Source::Cell(goal)
        } else {
            let within = if attempt < ALL_ROUND { BORDER } else { COLUMNS };
            let near = [goal[0].clamp(0, COLUMNS - 1), goal[1].clamp(0, ROWS - 1)];
            Source::Border(near, within)
        };
        let (margin, minds) = ATTEMPTS[usize::from(attempt)];
        self.wave.begin(&self.map, source, start, margin);
        if minds {
            for other in self.others.iter().filter(|other| other.stands()) {
                self.wave.mind(self.map.cell(other.at));
            }
        }
        self.stage = Stage::Spreads;
    }

    /// After one way to plan has found nothing: whether there is another one.
    fn try_otherwise(&mut self) -> bool {
        self.first = 1;
        if usize::from(self.attempt) + 1 < ATTEMPTS.len() {
            self.begin(self.attempt + 1);
            return true;
        }
        if self.fades < FADES {
            self.fades += 1;
            self.map.fade();
            self.begin_anew();
            return true;
        }
        false
    }
}

/// Whether an echo from `mm` ahead of the ranger of a robot that is `here` fits one of `others`.
fn is_of_robot(here: &Place, mm: i32, others: &[Other]) -> bool {
    let far = mm + MOUNT_MM;
    others.iter().any(|other| {
        let [ahead, left] = here.seen_from(other.at);
        (ahead - BODY_MM - far).abs() <= BLUR_MM && left.abs() <= BODY_MM + BLUR_MM / 2 + far / 5
    })
}
