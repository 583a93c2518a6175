-- The same as in records.parts.sql.
ALTER TABLE experiment ADD COLUMN build TEXT COLLATE "C" NOT NULL DEFAULT '' CHECK (length(build) <= 96);

CREATE TABLE experiment_part (
    id         BIGINT PRIMARY KEY,
    size       BIGINT NOT NULL CHECK (size BETWEEN 1 AND 1024),
    seed       BIGINT NOT NULL,
    worker     TEXT COLLATE "C" CHECK (length(worker) BETWEEN 1 AND 96),
    held_until BIGINT NOT NULL DEFAULT 0,
    lost       BIGINT NOT NULL DEFAULT 0 CHECK (lost >= 0)
);
CREATE INDEX experiment_part_held ON experiment_part (worker) WHERE worker IS NOT NULL;
