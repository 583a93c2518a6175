-- Polygons of the ground that robots keep in or out of. The corners are JSON: [[x, y], …], metres.
CREATE TABLE fence (
    id      TEXT PRIMARY KEY NOT NULL CHECK (length(id) BETWEEN 1 AND 32),
    name    TEXT NOT NULL UNIQUE CHECK (length(name) BETWEEN 1 AND 32),
    kind    TEXT NOT NULL CHECK (kind IN ('keep_in', 'keep_out')),
    action  TEXT NOT NULL CHECK (action IN ('warn', 'stop')),
    corners TEXT NOT NULL CHECK (length(corners) <= 4096),
    made_by TEXT NOT NULL CHECK (length(made_by) <= 64),
    made_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
