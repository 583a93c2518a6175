use std::num::NonZeroUsize;

use proptest::prelude::*;

use super::*;

const ONE: NonZeroUsize = NonZeroUsize::MIN;

fn shape() -> impl Strategy<Value = Shape> {
    let hidden = prop::collection::vec(1_usize..20, 0..3);
    let activation = prop_oneof![Just(Activation::Tanh), Just(Activation::Relu)];
    (1_usize..20, hidden, 1_usize..12, activation).prop_map(
        |(inputs, hidden, outputs, activation)| Shape {
            inputs,
            hidden,
            outputs,
            activation,
        },
    )
}

/// The network as its definition has it, in `f64`.
fn reference(network: &Network, parameters: &[f64], input: &[f32]) -> Vec<f64> {
    let mut values: Vec<f64> = input.iter().map(|x| f64::from(*x)).collect();
    for (index, layer) in network.layers.iter().enumerate() {
        let out = |o: usize| {
            let at = |i: usize| parameters[layer.weights.start + i * layer.stride + o];
            let sum: f64 = values.iter().enumerate().map(|(i, x)| x * at(i)).sum();
            let sum = sum + parameters[layer.biases.start + o];
            match (index + 1 == network.layers.len(), network.shape.activation) {
                (true, _) => sum,
                (false, Activation::Tanh) => libm::tanh(sum),
                (false, Activation::Relu) => sum.max(0.0),
            }
        };
        values = (0..layer.outputs).map(out).collect();
    }
    values
}

/// Numbers from −1 to 1.
fn draws(n: usize, seed: u64) -> Vec<f32> {
    let mut rng = crate::random::stream(seed, crate::random::Purpose::Order, (1, 1));
    (0..n)
        .map(|_| crate::random::uniform(&mut rng) * 2.0 - 1.0)
        .collect()
}

proptest! {
    /// The loss is a random combination of outputs over a few samples.
    #[test]
    fn gradients_are_what_finite_differences_say(shape in shape(), rows in 1_usize..7, seed in any::<u64>()) {
        let network = Network::initial(shape.clone(), 1.0, seed, 0);
        let compute = Compute::new(ONE);
        let inputs = draws(rows * shape.inputs, seed);
        let weights = draws(rows * shape.outputs, seed ^ 1);
        let mut space = Workspace::new(&network, rows);
        network.forward(&compute, rows, &inputs, &mut space);
        let stride = network.output_stride();
        let parameters: Vec<f64> = network.parameters.iter().map(|p| f64::from(*p)).collect();
        for row in 0..rows {
            let truth = reference(&network, &parameters, &inputs[row * shape.inputs..][..shape.inputs]);
            for (output, truth) in truth.iter().enumerate() {
                let own = f64::from(space.outputs().0[row * stride + output]);
                prop_assert!((own - truth).abs() < 1e-5 * (1.0 + truth.abs()), "{} {}", own, truth);
            }
            let slopes = &mut space.outputs().1[row * stride..][..stride];
            slopes.fill(0.0);
            slopes[..shape.outputs].copy_from_slice(&weights[row * shape.outputs..][..shape.outputs]);
        }
        let mut gradient = vec![0.0; network.parameters.len()];
        network.backward(&compute, rows, &inputs, &mut space, &mut gradient);
        let loss = |parameters: &[f64]| -> f64 {
            (0..rows).map(|row| {
                let out = reference(&network, parameters, &inputs[row * shape.inputs..][..shape.inputs]);
                let weights = &weights[row * shape.outputs..];
                out.iter().zip(weights).map(|(y, w)| y * f64::from(*w)).sum::<f64>()
            }).sum()
        };
        let mut moved = parameters.clone();
        for layer in &network.layers {
            for place in layer.weights.clone().chain(layer.biases.clone()) {
                let column = (place - layer.weights.start) % layer.stride;
                if column >= layer.outputs {
                    prop_assert_eq!(gradient[place], 0.0, "what fills up stays zero");
                    continue;
                }
                let mut at = |step: f64| {
                    moved[place] = parameters[place] + step;
                    let loss = loss(&moved);
                    moved[place] = parameters[place];
                    loss
                };
                let (above, here, below) = (at(1e-5), at(0.0), at(-1e-5));
                // Where a rectifier bends between the two points there is no derivative to compare with.
                if shape.activation == Activation::Relu && (above + below - 2.0 * here).abs() > 1e-9 {
                    continue;
                }
                let slope = (above - below) / 2e-5;
                let own = f64::from(gradient[place]);
                prop_assert!((own - slope).abs() < 2e-4 * (1.0 + slope.abs()), "{} {}", own, slope);
            }
        }
    }

    /// A row comes out the same alone, among others, with vectors and without.
    #[test]
    fn a_row_does_not_depend_on_its_neighbours(shape in shape(), rows in 1_usize..11, seed in any::<u64>()) {
        let network = Network::initial(shape.clone(), 1.0, seed, 0);
        let inputs = draws(rows * shape.inputs, seed);
        let mut together = Workspace::new(&network, rows);
        network.forward(&Compute::new(ONE), rows, &inputs, &mut together);
        let stride = network.output_stride();
        let mut alone = Workspace::new(&network, 1);
        for row in 0..rows {
            let input = &inputs[row * shape.inputs..][..shape.inputs];
            network.forward(&Compute::without_vectors(ONE), 1, input, &mut alone);
            prop_assert_eq!(&*alone.outputs().0, &together.outputs().0[row * stride..][..stride]);
        }
    }
}
