//! A certificate for people.

use std::fmt::Write as _;

use crawler_twin::certificate::Certificate;
use crawler_twin::predict::Score;

/// What a certificate says, as text.
pub(super) fn certificate(certificate: &Certificate, now_ms: u64) -> String {
    let c = certificate;
    let mut text = String::new();
    // Writing to a String does not fail.
    let _ = write!(text, "certificate {} of {}", c.id(), c.about.robot);
    if !c.about.build.is_empty() {
        let _ = write!(text, ", program {}", c.about.build);
    }
    if !c.about.floor.is_empty() {
        let _ = write!(text, ", on {}", c.about.floor);
    }
    if c.is_expired(now_ms) {
        text.push_str(", expired: to be made anew");
    }
    text.push('\n');
    let _ = writeln!(
        text,
        "  {:<16} {:>9} {:>9} {:>9}",
        "parameter", "value", "± sigma", "nominal"
    );
    for value in &c.values {
        let _ = writeln!(
            text,
            "  {:<16} {:>9.4} {:>9.4} {:>9.4}",
            value.name, value.value, value.sigma, value.nominal
        );
    }
    let [left, right] = c.parameters.settled(1.0, 7.4);
    let _ = writeln!(
        text,
        "  at full duty and 7.4 V: left {left:.3} m/s, right {right:.3} m/s, ratio {:.4}",
        left / right
    );
    let (left, right) = (right / left, left / right);
    let _ = writeln!(
        text,
        "  it drives straight with trim_left {:.3} and trim_right {:.3}, if somebody sets them",
        left.min(1.0),
        right.min(1.0)
    );
    text.push_str("held-out driving, error of predictions: median, nine of ten below\n");
    for validation in &c.validation {
        let own = &validation.own;
        let _ = write!(
            text,
            "  {:>4.0} s ahead, {} times over {:.1} m: {}; nominal {}",
            own.horizon_s,
            own.count,
            own.way_m,
            errors(own),
            errors(&validation.nominal)
        );
        if let Some(previous) = &validation.previous {
            let _ = write!(text, "; before {}", errors(previous));
        }
        text.push('\n');
    }
    let _ = writeln!(
        text,
        "what is left of the fit: {:.2} deviations of a fix; {} jumps, {} rows doubled, {} put in order, {} \
         refused",
        c.residual,
        c.jumps,
        c.counts.doubled,
        c.counts.reordered,
        c.counts.absurd + c.counts.late + c.counts.clock_jumps + c.counts.beyond
    );
    text
}

fn errors(score: &Score) -> String {
    format!(
        "{:.1} cm, {:.1} cm",
        score.median_m * 100.0,
        score.p90_m * 100.0
    )
}
