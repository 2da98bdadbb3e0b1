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

/// Bytes that are kept of the reason for a failure.
pub const MAX_REASON_BYTES: usize = 4096;

/// The reason for a failure, cut at a character boundary where it is longer than [`MAX_REASON_BYTES`]; then the length of the
/// whole follows.
pub fn shortened_reason(reason: String) -> String {
    if reason.len() <= MAX_REASON_BYTES {
        return reason;
    }
    let start = &reason[..reason.floor_char_boundary(MAX_REASON_BYTES)];
    format!("{start}... (cut: {} bytes in all, and {MAX_REASON_BYTES} are kept)", reason.len())
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
