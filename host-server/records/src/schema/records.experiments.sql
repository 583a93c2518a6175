-- What was asked for is in `recipe`, what is measured in `metrics`, what it came to in `results`: texts
-- that mean something to the server alone.
CREATE TABLE experiment (
    id      INTEGER PRIMARY KEY NOT NULL,
    owner   TEXT NOT NULL CHECK (length(owner) BETWEEN 1 AND 64),
    name    TEXT NOT NULL CHECK (length(name) BETWEEN 1 AND 64),
    recipe  TEXT NOT NULL CHECK (length(recipe) <= 65536),
    metrics TEXT NOT NULL CHECK (length(metrics) <= 65536),
    results TEXT NOT NULL CHECK (length(results) <= 65536),
    seeds   INTEGER NOT NULL CHECK (seeds BETWEEN 1 AND 100000),
    made_by TEXT NOT NULL CHECK (length(made_by) <= 64),
    created INTEGER NOT NULL,
    started INTEGER,
    ended   INTEGER,
    state   TEXT NOT NULL CHECK (state IN ('created', 'running', 'paused', 'stopped', 'completed', 'failed')),
    reason  TEXT CHECK (length(reason) <= 512),
    done    INTEGER NOT NULL CHECK (done BETWEEN 0 AND seeds)
) STRICT;

-- `id` is 1048576 times that of the experiment, plus the number of the trial. `measured` has a number
-- of 64 bits for each metric; not-a-number stands for one that the trial does not have.
CREATE TABLE trial (
    id       INTEGER PRIMARY KEY NOT NULL,
    seed     INTEGER NOT NULL,
    success  INTEGER NOT NULL CHECK (success IN (0, 1)),
    reason   TEXT CHECK (length(reason) <= 512),
    measured BLOB NOT NULL CHECK (length(measured) <= 512)
) STRICT;
