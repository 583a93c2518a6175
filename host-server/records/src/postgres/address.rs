//! Addresses of databases, and what to tell people about one that does not work.

use std::str::FromStr as _;

use sqlx::postgres::{PgConnectOptions, PgDatabaseError};

use crate::RecordsError;

/// What may follow the `?` of an address. The library lets others pass with a warning, and so
/// `sslmod=verify-full` would mean no check at all.
const PARAMETERS: [&str; 11] = [
    "application_name",
    "dbname",
    "host",
    "options",
    "password",
    "port",
    "sslcert",
    "sslkey",
    "sslmode",
    "sslrootcert",
    "user",
];

/// The options that `url` stands for. What it leaves out comes from the variables that every program
/// of `PostgreSQL` knows, such as `PGPASSWORD`, and from `~/.pgpass`.
pub(super) fn options(url: &str) -> Result<PgConnectOptions, RecordsError> {
    let (_, parameters) = url.split_once('?').unwrap_or((url, ""));
    let unknown = parameters
        .split('&')
        .filter_map(|parameter| parameter.split('=').next())
        .find(|name| !name.is_empty() && !PARAMETERS.contains(name));
    if let Some(name) = unknown {
        return Err(RecordsError::Refused(format!(
            "the address of the database has a parameter `{name}`; it may have {}",
            PARAMETERS.join(", ")
        )));
    }
    let options = PgConnectOptions::from_str(url).map_err(|error| {
        RecordsError::Refused(format!("the address of the database is none: {error}"))
    })?;
    if options.get_application_name().is_some() {
        return Ok(options);
    }
    Ok(options.application_name("terracrawler"))
}

/// The address without user name, password and parameters.
pub(super) fn shown(options: &PgConnectOptions) -> String {
    let database = options.get_database().unwrap_or(options.get_username());
    if let Some(socket) = options.get_socket() {
        return format!("postgres://{}/{database}", socket.display());
    }
    let (host, port) = (options.get_host(), options.get_port());
    format!("postgres://{host}:{port}/{database}")
}

/// The same error, as one of TLS where it is: a certificate that is no good comes as bytes that are.
pub(super) fn tls(error: sqlx::Error) -> sqlx::Error {
    match error {
        sqlx::Error::Io(error) if error.kind() == std::io::ErrorKind::InvalidData => {
            sqlx::Error::Tls(error.into())
        }
        error => error,
    }
}

/// The same error with the place, and what to do about it.
pub(super) fn explain(
    error: RecordsError,
    options: &PgConnectOptions,
    shown: &str,
) -> RecordsError {
    let cause = match error {
        RecordsError::Unavailable(why) => {
            return RecordsError::Unavailable(format!("{shown}: {why}"));
        }
        RecordsError::Storage(cause) => cause,
        error => return error,
    };
    let user = options.get_username();
    let database = options.get_database().unwrap_or(user);
    let refused = |why: String| RecordsError::Refused(format!("{shown}: {why}"));
    match &*cause {
        sqlx::Error::Tls(error) => refused(format!(
            "TLS fails: {error}; look at sslmode and sslrootcert in the address"
        )),
        sqlx::Error::Configuration(error) => refused(error.to_string()),
        sqlx::Error::Database(error) => {
            let code = error
                .try_downcast_ref::<PgDatabaseError>()
                .map_or("", PgDatabaseError::code);
            let said = error.message();
            match code {
                // Wrong password, no such user, or pg_hba.conf.
                "28P01" | "28000" => refused(format!("the database lets `{user}` not in: {said}")),
                "3D000" => refused(format!(
                    "there is no database `{database}`: `createdb --owner={user} {database}`"
                )),
                "42501" | "3F000" => refused(format!(
                    "`{user}` may not make tables there ({said}): make it the owner of the database"
                )),
                _ => refused(format!("the database refuses: {said}")),
            }
        }
        _ => RecordsError::Storage(cause),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_shown_has_no_password() {
        let options = options("postgres://ada:p%40ss@db.example/fleet?sslmode=require").unwrap();
        assert_eq!(shown(&options), "postgres://db.example:5432/fleet");
        assert_eq!(options.get_application_name(), Some("terracrawler"));
    }

    #[test]
    fn a_parameter_that_nobody_knows_is_refused() {
        for (url, says) in [
            ("postgres://db/fleet?sslmod=require", "`sslmod`"),
            ("postgres://db/fleet?sslmode=perhaps", "perhaps"),
            ("postgres://db:port/fleet", "none"),
        ] {
            let error = options(url).map(|_| ()).expect_err(url).to_string();
            assert!(error.contains(says), "{url}: {error}");
        }
    }
}
