//! Where an activity keeps what it seldom needs.
//!
//! A future is as large as the largest of its steps, also while it waits in the smallest. On a
//! board that is as it should be: the memory is there, and nothing can run out. Where thousands
//! of robots share a machine, rare steps had better not take memory while they are not taken.

/// A way to keep one step of an activity, or a buffer that only some steps use.
pub trait Hold {
    /// A step as it is kept.
    type Held<F: Future>: Future<Output = F::Output>;
    /// A buffer as it is kept.
    type Room<T: Blank>: Room<T>;

    /// Keeps `step` until it is done or dropped.
    fn hold<F: Future>(step: F) -> Self::Held<F>;
}

/// What has a state that means nothing yet.
pub trait Blank {
    /// That state.
    const BLANK: Self;
}

impl<const N: usize> Blank for [u8; N] {
    const BLANK: Self = [0; N];
}

/// A place for a value that is not always needed.
pub trait Room<T: Blank> {
    /// An empty place.
    const EMPTY: Self;

    /// The value, to be read: `None` where the place is empty.
    fn get(&self) -> Option<&T>;

    /// The value, to be changed; where the place is empty a blank one takes it.
    fn enter(&mut self) -> &mut T;

    /// Notes that the value is not needed for now. Whether it is still there is not to be relied
    /// upon.
    fn leave(&mut self);
}

/// Keeps everything inside the activity, as boards do.
#[derive(Debug, Clone, Copy)]
pub struct Inline;

impl Hold for Inline {
    type Held<F: Future> = F;
    type Room<T: Blank> = Always<T>;

    fn hold<F: Future>(step: F) -> F {
        step
    }
}

/// A place that is never empty.
#[derive(Debug, Clone, Copy)]
pub struct Always<T>(T);

impl<T: Blank> Room<T> for Always<T> {
    const EMPTY: Self = Self(T::BLANK);

    fn get(&self) -> Option<&T> {
        Some(&self.0)
    }

    fn enter(&mut self) -> &mut T {
        &mut self.0
    }

    fn leave(&mut self) {}
}
