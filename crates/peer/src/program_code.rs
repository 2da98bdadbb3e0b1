//! What a program tells about its own code, so that a run is not continued with another.

use std::fs::File;
use std::io;

/// Hexadecimal digits of a hash that are reported.
const DIGITS: usize = 16;

/// The name of this program's file and the BLAKE3 hash of its content.
///
/// # Errors
/// When the file cannot be read.
pub(crate) fn own_code() -> io::Result<String> {
    let path = std::env::current_exe()?;
    let mut hasher = blake3::Hasher::new();
    // Opened under this name, it is the file that runs, also after another one has taken its place.
    hasher.update_reader(File::open("/proc/self/exe")?)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let name: String = name.chars().take(40).collect();
    Ok(format!("{name}={}", &hasher.finalize().to_hex()[..DIGITS]))
}
