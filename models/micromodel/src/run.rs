//! Running a model, row by row.

use core::ops::Range;

use crate::blob::MAX_LAYERS;
use crate::error::ModelError;
use crate::kernels::{self, Rows, SCRATCH, Scratch};
use crate::layer::Operation;
use crate::model::Model;

const TENSORS: usize = MAX_LAYERS + 1;

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// There is more to do.
    More,
    /// The output is complete.
    Done,
}

/// A model and the memory that it runs in.
///
/// A run is many small steps, so that a program with one core can do other things between them:
/// [`Runner::step`] computes one row of one layer. [`Runner::run`] takes all steps at once.
#[derive(Debug)]
pub struct Runner<'m, 'a> {
    model: Model<'m>,
    arena: &'a mut [i8],
    /// Where a tensor's ring begins.
    rings: [u32; TENSORS],
    /// Rows of each tensor that were computed in this run.
    made: [u16; TENSORS],
    /// The tensor that got a row last, 0 before.
    latest: usize,
    /// For the kernels; what is in it does not matter.
    scratch: Scratch,
}

impl<'m, 'a> Runner<'m, 'a> {
    /// A runner. What is in `arena` does not matter.
    ///
    /// # Errors
    /// [`ModelError::Arena`] when it is too small, with what is needed.
    pub fn new(model: Model<'m>, arena: &'a mut [i8]) -> Result<Self, ModelError> {
        let needed = model.arena_bytes();
        if arena.len() < needed {
            return Err(ModelError::Arena { needed });
        }
        let mut rings = [0; TENSORS];
        let plan = model.plan();
        let mut end = 0;
        for (ring, (rows, shape)) in rings.iter_mut().zip(plan.rows.iter().zip(&plan.shapes)) {
            *ring = end as u32;
            end += usize::from(*rows) * shape.row();
        }
        Ok(Self {
            model,
            arena,
            rings,
            made: [0; TENSORS],
            latest: 0,
            scratch: [0.0; SCRATCH],
        })
    }

    /// The model that runs.
    pub fn model(&self) -> &Model<'m> {
        &self.model
    }

    /// Forgets a run that was begun.
    pub fn restart(&mut self) {
        self.made = [0; TENSORS];
        self.latest = 0;
    }

    /// Computes one row of one layer, or has `fill` write one row of the input: given its number,
    /// all of its values, one pixel after the other. The first step after `Done` begins a new run.
    #[cfg_attr(target_pointer_width = "64", inline(always))]
    pub fn step(&mut self, fill: impl FnOnce(usize, &mut [i8])) -> Step {
        let Self {
            model,
            arena,
            rings,
            made,
            latest,
            scratch,
        } = self;
        let plan = model.plan();
        let last = plan.layers;
        let complete = plan.shapes[last].height;
        if made[last] == complete {
            *made = [0; TENSORS];
            *latest = 0;
        }
        // Layers of a model can be read.
        let Ok(Some(tensor)) = plan.next(model.blob(), made, *latest) else {
            return Step::Done;
        };
        let row = usize::from(made[tensor]);
        let length = plan.shapes[tensor].row();
        let kept = usize::from(plan.rows[tensor]);
        let at = rings[tensor] as usize + (row % kept) * length;
        if tensor == 0 {
            fill(row, &mut arena[at..at + length]);
        } else {
            let place = at..at + length;
            compute(model, rings, arena, (tensor, row), place, scratch);
        }
        made[tensor] += 1;
        *latest = tensor;
        if made[last] == complete {
            Step::Done
        } else {
            Step::More
        }
    }

    /// A whole run from its beginning: `fill` writes rows of the input, see [`Runner::step`].
    /// Returns the output.
    #[cfg_attr(target_pointer_width = "64", inline(always))]
    pub fn run(&mut self, mut fill: impl FnMut(usize, &mut [i8])) -> &[i8] {
        self.restart();
        while self.step(&mut fill) == Step::More {}
        self.output()
    }

    /// The output, rows of pixels of channels. Complete once a step was `Done`.
    pub fn output(&self) -> &[i8] {
        let plan = self.model.plan();
        let begin = self.rings[plan.layers] as usize;
        &self.arena[begin..begin + plan.shapes[plan.layers].values()]
    }
}

/// Computes a row of a tensor, which lies at `place` of the arena.
#[cfg_attr(target_pointer_width = "64", inline(always))]
fn compute(
    model: &Model<'_>,
    rings: &[u32; TENSORS],
    arena: &mut [i8],
    (tensor, row): (usize, usize),
    place: Range<usize>,
    scratch: &mut Scratch,
) {
    let plan = model.plan();
    let layer = model.layer(tensor);
    let (before, rest) = arena.split_at_mut(place.start);
    let (out, after) = rest.split_at_mut(place.len());
    let rows = |tensor: u16| {
        let tensor = usize::from(tensor);
        let shape = plan.shapes[tensor];
        let kept = usize::from(plan.rows[tensor]);
        let (begin, length) = (rings[tensor] as usize, kept * shape.row());
        // A ring is before or behind the row that is written, which is another tensor's.
        let ring = if begin < place.start {
            &before[begin..begin + length]
        } else {
            &after[begin - place.end..][..length]
        };
        Rows {
            ring,
            kept,
            shape,
            zero: model.zero(tensor),
        }
    };
    let input = rows(layer.input);
    if layer.operation == Operation::Sum {
        kernels::sum(&layer, input, rows(layer.other), row, out);
        return;
    }
    // Checked when the model was made.
    let Ok(numbers) = model.numbers(tensor, &layer) else {
        return;
    };
    if layer.operation == Operation::Depthwise {
        kernels::depthwise(&layer, &numbers, input, row, out, scratch);
    } else {
        kernels::convolution(&layer, &numbers, input, row, out, scratch);
    }
}
