//! Bytes that the library returns.

/// Bytes that the library made: freed by `veiloc_bytes_free`.
#[repr(C)]
#[derive(Debug)]
pub struct VeilocBytes {
    /// The first byte; null when there are none.
    pub data: *mut u8,
    /// How many.
    pub length: usize,
}

impl From<Vec<u8>> for VeilocBytes {
    fn from(bytes: Vec<u8>) -> Self {
        if bytes.is_empty() {
            return Self { data: std::ptr::null_mut(), length: 0 };
        }
        let bytes = bytes.into_boxed_slice();
        let length = bytes.len();
        Self { data: Box::into_raw(bytes).cast(), length }
    }
}

/// Frees bytes that the library made. Bytes without data may be freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_bytes_free(bytes: VeilocBytes) {
    if !bytes.data.is_null() {
        let slice = std::ptr::slice_from_raw_parts_mut(bytes.data, bytes.length);
        // SAFETY: they came from `Box::into_raw` with this length, and the caller frees them once.
        drop(unsafe { Box::from_raw(slice) });
    }
}
