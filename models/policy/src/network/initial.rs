//! Parameters to begin with.

use super::{Layer, Network, Shape};
use crate::random::{self, Purpose};

/// A matrix with rows of unit length at right angles to each other, as far as there are columns for them; beyond
/// that the columns are so. Row by row.
fn orthogonal(rows: usize, columns: usize, seed: u64, place: (u64, u64)) -> Vec<f64> {
    let mut rng = random::stream(seed, Purpose::Weights, place);
    let (count, length) = (rows.min(columns), rows.max(columns));
    let mut vectors: Vec<Vec<f64>> = Vec::with_capacity(count);
    for _ in 0..count {
        let mut vector: Vec<f64> = (0..length).map(|_| random::normal(&mut rng)).collect();
        // Twice, since once leaves what rounding brought in (Giraud and others 2005).
        for _ in 0..2 {
            for other in &vectors {
                let along: f64 = vector.iter().zip(other).map(|(a, b)| a * b).sum();
                vector
                    .iter_mut()
                    .zip(other)
                    .for_each(|(a, b)| *a -= along * b);
            }
        }
        let length = vector.iter().map(|a| a * a).sum::<f64>().sqrt();
        for a in &mut vector {
            *a /= length;
        }
        vectors.push(vector);
    }
    let at = |row: usize, column: usize| {
        if rows <= columns {
            vectors[row][column]
        } else {
            vectors[column][row]
        }
    };
    (0..rows * columns)
        .map(|i| at(i / columns, i % columns))
        .collect()
}

impl Network {
    /// A network to learn with: orthogonal weights (Saxe and others 2014), scaled by √2 in hidden layers and by
    /// `gain` in the last one, without biases. `role` tells networks of one run apart.
    pub(crate) fn initial(shape: Shape, gain: f64, seed: u64, role: u64) -> Self {
        let mut network = Self::zero(shape);
        let layers: Vec<Layer> = network.layers.clone();
        network.change(|parameters| {
            for (index, layer) in layers.iter().enumerate() {
                let last = index + 1 == layers.len();
                let gain = if last {
                    gain
                } else {
                    core::f64::consts::SQRT_2
                };
                let weights = orthogonal(layer.inputs, layer.outputs, seed, (role, index as u64));
                let rows = parameters[layer.weights.clone()].chunks_exact_mut(layer.stride);
                for (row, weights) in rows.zip(weights.chunks_exact(layer.outputs)) {
                    for (parameter, weight) in row.iter_mut().zip(weights) {
                        *parameter = (gain * weight) as f32;
                    }
                }
            }
        });
        network
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_or_columns_are_at_right_angles() {
        for (rows, columns) in [(5, 9), (9, 5), (4, 4), (1, 7)] {
            let matrix = orthogonal(rows, columns, 1, (0, 0));
            let at = |i: usize, k: usize| {
                if rows <= columns {
                    matrix[i * columns + k]
                } else {
                    matrix[k * columns + i]
                }
            };
            let (count, length) = (rows.min(columns), rows.max(columns));
            for a in 0..count {
                for b in 0..count {
                    let product: f64 = (0..length).map(|k| at(a, k) * at(b, k)).sum();
                    let expected = if a == b { 1.0 } else { 0.0 };
                    assert!((product - expected).abs() < 1e-12, "{a} {b} {product}");
                }
            }
        }
    }
}
