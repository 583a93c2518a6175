-- Which program made the trials of an experiment: those of another may differ.
ALTER TABLE experiment ADD COLUMN build TEXT NOT NULL DEFAULT '' CHECK (length(build) <= 96);

-- What is left to do of experiments: seeds that one worker runs at a time. `id` is that of the first trial in
-- `trial`, `seed` its seed. A worker holds it until `held_until`, in Unix milliseconds by the clock of the database;
-- `lost` counts those that did not come back.
CREATE TABLE experiment_part (
    id         INTEGER PRIMARY KEY NOT NULL,
    size       INTEGER NOT NULL CHECK (size BETWEEN 1 AND 1024),
    seed       INTEGER NOT NULL,
    worker     TEXT CHECK (length(worker) BETWEEN 1 AND 96),
    held_until INTEGER NOT NULL DEFAULT 0,
    lost       INTEGER NOT NULL DEFAULT 0 CHECK (lost >= 0)
) STRICT;
CREATE INDEX experiment_part_held ON experiment_part (worker) WHERE worker IS NOT NULL;
