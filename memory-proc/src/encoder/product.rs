//! Products with constant matrices, as an operator of ONNX Runtime that computes them with [`super::amx`].
//!
//! The model's file stays as it is: [`redirected`] turns its products into this operator when it is opened. What
//! cannot be computed by it (matrices that are not constant, or of other sizes) is left to ONNX Runtime.

use ort::Error;
use ort::operator::{
    ComputeContext, Kernel, KernelContext, Operator, OperatorDomain, OperatorInput, OperatorOutput,
    ShapeInferenceContext,
};
use ort::value::{Shape, SymbolicDimensions, TensorElementType, TensorValueType, ValueType};

use super::amx::{Multiplier, TileUnit, Weights};
use super::onnx::{self, Malformed};

/// Where the operator is at home.
const DOMAIN: &str = "memtransfer";

/// The domain with the operator in it.
pub(super) fn domain(unit: TileUnit) -> ort::Result<OperatorDomain> {
    OperatorDomain::new(DOMAIN)?.add(Product(unit))
}

/// The model with its products turned into this operator's, as far as it can compute them.
pub(super) fn redirected(model: &[u8]) -> Result<Vec<u8>, Malformed> {
    onnx::redirect_products(model, DOMAIN, Weights::fits)
}

/// `MatMul` with a constant matrix on the right.
struct Product(TileUnit);

impl Operator for Product {
    type Kernel<'attr> = ProductKernel;

    fn name(&self) -> &str {
        onnx::PRODUCT
    }

    fn inputs(&self) -> impl IntoIterator<Item = OperatorInput> {
        [TensorElementType::Float32; 2].map(OperatorInput::required)
    }

    fn outputs(&self) -> impl IntoIterator<Item = OperatorOutput> {
        [OperatorOutput::required(TensorElementType::Float32)]
    }

    fn create_kernel<'attr>(&self, node: &KernelContext<'attr>) -> ort::Result<ProductKernel> {
        let matrix = node.constant_input::<TensorValueType<f32>>(1)?;
        let (shape, numbers) = matrix.extract_tensor();
        let weights = match **shape {
            [inner, columns] => Weights::new(numbers, inner as usize, columns as usize),
            _ => None,
        };
        let weights =
            weights.ok_or_else(|| Error::new(format!("no matrix to multiply by: {shape}")))?;
        Ok(ProductKernel { weights, multiplier: Multiplier::new(self.0) })
    }

    /// Says nothing while a length is unknown: ONNX Runtime would take it for a length of -1.
    fn infer_shape(&self, node: &mut ShapeInferenceContext) -> ort::Result<()> {
        let inputs = node.inputs();
        let shapes: Vec<_> = inputs.iter().filter_map(ValueType::tensor_shape).collect();
        if let [left, right] = shapes[..]
            && let (Some((_, outer)), Some(&columns)) = (left.split_last(), right.last())
            && outer.iter().all(|&length| length >= 0)
        {
            let shape = Shape::new(outer.iter().copied().chain([columns]));
            let dimension_symbols = SymbolicDimensions::empty(shape.len());
            let ty = TensorElementType::Float32;
            node.set_output(0, &ValueType::Tensor { ty, shape, dimension_symbols })?;
        }
        Ok(())
    }
}

struct ProductKernel {
    weights: Weights,
    multiplier: Multiplier,
}

impl Kernel for ProductKernel {
    fn compute(&mut self, node: &ComputeContext) -> ort::Result<()> {
        let missing = || Error::new("a product without its left side or its result");
        let left = node.input(0)?.ok_or_else(missing)?;
        let (shape, left) = left.try_extract_tensor::<f32>()?;
        let mut wanted = shape.to_vec();
        let columns = self.weights.columns();
        match wanted.last_mut() {
            Some(inner) if *inner == self.weights.inner() as i64 => *inner = columns as i64,
            _ => {
                return Err(Error::new(format!(
                    "{shape} cannot be multiplied by a matrix of {} rows",
                    self.weights.inner()
                )));
            }
        }
        let mut result = node.output(0, wanted)?.ok_or_else(missing)?;
        let (_, result) = result.try_extract_tensor_mut::<f32>()?;
        self.multiplier.multiply(left, &self.weights, result);
        Ok(())
    }
}
