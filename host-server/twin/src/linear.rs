//! Small systems of linear equations.

/// A symmetric matrix of `N` rows, dense.
pub(crate) type Square<const N: usize> = [[f64; N]; N];

/// Lower factor L of A = L·Lᵀ; `None` when A is not positive definite, or no numbers.
pub(crate) fn cholesky<const N: usize>(a: &Square<N>) -> Option<Square<N>> {
    let mut l = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
            if i == j {
                let rest = a[i][i] - sum;
                // Not-a-number is not positive either.
                if !(rest > 0.0 && rest.is_finite()) {
                    return None;
                }
                l[i][i] = rest.sqrt();
            } else {
                l[i][j] = (a[i][j] - sum) / l[j][j];
            }
        }
    }
    Some(l)
}

/// The x of L·Lᵀ·x = b.
pub(crate) fn solve<const N: usize>(l: &Square<N>, b: &[f64; N]) -> [f64; N] {
    let mut x = *b;
    for i in 0..N {
        let sum: f64 = (0..i).map(|k| l[i][k] * x[k]).sum();
        x[i] = (x[i] - sum) / l[i][i];
    }
    for i in (0..N).rev() {
        let sum: f64 = (i + 1..N).map(|k| l[k][i] * x[k]).sum();
        x[i] = (x[i] - sum) / l[i][i];
    }
    x
}

/// The inverse of L·Lᵀ.
pub(crate) fn inverse<const N: usize>(l: &Square<N>) -> Square<N> {
    let mut inverse = [[0.0; N]; N];
    for i in 0..N {
        let mut unit = [0.0; N];
        unit[i] = 1.0;
        let column = solve(l, &unit);
        for (row, value) in inverse.iter_mut().zip(column) {
            row[i] = value;
        }
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_solved_is_a_solution() {
        let a = [[4.0, 1.0, -0.5], [1.0, 3.0, 0.2], [-0.5, 0.2, 2.0]];
        let l = cholesky(&a).expect("positive definite");
        let x = solve(&l, &[1.0, 2.0, 3.0]);
        for (row, b) in a.iter().zip([1.0, 2.0, 3.0]) {
            let got: f64 = row.iter().zip(x).map(|(a, x)| a * x).sum();
            assert!((got - b).abs() < 1e-12);
        }
        let unit = inverse(&l);
        let got: f64 = (0..3).map(|k| a[1][k] * unit[k][1]).sum();
        assert!((got - 1.0).abs() < 1e-12);
        assert!(cholesky(&[[1.0, 2.0], [2.0, 1.0]]).is_none(), "indefinite");
        assert!(cholesky(&[[f64::NAN]]).is_none());
    }
}
