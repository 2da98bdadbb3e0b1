//! Frames: views whose pixels stay in shared memory.
//!
//! numpy reads the pixels through `__array_interface__` of a [`SharedPixels`], without a copy and without the
//! right to write. The simulator reuses a frame's memory only when every holder has dropped it. An array keeps its
//! [`SharedPixels`] alive, so an array never changes; a [`Frame`] does not, and its pixels are gone once the run has
//! evicted them.

use std::ops::Deref;
use std::sync::{Arc, Weak};

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyBytes, PyDict, PyType};

use crate::classes::error;

/// A view.
#[pyclass(frozen, module = "memtransfer")]
pub(crate) struct Frame {
    #[pyo3(get)]
    pub(crate) id: u64,
    #[pyo3(get)]
    pub(crate) width: u32,
    #[pyo3(get)]
    pub(crate) height: u32,
    pub(crate) content_hash: [u8; 16],
    pixels: Pixels,
}

/// Where the pixels are.
enum Pixels {
    /// In shared memory, until the run evicts the frame.
    Shared(Weak<shm_types::Frame>),
    /// In a read-only array of Python's.
    Own(Py<PyAny>),
}

impl Frame {
    pub(crate) fn shared(frame: &Arc<shm_types::Frame>) -> Self {
        let size = frame.size();
        Self {
            id: frame.id(),
            width: size.width,
            height: size.height,
            content_hash: frame.content_hash(),
            pixels: Pixels::Shared(Arc::downgrade(frame)),
        }
    }

    /// The frame in shared memory, if the run has not evicted it.
    fn resident(&self) -> Option<Arc<shm_types::Frame>> {
        match &self.pixels {
            Pixels::Shared(frame) => frame.upgrade().filter(|frame| !frame.is_evicted()),
            Pixels::Own(_) => None,
        }
    }

    /// The pixels: RGBA, rows from top to bottom.
    pub(crate) fn bytes(&self, py: Python<'_>) -> PyResult<PixelBytes> {
        match &self.pixels {
            Pixels::Shared(_) => {
                Ok(PixelBytes::Shared(self.resident().ok_or_else(|| self.gone(py))?))
            }
            Pixels::Own(array) => {
                Ok(PixelBytes::Own(array.call_method0(py, "tobytes")?.extract(py)?))
            }
        }
    }

    fn gone(&self, py: Python<'_>) -> PyErr {
        let message = format!(
            "frame {} is gone: the run has evicted it since its request was answered; copy the pixels that \
             you want to keep (frame.pixels.copy())",
            self.id
        );
        error(py, "FrameGone", message)
    }
}

#[pymethods]
impl Frame {
    #[classmethod]
    #[pyo3(signature = (pixels, id = 1, content_hash = None))]
    fn of(
        _class: &Bound<'_, PyType>,
        pixels: &Bound<'_, PyAny>,
        id: u64,
        content_hash: Option<[u8; 16]>,
    ) -> PyResult<Self> {
        let py = pixels.py();
        let numpy = py.import("numpy")?;
        let options = PyDict::new(py);
        options.set_item("order", "C")?;
        let array = numpy.call_method("array", (pixels,), Some(&options))?;
        let (dtype, shape) = (array.getattr("dtype")?, array.getattr("shape")?);
        if !dtype.eq(numpy.getattr("uint8")?)? {
            let problem = format!("pixels are {dtype}, but those of a frame are uint8 (0 to 255)");
            return Err(PyTypeError::new_err(problem));
        }
        let (height, width) = match shape.extract::<Vec<u32>>()?[..] {
            [height, width, 4] if height > 0 && width > 0 => (height, width),
            _ => {
                let problem = format!(
                    "pixels have the shape {shape}, but a frame has (height, width, 4), RGBA, and no side is 0"
                );
                return Err(PyValueError::new_err(problem));
            }
        };
        array.call_method1("setflags", (false,))?;
        let content_hash = match content_hash {
            Some(hash) => hash,
            None => {
                let bytes = array.call_method0("tobytes")?;
                hash_of(bytes.cast::<PyBytes>()?.as_bytes())
            }
        };
        Ok(Self { id, width, height, content_hash, pixels: Pixels::Own(array.unbind()) })
    }

    #[getter]
    fn content_hash<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.content_hash)
    }

    #[getter]
    fn pixels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        static AS_ARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
        if let Pixels::Own(array) = &self.pixels {
            return Ok(array.bind(py).clone());
        }
        let frame = self.resident().ok_or_else(|| self.gone(py))?;
        AS_ARRAY.import(py, "numpy", "asarray")?.call1((SharedPixels(frame),))
    }

    #[getter]
    fn is_gone(&self) -> bool {
        matches!(self.pixels, Pixels::Shared(_)) && self.resident().is_none()
    }

    fn __copy__(frame: Py<Self>) -> Py<Self> {
        frame
    }

    /// Deep copies and pickles hold a copy of the pixels, so that another process can read them.
    #[expect(clippy::type_complexity, reason = "the shape that pickle wants")]
    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyAny>, u64, Bound<'py, PyBytes>))> {
        let of = py.get_type::<Self>().getattr("of")?;
        let pixels = self.pixels(py)?.call_method0("copy")?;
        Ok((of, (pixels, self.id, self.content_hash(py))))
    }

    fn __eq__(&self, other: &Self) -> bool {
        (self.id, self.content_hash) == (other.id, other.content_hash)
    }

    fn __hash__(&self) -> u64 {
        self.id
    }

    fn __repr__(&self) -> String {
        format!("Frame({}, {} x {})", self.id, self.width, self.height)
    }
}

/// A frame's pixels.
pub(crate) enum PixelBytes {
    Shared(Arc<shm_types::Frame>),
    Own(Vec<u8>),
}

impl Deref for PixelBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Shared(frame) => frame.pixels(),
            Self::Own(bytes) => bytes,
        }
    }
}

/// The owner of the memory that an array shows.
#[pyclass(frozen, module = "memtransfer._native")]
pub(crate) struct SharedPixels(Arc<shm_types::Frame>);

#[pymethods]
impl SharedPixels {
    /// Version 3 of numpy's array interface: the address, and that the memory is read-only.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let size = self.0.size();
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("shape", (size.height, size.width, 4))?;
        interface.set_item("typestr", "|u1")?;
        interface.set_item("data", (self.0.pixels().as_ptr() as usize, true))?;
        Ok(interface)
    }
}

/// The name of pixels by their content, as the simulator makes it.
fn hash_of(pixels: &[u8]) -> [u8; 16] {
    let hash = blake3::hash(pixels);
    hash.as_bytes().first_chunk().copied().unwrap_or_default()
}
