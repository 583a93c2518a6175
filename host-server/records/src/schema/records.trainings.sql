-- An experiment has trials, or is the training of a policy: then `seeds` are its rounds, and `done` those that are kept.
ALTER TABLE experiment ADD COLUMN kind TEXT NOT NULL DEFAULT 'evaluation' CHECK (kind IN ('evaluation', 'training'));
