//! The table of all parameters: what each is, where its value comes from, and how far it may go.

use super::{
    ParameterError, Parameters, camera, chassis, gauge, look, pack, radio, ranger, spread,
    surroundings,
};

/// One parameter.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Name as in a scenario file: section and key.
    pub key: &'static str,
    /// Unit, `1` for a plain number.
    pub unit: &'static str,
    /// What it is.
    pub meaning: &'static str,
    /// Where the nominal value comes from: data sheet, paper, measurement, choice or estimate.
    pub source: &'static str,
    /// Smallest value a world can run with.
    pub least: Bound,
    /// Largest value a world can run with.
    pub most: Bound,
    /// How [`super::Profile::Mild`] varies it.
    pub mild: Vary,
    /// How [`super::Profile::Wild`] varies it.
    pub wild: Vary,
    pub(super) get: fn(&Parameters) -> f32,
    pub(super) set: fn(&mut Parameters, f32),
}

/// An end of an allowed range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bound {
    /// This number.
    Number(f32),
    /// The value of the parameter with this key, which stands before in the table.
    Of(&'static str),
}

/// How a profile varies a parameter: uniformly, around the value that the scenario gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Vary {
    /// Not at all.
    Fixed,
    /// By up to this share of the value, up or down.
    Times(f32),
    /// By up to this much, up or down.
    Plus(f32),
    /// Anywhere from the first to the second, whatever the value is.
    Within(f32, f32),
}

/// A number of a field.
pub(super) trait Number: Copy {
    fn get(self) -> f32;
    fn of(value: f32) -> Self;
}

impl Number for f32 {
    fn get(self) -> f32 {
        self
    }

    fn of(value: f32) -> Self {
        value
    }
}

/// Whole numbers below 2²⁴, which a float holds exactly; a cast to them saturates.
macro_rules! whole {
    ($($kind:ty),*) => {$(
        impl Number for $kind {
            fn get(self) -> f32 {
                self as f32
            }

            fn of(value: f32) -> Self {
                libm::roundf(value) as Self
            }
        }
    )*};
}

whole!(u16, u32);

/// A [`Row`] of a field: section and key, unit, range, profiles, meaning, source.
macro_rules! row {
    (
        $section:ident.$field:ident, $unit:literal, $least:expr, $most:expr, $mild:expr, $wild:expr,
        $meaning:literal, $source:literal
    ) => {
        Row {
            key: concat!(stringify!($section), ".", stringify!($field)),
            unit: $unit,
            meaning: $meaning,
            source: $source,
            least: $least,
            most: $most,
            mild: $mild,
            wild: $wild,
            get: |parameters| super::table::Number::get(parameters.$section.$field),
            set: |parameters, value| {
                parameters.$section.$field = super::table::Number::of(value);
            },
        }
    };
}

pub(super) use row;

/// The sections in their order; a bound names only what stands before it.
const SECTIONS: &[&[Row]] = &[
    chassis::ROWS,
    pack::ROWS,
    ranger::ROWS,
    gauge::ROWS,
    camera::ROWS,
    look::ROWS,
    radio::ROWS,
    spread::ROWS,
    surroundings::ROWS,
];

const ROWS: usize = {
    let (mut rows, mut section) = (0, 0);
    while section < SECTIONS.len() {
        rows += SECTIONS[section].len();
        section += 1;
    }
    rows
};

/// Every parameter that is a number. What is not (`ranger.wiring`) is not varied.
pub const TABLE: &[Row] = &{
    let mut all = [SECTIONS[0][0]; ROWS];
    let (mut section, mut next) = (0, 0);
    while section < SECTIONS.len() {
        let mut row = 0;
        while row < SECTIONS[section].len() {
            all[next] = SECTIONS[section][row];
            row += 1;
            next += 1;
        }
        section += 1;
    }
    all
};

impl Row {
    /// The value in `parameters`.
    pub fn value(&self, parameters: &Parameters) -> f32 {
        (self.get)(parameters)
    }

    /// The nominal value.
    pub fn nominal(&self) -> f32 {
        self.value(&Parameters::default())
    }

    /// The range it has to lie in, given the other parameters.
    pub fn range(&self, parameters: &Parameters) -> (f32, f32) {
        (self.least.value(parameters), self.most.value(parameters))
    }

    /// Changes the value: to the nearest whole number where it is one. Whether a world can run
    /// with it is for [`Parameters::validate`] to say.
    pub fn set(&self, parameters: &mut Parameters, value: f32) {
        (self.set)(parameters, value);
    }

    /// The row with this key.
    pub fn find(key: &str) -> Option<&'static Self> {
        TABLE.iter().find(|row| row.key == key)
    }

    /// # Errors
    /// When the value is outside of its range, or not a number.
    pub(super) fn check(&self, parameters: &Parameters) -> Result<(), ParameterError> {
        let (least, most) = self.range(parameters);
        // Not-a-number is in no range.
        if (least..=most).contains(&self.value(parameters)) {
            Ok(())
        } else {
            Err(ParameterError {
                name: self.key,
                least,
                most,
            })
        }
    }
}

impl Bound {
    fn value(&self, parameters: &Parameters) -> f32 {
        match *self {
            Self::Number(number) => number,
            Self::Of(key) => Row::find(key).map_or(f32::NAN, |row| row.value(parameters)),
        }
    }
}
