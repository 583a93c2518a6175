-- What an operator should know of, in words, newest last. AUTOINCREMENT: how many there are is told by
-- the numbers, which never come back. Levels: 0 info, 1 warn, 2 error.
CREATE TABLE event (
    id    INTEGER PRIMARY KEY AUTOINCREMENT,
    at    INTEGER NOT NULL,
    level INTEGER NOT NULL CHECK (level BETWEEN 0 AND 2),
    robot TEXT CHECK (length(robot) BETWEEN 1 AND 32),
    text  TEXT NOT NULL CHECK (length(text) <= 1024)
) STRICT;
CREATE INDEX event_by_time ON event (at, id);
CREATE INDEX event_warn ON event (at, id) WHERE level >= 1;
CREATE INDEX event_error ON event (at, id) WHERE level >= 2;
CREATE INDEX event_of_robot ON event (robot, at, id) WHERE robot IS NOT NULL;

-- The simulated arena from a time on, as JSON; NULL where there is none from then on.
CREATE TABLE arena (
    id   INTEGER PRIMARY KEY AUTOINCREMENT,
    at   INTEGER NOT NULL,
    data TEXT CHECK (length(data) <= 1048576)
) STRICT;
CREATE INDEX arena_by_time ON arena (at, id);
