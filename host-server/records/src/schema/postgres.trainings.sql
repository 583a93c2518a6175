-- The same as of records.trainings.sql.
ALTER TABLE experiment ADD COLUMN kind TEXT COLLATE "C" NOT NULL DEFAULT 'evaluation'
    CHECK (kind IN ('evaluation', 'training'));
