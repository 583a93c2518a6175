//! What can be adjusted: one typed table, and the values of one robot.

mod stored;
mod table;
#[cfg(test)]
mod tests;

use crawler_protocol::{ParameterValue, ParameterValues, Reason};
use heapless::String;

use stored::Entries;
pub use table::{Definition, Domain, PARAMETER_COUNT, Parameter, TABLE};

/// Longest text parameter, in bytes.
pub const MAX_TEXT: usize = 24;

/// How far the battery has to recover before it counts as better, in millivolts: more than the
/// pack gains when the motors stop. The two limits are at least this far apart.
pub const BATTERY_HYSTERESIS_MV: f32 = 200.0;

/// Most bytes of this program's own parameters in flash: per number one byte of key and four of value, and
/// a text with its key and length.
const OWN_MAX: usize = PARAMETER_COUNT * 5 + 2 + MAX_TEXT;

/// Bytes that are kept of what other versions of the program have stored: twelve numbers, for example.
const FOREIGN_MAX: usize = 64;

/// Most bytes [`Parameters::encode`] writes.
pub const ENCODED_MAX: usize = OWN_MAX + FOREIGN_MAX;

/// Current value of every parameter. Always within range, and always consistent.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    numbers: [f32; PARAMETER_COUNT],
    name: String<MAX_TEXT>,
    version: u32,
}

impl Default for Parameters {
    fn default() -> Self {
        let mut numbers = [0.0; PARAMETER_COUNT];
        for (value, definition) in numbers.iter_mut().zip(&TABLE) {
            *value = definition.domain.default_number();
        }
        Self {
            numbers,
            name: String::new(),
            version: 0,
        }
    }
}

impl Parameters {
    /// Value of a number; of a switch, 0 or 1; of a text, 0.
    pub fn number(&self, parameter: Parameter) -> f32 {
        self.numbers[parameter as usize]
    }

    /// Whether a switch is on.
    pub fn switch(&self, parameter: Parameter) -> bool {
        self.number(parameter) != 0.0
    }

    /// The name people gave the robot; empty until someone does.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Counts changes, so that readers notice them cheaply.
    pub fn version(&self) -> u32 {
        self.version
    }

