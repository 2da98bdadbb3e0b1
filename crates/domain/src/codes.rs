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

/// Declares enums whose `u8` codes are positions in `ALL`, each member with the word for it in files and messages.
#[macro_export]
macro_rules! code_sets {
    ($($(#[doc = $doc:literal])* $name:ident, $what:literal $(#[$attribute:meta])* {
        $(#[doc = $first_doc:literal])* $first:ident = $first_code:literal $first_word:literal,
        $($(#[doc = $other_doc:literal])* $other:ident = $other_code:literal $other_word:literal,)*
    })*) => {
        $(
            $crate::coded_enum! {
                $(#[doc = $doc])*
                $name, concat!(
                    $what, " (", $first_code, " ", $first_word,
                    $(", ", $other_code, " ", $other_word,)* ")"
                );
                $(#[$attribute])* {
                    $(#[doc = $first_doc])* $first = $first_code,
                    $($(#[doc = $other_doc])* $other = $other_code,)*
                }
            }

            impl $name {
                /// The word for it in files, on the command line and in messages.
                pub const fn word(self) -> &'static str {
                    match self {
                        Self::$first => $first_word,
                        $(Self::$other => $other_word,)*
                    }
                }
            }
        )*

        /// The enums declared here.
        pub const CODE_SETS: &[$crate::codes::CodeSet] = &[$(<$name as $crate::codes::Codes>::CODES),*];
    };
}

/// Declares an enum whose members have `u8` codes, which are positions in `ALL`. Errors about a code say what is `$expected`.
#[macro_export]
macro_rules! coded_enum {
    ($(#[doc = $doc:literal])* $name:ident, $expected:expr; $(#[$attribute:meta])* {
        $($(#[doc = $member_doc:literal])* $member:ident = $code:literal,)*
    }) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        $(#[$attribute])*
        #[repr(u8)]
        pub enum $name { $($(#[doc = $member_doc])* $member = $code,)* }

        impl $name {
            /// All members, in code order.
            pub const ALL: [Self; [$($code),*].len()] = [$(Self::$member),*];
        }

        impl TryFrom<u8> for $name {
            type Error = $crate::UnknownCode;

            fn try_from(code: u8) -> Result<Self, $crate::UnknownCode> {
                let found = Self::ALL.get(usize::from(code)).copied();
                found.ok_or_else(|| $crate::UnknownCode::new(code, $expected))
            }
        }

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

/// Lets serde read and write a type as the text of its `FromStr` and `Display`, given
/// `#[serde(try_from = "String", into = "String")]`.
#[macro_export]
macro_rules! serde_as_text {
    ($name:ty) => {
        impl TryFrom<String> for $name {
            type Error = <$name as std::str::FromStr>::Err;

            fn try_from(text: String) -> Result<Self, Self::Error> {
                text.parse()
            }
        }

        impl From<$name> for String {
            fn from(value: $name) -> Self {
                value.to_string()
            }
        }
    };
}
