//! What came of it all, from the server's commands and from the robots themselves.

use std::collections::BTreeSet;

use crawler_app::parameters::Parameter;
use crawler_delivery::{Class, End};
use crawler_protocol::{Action, ParameterValue};

use super::{Chaos, Report};

impl Chaos {
    pub(super) fn judge(mut self) -> Report {
        self.report.virtual_s = self.now() / 1_000;
        (self.report.sent, self.report.again) = (self.table.sent, self.table.again);
        let mut definite: Vec<BTreeSet<u64>> = vec![BTreeSet::new(); self.ids.len()];
        let mut perhaps = vec![0_u32; self.ids.len()];
        let last_halt = |robot: usize| -> u64 {
            let halts = self
                .table
                .given
                .iter()
                .filter(|(_, given)| given.robot == robot && given.class == Class::Halt);
            halts.map(|(id, _)| *id).max().unwrap_or(0)
        };
        let last_halts: Vec<u64> = (0..self.ids.len()).map(last_halt).collect();
        let mut settings: Vec<Option<f32>> = vec![None; self.ids.len()];
        for (id, given) in &self.table.given {
            let name = match given.class {
                Class::Halt => "stop",
                Class::Motion => "move, drive",
                Class::Plain => "identify",
                Class::Setting => "set",
            };
            let row = self.report.commands.entry(name).or_default();
            row[0] += 1;
            if !given.ran.is_empty() {
                row[1] += 1;
            } else if given.answered.is_some() {
                row[2] += 1;
            } else if given.end == Some(End::Expired) {
                row[3] += 1;
            } else if given.class == Class::Motion {
                self.report.unanswered_motion += 1;
                row[3] += 1;
                perhaps[given.robot] += 1;
            } else if given.forgotten && *id == last_halts[given.robot] {
                self.report.forgotten_halts += 1;
                row[2] += 1;
            } else if given.class != Class::Halt || *id == last_halts[given.robot] {
                self.report.lost += 1;
                perhaps[given.robot] += 1;
            } else {
                // A newer halt took its place.
                row[2] += 1;
            }
            if given.class == Class::Setting
                && !given.ran.is_empty()
                && let Action::Set(values) = &given.action
                && let Some((_, ParameterValue::Number(value))) = values.first()
            {
                settings[given.robot] = Some(*value);
            }
            if given.class != Class::Halt {
                self.report.twice += given.ran.len().saturating_sub(1) as u64;
                definite[given.robot].extend(&given.ran);
            }
            assert!(given.at <= self.simulation.now().as_millis());
        }
        for robot in 0..self.ids.len() {
            let program = self.simulation.robot(robot).unwrap();
            let (tally, known) = (program.tally(), &definite[robot]);
            let count = known.len() as u32;
            let most = count + perhaps[robot];
            self.report.twice += u64::from(tally.commands.saturating_sub(most));
            self.report.invented += u64::from(count.saturating_sub(tally.commands));
            if perhaps[robot] == 0 && tally.numbers != known.iter().sum::<u64>() {
                self.report.invented += 1;
            }
            let held =
                program.with_parameters(|parameters| parameters.number(Parameter::SafeDistance));
            let right = settings[robot].is_none_or(|value| value == held);
            self.report.wrong_settings += u64::from(!right);
            self.report.reboots += u64::from(self.simulation.boots(robot) - 1);
        }
        self.report
    }
}
