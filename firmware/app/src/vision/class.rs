//! The classes of things that robots recognise.

use core::fmt;

/// What a thing is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Class {
    /// Something to drive around.
    Obstacle,
    /// Something to look for.
    Object,
    /// Another robot.
    Robot,
}

impl Class {
    /// All of them, in the order in which a detector has them behind the class of nothing.
    pub const ALL: [Self; 3] = [Self::Obstacle, Self::Object, Self::Robot];

    /// Name on the wire, and the label of a detector.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Obstacle => "obstacle",
            Self::Object => "object",
            Self::Robot => "robot",
        }
    }

    /// What stands for it where there is little room.
    const fn letter(self) -> char {
        match self {
            Self::Obstacle => 'b',
            Self::Object => 'o',
            Self::Robot => 'r',
        }
    }
}

/// A set of classes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Classes(u8);

impl Classes {
    /// Takes a class in.
    pub const fn insert(&mut self, class: Class) {
        self.0 |= 1 << class as u8;
    }

    /// Whether it is in.
    pub const fn contains(self, class: Class) -> bool {
        self.0 & (1 << class as u8) != 0
    }

    /// Whether none is in.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
}

impl fmt::Display for Classes {
    /// `b` for obstacle, `o` for object, `r` for robot; `-` for none of them.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_empty() {
            return f.write_str("-");
        }
        for class in Class::ALL {
            if self.contains(class) {
                write!(f, "{}", class.letter())?;
            }
        }
        Ok(())
    }
}
