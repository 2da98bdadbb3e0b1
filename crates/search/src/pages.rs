//! Advice to the system about large pages.

#![expect(unsafe_code, reason = "madvise takes a raw address range")]

const LARGE_PAGE: usize = 2 << 20;

/// Asks for large pages under memory that is reserved and not written yet, so that a scan of gigabytes does not
/// spend its time on address translation.
pub(crate) fn advise_large<T>(reserved: &mut Vec<T>) {
    let spare = reserved.spare_capacity_mut();
    let (start, bytes) = (spare.as_mut_ptr() as usize, size_of_val(spare));
    let first = start.next_multiple_of(LARGE_PAGE);
    let end = (start + bytes) / LARGE_PAGE * LARGE_PAGE;
    if end > first {
        // SAFETY: the range lies inside memory that the vector owns, and the advice does not change its content.
        // The system may decline it, so the result does not matter.
        unsafe { libc::madvise(first as *mut libc::c_void, end - first, libc::MADV_HUGEPAGE) };
    }
}
