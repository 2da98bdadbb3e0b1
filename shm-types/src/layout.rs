//! Wire structs and codes that describe themselves: names, offsets, sizes and meanings, from the very
//! declaration that the compiler lays out.
//!
//! The reference of the wire (`docs/wire.md`) and the Python structures (`python/memtransfer/_wire.py`) are
//! written from these by the example `wire`. Nothing here is needed to take part in a run.

/// A struct of the wire, with its description.
pub trait Layout {
    /// The description.
    const LAYOUT: Struct;
}

/// How a struct lies in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Struct {
    /// Its name in Rust.
    pub name: &'static str,
    /// Its name for iceoryx2, which both ends of a service must agree on.
    pub type_name: &'static str,
    /// What it is; Markdown, one line of source a line.
    pub doc: &'static str,
    /// Its size in bytes.
    pub bytes: usize,
    /// Its alignment in bytes.
    pub align: usize,
    /// Its fields: they follow each other without gaps.
    pub fields: &'static [Field],
}

/// A field of a [`Struct`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: &'static str,
    /// Its type.
    pub shape: Shape,
    /// Bytes before it.
    pub offset: usize,
    /// Its size in bytes.
    pub bytes: usize,
    /// What it means; Markdown, one line of source a line.
    pub doc: &'static str,
}

/// The type of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// A number, by its name in Rust.
    Number(&'static str),
    /// A struct of the wire, by its name.
    Struct(&'static str),
    /// So many of one type.
    Array(&'static Self, usize),
}

/// A type that can be a field.
pub trait Shaped {
    /// What it is.
    const SHAPE: Shape;
}

macro_rules! numbers {
    ($($type:ident)*) => {$(
        impl Shaped for $type {
            const SHAPE: Shape = Shape::Number(stringify!($type));
        }
    )*};
}

numbers!(u8 u16 u32 u64 f32);

impl<T: Shaped, const N: usize> Shaped for [T; N] {
    const SHAPE: Shape = Shape::Array(&T::SHAPE, N);
}

/// Declares a wire struct and describes it; its size is asserted.
macro_rules! wire_struct {
    ($(#[doc = $doc:literal])* $name:ident $(: $($derive:ident)+)?, $type_name:literal, $size:literal bytes {
        $($(#[doc = $field_doc:literal])* $field:ident: $type:ty,)*
    }) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, Copy, PartialEq, $($($derive,)+)?)]
        #[derive(bytemuck::Pod, bytemuck::Zeroable, iceoryx2::prelude::ZeroCopySend)]
        #[repr(C)]
        #[type_name($type_name)]
        pub struct $name { $($(#[doc = $field_doc])* pub $field: $type,)* }

        const _: () = assert!(size_of::<$name>() == $size, "wire size changed: raise WIRE_VERSION");

        impl $crate::layout::Shaped for $name {
            const SHAPE: $crate::layout::Shape = $crate::layout::Shape::Struct(stringify!($name));
        }

        impl $crate::layout::Layout for $name {
            const LAYOUT: $crate::layout::Struct = $crate::layout::Struct {
                name: stringify!($name),
                type_name: $type_name,
                doc: concat!($($doc, "\n",)*),
                bytes: $size,
                align: align_of::<$name>(),
                fields: &[$($crate::layout::Field {
                    name: stringify!($field),
                    shape: <$type as $crate::layout::Shaped>::SHAPE,
                    offset: core::mem::offset_of!($name, $field),
                    bytes: size_of::<$type>(),
                    doc: concat!($($field_doc, "\n",)*),
                },)*],
            };
        }
    };
}

pub(crate) use wire_struct;
