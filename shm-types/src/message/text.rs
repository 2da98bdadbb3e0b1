//! Texts in buffers of fixed size.

use domain::UnknownCode;

/// Copies as much of `text` as fits into `buffer`, cut at a character boundary; returns the bytes used.
pub fn write_text(buffer: &mut [u8], text: &str) -> u32 {
    let mut end = text.len().min(buffer.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    buffer[..end].copy_from_slice(&text.as_bytes()[..end]);
    end as u32
}

/// The text that the first `len` bytes of `buffer` hold.
///
/// # Errors
/// When `len` is larger than the buffer or the bytes are not UTF-8: the sender is broken.
pub fn read_text(buffer: &[u8], len: u32) -> Result<&str, UnknownCode> {
    let broken = || UnknownCode::new(format_args!("a text of {len} bytes"), "UTF-8 that fits");
    let bytes = buffer.get(..len as usize).ok_or_else(broken)?;
    core::str::from_utf8(bytes).map_err(|_| broken())
}
