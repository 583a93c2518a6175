CREATE TABLE setting (
    key   TEXT PRIMARY KEY NOT NULL CHECK (length(key) BETWEEN 1 AND 64),
    value BLOB NOT NULL CHECK (length(value) <= 65536)
) STRICT, WITHOUT ROWID;

CREATE TABLE user (
    name     TEXT PRIMARY KEY NOT NULL CHECK (length(name) BETWEEN 1 AND 32),
    role     TEXT NOT NULL CHECK (role IN ('viewer', 'operator', 'admin')),
    password TEXT CHECK (length(password) <= 512),
    created  INTEGER NOT NULL,
    disabled INTEGER NOT NULL CHECK (disabled IN (0, 1))
) STRICT, WITHOUT ROWID;

-- Without a name: the person chooses one.
CREATE TABLE invitation (
    digest  BLOB PRIMARY KEY NOT NULL CHECK (length(digest) = 32),
    name    TEXT CHECK (length(name) BETWEEN 1 AND 32),
    role    TEXT NOT NULL CHECK (role IN ('viewer', 'operator', 'admin')),
    expires INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

-- A session outlives the user that it is of: until its last token has expired, it must be known to
-- be revoked. AUTOINCREMENT: a number never comes back.
CREATE TABLE session (
    id        INTEGER PRIMARY KEY AUTOINCREMENT,
    user      TEXT NOT NULL CHECK (length(user) BETWEEN 1 AND 32),
    came_from TEXT NOT NULL CHECK (length(came_from) <= 128),
    opened    INTEGER NOT NULL,
    refreshed INTEGER NOT NULL,
    expires   INTEGER NOT NULL,
    revoked   INTEGER
) STRICT;
CREATE INDEX session_user ON session (user, id);
CREATE INDEX session_revoked ON session (revoked) WHERE revoked IS NOT NULL;
CREATE INDEX session_expires ON session (expires);

-- Used ones stay for a while, so that a stolen one gives itself away.
CREATE TABLE refresh (
    digest  BLOB PRIMARY KEY NOT NULL CHECK (length(digest) = 32),
    session INTEGER NOT NULL REFERENCES session (id) ON DELETE CASCADE,
    used    INTEGER
) STRICT, WITHOUT ROWID;
CREATE INDEX refresh_session ON refresh (session, used);

CREATE TABLE credential (
    name    TEXT PRIMARY KEY NOT NULL CHECK (length(name) BETWEEN 1 AND 64),
    digest  BLOB NOT NULL CHECK (length(digest) = 32),
    created INTEGER NOT NULL,
    made_by TEXT NOT NULL CHECK (length(made_by) <= 64),
    revoked INTEGER
) STRICT, WITHOUT ROWID;

CREATE TABLE audit (
    seq       INTEGER PRIMARY KEY NOT NULL,
    at        INTEGER NOT NULL,
    who       TEXT NOT NULL CHECK (length(who) <= 64),
    came_from TEXT NOT NULL CHECK (length(came_from) <= 128),
    action    TEXT NOT NULL CHECK (length(action) <= 64),
    target    TEXT NOT NULL CHECK (length(target) <= 128),
    detail    TEXT NOT NULL CHECK (length(detail) <= 8192),
    outcome   TEXT NOT NULL CHECK (length(outcome) <= 128),
    hash      BLOB NOT NULL CHECK (length(hash) = 32)
) STRICT;
CREATE INDEX audit_who ON audit (who, seq);

-- Where the log ends: without it nobody would notice that its last entries are gone.
CREATE TABLE audit_end (
    one  INTEGER PRIMARY KEY NOT NULL CHECK (one = 1),
    seq  INTEGER NOT NULL,
    hash BLOB NOT NULL CHECK (length(hash) = 32)
) STRICT;
INSERT INTO audit_end VALUES (1, 0, zeroblob(32));

CREATE TRIGGER audit_never_changes BEFORE UPDATE ON audit
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
CREATE TRIGGER audit_never_shrinks BEFORE DELETE ON audit
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
-- INSERT OR REPLACE deletes without the trigger above.
CREATE TRIGGER audit_only_grows BEFORE INSERT ON audit
WHEN NEW.seq IS NOT (SELECT seq + 1 FROM audit_end)
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
CREATE TRIGGER audit_end_stays BEFORE DELETE ON audit_end
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
CREATE TRIGGER audit_end_follows BEFORE UPDATE ON audit_end
WHEN NEW.hash IS NOT (SELECT hash FROM audit WHERE seq = NEW.seq) OR NEW.seq IS NOT OLD.seq + 1
BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END;
