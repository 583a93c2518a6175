//! An account, as it is stored.

use std::fmt;

use crawler_access::{Role, UserName};

use crate::RecordsError;
use crate::query::{Connection, query};

/// An account.
#[derive(Clone, PartialEq, Eq)]
pub struct User {
    /// Its name.
    pub name: UserName,
    /// What it may do.
    pub role: Role,
    /// Hash of its password; without one nobody can log in.
    pub password: Option<String>,
    /// When it was made.
    pub created: i64,
    /// Kept, but locked out.
    pub disabled: bool,
}

impl fmt::Debug for User {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("User")
            .field("name", &self.name)
            .field("role", &self.role)
            // Debug texts end up in logs, where a hash invites guessing.
            .field("password", &self.password.as_ref().map(|_| ".."))
            .field("created", &self.created)
            .field("disabled", &self.disabled)
            .finish()
    }
}

pub(crate) type Row = (String, String, Option<String>, i64, i64);

/// A name from the file.
pub(crate) fn name(text: &str) -> Result<UserName, RecordsError> {
    text.parse()
        .map_err(|_| RecordsError::Invalid("an invalid user name is stored"))
}

/// A role from the file.
pub(crate) fn role(text: &str) -> Result<Role, RecordsError> {
    text.parse()
        .map_err(|_| RecordsError::Invalid("an invalid role is stored"))
}

pub(crate) fn user(
    (user, its_role, password, created, disabled): Row,
) -> Result<User, RecordsError> {
    Ok(User {
        name: name(&user)?,
        role: role(&its_role)?,
        password,
        created,
        disabled: disabled != 0,
    })
}

/// The account of that name.
pub(crate) async fn find(
    connection: &mut Connection<'_>,
    name: &str,
) -> Result<Option<User>, RecordsError> {
    let row: Option<Row> =
        query("SELECT name, role, password, created, disabled FROM \"user\" WHERE name = $1")
            .bind(name)
            .fetch_optional(connection)
            .await?;
    row.map(user).transpose()
}
