//! A small model, converted, and everything that is refused.

use crawler_micromodel::{Model, Runner};
use proptest::prelude::*;
use prost::Message as _;

use crate::onnx::{
    self, Attribute, Constant, Extent, Extents, Graph, Kind, Node, TensorKind, Value,
};
use crate::{ConvertError, Options, convert};

fn floats(name: &str, values: &[f32]) -> Constant {
    Constant {
        name: name.to_owned(),
        kind: 1,
        shape: vec![values.len() as i64],
        floats: values.to_vec(),
        ..Constant::default()
    }
}

fn scalar(name: &str, value: f32) -> Constant {
    Constant {
        shape: vec![],
        ..floats(name, &[value])
    }
}

fn bytes(name: &str, shape: &[i64], values: &[i8]) -> Constant {
    Constant {
        name: name.to_owned(),
        kind: 3,
        shape: shape.to_vec(),
        raw: values.iter().map(|&value| value as u8).collect(),
        ..Constant::default()
    }
}

fn node(kind: &str, inputs: &[&str], output: &str) -> Node {
    Node {
        inputs: inputs.iter().map(|&input| input.to_owned()).collect(),
        outputs: vec![output.to_owned()],
        name: format!("{output}.node"),
        kind: kind.to_owned(),
        attributes: vec![],
    }
}

fn ints(mut node: Node, name: &str, values: &[i64]) -> Node {
    node.attributes.push(Attribute {
        name: name.to_owned(),
        ints: values.to_vec(),
        ..Attribute::default()
    });
    node
}

fn int(mut node: Node, name: &str, value: i64) -> Node {
    node.attributes.push(Attribute {
        name: name.to_owned(),
        int: value,
        ..Attribute::default()
    });
    node
}

fn value(name: &str, extents: &[i64]) -> Value {
    let extents = extents.iter().map(|&value| Extent { value }).collect();
    let shape = Some(Extents { extents });
    Value {
        name: name.to_owned(),
        kind: Some(Kind {
            tensor: Some(TensorKind { shape }),
        }),
    }
}

/// `x` quantised as `name` and back.
fn quantised(graph: &mut Graph, x: &str, name: &str, scale: f32, zero: i8) {
    graph.constants.push(scalar(&format!("{name}.s"), scale));
    graph
        .constants
        .push(bytes(&format!("{name}.z"), &[], &[zero]));
    let (s, z, q) = (
        format!("{name}.s"),
        format!("{name}.z"),
        format!("{name}.q"),
    );
    graph.nodes.push(node("QuantizeLinear", &[x, &s, &z], &q));
    graph
        .nodes
        .push(node("DequantizeLinear", &[&q, &s, &z], name));
}

/// 1 × 2 × 3 × 3 → convolution of two pixels by two, clipped at 0 → sum with a pointwise one.
fn small() -> onnx::Model {
    let mut graph = Graph {
        inputs: vec![value("x", &[1, 2, 3, 3])],
        outputs: vec![value("out", &[1, 2, 2, 2])],
        ..Graph::default()
    };
    quantised(&mut graph, "x", "in", 0.5, 3);
    let weights: Vec<i8> = (0..16).map(|n| n * 3 - 20).collect();
    graph.constants.push(bytes("w.q", &[2, 2, 2, 2], &weights));
    graph.constants.push(floats("w.s", &[0.25, 0.75]));
    graph.constants.push(bytes("w.z", &[2], &[0, 0]));
    graph.constants.push(floats("b", &[0.5, -1.5]));
    let maker = node("DequantizeLinear", &["w.q", "w.s", "w.z"], "w");
    graph.nodes.push(int(maker, "axis", 0));
    graph.nodes.push(node("Conv", &["in", "w", "b"], "conv"));
    graph.nodes.push(node("Relu", &["conv"], "relu"));
    quantised(&mut graph, "relu", "first", 1.0, -100);
    graph
        .constants
        .push(bytes("v.q", &[2, 2, 1, 1], &[1, -2, 3, 4]));
    graph.constants.push(floats("v.s", &[0.5]));
    graph.constants.push(bytes("v.z", &[1], &[0]));
    let maker = node("DequantizeLinear", &["v.q", "v.s", "v.z"], "v");
    graph.nodes.push(int(maker, "axis", 0));
    graph.nodes.push(ints(
        node("Conv", &["first", "v"], "point"),
        "pads",
        &[0; 4],
    ));
    quantised(&mut graph, "point", "second", 2.0, 0);
    graph.nodes.push(node("Add", &["first", "second"], "sum"));
    quantised(&mut graph, "sum", "out", 4.0, 0);
    onnx::Model {
        graph: Some(graph),
        metadata: vec![],
    }
}

/// What the small model does, in numbers of any size.
fn expected(input: &[i8]) -> Vec<i8> {
    let x = |y: usize, x: usize, c: usize| (f64::from(input[(y * 3 + x) * 2 + c]) - 3.0) * 0.5;
    let round = |value: f64, scale: f64, zero: f64| {
        ((value / scale).round_ties_even() + zero).clamp(-128.0, 127.0)
    };
    let mut out = vec![];
    for row in 0..2 {
        for column in 0..2 {
            let first = [0, 1].map(|o: usize| {
                let mut sum = [0.5, -1.5][o];
                for c in 0..2 {
                    for ky in 0..2 {
                        for kx in 0..2 {
                            let n = ((o * 2 + c) * 2 + ky) * 2 + kx;
                            let weight = (n as f64 * 3.0 - 20.0) * [0.25, 0.75][o];
                            sum += weight * x(row + ky, column + kx, c);
                        }
                    }
                }
                round(sum.max(0.0), 1.0, -100.0) + 100.0
            });
            for weights in [[1.0, -2.0], [3.0, 4.0]].into_iter().enumerate() {
                let (o, [a, b]) = weights;
                let second = round(0.5 * (a * first[0] + b * first[1]), 2.0, 0.0) * 2.0;
                out.push(round(first[o] + second, 4.0, 0.0) as i8);
            }
        }
    }
    out
}

