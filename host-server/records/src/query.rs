//! One set of statements for both engines: `$1` stands for a value in either, and what goes in and
//! comes out are whole numbers, texts and bytes.

use sqlx::postgres::{PgConnection, PgRow};
use sqlx::sqlite::{SqliteConnection, SqliteRow};
use sqlx::{ColumnIndex, Decode, FromRow, SqlSafeStr, SqlStr, Type, TypeInfo as _};

use crate::RecordsError;
use crawler_database::Boxed;

/// A connection of either engine, lent for a piece of work.
#[derive(Debug)]
pub(crate) enum Connection<'c> {
    Sqlite(&'c mut SqliteConnection),
    Postgres(&'c mut PgConnection),
}

/// What goes in.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    Integer(Option<i64>),
    Text(Option<String>),
    Bytes(Option<Vec<u8>>),
}

impl From<i64> for Value {
    fn from(value: i64) -> Self {
        Self::Integer(Some(value))
    }
}
impl From<Option<i64>> for Value {
    fn from(value: Option<i64>) -> Self {
        Self::Integer(value)
    }
}
impl From<bool> for Value {
    fn from(value: bool) -> Self {
        Self::Integer(Some(value.into()))
    }
}
impl From<String> for Value {
    fn from(value: String) -> Self {
        Self::Text(Some(value))
    }
}
impl From<&String> for Value {
    fn from(value: &String) -> Self {
        Self::Text(Some(value.clone()))
    }
}
impl From<&str> for Value {
    fn from(value: &str) -> Self {
        Self::Text(Some(value.to_owned()))
    }
}
impl From<Option<String>> for Value {
    fn from(value: Option<String>) -> Self {
        Self::Text(value)
    }
}
impl From<Vec<u8>> for Value {
    fn from(value: Vec<u8>) -> Self {
        Self::Bytes(Some(value))
    }
}

/// What comes out: a tuple.
pub(crate) trait Row:
    Send + Unpin + for<'r> FromRow<'r, SqliteRow> + for<'r> FromRow<'r, PgRow>
{
}
impl<T> Row for T where T: Send + Unpin + for<'r> FromRow<'r, SqliteRow> + for<'r> FromRow<'r, PgRow>
{}

/// A row of columns that are known at run time only.
#[derive(Debug, PartialEq)]
pub(crate) struct Values(pub(crate) Vec<Value>);

impl<'r, R> FromRow<'r, R> for Values
where
    R: sqlx::Row,
    usize: ColumnIndex<R>,
    i64: Decode<'r, R::Database> + Type<R::Database>,
    String: Decode<'r, R::Database> + Type<R::Database>,
    Vec<u8>: Decode<'r, R::Database> + Type<R::Database>,
{
    fn from_row(row: &'r R) -> Result<Self, sqlx::Error> {
        use sqlx::Column as _;
        let values = row.columns().iter().enumerate().map(|(index, column)| {
            match column.type_info().name() {
                "INTEGER" | "INT8" => row.try_get(index).map(Value::Integer),
                "TEXT" => row.try_get(index).map(Value::Text),
                _ => row.try_get(index).map(Value::Bytes),
            }
        });
        values.collect::<Result<_, _>>().map(Self)
    }
}

/// What an engine answered.
enum Rows {
    Sqlite(Vec<SqliteRow>),
    Postgres(Vec<PgRow>),
}

impl Rows {
    fn read<T: Row>(&self) -> Result<Vec<T>, RecordsError> {
        let read: Result<_, sqlx::Error> = match self {
            Self::Sqlite(rows) => rows.iter().map(T::from_row).collect(),
            Self::Postgres(rows) => rows.iter().map(T::from_row).collect(),
        };
        Ok(read?)
    }
}

/// A statement and its values.
///
/// What drives an engine is [`Boxed`], and the same for every type of row.
#[derive(Debug)]
#[must_use = "it does nothing until it is executed"]
pub(crate) struct Query {
    sql: SqlStr,
    values: Vec<Value>,
}

pub(crate) fn query(sql: impl SqlSafeStr) -> Query {
    Query {
        sql: sql.into_sql_str(),
        values: Vec::new(),
    }
}

/// `query` with `values`, each in its own type.
macro_rules! bound {
    ($query:expr, $values:expr) => {{
        let mut query = $query;
        for value in $values {
            query = match value {
                Value::Integer(value) => query.bind(value),
                Value::Text(value) => query.bind(value),
                Value::Bytes(value) => query.bind(value),
            };
        }
        query
    }};
}

impl Query {
    /// The value of the next `$n`.
    pub(crate) fn bind(mut self, value: impl Into<Value>) -> Self {
        self.values.push(value.into());
        self
    }

    /// Returns how many rows it changed.
    pub(crate) fn execute<'c>(
        self,
        on: &'c mut Connection<'_>,
    ) -> Boxed<'c, Result<u64, RecordsError>> {
        Box::pin(async move {
            Ok(match on {
                Connection::Sqlite(on) => bound!(sqlx::query(self.sql), self.values)
                    .execute(&mut **on)
                    .await?
                    .rows_affected(),
                Connection::Postgres(on) => bound!(sqlx::query(self.sql), self.values)
                    .execute(&mut **on)
                    .await?
                    .rows_affected(),
            })
        })
    }

    pub(crate) async fn fetch_all<T: Row>(
        self,
        on: &mut Connection<'_>,
    ) -> Result<Vec<T>, RecordsError> {
        self.rows(on).await?.read()
    }

    pub(crate) async fn fetch_optional<T: Row>(
        self,
        on: &mut Connection<'_>,
    ) -> Result<Option<T>, RecordsError> {
        Ok(self.first_row(on).await?.read()?.pop())
    }

    /// As [`Query::fetch_optional`], where there must be a row.
    pub(crate) async fn fetch_one<T: Row>(
        self,
        on: &mut Connection<'_>,
    ) -> Result<T, RecordsError> {
        let row = self.fetch_optional(on).await?;
        row.ok_or_else(|| sqlx::Error::RowNotFound.into())
    }

    fn rows<'c>(self, on: &'c mut Connection<'_>) -> Boxed<'c, Result<Rows, RecordsError>> {
        Box::pin(async move {
            Ok(match on {
                Connection::Sqlite(on) => {
                    let query = bound!(sqlx::query(self.sql), self.values);
                    Rows::Sqlite(query.fetch_all(&mut **on).await?)
                }
                Connection::Postgres(on) => {
                    let query = bound!(sqlx::query(self.sql), self.values);
                    Rows::Postgres(query.fetch_all(&mut **on).await?)
                }
            })
        })
    }

    /// No more than one.
    fn first_row<'c>(self, on: &'c mut Connection<'_>) -> Boxed<'c, Result<Rows, RecordsError>> {
        Box::pin(async move {
            Ok(match on {
                Connection::Sqlite(on) => {
                    let query = bound!(sqlx::query(self.sql), self.values);
                    let row = query.fetch_optional(&mut **on).await?;
                    Rows::Sqlite(row.into_iter().collect())
                }
                Connection::Postgres(on) => {
                    let query = bound!(sqlx::query(self.sql), self.values);
                    let row = query.fetch_optional(&mut **on).await?;
                    Rows::Postgres(row.into_iter().collect())
                }
            })
        })
    }
}

/// `refusal` unless a row was changed.
pub(crate) fn changed(rows: u64, refusal: RecordsError) -> Result<(), RecordsError> {
    if rows == 0 { Err(refusal) } else { Ok(()) }
}
