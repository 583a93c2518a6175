//! Any way to spell a message.

use serde_json::Value;

/// The same JSON with its members in another order, and with white space. Every `seed` is another
/// order.
pub(crate) fn respell(json: &[u8], seed: u64) -> String {
    fn write(value: &Value, seed: &mut u64, out: &mut String) {
        match value {
            Value::Object(members) => {
                let mut members: Vec<_> = members.iter().collect();
                out.push_str("{ ");
                let mut first = true;
                while !members.is_empty() {
                    // A linear congruential step is enough to vary the order.
                    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    let (name, value) = members.remove((*seed >> 33) as usize % members.len());
                    if !core::mem::take(&mut first) {
                        out.push_str(",\n\t");
                    }
                    out.push_str(&Value::from(name.as_str()).to_string());
                    out.push_str(" : ");
                    write(value, seed, out);
                }
                out.push_str("\r\n}");
            }
            Value::Array(elements) => {
                out.push('[');
                for (at, element) in elements.iter().enumerate() {
                    if at > 0 {
                        out.push_str(" , ");
                    }
                    write(element, seed, out);
                }
                out.push(']');
            }
            Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => {
                out.push_str(&value.to_string());
            }
        }
    }

    let value = serde_json::from_slice(json).expect("others can read what we write");
    let mut out = String::new();
    let mut seed = seed;
    write(&value, &mut seed, &mut out);
    out
}
