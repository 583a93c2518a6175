-- The same tables as of records.rollouts.sql.
CREATE TABLE rollout (
    id       BIGINT PRIMARY KEY,
    made_by  TEXT NOT NULL CHECK (length(made_by) <= 64),
    made     BIGINT NOT NULL,
    ended    BIGINT,
    owner    TEXT NOT NULL CHECK (length(owner) BETWEEN 1 AND 64),
    epoch    BIGINT NOT NULL CHECK (epoch >= 1),
    beat     BIGINT NOT NULL CHECK (beat >= 0),
    document TEXT NOT NULL CHECK (length(document) <= 2097152)
);
CREATE INDEX rollout_at_work ON rollout (id) WHERE ended IS NULL;

CREATE TABLE rollout_robot (
    place TEXT COLLATE "C" PRIMARY KEY CHECK (length(place) <= 64),
    state TEXT NOT NULL CHECK (length(state) BETWEEN 1 AND 32),
    entry TEXT NOT NULL CHECK (length(entry) <= 4096)
);

CREATE TABLE rollout_note (
    place TEXT COLLATE "C" PRIMARY KEY CHECK (length(place) <= 80),
    at    BIGINT NOT NULL,
    what  TEXT NOT NULL CHECK (length(what) <= 4096)
);
