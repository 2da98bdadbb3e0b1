//! ONNX Runtime's execution providers: the hardware that a model runs on.

use std::fmt;
use std::path::Path;

use clap::ValueEnum;
use ort::ep::cuda::ConvAlgorithmSearch;
use ort::ep::{CPU, CUDA, ExecutionProvider, ExecutionProviderDispatch, OpenVINO, TensorRT};

use anyhow::{Result, bail};

/// An execution provider of ONNX Runtime.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Provider {
    /// The processor, with the runtime's own kernels; in every build of the runtime
    #[default]
    Cpu,
    /// Intel processors and graphics, by OpenVINO
    Openvino,
    /// NVIDIA graphics, by CUDA
    Cuda,
    /// NVIDIA graphics, by TensorRT
    Tensorrt,
}

impl Provider {
    /// The provider's name in settings and manifests.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Openvino => "openvino",
            Self::Cuda => "cuda",
            Self::Tensorrt => "tensorrt",
        }
    }

    /// Checks that the loaded runtime, the library at `runtime`, has this provider.
    ///
    /// # Errors
    /// When it has not; the error names those that it has.
    pub(super) fn check(self, runtime: &Path) -> Result<()> {
        if self.is_offered() {
            return Ok(());
        }
        let offered = Self::value_variants().iter().filter(|other| other.is_offered());
        let offered: Vec<&str> = offered.map(|other| other.word()).collect();
        bail!(
            "ONNX Runtime at {} has no execution provider `{self}`; it offers {}. Pass one of these with --provider, or \
             put a build of ONNX Runtime that has `{self}` there (docs/encoders.md says how)",
            runtime.display(),
            offered.join(", ")
        )
    }

    /// Whether the loaded runtime was built with this provider.
    fn is_offered(self) -> bool {
        match self {
            Self::Cpu => Ok(true),
            Self::Openvino => OpenVINO::is_available(),
            Self::Cuda => CUDA::is_available(),
            Self::Tensorrt => TensorRT::is_available(),
        }
        .unwrap_or(false)
    }

    /// What a session registers. A provider that cannot be registered is an error, never replaced silently.
    pub(super) fn dispatch(self) -> ExecutionProviderDispatch {
        match self {
            Self::Cpu => CPU::default().build(),
            Self::Openvino => OpenVINO::default().build(),
            // Without these settings, each session times the algorithms of a convolution and takes the fastest, and
            // factors are rounded to TF32 (10 bits), which changes what is retrieved.
            Self::Cuda => CUDA::default()
                .with_conv_algorithm_search(ConvAlgorithmSearch::Default)
                .with_tf32(false)
                .build(),
            Self::Tensorrt => TensorRT::default().build(),
        }
        .error_on_failure()
    }

    /// What the last bits of an embedding depend on, beside the model and the runtime's build.
    pub(super) fn fingerprint(self) -> String {
        format!("{} {}", self.word(), vector_instructions())
    }
}

impl fmt::Display for Provider {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// The instruction set by which ONNX Runtime chooses its kernels.
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
