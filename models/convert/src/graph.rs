//! Values of a graph, looked up by name.

use std::collections::BTreeMap;

use crate::error::ConvertError;
use crate::onnx::{Attribute, Constant, Graph, Node};

/// A graph whose nodes are asked for constants and attributes.
pub(crate) struct Lookup<'g> {
    pub(crate) graph: &'g Graph,
    constants: BTreeMap<&'g str, &'g Constant>,
    makers: BTreeMap<&'g str, &'g Node>,
    readers: BTreeMap<&'g str, usize>,
}

/// Input `n` of a node.
pub(crate) fn input(node: &Node, n: usize) -> Result<&str, ConvertError> {
    let input = node.inputs.get(n).filter(|input| !input.is_empty());
    let input = input.ok_or_else(|| refused(node, format!("has no input {n}")))?;
    Ok(input)
}

/// The one output of a node.
pub(crate) fn output(node: &Node) -> Result<&str, ConvertError> {
    let [output] = &node.outputs[..] else {
        return Err(refused(node, "does not have one output"));
    };
    Ok(output)
}

/// What a node is called in errors.
pub(crate) fn name(node: &Node) -> String {
    let made = node.outputs.first().map_or("?", String::as_str);
    let name = if node.name.is_empty() {
        made
    } else {
        &node.name
    };
    format!("{name} ({})", node.kind)
}

pub(crate) fn refused(node: &Node, why: impl Into<String>) -> ConvertError {
    ConvertError::Node {
        node: name(node),
        why: why.into(),
    }
}

impl<'g> Lookup<'g> {
    pub(crate) fn new(graph: &'g Graph) -> Self {
        let mut makers = BTreeMap::new();
        let mut readers: BTreeMap<&str, usize> = BTreeMap::new();
        for node in &graph.nodes {
            for output in &node.outputs {
                makers.insert(output.as_str(), node);
            }
            for input in &node.inputs {
                *readers.entry(input.as_str()).or_default() += 1;
            }
        }
        let constants = graph.constants.iter();
        Self {
            graph,
            constants: constants.map(|c| (c.name.as_str(), c)).collect(),
            makers,
            readers,
        }
    }

    pub(crate) fn maker(&self, value: &str) -> Option<&'g Node> {
        self.makers.get(value).copied()
    }

    /// How many inputs of nodes a value is.
    pub(crate) fn readers(&self, value: &str) -> usize {
        self.readers.get(value).copied().unwrap_or(0)
    }

    /// Input `n` of a node.
    /// The constant that is input `n` of a node.
    fn constant(&self, node: &'g Node, n: usize) -> Result<&'g Constant, ConvertError> {
        let value = input(node, n)?;
        let constant = self.constants.get(value).copied();
        constant.ok_or_else(|| refused(node, format!("its input {value} is no constant")))
    }

    /// The f32 of a constant input.
    pub(crate) fn f32s(&self, node: &'g Node, n: usize) -> Result<Vec<f32>, ConvertError> {
        let values = self.constant(node, n)?.f32s();
        values.ok_or_else(|| refused(node, format!("its input {n} is not all f32")))
    }

    /// The int8 of a constant input, and its shape.
    pub(crate) fn i8s(
        &self,
        node: &'g Node,
        n: usize,
    ) -> Result<(Vec<i8>, Vec<usize>), ConvertError> {
        let constant = self.constant(node, n)?;
        let values = constant.i8s();
        let values =
            values.ok_or_else(|| refused(node, format!("its input {n} is not all int8")))?;
        // The count of values was right, so no extent is negative.
        let shape = constant.shape.iter().map(|&extent| extent as usize);
        Ok((values, shape.collect()))
    }

    /// Scale and zero point of a (de)quantisation of a whole tensor.
    pub(crate) fn scale(&self, node: &'g Node) -> Result<(f32, i8), ConvertError> {
        let scales = self.f32s(node, 1)?;
        let zeros = if node.inputs.len() > 2 {
            self.i8s(node, 2)?.0
        } else {
            return Err(refused(
                node,
                "has no zero point, which would make it unsigned",
            ));
        };
        let ([scale], [zero]) = (&scales[..], &zeros[..]) else {
            return Err(refused(node, "has more than one scale for a tensor"));
        };
        Ok((*scale, *zero))
    }
}

/// An attribute of a node.
pub(crate) fn attribute<'g>(node: &'g Node, name: &str) -> Option<&'g Attribute> {
    node.attributes
        .iter()
        .find(|attribute| attribute.name == name)
}

/// The integers of an attribute, or what they are when it is not there.
pub(crate) fn ints(node: &Node, name: &str, otherwise: &[i64]) -> Vec<i64> {
    attribute(node, name).map_or_else(|| otherwise.to_vec(), |attribute| attribute.ints.clone())
}

/// All of some numbers, when they are the same small one.
pub(crate) fn same(node: &Node, what: &str, values: &[i64]) -> Result<u8, ConvertError> {
    let first = values.first().copied().unwrap_or(-1);
    let alike = values.iter().all(|value| *value == first);
    match u8::try_from(first) {
        Ok(value) if alike => Ok(value),
        Ok(_) | Err(_) => Err(refused(node, format!("{what} {values:?}"))),
    }
}
