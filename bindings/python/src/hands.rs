//! Threads that wait for the next call: to start one takes a tenth of a millisecond, as long as a twentieth of a pose.
//!
//! A process that was forked has none of its parent's threads, so each knows whose it is.

use std::sync::Mutex;
use std::sync::mpsc::{Sender, channel};

type Work = Box<dyn FnOnce() + Send>;

/// A thread that does what it is sent.
struct Hand {
    process: u32,
    send: Sender<Work>,
}

/// Those that have nothing to do.
static IDLE: Mutex<Vec<Hand>> = Mutex::new(Vec::new());

/// Threads that are kept.
const KEPT: usize = 4;

/// Does the work on another thread. The work must not unwind.
pub(crate) fn on_another_thread(work: impl FnOnce() + Send + 'static) {
    let process = std::process::id();
    // Never waited for: in a child that was forked meanwhile nobody would let go of it.
    let hand = IDLE.try_lock().ok().and_then(|mut idle| {
        // Of the parent's, nothing may be touched: what they share with their threads may be half changed.
        idle.extract_if(.., |hand| hand.process != process).for_each(std::mem::forget);
        idle.pop()
    });
    let hand = hand.unwrap_or_else(|| Hand::new(process));
    let send = hand.send.clone();
    let whole = Box::new(move || {
        work();
        if let Ok(mut idle) = IDLE.try_lock()
            && idle.len() < KEPT
        {
            idle.push(hand);
        }
    });
    send.send(whole).expect("it ends when nobody can send to it");
}

impl Hand {
    fn new(process: u32) -> Self {
        let (send, receive) = channel::<Work>();
        std::thread::spawn(move || receive.into_iter().for_each(|work| work()));
        Self { process, send }
    }
}
