//! Pointers of the caller as references, and back: all conversions of this crate.

use std::ffi::{CStr, c_char};

use crate::status::{Failure, VeilocStatus};

/// Null where something is needed.
fn null(what: &str) -> Failure {
    Failure::new(VeilocStatus::Argument, format!("{what} is null"))
}

/// A reference to what a pointer points to.
///
/// # Safety
/// `pointer` is null or valid for reads during the call.
pub(crate) unsafe fn reference<'a, T>(pointer: *const T, what: &str) -> Result<&'a T, Failure> {
    // SAFETY: the caller guarantees it.
    unsafe { pointer.as_ref() }.ok_or_else(|| null(what))
}

/// The same, or `None` for null.
///
/// # Safety
/// As for [`reference`].
pub(crate) unsafe fn optional<'a, T>(pointer: *const T) -> Option<&'a T> {
    // SAFETY: the caller guarantees it.
    unsafe { pointer.as_ref() }
}

/// A mutable reference.
///
/// # Safety
/// `pointer` is null or valid for reads and writes during the call, and nothing else uses what it points to.
pub(crate) unsafe fn mutable<'a, T>(pointer: *mut T, what: &str) -> Result<&'a mut T, Failure> {
    // SAFETY: the caller guarantees it.
    unsafe { pointer.as_mut() }.ok_or_else(|| null(what))
}

/// The same, or `None` for null.
///
/// # Safety
/// As for [`mutable`].
pub(crate) unsafe fn optional_mutable<'a, T>(pointer: *mut T) -> Option<&'a mut T> {
    // SAFETY: the caller guarantees it.
    unsafe { pointer.as_mut() }
}

/// A slice; null is empty when `length` is 0.
///
/// # Safety
/// `pointer` is null or valid for reads of `length` values during the call.
pub(crate) unsafe fn slice<'a, T>(pointer: *const T, length: usize, what: &str) -> Result<&'a [T], Failure> {
    if length == 0 {
        return Ok(&[]);
    }
    if pointer.is_null() {
        return Err(null(what));
    }
    if length > isize::MAX as usize / size_of::<T>().max(1) {
        return Err(Failure::new(VeilocStatus::Argument, format!("{what}: {length} are too many")));
    }
    // SAFETY: it is not null, not longer than memory can be, and the caller guarantees the rest.
    Ok(unsafe { std::slice::from_raw_parts(pointer, length) })
}

/// A text; `None` for null.
///
/// # Safety
/// `pointer` is null or points to bytes that end with a zero byte, valid during the call.
pub(crate) unsafe fn text<'a>(pointer: *const c_char, what: &str) -> Result<Option<&'a str>, Failure> {
    if pointer.is_null() {
        return Ok(None);
    }
    // SAFETY: it is not null, and the caller guarantees the rest.
    let text = unsafe { CStr::from_ptr(pointer) }.to_str();
    let wrong = |_| Failure::new(VeilocStatus::Argument, format!("{what} is not UTF-8"));
    text.map(Some).map_err(wrong)
}

/// Writes a result.
///
/// # Safety
/// `out` is null or valid for a write.
pub(crate) unsafe fn give<T>(out: *mut T, value: T, what: &str) -> Result<(), Failure> {
    if out.is_null() {
        return Err(null(what));
    }
    // SAFETY: it is not null, and the caller guarantees the rest. The old value may be uninitialized and is not dropped.
    unsafe { out.write(value) };
    Ok(())
}

/// Writes a new handle.
///
/// # Safety
/// As for [`give`].
pub(crate) unsafe fn give_handle<T>(out: *mut *mut T, value: T) -> Result<(), Failure> {
    if out.is_null() {
        return Err(null("out"));
    }
    // SAFETY: as above.
    unsafe { give(out, Box::into_raw(Box::new(value)), "out") }
}

/// Frees a handle; null may be freed.
///
/// # Safety
/// `handle` is null or came from [`give_handle`], and was not freed.
pub(crate) unsafe fn free<T>(handle: *mut T) {
    if !handle.is_null() {
        // SAFETY: it came from `Box::into_raw`, and the caller guarantees that it is freed once.
        drop(unsafe { Box::from_raw(handle) });
    }
}
