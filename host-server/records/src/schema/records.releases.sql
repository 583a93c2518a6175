-- What the manifest says stands in the columns, the manifest with its signature in `envelope`. The image is in
-- `release_piece`, and gone once a release was withdrawn. `gate` is the signed report on what the release was
-- tried on, and `passed` says whether it passed.
CREATE TABLE release (
    id           TEXT PRIMARY KEY NOT NULL CHECK (length(id) = 16),
    kind         TEXT NOT NULL CHECK (kind IN ('program', 'model')),
    name         TEXT CHECK (length(name) BETWEEN 1 AND 16),
    board        TEXT NOT NULL CHECK (length(board) BETWEEN 1 AND 16),
    version      TEXT NOT NULL CHECK (length(version) BETWEEN 1 AND 32),
    build        TEXT NOT NULL CHECK (length(build) BETWEEN 1 AND 40),
    sequence     INTEGER NOT NULL CHECK (sequence BETWEEN 1 AND 4294967295),
    floor        INTEGER NOT NULL CHECK (floor BETWEEN 0 AND sequence),
    expires      INTEGER,
    size         INTEGER NOT NULL CHECK (size BETWEEN 1 AND 4718592),
    envelope     BLOB NOT NULL CHECK (length(envelope) <= 1024),
    gate         BLOB CHECK (length(gate) <= 262144),
    passed       INTEGER CHECK (passed IN (0, 1)),
    added_by     TEXT NOT NULL CHECK (length(added_by) <= 64),
    added        INTEGER NOT NULL,
    withdrawn_by TEXT CHECK (length(withdrawn_by) <= 64),
    withdrawn    INTEGER,
    why          TEXT CHECK (length(why) <= 512)
) STRICT;
CREATE INDEX release_by_time ON release (added, id);

-- `place` is the id of the release, a hyphen, and the number of the piece in three digits. Every piece has 65536
-- bytes, but for the last one.
CREATE TABLE release_piece (
    place TEXT PRIMARY KEY NOT NULL CHECK (length(place) = 20),
    data  BLOB NOT NULL CHECK (length(data) BETWEEN 1 AND 65536)
) STRICT;
