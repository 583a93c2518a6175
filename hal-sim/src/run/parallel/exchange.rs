//! What the shards of a world hand each other at the end of each physics step.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};

use crawler_protocol::Says;

use super::barrier::Barrier;
use crate::devices::World;
use crate::net::lockstep::{News, VirtualNetwork};
use crate::world::{Members, Published};

/// What a shard tells the others about one step.
#[derive(Debug, Default)]
struct Page {
    bodies: Vec<Published>,
    said: Vec<(usize, Says)>,
    news: News,
}

/// One exchange for all shards of a world.
#[derive(Debug)]
pub(super) struct Exchange {
    /// Two pages for each shard: while one is read by those who are late, the next step is
    /// written on the other. Who writes on a page a second time has met all others since, and
    /// they read the first time before they came.
    pages: Vec<[RwLock<Page>; 2]>,
    barrier: Barrier,
}

impl Exchange {
    pub(super) fn new(shards: usize, cores: usize) -> Self {
        Self {
            pages: (0..shards).map(|_| Default::default()).collect(),
            barrier: Barrier::new(shards, cores),
        }
    }
}

/// What a shard takes part in the exchange with. When it is given up, for whatever reason, the others are not kept
/// waiting.
#[derive(Debug)]
pub(crate) struct ShardHandle {
    exchange: Arc<Exchange>,
    shard: usize,
    members: Members,
    /// Which of its two pages is next.
    page: usize,
    cut_off: bool,
}

impl ShardHandle {
    /// The handle of shard `shard`.
    pub(super) fn new(exchange: &Arc<Exchange>, shard: usize) -> Option<Self> {
        Some(Self {
            members: Members::of_shard(shard, exchange.pages.len())?,
            exchange: Arc::clone(exchange),
            shard,
            page: 0,
            cut_off: false,
        })
    }

    pub(crate) const fn members(&self) -> Members {
        self.members
    }

    /// Whether another shard has given up its handle in the middle of a run.
    pub(crate) const fn is_cut_off(&self) -> bool {
        self.cut_off
    }

    /// Tells the others what members did in this step, and takes over what theirs did. False, and
    /// nothing is taken over, when one of them is gone.
    ///
    /// `said` has what members say to those near them, and then what all do.
    pub(crate) fn trade(
        &mut self,
        world: &mut World,
        network: Option<&VirtualNetwork>,
        said: &mut BTreeMap<usize, Says>,
    ) -> bool {
        if self.cut_off {
            return false;
        }
        let page = self.page;
        self.page = 1 - page;
        {
            let mut own = self.exchange.pages[self.shard][page]
                .write()
                .unwrap_or_else(PoisonError::into_inner);
            world.publish(&mut own.bodies);
            own.said.clear();
            own.said
                .extend(said.iter().map(|(robot, says)| (*robot, *says)));
            if let Some(network) = network {
                network.report(&mut own.news);
            }
        }
        if self.exchange.barrier.wait().is_err() {
            self.cut_off = true;
            return false;
        }
        for (shard, pages) in self.exchange.pages.iter().enumerate() {
            let told = pages[page].read().unwrap_or_else(PoisonError::into_inner);
            let foreign = shard != self.shard;
            if foreign && let Some(members) = Members::of_shard(shard, self.exchange.pages.len()) {
                world.take_over(members, &told.bodies);
                said.extend(told.said.iter().copied());
            }
            if let Some(network) = network {
                network.hear(&told.news, foreign);
            }
        }
        if let Some(network) = network {
            network.hand_on();
        }
        true
    }
}

impl Drop for ShardHandle {
    fn drop(&mut self) {
        self.exchange.barrier.leave();
    }
}
