//! The frames that engines are compared on, and what ours makes of them.

use crawler_micromodel::Runner;

/// Pixels of a frame's side.
pub(crate) const SIDE: usize = 96;

/// Frames of every kind, red, green, blue: noise of several grains, ramps, black, white.
pub(crate) fn frames() -> Vec<Vec<u8>> {
    let mut state = 1_u64;
    let mut noise = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 56) as u8
    };
    let mut frames = vec![vec![0; SIDE * SIDE * 3], vec![255; SIDE * SIDE * 3]];
    for grain in [1, 2, 4, 8, 16, 32] {
        let across = SIDE / grain;
        let blocks: Vec<[u8; 3]> = (0..across * across)
            .map(|_| [noise(), noise(), noise()])
            .collect();
        let pixel = |at: usize| blocks[at / SIDE / grain * across + at % SIDE / grain];
        frames.push((0..SIDE * SIDE).flat_map(pixel).collect());
    }
    let ramp = |at: usize| {
        [
            (at % SIDE * 2) as u8,
            (at / SIDE * 2) as u8,
            (at / 48) as u8,
        ]
    };
    frames.push((0..SIDE * SIDE).flat_map(ramp).collect());
    frames
}

/// The logits of all frames: row by row of cells, cell by cell, class by class.
pub(crate) fn logits(runner: &mut Runner<'_, '_>) -> Vec<i8> {
    let mut logits = Vec::new();
    for frame in frames() {
        logits.extend_from_slice(runner.run(|row, out| {
            let pixels = &frame[row * SIDE * 3..][..SIDE * 3];
            for (out, pixel) in out.iter_mut().zip(pixels) {
                *out = (i16::from(*pixel) - 128) as i8;
            }
        }));
    }
    logits
}
