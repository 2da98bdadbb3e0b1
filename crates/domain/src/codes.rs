//! Enums with `u8` codes, described from their declaration for the reference of the wire.

/// An enum with codes.
pub trait Codes {
    /// The description.
    const CODES: CodeSet;
}

/// The description of an enum with codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CodeSet {
    /// Its name in Rust.
    pub name: &'static str,
    /// Its meaning, in Markdown.
    pub doc: &'static str,
    /// Its members, in code order.
    pub members: &'static [CodeSetMember],
}

/// A member of a [`CodeSet`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CodeSetMember {
    /// Its name in Rust.
    pub name: &'static str,
    /// Its code on the wire.
    pub code: u8,
    /// Its meaning, in Markdown.
    pub doc: &'static str,
}

/// Declares enums whose `u8` codes are positions in `ALL`.
#[macro_export]
macro_rules! code_sets {
    ($($(#[doc = $doc:literal])* $name:ident, $what:literal $(#[$attribute:meta])* {
        $($(#[doc = $variant_doc:literal])* $variant:ident = $code:literal,)*
    })*) => {
        $(
            $crate::coded_enum! {
                $(#[doc = $doc])*
                $name $(#[$attribute])* { $($(#[doc = $variant_doc])* $variant = $code,)* }
            }

            impl $name {
                /// All members, in code order.
                pub const ALL: &'static [Self] = &[$(Self::$variant),*];
            }

            impl TryFrom<u8> for $name {
                type Error = $crate::UnknownCode;

                fn try_from(code: u8) -> Result<Self, $crate::UnknownCode> {
                    match code {
                        $($code => Ok(Self::$variant),)*
                        _ => Err($crate::UnknownCode::new(code, $what)),
                    }
                }
            }
        )*

        /// The enums declared here.
        pub const CODE_SETS: &[$crate::codes::CodeSet] = &[$(<$name as $crate::codes::Codes>::CODES),*];
    };
}

/// Declares an enum whose members have `u8` codes.
#[macro_export]
macro_rules! coded_enum {
    ($(#[doc = $doc:literal])* $name:ident $(#[$attribute:meta])* {
        $($(#[doc = $member_doc:literal])* $member:ident = $code:literal,)*
    }) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        $(#[$attribute])*
        #[repr(u8)]
        pub enum $name { $($(#[doc = $member_doc])* $member = $code,)* }

        impl $crate::codes::Codes for $name {
            const CODES: $crate::codes::CodeSet = $crate::codes::CodeSet {
                name: stringify!($name),
                doc: concat!($($doc, "\n",)*),
                members: &[$($crate::codes::CodeSetMember {
                    name: stringify!($member),
                    code: $code,
                    doc: concat!($($member_doc, "\n",)*),
                },)*],
            };
        }
    };
}
