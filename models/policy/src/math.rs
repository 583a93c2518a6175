//! Functions whose bits are the same everywhere, written so that compilers turn loops of them into vectors:
//! without calls, tables or branches.

/// The hyperbolic tangent, within 7 units in the last place. The rational approximation of Eigen
/// (`generic_fast_tanh_float`): an odd polynomial over an even one.
#[inline(always)]
pub(crate) fn tanh(x: f32) -> f32 {
    /// Beyond, the result is ±1 in `f32`.
    const END: f32 = 7.998_811_7;
    let x = if x > END { END } else { x };
    let x = if x < -END { -END } else { x };
    let square = x * x;
    let mut above = -2.760_768_5e-16_f32;
    for factor in [
        2.000_188e-13,
        -8.604_672e-11,
        5.122_297_1e-8,
        1.485_722_4e-5,
        6.372_619_3e-4,
        4.893_524_6e-3,
    ] {
        above = above * square + factor;
    }
    let mut below = 1.198_258_4e-6_f32;
    for factor in [1.185_347_1e-4, 2.268_434_6e-3, 4.893_525e-3] {
        below = below * square + factor;
    }
    let y = x * above / below;
    let y = if y > 1.0 { 1.0 } else { y };
    if y < -1.0 { -1.0 } else { y }
}

/// The exponential function within 2 units in the last place, for results that are normal numbers: arguments
/// are held to ±87. The method of `expf` in the Cephes library (Moshier 1992).
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    /// Added to a small number, it leaves the nearest integer in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    let x = if x > 87.0 { 87.0 } else { x };
    let x = if x < -87.0 { -87.0 } else { x };
    let shifted = x * core::f32::consts::LOG2_E + ROUND;
    let whole = shifted - ROUND;
    // ln 2 in two parts, the first of them short, so that its product is exact.
    let rest = x - whole * 0.693_359_4;
    let rest = rest - whole * -2.121_944_4e-4;
    let mut sum = 1.987_569_1e-4_f32;
    for factor in [
        1.398_199_9e-3,
        8.333_452e-3,
        4.166_579_6e-2,
        0.166_666_65,
        0.5,
    ] {
        sum = sum * rest + factor;
    }
    let sum = sum * (rest * rest) + rest + 1.0;
    // 2^whole: the integer goes to where the exponent is.
    let power = f32::from_bits((shifted.to_bits() << 23).wrapping_add(1.0_f32.to_bits()));
    sum * power
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The distance from `y` to the true value in units of the last place.
    fn error(y: f32, truth: f64) -> f64 {
        let ulp = f64::from(f32::from_bits((truth.abs() as f32).to_bits() + 1))
            - f64::from(truth.abs() as f32);
        (f64::from(y) - truth).abs() / ulp
    }

    #[test]
    fn tanh_is_close_and_never_beyond_one() {
        for step in -400_000..=400_000 {
            let x = step as f32 * 2.5e-5;
            let error = error(tanh(x), libm::tanh(f64::from(x)));
            assert!(error < 7.0, "{x}: {error}");
            assert!(tanh(x).abs() <= 1.0, "{x}");
        }
        assert_eq!(tanh(f32::INFINITY), tanh(100.0));
        assert_eq!(tanh(0.0), 0.0);
        assert!(tanh(f32::NAN).is_nan());
    }

    #[test]
    fn exp_is_close() {
        for step in -870_000..=870_000 {
            let x = step as f32 * 1e-4;
            assert!(error(exp(x), libm::exp(f64::from(x))) < 2.0, "{x}");
        }
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(exp(-1e9), exp(-87.0));
        assert!(exp(f32::NAN).is_nan());
    }
}
