-- What a rollout is to do and how far it is stands in `document`, JSON that means something to the server alone.
-- `epoch` rises each time it goes to another server, `beat` while its server lives.
CREATE TABLE rollout (
    id       INTEGER PRIMARY KEY NOT NULL,
    made_by  TEXT NOT NULL CHECK (length(made_by) <= 64),
    made     INTEGER NOT NULL,
    ended    INTEGER,
    owner    TEXT NOT NULL CHECK (length(owner) BETWEEN 1 AND 64),
    epoch    INTEGER NOT NULL CHECK (epoch >= 1),
    beat     INTEGER NOT NULL CHECK (beat >= 0),
    document TEXT NOT NULL CHECK (length(document) <= 2097152)
) STRICT;
CREATE INDEX rollout_at_work ON rollout (id) WHERE ended IS NULL;

-- `place` is the id of the rollout, a slash, and that of the robot.
CREATE TABLE rollout_robot (
    place TEXT PRIMARY KEY NOT NULL CHECK (length(place) <= 64),
    state TEXT NOT NULL CHECK (length(state) BETWEEN 1 AND 32),
    entry TEXT NOT NULL CHECK (length(entry) <= 4096)
) STRICT, WITHOUT ROWID;

-- What has happened. `place` is that of the robot, or the id of the rollout with a slash, then a slash and the
-- revision in ten digits.
CREATE TABLE rollout_note (
    place TEXT PRIMARY KEY NOT NULL CHECK (length(place) <= 80),
    at    INTEGER NOT NULL,
    what  TEXT NOT NULL CHECK (length(what) <= 4096)
) STRICT, WITHOUT ROWID;
