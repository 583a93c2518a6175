//! What a robot says to those around it, beside where it is.

use core::fmt;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::BehaviourName;

/// Most numbers of one saying, the first of which names the behaviour.
pub const MAX_SAYS: usize = 6;

/// A few whole numbers that a robot says to its neighbours while its behaviour needs that, in its
/// telemetry and from there in the digest of its cell. The first is the place of the behaviour in
/// [`BehaviourName`]; what the others mean is the behaviour's business, and a robot of another behaviour
/// passes over them.
///
/// On the wire an array of one to [`MAX_SAYS`] numbers of 32 bits.
#[derive(Clone, Copy, PartialEq, Eq, Default)]
pub struct Says {
    numbers: [i32; MAX_SAYS],
    count: u8,
}

impl Says {
    /// What a robot of this behaviour says. Numbers beyond [`MAX_SAYS`] are left out.
    #[must_use]
    pub fn new(behaviour: BehaviourName, rest: &[i32]) -> Self {
        let mut says = Self::default();
        says.push(behaviour as i32);
        for number in rest {
            says.push(*number);
        }
        says
    }

    fn push(&mut self, number: i32) -> bool {
        match self.numbers.get_mut(usize::from(self.count)) {
            Some(free) => {
                *free = number;
                self.count += 1;
                true
            }
            None => false,
        }
    }

    /// All the numbers, that of the behaviour first.
    #[must_use]
    pub fn numbers(&self) -> &[i32] {
        self.numbers
            .get(..usize::from(self.count))
            .unwrap_or_default()
    }

    /// What a robot of this behaviour said beside which that is; `None` from a robot of another one.
    #[must_use]
    pub fn by(&self, behaviour: BehaviourName) -> Option<&[i32]> {
        match self.numbers().split_first() {
            Some((kind, rest)) if *kind == behaviour as i32 => Some(rest),
            Some(_) | None => None,
        }
    }

    /// These numbers; `None` where there are none, or too many.
    #[must_use]
    pub fn of_numbers(numbers: &[i32]) -> Option<Self> {
        let mut says = Self::default();
        let fits = numbers.iter().all(|number| says.push(*number));
        (fits && says.count > 0).then_some(says)
    }
}

impl fmt::Debug for Says {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.numbers()).finish()
    }
}

impl Serialize for Says {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.numbers())
    }
}

impl<'de> Deserialize<'de> for Says {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct SaysVisitor;

        impl<'de> Visitor<'de> for SaysVisitor {
            type Value = Says;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("one to six whole numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut all: A) -> Result<Says, A::Error> {
                let mut says = Says::default();
                while let Some(number) = all.next_element()? {
                    if !says.push(number) {
                        return Err(A::Error::invalid_length(MAX_SAYS + 1, &self));
                    }
                }
                if says.count == 0 {
                    return Err(A::Error::invalid_length(0, &self));
                }
                Ok(says)
            }
        }

        deserializer.deserialize_seq(SaysVisitor)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Says {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Says".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "description": "What a robot says to its neighbours: the number of its behaviour, and what that one needs.",
            "type": "array",
            "items": { "type": "integer", "minimum": i32::MIN, "maximum": i32::MAX },
            "minItems": 1,
            "maxItems": MAX_SAYS,
        })
    }
}
