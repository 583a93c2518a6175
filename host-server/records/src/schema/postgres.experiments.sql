-- The same tables as of records.experiments.sql.
CREATE TABLE experiment (
    id      BIGINT PRIMARY KEY,
    owner   TEXT COLLATE "C" NOT NULL CHECK (length(owner) BETWEEN 1 AND 64),
    name    TEXT NOT NULL CHECK (length(name) BETWEEN 1 AND 64),
    recipe  TEXT NOT NULL CHECK (length(recipe) <= 65536),
    metrics TEXT NOT NULL CHECK (length(metrics) <= 65536),
    results TEXT NOT NULL CHECK (length(results) <= 65536),
    seeds   BIGINT NOT NULL CHECK (seeds BETWEEN 1 AND 100000),
    made_by TEXT NOT NULL CHECK (length(made_by) <= 64),
    created BIGINT NOT NULL,
    started BIGINT,
    ended   BIGINT,
    state   TEXT NOT NULL CHECK (state IN ('created', 'running', 'paused', 'stopped', 'completed', 'failed')),
    reason  TEXT CHECK (length(reason) <= 512),
    done    BIGINT NOT NULL CHECK (done BETWEEN 0 AND seeds)
);

CREATE TABLE trial (
    id       BIGINT PRIMARY KEY,
    seed     BIGINT NOT NULL,
    success  BIGINT NOT NULL CHECK (success IN (0, 1)),
    reason   TEXT CHECK (length(reason) <= 512),
    measured BYTEA NOT NULL CHECK (length(measured) <= 512)
);