fn converted(model: &onnx::Model) -> Result<Vec<u8>, ConvertError> {
    convert(&model.encode_to_vec(), &Options::default())
}

proptest! {
    #[test]
    fn a_small_model_does_the_same(input in proptest::collection::vec(any::<i8>(), 18)) {
        let blob = converted(&small()).unwrap();
        let model = Model::new(&blob).unwrap();
        prop_assert_eq!((model.input_zero(), model.output_exponent()), (3, 2));
        let mut arena = vec![0; model.arena_bytes()];
        let mut runner = Runner::new(model, &mut arena).unwrap();
        let output = runner.run(|row, out| out.copy_from_slice(&input[row * 6..][..6]));
        prop_assert_eq!(output, expected(&input));
    }

    #[test]
    fn arbitrary_bytes_are_refused_or_converted(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let _ = convert(&bytes, &Options::default());
    }

    #[test]
    fn a_damaged_file_is_refused_or_converted(at: prop::sample::Index, value: u8) {
        let mut bytes = small().encode_to_vec();
        let at = at.index(bytes.len());
        bytes[at] = value;
        if let Ok(blob) = convert(&bytes, &Options::default()) {
            prop_assert!(Model::new(&blob).is_ok());
        }
    }
}

/// The error of the small model after a change.
fn refusal(change: impl FnOnce(&mut Graph)) -> String {
    let mut model = small();
    change(model.graph.as_mut().expect("a graph"));
    converted(&model).expect_err("refused").to_string()
}

fn named<'g>(graph: &'g mut Graph, output: &str) -> &'g mut Node {
    let mut nodes = graph.nodes.iter_mut();
    nodes
        .find(|node| node.outputs[0] == output)
        .expect("a node")
}

fn constant<'g>(graph: &'g mut Graph, name: &str) -> &'g mut Constant {
    let mut constants = graph.constants.iter_mut();
    constants
        .find(|constant| constant.name == name)
        .expect("a constant")
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let scale = |name: &'static str, value: f32| {
        move |graph: &mut Graph| constant(graph, name).floats = vec![value]
    };
    let attribute = |output: &'static str, name: &'static str, values: &'static [i64]| {
        move |graph: &mut Graph| {
            let changed = ints(named(graph, output).clone(), name, values);
            *named(graph, output) = changed;
        }
    };
    let cases: Vec<(String, &str)> = vec![
        (
            refusal(|graph| named(graph, "conv").kind = "ConvTranspose".to_owned()),
            "node conv.node (ConvTranspose): there is no such operation",
        ),
        (
            refusal(scale("first.s", 0.3)),
            "node first.q.node (QuantizeLinear): its scale 0.3 is no power",
        ),
        (
            refusal(scale("v.s", 0.3)),
            "scale 0.3 of channel 0 is no m / 2^s",
        ),
        (
            refusal(|graph| constant(graph, "b").floats = vec![0.1, 0.0]),
            "the bias 0.1 of channel 0 is no multiple",
        ),
        (
            refusal(attribute("conv", "dilations", &[2, 2])),
            "node conv.node (Conv): is dilated",
        ),
        (
            refusal(attribute("conv", "strides", &[1, 2])),
            "strides of [1, 2]",
        ),
        (
            refusal(attribute("conv", "pads", &[0, 1, 0, 0])),
            "padding above and left of [0, 1]",
        ),
        (
            refusal(|graph| constant(graph, "w.z").raw = vec![0, 1]),
            "node w.node (DequantizeLinear): weights need zero points that are 0",
        ),
        (
            refusal(|graph| named(graph, "point").inputs[0] = "relu".to_owned()),
            "node first.q.node (QuantizeLinear): others look at what it quantises",
        ),
        (
            refusal(|graph| named(graph, "sum").inputs[1] = "nobody".to_owned()),
            "node sum.node (Add): its input nobody is made by no layer before",
        ),
        (
            refusal(|graph| graph.outputs[0].name = "first".to_owned()),
            "the output first is not the last layer",
        ),
        (
            refusal(|graph| graph.inputs.clear()),
            "does not have one input",
        ),
        (
            refusal(|graph| graph.inputs[0] = value("x", &[1, 2, 3])),
            "the input's shape [1, 2, 3] is not",
        ),
        (
            refusal(|graph| constant(graph, "b").floats = vec![0.0, 2.7e8]),
            "could overflow",
        ),
    ];
    for (told, wanted) in cases {
        assert!(told.contains(wanted), "{told:?} does not say {wanted:?}");
    }
    let nonsense = convert(b"no protobuf", &Options::default()).unwrap_err();
    assert!(matches!(nonsense, ConvertError::NotOnnx(_)), "{nonsense}");
}

#[test]
fn labels_come_from_the_caller_or_the_file() {
    let mut model = small();
    model.metadata.push(onnx::Entry {
        key: "labels".to_owned(),
        value: "nothing,something".to_owned(),
    });
    let blob = converted(&model).unwrap();
    let read = |blob: &[u8]| -> Vec<String> {
        let model = Model::new(blob).unwrap();
        model.labels().map(str::to_owned).collect()
    };
    assert_eq!(read(&blob), ["nothing", "something"]);
    let labels = vec!["a".to_owned(), "b".to_owned()];
    let blob = convert(&model.encode_to_vec(), &Options { labels }).unwrap();
    assert_eq!(read(&blob), ["a", "b"]);
}
