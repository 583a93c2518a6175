-- The same tables as of records.releases.sql.
CREATE TABLE release (
    id           TEXT COLLATE "C" PRIMARY KEY CHECK (length(id) = 16),
    kind         TEXT NOT NULL CHECK (kind IN ('program', 'model')),
    name         TEXT CHECK (length(name) BETWEEN 1 AND 16),
    board        TEXT NOT NULL CHECK (length(board) BETWEEN 1 AND 16),
    version      TEXT NOT NULL CHECK (length(version) BETWEEN 1 AND 32),
    build        TEXT NOT NULL CHECK (length(build) BETWEEN 1 AND 40),
    sequence     BIGINT NOT NULL CHECK (sequence BETWEEN 1 AND 4294967295),
    floor        BIGINT NOT NULL CHECK (floor BETWEEN 0 AND sequence),
    expires      BIGINT,
    size         BIGINT NOT NULL CHECK (size BETWEEN 1 AND 4718592),
    envelope     BYTEA NOT NULL CHECK (length(envelope) <= 1024),
    gate         BYTEA CHECK (length(gate) <= 262144),
    passed       BIGINT CHECK (passed IN (0, 1)),
    added_by     TEXT NOT NULL CHECK (length(added_by) <= 64),
    added        BIGINT NOT NULL,
    withdrawn_by TEXT CHECK (length(withdrawn_by) <= 64),
    withdrawn    BIGINT,
    why          TEXT CHECK (length(why) <= 512)
);
CREATE INDEX release_by_time ON release (added, id);

CREATE TABLE release_piece (
    place TEXT COLLATE "C" PRIMARY KEY CHECK (length(place) = 20),
    data  BYTEA NOT NULL CHECK (length(data) BETWEEN 1 AND 65536)
);
