//! Descriptions of wire structs, from the declarations that the compiler lays out. The example `wire` writes
//! `docs/wire.md` from them.

/// A wire struct.
pub trait WireLayout {
    /// Its description.
    const LAYOUT: Struct;
}

/// The layout of a wire struct.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Struct {
    /// Its name in Rust.
    pub name: &'static str,
    /// Its type name in iceoryx2.
    pub type_name: &'static str,
    /// Its meaning, in Markdown.
    pub doc: &'static str,
    /// Its size in bytes.
    pub bytes: usize,
    /// Its alignment in bytes.
    pub align: usize,
    /// Its fields, without gaps.
    pub fields: &'static [Field],
}

/// A field of a [`Struct`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: &'static str,
    /// Its type.
    pub shape: FieldType,
    /// Its offset in bytes.
    pub offset: usize,
    /// Its size in bytes.
    pub bytes: usize,
    /// Its meaning, in Markdown.
    pub doc: &'static str,
}

/// The type of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldType {
    /// A number, by its Rust name.
    Number(&'static str),
    /// A wire struct, by its name.
    Struct(&'static str),
    /// An array.
    Array(&'static Self, usize),
}

/// A type that can be a field.
pub trait WireType {
    /// Its type.
    const SHAPE: FieldType;
}

macro_rules! numbers {
    ($($type:ident)*) => {$(
        impl WireType for $type {
            const SHAPE: FieldType = FieldType::Number(stringify!($type));
        }
    )*};
}

numbers!(u8 u16 u32 u64 f32);

impl<T: WireType, const N: usize> WireType for [T; N] {
    const SHAPE: FieldType = FieldType::Array(&T::SHAPE, N);
}

/// Declares and describes a wire struct, and asserts its size.
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

        impl $crate::layout::WireType for $name {
            const SHAPE: $crate::layout::FieldType = $crate::layout::FieldType::Struct(stringify!($name));
        }

        impl $crate::layout::WireLayout for $name {
            const LAYOUT: $crate::layout::Struct = $crate::layout::Struct {
                name: stringify!($name),
                type_name: $type_name,
                doc: concat!($($doc, "\n",)*),
                bytes: $size,
                align: align_of::<$name>(),
                fields: &[$($crate::layout::Field {
                    name: stringify!($field),
                    shape: <$type as $crate::layout::WireType>::SHAPE,
                    offset: core::mem::offset_of!($name, $field),
                    bytes: size_of::<$type>(),
                    doc: concat!($($field_doc, "\n",)*),
                },)*],
            };
        }
    };
}

pub(crate) use wire_struct;
