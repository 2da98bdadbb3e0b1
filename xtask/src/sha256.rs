//! SHA-256 hashes of files.

use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use anyhow::Context;
use serde::Deserialize;
use sha2::{Digest, Sha256};

/// A SHA-256 hash, written as 64 lower-case hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Deserialize)]
#[serde(try_from = "String")]
pub(crate) struct Sum([u8; 32]);

impl Sum {
    /// Hashes a file.
    pub(crate) fn of_file(path: &Path) -> anyhow::Result<Self> {
        let read = || -> std::io::Result<Self> {
            let mut file = File::open(path)?;
            let mut hasher = Sha256::new();
            let mut block = vec![0; 1 << 20];
            loop {
                match file.read(&mut block)? {
                    0 => return Ok(Self(hasher.finalize().into())),
                    length => hasher.update(&block[..length]),
                }
            }
        };
        read().with_context(|| format!("cannot read {}", path.display()))
    }
}

impl TryFrom<String> for Sum {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let wrong = || format!("a SHA-256 sum is 64 hexadecimal digits, not {text:?}");
        if text.len() != 64 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Err(wrong());
        }
        let mut bytes = [0; 32];
        for (byte, digits) in bytes.iter_mut().zip(text.as_bytes().chunks(2)) {
            let digits = str::from_utf8(digits).map_err(|_| wrong())?;
            *byte = u8::from_str_radix(digits, 16).map_err(|_| wrong())?;
        }
        Ok(Self(bytes))
    }
}

impl fmt::Display for Sum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_match_the_examples_of_the_standard() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(Sum::of_file(&path).unwrap().to_string(), expected);
        assert_eq!(Sum::try_from(expected.to_owned()).unwrap(), Sum::of_file(&path).unwrap());
    }

    #[test]
    fn invalid_sums_are_refused() {
        for text in ["", "abc", &"g".repeat(64), &"é".repeat(32)] {
            assert!(Sum::try_from(text.to_owned()).is_err(), "{text:?}");
        }
    }
}
