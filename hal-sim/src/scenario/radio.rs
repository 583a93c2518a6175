//! The radio of a scenario.

use super::{Scenario, ScenarioError};
use crate::net::lockstep::LinkModel;
use crate::net::radio::Setup;

impl Scenario {
    /// The radio of a run.
    #[must_use]
    pub fn radio_setup(&self, seed: u64) -> Setup {
        let figures = self.drawn_parameters(seed).radio;
        Setup {
            link: self.link.unwrap_or_else(|| LinkModel::of_radio(&figures)),
            radio: self.radio.clone(),
            figures,
            seed,
        }
    }

    pub(super) fn validate_radio(&self) -> Result<(), ScenarioError> {
        if let Some(link) = &self.link {
            link.validate()
                .map_err(|text| super::validate::named("link", text))?;
        }
        if let Some(radio) = &self.radio {
            radio
                .validate()
                .map_err(|(key, rule)| ScenarioError::value(format!("radio.{key}"), rule))?;
        }
        Ok(())
    }
}
