//! What makes sense as a layer, limit by limit.

use std::vec::Vec;

use super::*;
use crate::blob::{MAX_KERNEL, MAX_LIFT, MAX_PATCH, MAX_SHIFT, MAX_STRIDE};

const INPUT: Shape = Shape {
    height: 9,
    width: 7,
    channels: 4,
};

/// The tensor that the layers here make; those before it have the shape [`INPUT`].
const TENSOR: usize = 3;

const CONVOLUTION: Layer = Layer {
    kernel: 3,
    stride: 2,
    before: 1,
    after: 1,
    channels: 8,
    ..Layer::PLAIN
};

const DEPTHWISE: Layer = Layer {
    operation: Operation::Depthwise,
    channels: INPUT.channels,
    ..CONVOLUTION
};

const SUM: Layer = Layer {
    operation: Operation::Sum,
    input: 1,
    other: 2,
    channels: INPUT.channels,
    shifts: [0, 0, 1],
    ..Layer::PLAIN
};

fn shape(layer: Layer, input: Shape) -> Option<(u16, u16, u16)> {
    let shape = layer.shape(TENSOR, &[input; MAX_LAYERS + 1]);
    if shape.is_err() {
        assert_eq!(shape, Err(ModelError::Layer(TENSOR as u16)));
    }
    shape.ok().map(|s| (s.height, s.width, s.channels))
}

/// `layer` with each of `changes`, one at a time.
fn variants(layer: Layer, changes: &[fn(&mut Layer)]) -> Vec<Layer> {
    let with = |change: &fn(&mut Layer)| {
        let mut changed = layer;
        change(&mut changed);
        changed
    };
    changes.iter().map(with).collect()
}

#[test]
fn every_extent_has_both_its_limits() {
    let sound = |height, width, channels| {
        Shape {
            height,
            width,
            channels,
        }
        .is_valid()
    };
    assert!(sound(1, 1, 1) && sound(MAX_EXTENT, MAX_EXTENT, MAX_EXTENT));
    for bad in [0, MAX_EXTENT + 1] {
        assert!(!sound(bad, 1, 1), "height {bad}");
        assert!(!sound(1, bad, 1), "width {bad}");
        assert!(!sound(1, 1, bad), "{bad} channels");
    }
}

#[test]
fn kernel_stride_and_border_make_the_shape() {
    assert_eq!(shape(CONVOLUTION, INPUT), Some((5, 4, 8)));
    assert_eq!(shape(DEPTHWISE, INPUT), Some((5, 4, 4)));
    let lopsided = Layer {
        before: 2,
        after: 0,
        stride: 1,
        ..CONVOLUTION
    };
    assert_eq!(shape(lopsided, INPUT), Some((9, 7, 8)));
    let exactly = Layer {
        before: 0,
        after: 0,
        ..CONVOLUTION
    };
    let small = |height, width| Shape {
        height,
        width,
        ..INPUT
    };
    assert_eq!(shape(exactly, small(3, 3)), Some((1, 1, 8)));
    assert_eq!(shape(exactly, small(2, 3)), None, "too few rows");
    assert_eq!(shape(exactly, small(3, 2)), None, "too few columns");
    // A border counts.
    assert_eq!(shape(CONVOLUTION, small(1, 1)), Some((1, 1, 8)));
    assert_eq!(shape(SUM, INPUT), Some((9, 7, 4)));
}

#[test]
fn a_layer_may_go_to_its_limits() {
    let most: &[fn(&mut Layer)] = &[
        |layer| (layer.kernel, layer.before, layer.after) = (MAX_KERNEL, MAX_KERNEL - 1, 0),
        |layer| (layer.kernel, layer.before, layer.after) = (MAX_KERNEL, 0, MAX_KERNEL - 1),
        |layer| layer.stride = MAX_STRIDE,
        |layer| (layer.lowest, layer.highest) = (5, 5),
        |layer| layer.input = TENSOR as u16 - 1,
    ];
    for layer in variants(CONVOLUTION, most) {
        assert!(shape(layer, INPUT).is_some(), "{layer:?}");
    }
    let most: &[fn(&mut Layer)] = &[
        |layer| layer.shifts = [MAX_LIFT, 0, 1],
        |layer| layer.shifts = [0, MAX_LIFT, 1],
        |layer| layer.shifts = [0, 0, MAX_SHIFT],
    ];
    for layer in variants(SUM, most) {
        assert!(shape(layer, INPUT).is_some(), "{layer:?}");
    }
}

#[test]
fn no_layer_goes_beyond_one_of_its_limits() {
    let wrong: &[fn(&mut Layer)] = &[
        |layer| layer.input = TENSOR as u16,
        |layer| (layer.lowest, layer.highest) = (5, 4),
        |layer| (layer.kernel, layer.before, layer.after) = (0, 0, 0),
        |layer| layer.kernel = MAX_KERNEL + 1,
        |layer| layer.stride = 0,
        |layer| layer.stride = MAX_STRIDE + 1,
        |layer| layer.before = 3,
        |layer| layer.after = 3,
        |layer| layer.channels = 0,
        |layer| layer.channels = MAX_EXTENT + 1,
    ];
    for layer in variants(CONVOLUTION, wrong) {
        assert_eq!(shape(layer, INPUT), None, "{layer:?}");
    }
    for layer in variants(DEPTHWISE, &[|layer| layer.channels += 1]) {
        assert_eq!(shape(layer, INPUT), None, "{layer:?}");
    }
    let wrong: &[fn(&mut Layer)] = &[
        |layer| layer.input = TENSOR as u16,
        |layer| layer.other = TENSOR as u16,
        |layer| layer.other = layer.input,
        |layer| layer.channels += 1,
        |layer| layer.kernel = 3,
        |layer| layer.stride = 2,
        |layer| layer.before = 1,
        |layer| layer.after = 1,
        |layer| layer.shifts = [MAX_LIFT + 1, 0, 1],
        |layer| layer.shifts = [0, MAX_LIFT + 1, 1],
        |layer| layer.shifts = [0, 0, MAX_SHIFT + 1],
        |layer| layer.shifts = [0, 0, 0],
    ];
    for layer in variants(SUM, wrong) {
        assert_eq!(shape(layer, INPUT), None, "{layer:?}");
    }
}

#[test]
fn tensors_are_only_added_to_their_like() {
    let others: &[fn(&mut Shape)] = &[
        |shape| shape.height += 1,
        |shape| shape.width += 1,
        |shape| shape.channels += 1,
    ];
    for change in others {
        let mut shapes = [INPUT; MAX_LAYERS + 1];
        change(&mut shapes[usize::from(SUM.other)]);
        let wrong = Err(ModelError::Layer(TENSOR as u16));
        assert_eq!(SUM.shape(TENSOR, &shapes), wrong, "{:?}", shapes[2]);
    }
}

#[test]
fn a_convolution_looks_at_no_more_than_fits_its_scratch() {
    let deep = |channels| Shape { channels, ..INPUT };
    let most = MAX_PATCH as u16 / 9;
    assert!(shape(CONVOLUTION, deep(most)).is_some());
    assert_eq!(shape(CONVOLUTION, deep(most + 1)), None);
    // Of one pixel, or of one channel, it needs none.
    let pointwise = Layer {
        channels: 8,
        ..Layer::PLAIN
    };
    assert!(shape(pointwise, deep(MAX_EXTENT)).is_some());
    let depthwise = Layer {
        channels: MAX_EXTENT,
        ..DEPTHWISE
    };
    assert!(shape(depthwise, deep(MAX_EXTENT)).is_some());
}
