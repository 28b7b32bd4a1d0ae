//! The three exported functions. Arguments and results are numbers; messages are in memory that the library owns.
//!
//! 1. `veiloc_allocate(length)`: the address for a message of `length` bytes; 0 when it is too long.
//! 2. `veiloc_call()`: handles the message; the length of the reply.
//! 3. `veiloc_reply()`: the address of the reply, valid until the next call.
//!
//! After an error the reply's head has the field `error`. There is no `unsafe` code here: the functions return
//! addresses, and never read one. Only the names of exports need the attribute (decision 0027).

use std::cell::RefCell;

use serde::Serialize;

use crate::device::Device;
use crate::error::WebError;
use crate::message;

/// Most bytes of a message; this limits the size of images.
const MAX_MESSAGE_BYTES: usize = 512 << 20;

/// The state between two calls.
#[derive(Default)]
struct Instance {
    message: Vec<u8>,
    reply: Vec<u8>,
    device: Device,
}

thread_local! {
    static INSTANCE: RefCell<Instance> = RefCell::default();
}

#[derive(Serialize)]
struct ErrorReply {
    error: String,
    kind: &'static str,
}

/// Allocates memory for a message and returns its address; null when it is too long.
#[expect(unsafe_code, reason = "the name of an export; the function is safe")]
#[unsafe(no_mangle)]
pub extern "C" fn veiloc_allocate(length: usize) -> *mut u8 {
    INSTANCE.with_borrow_mut(|instance| {
        if length > MAX_MESSAGE_BYTES {
            return std::ptr::null_mut();
        }
        instance.message.clear();
        instance.message.resize(length, 0);
        instance.message.as_mut_ptr()
    })
}

/// Handles the message and returns the length of the reply.
#[expect(unsafe_code, reason = "the name of an export; the function is safe")]
#[unsafe(no_mangle)]
pub extern "C" fn veiloc_call() -> usize {
    INSTANCE.with_borrow_mut(|instance| {
        // The message is taken, so the image does not stay in memory.
        let message = std::mem::take(&mut instance.message);
        instance.reply = reply(&mut instance.device, &message);
        instance.reply.len()
    })
}

/// The address of the reply, valid until the next call.
#[expect(unsafe_code, reason = "the name of an export; the function is safe")]
#[unsafe(no_mangle)]
pub extern "C" fn veiloc_reply() -> *const u8 {
    INSTANCE.with_borrow(|instance| instance.reply.as_ptr())
}

/// The reply to a message. It never panics, also not for arbitrary bytes.
pub fn reply(device: &mut Device, message: &[u8]) -> Vec<u8> {
    device.answer(message).unwrap_or_else(|error: WebError| {
        message::write(&ErrorReply { error: error.to_string(), kind: error.kind() }, &[])
    })
}
