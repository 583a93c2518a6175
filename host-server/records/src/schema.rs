//! The tables of the records in a file.

use crawler_database::Schema;

/// Accounts, credentials, audit log, experiments, fences, events, rollouts, releases: `TCRr`.
pub(crate) const RECORDS: Schema = Schema {
    id: 0x5443_5272,
    steps: &[
        include_str!("schema/records.1.sql"),
        include_str!("schema/records.experiments.sql"),
        include_str!("schema/records.fences.sql"),
        include_str!("schema/records.events.sql"),
        include_str!("schema/records.rollouts.sql"),
        include_str!("schema/records.releases.sql"),
        include_str!("schema/records.parts.sql"),
        include_str!("schema/records.trainings.sql"),
    ],
};

#[cfg(test)]
mod tests {
    use std::path::Path;

    use crawler_database::check_whole;
    use crawler_history::HISTORY;
    use sqlx::{Connection as _, SqliteConnection};

    use super::*;

    #[tokio::test]
    async fn a_file_of_any_version_comes_to_the_newest() {
        let file = Path::new("in memory");
        for schema in [RECORDS, HISTORY] {
            for known in 0..=schema.steps.len() {
                let mut connection = SqliteConnection::connect("sqlite::memory:").await.unwrap();
                let old = Schema {
                    steps: &schema.steps[..known],
                    ..schema
                };
                old.migrate(&mut connection, file).await.unwrap();
                assert_eq!(
                    old.check(&mut connection, file).await.unwrap(),
                    known as i64
                );
                schema.migrate(&mut connection, file).await.unwrap();
                let version = schema.check(&mut connection, file).await.unwrap();
                assert_eq!(version, schema.version());
                check_whole(&mut connection, file).await.unwrap();
            }
        }
    }
}
