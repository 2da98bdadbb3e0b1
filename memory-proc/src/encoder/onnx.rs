//! As much of the ONNX format as it takes to give a product to another operator: protobuf fields, of which all but
//! a few are passed through unread.

use std::collections::HashMap;

/// The operator type of a matrix product.
pub(super) const PRODUCT: &str = "MatMul";

/// The bytes are not a model as ONNX describes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Malformed;

// Field numbers of onnx.proto.
const MODEL_GRAPH: u64 = 7;
const MODEL_OPSET: u64 = 8;
const OPSET_DOMAIN: u64 = 1;
const OPSET_VERSION: u64 = 2;
const GRAPH_NODE: u64 = 1;
const GRAPH_INITIALIZER: u64 = 5;
const NODE_INPUT: u64 = 1;
const NODE_TYPE: u64 = 4;
const NODE_DOMAIN: u64 = 7;
const TENSOR_DIMS: u64 = 1;
const TENSOR_NAME: u64 = 8;

/// The model with every product by a constant matrix whose rows and columns `fit` moved to `domain`.
pub(super) fn redirect_products(
    model: &[u8],
    domain: &str,
    fit: impl Fn(usize, usize) -> bool,
) -> Result<Vec<u8>, Malformed> {
    let mut redirected = Vec::with_capacity(model.len() + (1 << 16));
    for field in fields(model) {
        let field = field?;
        match field.content {
            Content::Bytes(graph) if field.number == MODEL_GRAPH => {
                append_bytes(&mut redirected, MODEL_GRAPH, &in_graph(graph, domain, &fit)?);
            }
            _ => redirected.extend_from_slice(field.whole),
        }
    }
    let mut opset = Vec::new();
    append_bytes(&mut opset, OPSET_DOMAIN, domain.as_bytes());
    append_number(&mut opset, OPSET_VERSION << 3);
    append_number(&mut opset, 1);
    append_bytes(&mut redirected, MODEL_OPSET, &opset);
    Ok(redirected)
}

fn in_graph(
    graph: &[u8],
    domain: &str,
    fit: &impl Fn(usize, usize) -> bool,
) -> Result<Vec<u8>, Malformed> {
    let mut constants = HashMap::new();
    for field in fields(graph) {
        let field = field?;
        if let (GRAPH_INITIALIZER, Content::Bytes(tensor)) = (field.number, field.content) {
            let (name, dims) = name_and_dims(tensor)?;
            constants.insert(name, dims);
        }
    }
    let fits = |name: &[u8]| match constants.get(name).map(Vec::as_slice) {
        Some(&[inner, columns]) => fit(inner as usize, columns as usize),
        _ => false,
    };
    let mut redirected = Vec::with_capacity(graph.len() + (1 << 16));
    for field in fields(graph) {
        let field = field?;
        match field.content {
            Content::Bytes(node) if field.number == GRAPH_NODE && is_product(node, &fits)? => {
                let mut moved = node.to_vec();
                append_bytes(&mut moved, NODE_DOMAIN, domain.as_bytes());
                append_bytes(&mut redirected, GRAPH_NODE, &moved);
            }
            _ => redirected.extend_from_slice(field.whole),
        }
    }
    Ok(redirected)
}

/// Whether a node is a product whose right side `fits`.
fn is_product(node: &[u8], fits: &impl Fn(&[u8]) -> bool) -> Result<bool, Malformed> {
    let (mut inputs, mut is_product) = (Vec::new(), false);
    for field in fields(node) {
        match field? {
            Field { number: NODE_INPUT, content: Content::Bytes(name), .. } => inputs.push(name),
            Field { number: NODE_TYPE, content: Content::Bytes(kind), .. } => {
                is_product = kind == PRODUCT.as_bytes();
            }
            // Somebody else's operator of that name.
            Field { number: NODE_DOMAIN, content: Content::Bytes(domain), .. }
                if !domain.is_empty() =>
            {
                return Ok(false);
            }
            _ => {}
        }
    }
    Ok(is_product && inputs.len() == 2 && fits(inputs[1]))
}

fn name_and_dims(tensor: &[u8]) -> Result<(&[u8], Vec<u64>), Malformed> {
    let (mut name, mut dims) = (&[][..], Vec::new());
    for field in fields(tensor) {
        match field? {
            Field { number: TENSOR_NAME, content: Content::Bytes(bytes), .. } => name = bytes,
            Field { number: TENSOR_DIMS, content: Content::Number(dim), .. } => dims.push(dim),
            // Packed into one field.
            Field { number: TENSOR_DIMS, content: Content::Bytes(mut bytes), .. } => {
                while !bytes.is_empty() {
                    dims.push(number(&mut bytes)?);
                }
            }
            _ => {}
        }
    }
    Ok((name, dims))
}

struct Field<'a> {
    number: u64,
    content: Content<'a>,
    /// With its tag.
    whole: &'a [u8],
}

enum Content<'a> {
    Number(u64),
    Bytes(&'a [u8]),
    /// Four or eight bytes, of no interest here.
    Fixed,
}