    /// Every parameter with its current value, in the order of the table.
    pub fn iter(&self) -> impl Iterator<Item = (&'static Definition, ParameterValue)> + '_ {
        TABLE
            .iter()
            .map(|definition| (definition, self.value_of(definition)))
    }

    fn value_of(&self, definition: &Definition) -> ParameterValue {
        match definition.domain {
            Domain::Number { .. } => ParameterValue::Number(self.number(definition.parameter)),
            Domain::Switch { .. } => ParameterValue::Bool(self.switch(definition.parameter)),
            Domain::Text { .. } => text_value(&self.name),
        }
    }

    /// A copy with all of `values` applied.
    ///
    /// # Errors
    /// The reason to answer with; then nothing is to change. [`Reason::UnknownParameter`],
    /// [`Reason::WrongType`], [`Reason::DuplicateField`], or [`Reason::OutOfRange`], also when
    /// the values do not go together (the critical distance must stay below the safe one, and
    /// the voltages in their order).
    pub fn with(&self, values: &ParameterValues) -> Result<Self, Reason> {
        self.changed(&Changes::new(values)?)
    }

    /// A copy with `changes` applied.
    ///
    /// # Errors
    /// [`Reason::OutOfRange`] when the values would not go together.
    pub(crate) fn changed(&self, changes: &Changes) -> Result<Self, Reason> {
        let mut next = self.clone();
        for definition in TABLE.iter().filter(|d| changes.has(d.parameter)) {
            match definition.domain {
                Domain::Number { .. } | Domain::Switch { .. } => {
                    let number = changes.values.number(definition.parameter);
                    next.numbers[definition.parameter as usize] = number;
                }
                Domain::Text { .. } => next.name.clone_from(&changes.values.name),
            }
        }
        next.check_consistent()?;
        next.version = self.version.wrapping_add(1);
        Ok(next)
    }

    fn put(&mut self, definition: &Definition, value: &ParameterValue) -> Result<(), Reason> {
        match (definition.domain, value) {
            (Domain::Number { .. }, ParameterValue::Number(number)) => {
                if !definition.domain.admits(*number) {
                    return Err(Reason::OutOfRange);
                }
                self.numbers[definition.parameter as usize] = *number;
            }
            (Domain::Switch { .. }, ParameterValue::Bool(on)) => {
                self.numbers[definition.parameter as usize] = f32::from(u8::from(*on));
            }
            (Domain::Text { .. }, ParameterValue::Text(text)) => {
                self.name = printable(text).ok_or(Reason::OutOfRange)?;
            }
            (
                Domain::Number { .. } | Domain::Switch { .. } | Domain::Text { .. },
                ParameterValue::Bool(_) | ParameterValue::Number(_) | ParameterValue::Text(_),
            ) => return Err(Reason::WrongType),
        }
        Ok(())
    }

    fn check_consistent(&self) -> Result<(), Reason> {
        if self.number(Parameter::CriticalDistance) < self.number(Parameter::SafeDistance)
            && self.number(Parameter::CriticalBattery) + BATTERY_HYSTERESIS_MV
                <= self.number(Parameter::LowBattery)
        {
            Ok(())
        } else {
            Err(Reason::OutOfRange)
        }
    }

    /// Whether a stored copy of `self` would differ from one of `other`.
    pub fn differs_in_flash(&self, other: &Self) -> bool {
        self.name != other.name
            || TABLE.iter().any(|definition| {
                definition.persistent
                    && self.number(definition.parameter) != other.number(definition.parameter)
            })
    }

    /// Writes every persistent parameter to `buffer`, as key (1), length (1, texts only) and
    /// value (numbers: `f32`, little-endian), and behind them what another version of the program has
    /// stored in `before`, the item that this one replaces. Returns the part that was written.
    ///
    /// Whoever goes back to an older program, and then on to the newer one again, finds there what the newer
    /// one had been told. There is room for at least 64 bytes of that; an entry that does not fit is lost, with
    /// those behind it.
    pub fn encode<'b>(&self, before: &[u8], buffer: &'b mut [u8; ENCODED_MAX]) -> &'b [u8] {
        let mut at = 0;
        for definition in TABLE.iter().filter(|definition| definition.persistent) {
            buffer[at] = definition.key;
            at += 1;
            match definition.domain {
                Domain::Number { .. } | Domain::Switch { .. } => {
                    let bytes = self.number(definition.parameter).to_le_bytes();
                    buffer[at..at + 4].copy_from_slice(&bytes);
                    at += 4;
                }
                Domain::Text { .. } => {
                    let text = self.name.as_bytes();
                    buffer[at] = text.len() as u8;
                    buffer[at + 1..at + 1 + text.len()].copy_from_slice(text);
                    at += 1 + text.len();
                }
            }
        }
        for entry in Entries::new(before, NAME_KEY).filter(|entry| by_key(entry.key).is_none()) {
            let Some(place) = buffer.get_mut(at..at + entry.bytes.len()) else {
                break;
            };
            place.copy_from_slice(entry.bytes);
            at += entry.bytes.len();
        }
        &buffer[..at]
    }

    /// Reads what [`Parameters::encode`] wrote, perhaps by another version of the program.
    ///
    /// Whatever is out of range or cut off keeps its default; the second value counts those. What this version
    /// does not know is passed over. Values that do not go together are all dropped.
    pub fn decode(bytes: &[u8]) -> (Self, usize) {
        let mut loaded = Self::default();
        let mut dropped = 0;
        let mut entries = Entries::new(bytes, NAME_KEY);
        for entry in &mut entries {
            let Some(definition) = by_key(entry.key) else {
                continue;
            };
            let number = || entry.value.try_into().ok().map(f32::from_le_bytes);
            let value = match definition.domain {
                Domain::Number { .. } => number().map(ParameterValue::Number),
                Domain::Switch { .. } => number().map(|number| ParameterValue::Bool(number != 0.0)),
                Domain::Text { .. } => core::str::from_utf8(entry.value).ok().map(text_value),
            };
            let put = value.is_some_and(|value| {
                definition.persistent && loaded.put(definition, &value).is_ok()
            });
            dropped += usize::from(!put);
        }
        dropped += usize::from(entries.cut);
        (loaded.or_default(), dropped)
    }

    fn or_default(self) -> Self {
        match self.check_consistent() {
            Ok(()) => self,
            Err(_) => Self::default(),
        }
    }

    /// Takes over loaded values as the newest version.
    pub(crate) fn replace_with(&mut self, loaded: Self) {
        let version = self.version.wrapping_add(1);
        *self = Self { version, ..loaded };
    }
}

/// What a `set` asks for, with names looked up and each value one that its parameter may have: a
/// tenth of the message's size.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Changes {
    /// Only those count that are marked.
    values: Parameters,
    marked: [bool; PARAMETER_COUNT],
}

impl Changes {
    /// What `values` ask for.
    ///
    /// # Errors
    /// As [`Parameters::with`], but for what depends on the values in force.
    pub(crate) fn new(values: &ParameterValues) -> Result<Self, Reason> {
        let mut changes = Self {
            values: Parameters::default(),
            marked: [false; PARAMETER_COUNT],
        };
        for (name, value) in values {
            let definition = Definition::by_name(name).ok_or(Reason::UnknownParameter)?;
            let marked = &mut changes.marked[definition.parameter as usize];
            if core::mem::replace(marked, true) {
                return Err(Reason::DuplicateField);
            }
            changes.values.put(definition, value)?;
        }
        Ok(changes)
    }

    /// Whether they ask to look all the time.
    pub(crate) fn wants_eyes(&self) -> bool {
        self.has(Parameter::VisionAlways) && self.values.switch(Parameter::VisionAlways)
    }

    const fn has(&self, parameter: Parameter) -> bool {
        self.marked[parameter as usize]
    }
}

/// Key of the robot's name, a text.
const NAME_KEY: u8 = TABLE[Parameter::Name as usize].key;

fn by_key(key: u8) -> Option<&'static Definition> {
    TABLE.iter().find(|definition| definition.key == key)
}

fn text_value(text: &str) -> ParameterValue {
    // A name is far shorter than a text value may be; `unwrap_or_default` keeps this total.
    ParameterValue::Text(text.try_into().unwrap_or_default())
}

/// A name must print everywhere: no control characters, no quotes, no backslash.
fn printable(text: &str) -> Option<String<MAX_TEXT>> {
    let fits = text
        .chars()
        .all(|c| (c.is_ascii_graphic() || c == ' ') && c != '"' && c != '\\');
    if fits { text.try_into().ok() } else { None }
}
