//! Drives of real robots, from tables of comma-separated values.
//!
//! A head names the columns: `t` (seconds), `duty_left` and `duty_right` (−1 to 1), or `volts_left` and
//! `volts_right` at the motors (with `voltage` beside them), `voltage` (of the pack, volts), `x`, `y`
//! (metres), `theta` (radians, anticlockwise), `sigma` (of the position, metres). Lines that begin with `#`
//! are left out, and a cell may be empty: each sensor has its own moments.

use crate::evidence::{Duty, Evidence, Fix, Supply};

/// Longest line, bytes.
const LONGEST_LINE: usize = 4_096;

/// Columns that are read; others are left alone.
const COLUMNS: [&str; 10] = [
    "t",
    "duty_left",
    "duty_right",
    "volts_left",
    "volts_right",
    "voltage",
    "x",
    "y",
    "theta",
    "sigma",
];

/// Why a table is none.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum TableError {
    /// A column is missing.
    Missing(&'static str),
    /// Columns have the same name.
    Twice(String),
    /// A line has a cell that is no number: line and column.
    NoNumber(usize, String),
    /// A line has more cells than there are columns, or is longer than any such line.
    TooLong(usize),
}

impl std::fmt::Display for TableError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Missing(column) => write!(f, "there is no column `{column}`"),
            Self::Twice(column) => write!(f, "there are two columns `{column}`"),
            Self::NoNumber(line, column) => write!(f, "line {line}: `{column}` is no number"),
            Self::TooLong(line) => write!(f, "line {line} is too long"),
        }
    }
}

impl std::error::Error for TableError {}

/// Reads a table. Rows that no robot can have had are refused and counted in the evidence.
///
/// # Errors
/// [`TableError`] for what is no table.
pub fn read(text: &str) -> Result<Evidence, TableError> {
    let mut lines = text
        .lines()
        .enumerate()
        .map(|(number, line)| (number + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let (_, head) = lines.next().ok_or(TableError::Missing("t"))?;
    let names: Vec<&str> = head.split(',').map(str::trim).collect();
    let mut places = [None; COLUMNS.len()];
    for (place, name) in names.iter().enumerate() {
        if let Some(column) = COLUMNS.iter().position(|column| column == name)
            && places[column].replace(place).is_some()
        {
            return Err(TableError::Twice((*name).to_owned()));
        }
    }
    let has = |column: usize| places[column].is_some();
    let by_duty = has(1) && has(2);
    for needed in [0, 5, 6, 7, 8] {
        if !has(needed) {
            return Err(TableError::Missing(COLUMNS[needed]));
        }
    }
    let by_volts = has(3) && has(4);
    if !(by_duty || by_volts) {
        return Err(TableError::Missing("duty_left"));
    }
    let mut evidence = Evidence::default();
    let mut pack_v = None;
    for (number, line) in lines {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        if line.len() > LONGEST_LINE || cells.len() > names.len() {
            return Err(TableError::TooLong(number));
        }
        let mut row = [None; COLUMNS.len()];
        for ((value, place), name) in row.iter_mut().zip(places).zip(COLUMNS) {
            let cell = place.and_then(|place| cells.get(place)).copied();
            let Some(cell) = cell.filter(|cell| !cell.is_empty()) else {
                continue;
            };
            let read = cell.parse::<f64>();
            *value = Some(read.map_err(|_| TableError::NoNumber(number, name.to_owned()))?);
        }
        let [
            t,
            duty_left,
            duty_right,
            volts_left,
            volts_right,
            voltage,
            x,
            y,
            theta,
            sigma,
        ] = row;
        let at_s = t.ok_or_else(|| TableError::NoNumber(number, "t".to_owned()))?;
        // What is refused is counted; whoever certifies looks at the counts.
        if let Some(volts) = voltage {
            pack_v = Some(volts);
            let _ = evidence.supply(Supply {
                at_s,
                arrived_s: None,
                volts,
            });
        }
        let duty = if by_duty {
            duty_left.zip(duty_right)
        } else {
            // A share of what the pack has for a motor.
            volts_left
                .zip(volts_right)
                .zip(pack_v)
                .map(|((left, right), pack)| {
                    let full = (pack - crate::body::Parameters::NOMINAL.bridge_drop_v).max(0.1);
                    (
                        (left / full).clamp(-1.0, 1.0),
                        (right / full).clamp(-1.0, 1.0),
                    )
                })
        };
        if let Some((left, right)) = duty {
            let _ = evidence.duty(Duty {
                at_s,
                arrived_s: None,
                duty: [left, right],
            });
        }
        if let (Some(x), Some(y), Some(theta)) = (x, y, theta) {
            let sigma_m = sigma.unwrap_or(0.0);
            let _ = evidence.fix(Fix {
                at_s,
                arrived_s: None,
                x,
                y,
                theta,
                sigma_m,
            });
        }
    }
    Ok(evidence)
}