/// The fields of a message, until the first that is none.
fn fields(mut message: &[u8]) -> impl Iterator<Item = Result<Field<'_>, Malformed>> {
    std::iter::from_fn(move || {
        if message.is_empty() {
            return None;
        }
        let next = field(&mut message);
        if next.is_err() {
            message = &[];
        }
        Some(next)
    })
}

fn field<'a>(message: &mut &'a [u8]) -> Result<Field<'a>, Malformed> {
    let whole = *message;
    let tag = number(message)?;
    let content = match tag & 7 {
        0 => Content::Number(number(message)?),
        1 => take(message, 8).map(|_| Content::Fixed)?,
        2 => {
            let length = usize::try_from(number(message)?).map_err(|_| Malformed)?;
            Content::Bytes(take(message, length)?)
        }
        5 => take(message, 4).map(|_| Content::Fixed)?,
        _ => return Err(Malformed),
    };
    Ok(Field { number: tag >> 3, content, whole: &whole[..whole.len() - message.len()] })
}

fn take<'a>(message: &mut &'a [u8], length: usize) -> Result<&'a [u8], Malformed> {
    let (taken, rest) = message.split_at_checked(length).ok_or(Malformed)?;
    *message = rest;
    Ok(taken)
}

/// A number of seven bits a byte, the lowest first.
fn number(message: &mut &[u8]) -> Result<u64, Malformed> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let byte = take(message, 1)?[0];
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Ok(value);
        }
    }
    Err(Malformed)
}

fn append_number(message: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        message.push(value as u8 | 0x80);
        value >>= 7;
    }
    message.push(value as u8);
}

fn append_bytes(message: &mut Vec<u8>, number: u64, bytes: &[u8]) {
    append_number(message, number << 3 | 2);
    append_number(message, bytes.len() as u64);
    message.extend_from_slice(bytes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn message(parts: &[(u64, &[u8])]) -> Vec<u8> {
        let mut message = Vec::new();
        parts.iter().for_each(|(number, bytes)| append_bytes(&mut message, *number, bytes));
        message
    }

    fn matrix(name: &str, dims: [u8; 2]) -> Vec<u8> {
        [&[8, dims[0], 8, dims[1]], &message(&[(TENSOR_NAME, name.as_bytes())])[..]].concat()
    }

    fn node(kind: &str, inputs: [&str; 2]) -> Vec<u8> {
        let inputs = inputs.map(str::as_bytes);
        message(&[(NODE_INPUT, inputs[0]), (NODE_INPUT, inputs[1]), (NODE_TYPE, kind.as_bytes())])
    }

    fn model(nodes: &[Vec<u8>], matrices: &[Vec<u8>]) -> Vec<u8> {
        let nodes = nodes.iter().map(|node| (GRAPH_NODE, &node[..]));
        let matrices = matrices.iter().map(|matrix| (GRAPH_INITIALIZER, &matrix[..]));
        message(&[(MODEL_GRAPH, &message(&Vec::from_iter(nodes.chain(matrices))))])
    }

    #[test]
    fn products_by_constants_that_fit_are_moved_and_nothing_else() {
        let matrices = [matrix("even", [64, 96]), matrix("odd", [64, 5])];
        let nodes = [
            node(PRODUCT, ["x", "even"]),
            node(PRODUCT, ["x", "odd"]),
            node(PRODUCT, ["even", "x"]),
            node("Add", ["x", "even"]),
            [node(PRODUCT, ["x", "even"]), message(&[(NODE_DOMAIN, b"theirs")])].concat(),
        ];
        let fit = |inner, columns| (inner, columns) == (64, 96);
        let found = redirect_products(&model(&nodes, &matrices), "ours", fit).unwrap();
        let mut expected = nodes.clone();
        append_bytes(&mut expected[0], NODE_DOMAIN, b"ours");
        let opset =
            [message(&[(OPSET_DOMAIN, b"ours")]), vec![OPSET_VERSION as u8 * 8, 1]].concat();
        let mut expected = model(&expected, &matrices);
        append_bytes(&mut expected, MODEL_OPSET, &opset);
        assert_eq!(found, expected);
    }

    proptest! {
        #[test]
        fn bytes_that_are_no_model_are_refused_or_passed_through(bytes in any::<Vec<u8>>()) {
            let _ = redirect_products(&bytes, "ours", |_, _| true);
        }

        #[test]
        fn a_model_that_is_cut_short_is_refused(length in 1_usize..100) {
            let whole = model(&[node(PRODUCT, ["x", "even"])], &[matrix("even", [64, 96])]);
            let length = length.min(whole.len() - 1);
            prop_assert_eq!(redirect_products(&whole[..length], "ours", |_, _| true), Err(Malformed));
        }

        #[test]
        fn numbers_are_read_as_they_were_written(value in any::<u64>()) {
            let mut bytes = Vec::new();
            append_number(&mut bytes, value);
            prop_assert_eq!(number(&mut &bytes[..]), Ok(value));
        }
    }
}
