//! What a policy has to choose from.

/// A motion to choose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Action {
    /// Stand.
    #[default]
    Stand,
    /// Straight ahead.
    Ahead,
    /// Turn on the spot, counter-clockwise.
    Left,
    /// Turn on the spot, clockwise.
    Right,
    /// Straight back, slowly: nothing looks there.
    Back,
    /// Ahead in a curve to the left.
    CurveLeft,
    /// Ahead in a curve to the right.
    CurveRight,
}

impl Action {
    /// How many there are.
    pub const COUNT: usize = Self::ALL.len();

    /// All of them, by their numbers.
    pub const ALL: [Self; 7] = [
        Self::Stand,
        Self::Ahead,
        Self::Left,
        Self::Right,
        Self::Back,
        Self::CurveLeft,
        Self::CurveRight,
    ];

    /// The action of this number.
    pub fn of(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// Its twist, in mm/s ahead and mrad/s counter-clockwise.
    pub const fn twist(self) -> [i32; 2] {
        match self {
            Self::Stand => [0, 0],
            Self::Ahead => [300, 0],
            Self::Left => [0, 1_200],
            Self::Right => [0, -1_200],
            Self::Back => [-150, 0],
            Self::CurveLeft => [200, 800],
            Self::CurveRight => [200, -800],
        }
    }
}
