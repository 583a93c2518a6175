-- The same table as of records.fences.sql, as PostgreSQL has it.
CREATE TABLE fence (
    id      TEXT COLLATE "C" PRIMARY KEY CHECK (length(id) BETWEEN 1 AND 32),
    name    TEXT COLLATE "C" NOT NULL UNIQUE CHECK (length(name) BETWEEN 1 AND 32),
    kind    TEXT NOT NULL CHECK (kind IN ('keep_in', 'keep_out')),
    action  TEXT NOT NULL CHECK (action IN ('warn', 'stop')),
    corners TEXT NOT NULL CHECK (length(corners) <= 4096),
    made_by TEXT NOT NULL CHECK (length(made_by) <= 64),
    made_at BIGINT NOT NULL
);
