//! Tables of the network, made when the program is built.

/// Steps of what is squeezed, to one.
pub const PRE_STEPS: i32 = 64;

/// The hyperbolic tangent of numbers from 0 on in steps of 1 / [`PRE_STEPS`], in 1/127.
const TANH: [u8; 256] = {
    let mut table = [0; 256];
    let mut step = 0;
    while step < 256 {
        let power = exp(-2.0 * step as f64 / PRE_STEPS as f64);
        table[step] = (127.0 * (1.0 - power) / (1.0 + power) + 0.5) as u8;
        step += 1;
    }
    table
};

/// Quantiles of Gumbel's distribution: −ln(−ln u) for u = (n + ½) / 256, in 1 / [`PRE_STEPS`]. Who adds one of them by
/// chance to each logit and takes the largest sum chooses with the probabilities that logits stand for (Gumbel 1954).
const GUMBEL: [i16; 256] = {
    let mut table = [0; 256];
    let mut step = 0;
    while step < 256 {
        let value = -ln(-ln((step as f64 + 0.5) / 256.0)) * PRE_STEPS as f64;
        table[step] = if value < 0.0 {
            (value - 0.5) as i16
        } else {
            (value + 0.5) as i16
        };
        step += 1;
    }
    table
};

/// What is left of a sum behind a layer that is not the last one: its hyperbolic tangent, in 1/127.
pub fn squeezed(value: i32) -> i8 {
    let step = value.unsigned_abs().min(255) as usize;
    let tanh = TANH.get(step).map_or(0, |tanh| tanh.cast_signed());
    if value < 0 { -tanh } else { tanh }
}

/// What chance adds to a logit.
pub(super) fn chance(byte: u8) -> i32 {
    GUMBEL
        .get(usize::from(byte))
        .map_or(0, |value| i32::from(*value))
}

const fn exp(x: f64) -> f64 {
    // Of an eighth, to the eighth power: the series is short there.
    let x = x / 8.0;
    let (mut sum, mut term, mut n) = (1.0, 1.0, 1.0);
    while n < 20.0 {
        term *= x / n;
        sum += term;
        n += 1.0;
    }
    let square = sum * sum;
    let fourth = square * square;
    fourth * fourth
}

/// Of what is above 0.
const fn ln(x: f64) -> f64 {
    let (mut x, mut halvings) = (x, 0.0);
    while x > 1.5 {
        x /= 2.0;
        halvings += 1.0;
    }
    while x < 0.75 {
        x *= 2.0;
        halvings -= 1.0;
    }
    let ratio = (x - 1.0) / (x + 1.0);
    let (mut sum, mut power, mut n) = (0.0, ratio, 1.0);
    while n < 40.0 {
        sum += power / n;
        power *= ratio * ratio;
        n += 2.0;
    }
    2.0 * sum + halvings * core::f64::consts::LN_2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_what_they_say() {
        for value in -1_000..1_000 {
            let exact = 127.0 * libm::tanh(f64::from(value) / 64.0);
            assert!(
                (f64::from(squeezed(value)) - exact).abs() <= 0.51,
                "{value}"
            );
        }
        assert_eq!(squeezed(i32::MIN), -127);
        for byte in 0..=255_u8 {
            let u = (f64::from(byte) + 0.5) / 256.0;
            let exact = -libm::log(-libm::log(u)) * 64.0;
            assert!((f64::from(chance(byte)) - exact).abs() <= 0.51, "{byte}");
        }
    }
}
