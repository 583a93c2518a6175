//! Metrics as text.

use std::fmt::Write as _;

/// What a text of metrics ends with.
const END: &str = "# EOF\n";

/// Metrics as text, in the order in which they were written. Names are written whole, but for the suffix
/// `_total` of counters; help texts without their full stop.
#[derive(Debug)]
pub struct Exposition(String);

// Writing to a String does not fail.
impl Exposition {
    /// Goes on behind `counted`, which may have ended.
    pub(crate) fn behind(mut counted: String) -> Self {
        if counted.ends_with(END) {
            counted.truncate(counted.len() - END.len());
        }
        Self(counted)
    }

    /// A value that goes up and down.
    pub fn gauge(&mut self, name: &str, help: &str, value: f64) {
        self.head(name, help, "gauge");
        let _ = writeln!(self.0, "{name} {value}");
    }

    /// 1 while something is so, else 0.
    pub fn flag(&mut self, name: &str, help: &str, value: bool) {
        self.gauge(name, help, f64::from(u8::from(value)));
    }

    /// A value that only goes up.
    pub fn counter(&mut self, name: &str, help: &str, value: f64) {
        self.head(name, help, "counter");
        let _ = writeln!(self.0, "{name}_total {value}");
    }

    /// Gauges that differ in the value of one label.
    pub fn gauges<'a>(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        values: impl IntoIterator<Item = (&'a str, usize)>,
    ) {
        self.head(name, help, "gauge");
        for (value, count) in values {
            let _ = writeln!(self.0, "{name}{{{label}=\"{value}\"}} {count}");
        }
    }

    /// Counters that differ in the value of one label.
    pub fn counters<'a>(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        values: impl IntoIterator<Item = (&'a str, u64)>,
    ) {
        self.head(name, help, "counter");
        for (value, count) in values {
            let _ = writeln!(self.0, "{name}_total{{{label}=\"{value}\"}} {count}");
        }
    }

    /// A value that is always 1 and says something in its label.
    pub fn info(&mut self, name: &str, help: &str, label: &str, value: &str) {
        self.gauges(name, help, label, [(value, 1)]);
    }

    fn head(&mut self, name: &str, help: &str, kind: &str) {
        let _ = write!(self.0, "# HELP {name} {help}.\n# TYPE {name} {kind}\n");
    }

    /// The text, with its end.
    pub fn finish(mut self) -> String {
        self.0.push_str(END);
        self.0
    }
}
