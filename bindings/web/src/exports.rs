//! The three functions that a loader sees. Numbers go in and out; all else lies in memory that the library owns.
//!
//! 1. `veiloc_room(length)`: where to write a message of so many bytes; 0 when it is too long.
//! 2. `veiloc_call()`: does what the message asks for; the length of the reply.
//! 3. `veiloc_reply()`: where the reply is, until the next call.
//!
//! A reply's head has the field `error` when nothing was done. There is no `unsafe` code here: addresses are handed out, none is
//! followed. Only the names of exports take the attribute (decision 0027).

use std::cell::RefCell;

use serde::Serialize;

use crate::device::Device;
use crate::error::WebError;
use crate::message;

/// Longest message, bytes: the largest image that is read.
const MOST: usize = 512 << 20;

/// All there is between two calls.
#[derive(Default)]
struct Held {
    message: Vec<u8>,
    reply: Vec<u8>,
    device: Device,
}

thread_local! {
    static HELD: RefCell<Held> = RefCell::default();
}

#[derive(Serialize)]
struct Refusal {
    error: String,
    kind: &'static str,
}

/// Room for a message, and where it is; null when it is longer than any image.
#[expect(unsafe_code, reason = "the name of an export; the function is safe")]
#[unsafe(no_mangle)]
pub extern "C" fn veiloc_room(length: usize) -> *mut u8 {
    HELD.with_borrow_mut(|held| {
        if length > MOST {
            return std::ptr::null_mut();
        }
        held.message.clear();
        held.message.resize(length, 0);
        held.message.as_mut_ptr()
    })
}

/// Does what the message asks for; the length of the reply.
#[expect(unsafe_code, reason = "the name of an export; the function is safe")]
#[unsafe(no_mangle)]
pub extern "C" fn veiloc_call() -> usize {
    HELD.with_borrow_mut(|held| {
        // Of the image nothing is kept but what the reply says.
        let message = std::mem::take(&mut held.message);
        held.reply = reply(&mut held.device, &message);
        held.reply.len()
    })
}

/// Where the reply is, until the next call.
#[expect(unsafe_code, reason = "the name of an export; the function is safe")]
#[unsafe(no_mangle)]
pub extern "C" fn veiloc_reply() -> *const u8 {
    HELD.with_borrow(|held| held.reply.as_ptr())
}

/// What a message is answered with: never a panic, whatever it holds.
pub fn reply(device: &mut Device, message: &[u8]) -> Vec<u8> {
    device.answer(message).unwrap_or_else(|error: WebError| {
        message::write(&Refusal { error: error.to_string(), kind: error.kind() }, &[])
    })
}
