//! At which precision a model runs, decided once before anything is opened.
//!
//! 32-bit floats run anywhere. Where the processor has a tile unit, products can be made of 16-bit ones. What
//! was not asked for by name falls back to 32 bits: slower, and right.

use super::EncoderError;
use super::amx::TileUnit;
use crate::manifest::{Model, Precision};

/// What products are computed with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Products {
    /// ONNX Runtime's own kernels, 32-bit floats.
    Own,
    /// The tile unit, 16-bit floats three by three.
    Tiles(TileUnit),
}

impl Products {
    /// What `model` runs with, at precision `asked` or else at its own as far as this machine can.
    ///
    /// # Errors
    /// When this machine cannot do what was asked for.
    pub(super) fn choose(model: &Model, asked: Option<Precision>) -> Result<Self, EncoderError> {
        Self::on(TileUnit::get(), model, asked)
    }

    fn on(
        unit: Option<TileUnit>,
        model: &Model,
        asked: Option<Precision>,
    ) -> Result<Self, EncoderError> {
        match (asked.unwrap_or(model.precision), unit, asked) {
            (Precision::F32, ..) | (Precision::Bf16x3, None, None) => Ok(Self::Own),
            (Precision::Bf16x3, Some(unit), _) => Ok(Self::Tiles(unit)),
            (Precision::Bf16x3, None, Some(asked)) => {
                Err(EncoderError::Precision { precision: asked.word() })
            }
        }
    }

    /// The precision that it comes to.
    pub(super) fn precision(self) -> Precision {
        match self {
            Self::Own => Precision::F32,
            Self::Tiles(_) => Precision::Bf16x3,
        }
    }

    /// What the last bits of an embedding depend on, beside the model and ONNX Runtime's build.
    pub(super) fn fingerprint(self) -> String {
        match self {
            Self::Own => vector_instructions().into(),
            Self::Tiles(_) => format!("{} {}", vector_instructions(), self.precision().word()),
        }
    }
}

/// The instruction set that decides which kernels ONNX Runtime picks.
fn vector_instructions() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        if std::is_x86_feature_detected!("avx512f") {
            "x86-64 avx512"
        } else if std::is_x86_feature_detected!("avx2") {
            "x86-64 avx2"
        } else {
            "x86-64"
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        std::env::consts::ARCH
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::Manifest;

    #[test]
    fn sixteen_bits_where_the_model_allows_it_and_the_machine_can() {
        use Precision::{Bf16x3, F32};
        let manifest = Manifest::shipped().unwrap();
        let (fast, exact) = (manifest.model("dinov2-s14"), manifest.model("vit-b16"));
        let (fast, exact) = (fast.unwrap(), exact.unwrap());
        for (model, asked) in [(fast, None), (fast, Some(F32)), (exact, None), (exact, Some(F32))] {
            assert_eq!(Products::on(None, model, asked).unwrap(), Products::Own, "{asked:?}");
        }
        let error = Products::on(None, exact, Some(Bf16x3)).unwrap_err().to_string();
        assert!(error.contains("bf16x3") && error.contains("f32"), "{error}");
        let Some(unit) = TileUnit::get() else { return };
        for (model, asked, expected) in [
            (fast, None, Bf16x3),
            (fast, Some(F32), F32),
            (exact, None, F32),
            (exact, Some(Bf16x3), Bf16x3),
        ] {
            let found = Products::on(Some(unit), model, asked).unwrap();
            assert_eq!(found.precision(), expected, "{} {asked:?}", model.name);
        }
        assert_ne!(Products::Own.fingerprint(), Products::Tiles(unit).fingerprint());
    }
}
