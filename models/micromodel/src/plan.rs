//! How many rows of each tensor must be in memory at once, and where they lie.

use crate::blob::{self, HEADER, LAYER, MAX_LAYERS};
use crate::error::ModelError;
use crate::layer::{Layer, Operation, Shape, u16_at, u32_at};

const TENSORS: usize = MAX_LAYERS + 1;

/// Shapes of all tensors, and the rows of each that are kept.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plan {
    pub(crate) layers: usize,
    pub(crate) shapes: [Shape; TENSORS],
    /// A tensor's rows lie in a ring of so many.
    pub(crate) rows: [u16; TENSORS],
    /// The last layer that looks at a tensor; 0 when none does.
    readers: [u8; TENSORS],
}

const NOTHING: Shape = Shape {
    height: 0,
    width: 0,
    channels: 0,
};

impl Plan {
    /// Reads header and layers of a blob, but not its weights, and finds out what is kept.
    ///
    /// # Errors
    /// What is wrong with the blob's structure.
    pub(crate) const fn of(blob: &[u8]) -> Result<Self, ModelError> {
        let mut plan = match Self::shapes(blob) {
            Ok(plan) => plan,
            Err(error) => return Err(error),
        };
        match plan.rehearse(blob) {
            Ok(()) => Ok(plan),
            Err(error) => Err(error),
        }
    }

    const fn shapes(blob: &[u8]) -> Result<Self, ModelError> {
        if blob.len() < HEADER {
            return Err(ModelError::Truncated);
        }
        let magic = blob::MAGIC;
        let mut n = 0;
        while n < magic.len() {
            if blob[n] != magic[n] {
                return Err(ModelError::Magic);
            }
            n += 1;
        }
        let version = u16_at(blob, 4);
        if version != blob::VERSION {
            return Err(ModelError::Version(version));
        }
        let stated = u32_at(blob, 8);
        if stated as usize != blob.len() {
            return Err(ModelError::Length { stated });
        }
        let layers = u16_at(blob, 6) as usize;
        let input = Shape {
            height: u16_at(blob, 16),
            width: u16_at(blob, 18),
            channels: u16_at(blob, 20),
        };
        if layers == 0 || layers > MAX_LAYERS || !input.is_valid() {
            return Err(ModelError::Layer(0));
        }
        if blob.len() < HEADER + layers * LAYER {
            return Err(ModelError::Truncated);
        }
        let mut shapes = [NOTHING; TENSORS];
        let mut readers = [0; TENSORS];
        shapes[0] = input;
        let mut tensor = 1;
        while tensor <= layers {
            let layer = match Layer::read(blob, tensor) {
                Ok(layer) => layer,
                Err(error) => return Err(error),
            };
            shapes[tensor] = match layer.shape(tensor, &shapes) {
                Ok(shape) => shape,
                Err(error) => return Err(error),
            };
            readers[layer.input as usize] = tensor as u8;
            if let Operation::Sum = layer.operation {
                readers[layer.other as usize] = tensor as u8;
            }
            tensor += 1;
        }
        Ok(Self {
            layers,
            shapes,
            rows: [0; TENSORS],
            readers,
        })
    }

    /// Runs the schedule without computing anything, and notes how many rows wait at most.
    const fn rehearse(&mut self, blob: &[u8]) -> Result<(), ModelError> {
        let mut made = [0; TENSORS];
        let mut tensor = 0;
        while tensor < self.layers {
            if let Err(error) = self.waiting(blob, tensor, &made) {
                return Err(error);
            }
            tensor += 1;
        }
        let mut last = 0;
        loop {
            let tensor = match self.next(blob, &made, last) {
                Ok(Some(tensor)) => tensor,
                Ok(None) => break,
                Err(error) => return Err(error),
            };
            made[tensor] += 1;
            last = tensor;
            // Only the tensor that got a row has more of them than before.
            match self.waiting(blob, tensor, &made) {
                Ok(waiting) if waiting > self.rows[tensor] => self.rows[tensor] = waiting,
                Ok(_) => {}
                Err(error) => return Err(error),
            }
        }
        // Somebody wants to read the output as a whole.
        self.rows[self.layers] = self.shapes[self.layers].height;
        Ok(())
    }

    /// Which tensor gets its next row: the last one that can, so that rows wait as short as
    /// possible. 0 is a row of input; `None` when all is done.
    ///
    /// `last` is the tensor that got one before, or 0. It was the last that could; so it is again,
    /// if none of those can now that look at it, or one before it.
    pub(crate) const fn next(
        &self,
        blob: &[u8],
        made: &[u16; TENSORS],
        last: usize,
    ) -> Result<Option<usize>, ModelError> {
        let reader = self.readers[last] as usize;
        let mut tensor = if reader > last { reader } else { last };
        while tensor > 0 {
            if made[tensor] < self.shapes[tensor].height {
                let layer = match Layer::read(blob, tensor) {
                    Ok(layer) => layer,
                    Err(error) => return Err(error),
                };
                let input = layer.input as usize;
                let height = self.shapes[input].height as usize;
                let rows = layer.rows_until(made[tensor] as usize, height);
                let mut ready = made[input] as usize >= rows;
                if let Operation::Sum = layer.operation {
                    ready = ready && made[layer.other as usize] > made[tensor];
                }
                if ready {
                    return Ok(Some(tensor));
                }
            }
            tensor -= 1;
        }
        if made[0] < self.shapes[0].height && made[self.layers] < self.shapes[self.layers].height {
            Ok(Some(0))
        } else {
            Ok(None)
        }
    }

    /// Rows of a tensor that a layer still looks at. All of the last tensor's.
    const fn waiting(
        &self,
        blob: &[u8],
        tensor: usize,
        made: &[u16; TENSORS],
    ) -> Result<u16, ModelError> {
        let mut used = false;
        let mut oldest = made[tensor];
        let mut reader = tensor + 1;
        while reader <= self.layers {
            let layer = match Layer::read(blob, reader) {
                Ok(layer) => layer,
                Err(error) => return Err(error),
            };
            let sum = matches!(layer.operation, Operation::Sum);
            if layer.input as usize == tensor || (sum && layer.other as usize == tensor) {
                used = true;
                if made[reader] < self.shapes[reader].height {
                    let first = layer.first_row(made[reader] as usize) as u16;
                    if first < oldest {
                        oldest = first;
                    }
                }
            }
            reader += 1;
        }
        if used || tensor == self.layers {
            Ok(made[tensor] - oldest)
        } else {
            Err(ModelError::Unused(tensor as u16))
        }
    }

    /// Bytes of all rings.
    pub(crate) const fn bytes(&self) -> usize {
        let mut bytes = 0;
        let mut tensor = 0;
        while tensor <= self.layers {
            bytes += self.rows[tensor] as usize * self.shapes[tensor].row();
            tensor += 1;
        }
        bytes
    }
}

/// Bytes of the arena that a model needs, for the size of a static:
///
/// ```ignore
/// const NEEDED: usize = match arena_bytes(MODEL) { Ok(bytes) => bytes, Err(_) => panic!() };
/// static ARENA: StaticCell<[i8; NEEDED]> = StaticCell::new();
/// ```
///
/// # Errors
/// When the structure of the blob is wrong; weights and checksum are not looked at.
pub const fn arena_bytes(blob: &[u8]) -> Result<usize, ModelError> {
    match Plan::of(blob) {
        Ok(plan) => Ok(plan.bytes()),
        Err(error) => Err(error),
    }
}
