//! What was sent lately.

use crawler_protocol::{Action, RobotId};

use super::{CommandCenter, CommandView, Record};

impl CommandCenter {
    /// The newest commands that are remembered, newest first, without the outcomes of single robots;
    /// with `robot` those that went to it, with its outcome alone. Steering sends so many `drive`
    /// commands that nothing else would be left: they are there only when `drive` asks for them.
    pub fn newest(&self, robot: Option<&RobotId>, drive: bool, limit: usize) -> Vec<CommandView> {
        let view = |record: &Record| match robot {
            Some(robot) => record.view_of(robot),
            None => Some(record.summary()),
        };
        let book = self.book();
        let records = book.table.records.values().rev();
        records
            .filter(|record| drive || !matches!(record.command.action, Action::Drive { .. }))
            .filter_map(view)
            .take(limit)
            .collect()
    }
}
