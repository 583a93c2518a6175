//! Adam (Kingma and Ba 2015), and the norm that gradients are held to.

/// What Adam keeps for the parameters of a network.
#[derive(Debug, Clone)]
pub(crate) struct Adam {
    /// Running mean of the gradient, and of its square.
    pub(crate) moments: [Vec<f32>; 2],
    pub(crate) steps: u64,
}

/// How fast the running means forget, and what keeps the quotient finite.
const BETA: [f32; 2] = [0.9, 0.999];
const EPSILON: f32 = 1e-5;

impl Adam {
    pub(crate) fn new(parameters: usize) -> Self {
        Self {
            moments: [vec![0.0; parameters], vec![0.0; parameters]],
            steps: 0,
        }
    }

    /// One step down `scale · gradient`.
    pub(crate) fn step(&mut self, parameters: &mut [f32], gradient: &[f32], scale: f32, rate: f64) {
        self.steps += 1;
        let steps = self.steps as f64;
        let missing = BETA.map(|beta| 1.0 - libm::pow(f64::from(beta), steps));
        let rate = (rate / missing[0]) as f32;
        let second = (1.0 / missing[1]) as f32;
        let [means, squares] = &mut self.moments;
        let state = means.iter_mut().zip(squares);
        for ((parameter, gradient), (mean, square)) in
            parameters.iter_mut().zip(gradient).zip(state)
        {
            let gradient = gradient * scale;
            *mean = BETA[0] * *mean + (1.0 - BETA[0]) * gradient;
            *square = BETA[1] * *square + (1.0 - BETA[1]) * gradient * gradient;
            *parameter -= rate * *mean / ((*square * second).sqrt() + EPSILON);
        }
    }
}

/// What `gradient` has to be multiplied with for its Euclidean norm to be at most `most`. `None` where it is not
/// finite.
pub(crate) fn clip(gradient: &[f32], most: f32) -> Option<f32> {
    let squares = gradient.iter().map(|g| f64::from(*g) * f64::from(*g));
    let norm = squares.sum::<f64>().sqrt();
    let scale = if norm > f64::from(most) {
        (f64::from(most) / norm) as f32
    } else {
        1.0
    };
    norm.is_finite().then_some(scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first steps, by the formulas of the paper (algorithm 1) in `f64`.
    #[test]
    fn steps_are_those_of_the_paper() {
        let gradients = [[0.3_f32, -2.0], [0.1, 1.0], [-0.5, 0.25], [0.0, 4.0]];
        let mut parameters = [1.0_f32, -1.0];
        let mut adam = Adam::new(2);
        let (mut theta, mut m, mut v) = ([1.0_f64, -1.0], [0.0; 2], [0.0; 2]);
        for (t, gradient) in (1..).zip(gradients) {
            adam.step(&mut parameters, &gradient, 0.5, 0.01);
            for i in 0..2 {
                let g = f64::from(gradient[i]) * 0.5;
                m[i] = 0.9 * m[i] + 0.1 * g;
                v[i] = 0.999 * v[i] + 0.001 * g * g;
                let mean = m[i] / (1.0 - 0.9_f64.powi(t));
                let square = v[i] / (1.0 - 0.999_f64.powi(t));
                theta[i] -= 0.01 * mean / (square.sqrt() + 1e-5);
                assert!((f64::from(parameters[i]) - theta[i]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn long_gradients_are_shortened_and_short_ones_left() {
        assert_eq!(clip(&[3.0, 4.0], 5.0), Some(1.0));
        assert_eq!(clip(&[3.0, 4.0], 0.5), Some(0.1));
        assert_eq!(clip(&[0.0], 0.5), Some(1.0));
        assert_eq!(clip(&[1.0, f32::NAN], 0.5), None);
    }
}
