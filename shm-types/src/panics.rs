//! Catching the panics with which iceoryx2 answers a system call that fails in a destructor.

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

thread_local! {
    /// Whether a panic of this thread is caught.
    static IS_CAUGHT: Cell<bool> = const { Cell::new(false) };
}

/// Makes the panics that [`caught`] catches silent. The panics of a thread that is panicking already can only be made silent
/// beforehand.
pub(crate) fn prepare() {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let report = panic::take_hook();
        panic::set_hook(Box::new(move |panic| {
            if !IS_CAUGHT.get() {
                report(panic);
            }
        }));
    });
}

/// Calls `f`; `None` if it panicked. What `f` uses must be in a usable state then.
pub(crate) fn caught<T>(f: impl FnOnce() -> T) -> Option<T> {
    let was_caught = IS_CAUGHT.replace(true);
    let outcome = panic::catch_unwind(AssertUnwindSafe(f)).ok();
    IS_CAUGHT.set(was_caught);
    outcome
}
