//! From floats to 8 bits: in blocks of 64 with a scale of their own. What rounding takes away is added to what comes next
//! (error feedback: Seide and others 2014, Karimireddy and others 2019), so that nothing is lost for good.

/// Numbers that share a scale.
pub const BLOCK: usize = 64;
/// The largest number of a block becomes this one.
const MOST: f32 = 127.0;

/// Numbers in 8 bits.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantised {
    scales: Vec<f32>,
    numbers: Vec<i8>,
}

impl Quantised {
    /// Of `numbers`, each rounded to the nearest step of its block: the largest of the block by 127. Numbers that are not finite become
    /// zero, with their block.
    #[must_use]
    pub fn of(numbers: &[f32]) -> Self {
        let mut quantised = Self {
            scales: Vec::with_capacity(numbers.len().div_ceil(BLOCK)),
            numbers: Vec::with_capacity(numbers.len()),
        };
        for block in numbers.chunks(BLOCK) {
            let finite = block.iter().all(|number| number.is_finite());
            let most = block
                .iter()
                .fold(0.0_f32, |most, number| most.max(number.abs()));
            let scale = most / MOST;
            if !finite || scale < f32::MIN_POSITIVE {
                quantised.scales.push(0.0);
                quantised.numbers.extend(block.iter().map(|_| 0));
                continue;
            }
            quantised.scales.push(scale);
            let steps = block.iter().map(|number| {
                let steps = (number / scale).round().clamp(-MOST, MOST);
                steps as i8
            });
            quantised.numbers.extend(steps);
        }
        quantised
    }

    /// From its parts; `None` unless there is a scale for each block, and each is finite and not negative.
    pub(crate) fn from_parts(scales: Vec<f32>, numbers: Vec<i8>) -> Option<Self> {
        let enough = scales.len() == numbers.len().div_ceil(BLOCK);
        // −128 of them at most, which is to be finite too.
        let right = |scale: &f32| *scale >= 0.0 && (scale * -f32::from(i8::MIN)).is_finite();
        (enough && scales.iter().all(right)).then_some(Self { scales, numbers })
    }

    /// Scale of each block.
    pub(crate) fn scales(&self) -> &[f32] {
        &self.scales
    }

    /// In steps of their scale.
    pub(crate) fn numbers(&self) -> &[i8] {
        &self.numbers
    }

    /// How many numbers there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.numbers.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.numbers.is_empty()
    }

    /// The numbers, as they come out: finite, whatever came in.
    pub fn values(&self) -> impl Iterator<Item = f32> {
        let blocks = self.numbers.chunks(BLOCK).zip(&self.scales);
        blocks.flat_map(|(block, scale)| block.iter().map(move |number| f32::from(*number) * scale))
    }
}

/// What rounding has taken away so far.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ErrorFeedback {
    left: Vec<f32>,
}

impl ErrorFeedback {
    /// Quantises `numbers` with what was left of those before, and keeps what is left now. After numbers of another count it begins
    /// anew.
    pub fn quantise(&mut self, numbers: &[f32]) -> Quantised {
        if self.left.len() != numbers.len() {
            self.left = vec![0.0; numbers.len()];
        }
        let wanted: Vec<f32> = self
            .left
            .iter()
            .zip(numbers)
            .map(|(left, own)| left + own)
            .collect();
        let quantised = Quantised::of(&wanted);
        let both = wanted.iter().zip(quantised.values());
        for (left, (wanted, told)) in self.left.iter_mut().zip(both) {
            let rest = wanted - told;
            *left = if rest.is_finite() { rest } else { 0.0 };
        }
        quantised
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn any_numbers() -> impl Strategy<Value = Vec<f32>> {
        prop::collection::vec(-1e3_f32..1e3, 0..300)
    }

    proptest! {
        #[test]
        fn no_number_is_off_by_more_than_half_a_step(numbers in any_numbers()) {
            let quantised = Quantised::of(&numbers);
            prop_assert_eq!(quantised.len(), numbers.len());
            let values: Vec<f32> = quantised.values().collect();
            for (block, values) in numbers.chunks(BLOCK).zip(values.chunks(BLOCK)) {
                let most = block.iter().fold(0.0_f32, |most, number| most.max(number.abs()));
                for (number, value) in block.iter().zip(values) {
                    prop_assert!((number - value).abs() <= most / 253.0, "{} {}", number, value);
                }
            }
        }

        #[test]
        fn whatever_comes_in_what_comes_out_is_finite(numbers in prop::collection::vec(any::<f32>(), 0..200)) {
            let mut feedback = ErrorFeedback::default();
            for _ in 0..3 {
                let quantised = feedback.quantise(&numbers);
                prop_assert!(quantised.values().all(f32::is_finite));
            }
            prop_assert!(feedback.left.iter().all(|left| left.is_finite()));
        }

        /// What was told in all differs from what was meant by no more than one rounding, however often it was told.
        #[test]
        fn nothing_is_lost_for_good(numbers in prop::collection::vec(-1.0_f32..1.0, 1..100), times in 1_usize..40) {
            let mut feedback = ErrorFeedback::default();
            let mut told = vec![0.0_f64; numbers.len()];
            for _ in 0..times {
                let quantised = feedback.quantise(&numbers);
                told.iter_mut().zip(quantised.values()).for_each(|(sum, value)| *sum += f64::from(value));
            }
            for (sum, number) in told.iter().zip(&numbers) {
                let off = (sum - times as f64 * f64::from(*number)).abs();
                prop_assert!(off < 0.01, "{} of {} {} times", off, number, times);
            }
        }
    }

    #[test]
    fn small_numbers_come_through_in_time() {
        // Next to a 1 a 0.001 is rounded to nothing, but four of them are not.
        let mut feedback = ErrorFeedback::default();
        let told: Vec<f32> = (0..8)
            .map(|_| {
                feedback
                    .quantise(&[1.0, 0.001])
                    .values()
                    .nth(1)
                    .unwrap_or(f32::NAN)
            })
            .collect();
        assert_eq!(told[0], 0.0);
        assert!(told.iter().sum::<f32>() > 0.007, "{told:?}");
    }
}
