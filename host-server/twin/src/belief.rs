//! A body, and how well it is known.

use crate::body::Parameters;
use crate::certificate::Certificate;
use crate::drive::Drive;
use crate::identify::{COUNT, Identified, Unidentified, at, identify};
use crate::linear::{Square, cholesky};

/// See the [module](self).
#[derive(Debug, Clone, PartialEq)]
pub struct Belief {
    /// What is likeliest.
    pub parameters: Parameters,
    /// Covariance in deviations of the priors.
    covariance: Square<COUNT>,
}

impl Belief {
    /// Of a robot of which nothing is known but its make.
    #[must_use]
    pub fn prior() -> Self {
        let mut covariance = [[0.0; COUNT]; COUNT];
        for (k, row) in covariance.iter_mut().enumerate() {
            row[k] = 1.0;
        }
        Self {
            parameters: Parameters::NOMINAL,
            covariance,
        }
    }

    /// Of a robot of which a drive is known, whatever it drove for.
    ///
    /// # Errors
    /// [`Unidentified`] where the drive says too little.
    pub fn of_drive(drive: &Drive<'_>) -> Result<Self, Unidentified> {
        let Identified {
            parameters,
            covariance,
            ..
        } = identify(drive, &Parameters::NOMINAL)?;
        Ok(Self {
            parameters,
            covariance,
        })
    }

    /// A body that is possible as well: the likeliest one, moved along the covariance by these draws from the standard normal
    /// distribution. The likeliest one itself where such a body could not be, or the covariance is none.
    #[must_use]
    pub fn draw(&self, normals: &[f64; COUNT]) -> Parameters {
        let drawn = cholesky(&self.covariance).map(|factor| {
            let moved = factor.map(|row| row.iter().zip(normals).map(|(a, z)| a * z).sum());
            at(&self.parameters, &moved)
        });
        drawn
            .filter(Parameters::is_sound)
            .unwrap_or(self.parameters)
    }
}

impl From<&Certificate> for Belief {
    fn from(certificate: &Certificate) -> Self {
        let mut covariance = [[0.0; COUNT]; COUNT];
        for (row, known) in covariance.iter_mut().zip(&certificate.covariance) {
            for (value, known) in row.iter_mut().zip(known) {
                *value = *known;
            }
        }
        Self {
            parameters: certificate.parameters,
            covariance,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bodies_of_a_make_are_about_the_nominal_one() {
        let prior = Belief::prior();
        let nominal = Parameters::NOMINAL;
        assert_eq!(prior.draw(&[0.0; COUNT]), nominal);
        let quick = prior.draw(&[1.0; COUNT]);
        for k in 0..2 {
            let share = quick.speed_per_volt[k] / nominal.speed_per_volt[k];
            assert!((1.1..1.2).contains(&share), "{share}");
        }
        let absurd = prior.draw(&[100.0; COUNT]);
        assert_eq!(absurd, nominal, "there is no such body");
    }
}
