//! Names of what a world can be told to keep or to load.

use crawler_protocol::{MAX_ID, identifier, ids};

identifier!(
    /// The name of a snapshot of a simulated world: same alphabet as
    /// [`RobotId`](crawler_protocol::RobotId), so that it is safe as the name of a file.
    SnapshotName, MAX_ID, ids::is_id_byte,
    "a name of a snapshot: 1 to 32 characters of a-z, 0-9 and -", "^[a-z0-9-]+$"
);
identifier!(
    /// The name of a scenario: same alphabet as [`RobotId`](crawler_protocol::RobotId).
    ScenarioName, MAX_ID, ids::is_id_byte,
    "a name of a scenario: 1 to 32 characters of a-z, 0-9 and -", "^[a-z0-9-]+$"
);
