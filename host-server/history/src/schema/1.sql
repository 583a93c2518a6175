-- Robots by number, so that a sample need not carry a name.
CREATE TABLE robot (
    id   INTEGER PRIMARY KEY NOT NULL,
    name TEXT NOT NULL UNIQUE CHECK (length(name) BETWEEN 1 AND 32)
) STRICT;

-- What came in lately, of all robots mixed: replayed at start, gone once it is in blocks.
CREATE TABLE tail (
    id   INTEGER PRIMARY KEY NOT NULL,
    data BLOB NOT NULL
) STRICT;

-- A minute or so of one robot at one level: 0 raw, 1 seconds, 2 minutes. `first` and `last` are the
-- earliest and the latest time inside.
CREATE TABLE block (
    id    INTEGER PRIMARY KEY NOT NULL,
    level INTEGER NOT NULL CHECK (level BETWEEN 0 AND 2),
    robot INTEGER NOT NULL,
    first INTEGER NOT NULL,
    last  INTEGER NOT NULL,
    data  BLOB NOT NULL
) STRICT;
CREATE INDEX block_of_robot ON block (robot, level, last, first);
CREATE INDEX block_by_age ON block (level, last);
