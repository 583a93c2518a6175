//! Which robots of a world a replica of it works for.

/// The robots whose index leaves `first` when divided by `stride`.
///
/// A world can be run by several threads. Each of them has a *replica*: the whole arena and all
/// bodies, but devices, programs and private state of its members only. What the others do it
/// takes over after every step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Members {
    first: usize,
    stride: usize,
}

impl Members {
    /// Every robot: the whole world in one thread.
    pub const ALL: Self = Self {
        first: 0,
        stride: 1,
    };

    /// The robots of shard `shard` of `shards`; `None` unless `shard` is less than `shards`.
    #[must_use]
    pub const fn of_shard(shard: usize, shards: usize) -> Option<Self> {
        if shard < shards {
            Some(Self {
                first: shard,
                stride: shards,
            })
        } else {
            None
        }
    }

    /// Whether the robot with this index is one of them.
    #[must_use]
    pub const fn contains(self, robot: usize) -> bool {
        // Saves the division where there is nothing to divide.
        self.stride == 1 || robot % self.stride == self.first
    }

    /// The lowest index among them.
    #[must_use]
    pub const fn first(self) -> usize {
        self.first
    }

    /// The distance from one to the next.
    #[must_use]
    pub const fn stride(self) -> usize {
        self.stride
    }

    /// Their indices below `robots`, ascending.
    pub fn iter(self, robots: usize) -> impl Iterator<Item = usize> {
        (self.first..robots.max(self.first)).step_by(self.stride)
    }
}

impl Default for Members {
    fn default() -> Self {
        Self::ALL
    }
}

#[cfg(test)]
mod tests {
    use super::Members;

    #[test]
    fn shards_share_all_robots_without_gap_or_overlap() {
        for shards in 1..=5 {
            let mut owners = [0; 17];
            for shard in 0..shards {
                let members = Members::of_shard(shard, shards).unwrap();
                for robot in members.iter(owners.len()) {
                    owners[robot] += 1;
                    assert!(members.contains(robot));
                }
                let counted = (0..owners.len()).filter(|&robot| members.contains(robot));
                assert_eq!(counted.count(), members.iter(owners.len()).count());
            }
            assert_eq!(owners, [1; 17]);
        }
        assert_eq!(Members::of_shard(3, 8).unwrap().iter(2).count(), 0);
        assert_eq!(Members::of_shard(2, 2), None);
        assert_eq!(Members::of_shard(0, 0), None);
        assert_eq!(Members::of_shard(0, 1), Some(Members::ALL));
    }
}
