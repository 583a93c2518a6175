//! A program that takes no faults.

use core::marker::PhantomData;

use crawler_drivers::us100::RangeError;
use crawler_hal::{Instant, Millimeters};
use crawler_protocol::LinkCut;

/// Nothing is ever injected.
pub(crate) struct Injected<M>(PhantomData<fn() -> M>);

// The signatures are those of the program that takes faults.
#[allow(clippy::unused_self)]
impl<M> Injected<M> {
    pub(crate) const fn new() -> Self {
        Self(PhantomData)
    }

    #[inline]
    pub(crate) fn range(
        &self,
        measured: Result<Millimeters, RangeError>,
        _: Instant,
    ) -> Result<Millimeters, RangeError> {
        measured
    }

    #[inline]
    pub(crate) fn weaken(&self, duties: [f32; 2], _: Instant) -> [f32; 2] {
        duties
    }

    #[inline]
    pub(crate) fn restart_is_due(&self, _: Instant) -> bool {
        false
    }

    #[inline]
    pub(crate) fn link(&self, _: Instant) -> Option<LinkCut> {
        None
    }
}
