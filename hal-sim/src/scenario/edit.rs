//! Changing scenarios by key, and writing them.

use toml::{Table, Value};

use super::place::{Step, steps};
use super::{Scenario, ScenarioError};

impl Scenario {
    /// The same with another value for `key` (like `arena.scatter.per_square_metre` or
    /// `goals[0].x`), which is written as in a scenario file; a bare word counts as text.
    ///
    /// # Errors
    /// When there is no such key, or it cannot have this value.
    pub fn with_value(&self, key: &str, text: &str) -> Result<Self, ScenarioError> {
        let value = text.parse::<Value>();
        let scenario = self.with(
            key,
            value.unwrap_or_else(|_| Value::String(text.to_owned())),
        )?;
        scenario.validate()?;
        Ok(scenario)
    }

    /// The same with another value for `key`, not validated. Difficulty has no say in it any more.
    pub(crate) fn with(&self, key: &str, value: Value) -> Result<Self, ScenarioError> {
        let mut table = self.table()?;
        // Read again from a file, its difficulty would put the old value back.
        if let Some(Value::Table(difficulty)) = table.get_mut("difficulty")
            && let Some(Value::Table(keys)) = difficulty.get_mut("keys")
        {
            keys.remove(key);
        }
        let mut root = Value::Table(table);
        let no_key = || ScenarioError::value(key, "is no key of a scenario");
        *descend(&mut root, key).ok_or_else(no_key)? = value;
        if !root.is_table() {
            return Err(no_key());
        }
        // Read as a file is, though a table could be read as well: all that reads a scenario is in the
        // program once then, and it is large.
        let text = text_of(&root)?;
        let changed: Self = toml::from_str(&text).map_err(|error| {
            ScenarioError::Text(format!("{key}: {}", error.message().trim()), None)
        })?;
        Ok(Self {
            detector: self.detector,
            policy: self.policy.clone(),
            ..changed
        })
    }

    fn table(&self) -> Result<Table, ScenarioError> {
        Table::try_from(self).map_err(|error| ScenarioError::Text(error.to_string(), None))
    }

    /// Writes the scenario as a file, without what is as it would be anyway.
    ///
    /// # Errors
    /// When a number is one that TOML cannot hold.
    pub fn to_toml(&self) -> Result<String, ScenarioError> {
        let mut table = self.table()?;
        drop_same(&mut table, &Self::plain(String::new()).table()?);
        table.iter_mut().for_each(|(_, value)| shorten(value));
        text_of(&Value::Table(table))
    }

    /// The same with everything, as it is.
    pub(crate) fn to_whole_toml(&self) -> Result<String, ScenarioError> {
        text_of(&Value::Table(self.table()?))
    }
}

/// Scalars first: whatever follows a table's head belongs to it.
fn text_of(root: &Value) -> Result<String, ScenarioError> {
    toml::to_string(root).map_err(|error| ScenarioError::Text(error.to_string(), None))
}

/// The place of `key`, made where its parent is a table.
fn descend<'a>(root: &'a mut Value, key: &str) -> Option<&'a mut Value> {
    let mut spot = root;
    for step in steps(key) {
        spot = match (step, spot) {
            (Step::Key(name), Value::Table(table)) => table
                .entry(name)
                .or_insert_with(|| Value::Table(Table::new())),
            (Step::Index(index), Value::Array(array)) => array.get_mut(index)?,
            _ => return None,
        };
    }
    Some(spot)
}

/// Takes away what is the same in `plain`.
fn drop_same(table: &mut Table, plain: &Table) {
    table.retain(|key, value| match (value, plain.get(key)) {
        (Value::Table(inner), Some(Value::Table(plain))) => {
            drop_same(inner, plain);
            !inner.is_empty()
        }
        (value, Some(plain)) => value != plain,
        (_, None) => true,
    });
}

/// Writes numbers as short as 32 bits need: that is what they are read into.
fn shorten(value: &mut Value) {
    match value {
        Value::Float(number) => {
            let single = *number as f32;
            if f64::from(single) == *number
                && let Ok(short) = single.to_string().parse()
            {
                *number = short;
            }
        }
        Value::Array(array) => array.iter_mut().for_each(shorten),
        Value::Table(table) => table.iter_mut().for_each(|(_, value)| shorten(value)),
        Value::String(_) | Value::Integer(_) | Value::Boolean(_) | Value::Datetime(_) => {}
    }
}
