//! The policy that a release has brought: where it lies, and who may drive by it.

use core::ops::Deref;

use crawler_hal::ModelRegion;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::ReadNorFlash;

use crate::hold::Hold;
use crate::policy::{PolicyError, Shelf, Unread};
use crate::update::{Failed, Refused};

/// Where the policies of a body are: two places in the flash of its slots, and one in memory, for the policy that is in use.
#[derive(Debug)]
pub struct PolicyHost<D> {
    shelf: D,
    region: Option<ModelRegion>,
    unsettled: bool,
}

impl<D> PolicyHost<D> {
    /// Policies in `region`; with none there are no places, and what is offered is refused.
    pub const fn new(shelf: D, region: Option<ModelRegion>) -> Self {
        Self {
            shelf,
            region,
            unsettled: false,
        }
    }
}

/// What the update activity wants of it.
pub(in crate::update) trait PolicyPlace {
    /// Where in flash the places are.
    fn region(&self) -> Option<ModelRegion>;
    /// Reads the policy of `bytes` bytes that begins at `at` of `flash` into memory, in the place of the one that is there.
    async fn put<F: ReadNorFlash>(
        &mut self,
        flash: &mut F,
        at: u32,
        bytes: u32,
    ) -> Result<(), Failed>;
    /// Has the one in memory driven by under a name, or none.
    async fn allow(&mut self, name: Option<u32>);
    /// Whether one was put into memory of which nobody has said what becomes of it.
    fn is_unsettled(&self) -> bool;
}

impl<M: RawMutex, H: Hold, D: Deref<Target = Shelf<M, H>>> PolicyPlace for PolicyHost<D> {
    fn region(&self) -> Option<ModelRegion> {
        self.region
    }

    async fn put<F: ReadNorFlash>(
        &mut self,
        flash: &mut F,
        at: u32,
        bytes: u32,
    ) -> Result<(), Failed> {
        self.unsettled = true;
        let refused = |code| {
            Failed::Refused(Refused {
                code,
                lasting: true,
            })
        };
        let put = self.shelf.put(flash, at, bytes).await;
        put.map_err(|why| match why {
            Unread::Flash => Failed::Flash,
            Unread::Policy(PolicyError::OtherObservation) => refused(OTHER),
            Unread::Policy(_) => refused("bad_policy"),
        })
    }

    async fn allow(&mut self, name: Option<u32>) {
        self.unsettled = false;
        self.shelf.allow(name).await;
    }

    fn is_unsettled(&self) -> bool {
        self.unsettled
    }
}

/// Code of a policy that was trained for another observation, other actions or another shield.
pub(super) const OTHER: &str = "other_observation";
