//! Seals one frame several times, and prints what it costs: for `scripts/phones/measure.py`.
//!
//! `seal_frame FRAME.pgm PROFILE|PACK TIMES [SIDE]` seals a gray frame (binary PGM) of a camera whose focal length is 1.2 times the longer
//! side, with fixed seeds, scaled down to the longest side SIDE, as matches where a pack is given, and prints lines of `name value`:
//!
//! - `preparation_milliseconds`: reading the profile or the pack, and preparing it;
//! - `rows`, `keypoints` of the query, and `hash` of all bytes sealed;
//! - `milliseconds`: the median of all seals but the first;
//! - `allocations`, `allocated_bytes` of the last seal, `first_allocations` of the first;
//! - `peak_bytes`: the largest heap during a seal, without the frame and the profile;
//! - `resident_bytes`: the largest resident memory of the process, on Linux.
//!
//! The number of threads is that of `RAYON_NUM_THREADS`.
#![expect(unsafe_code, reason = "an allocator that counts")]
#![expect(clippy::print_stdout, reason = "the result of the program")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::error::Error;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::Instant;

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng as _;
use veiloc_ar::{CameraFrame, PixelFormat};
use veiloc_features::Image;
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{DeviceLimits, KnownPlace, PackUse, SealOptions, Sealer};
use veiloc_protocol::{Pack, Profile};

/// The allocator of the system, counted.
struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);
static ALLOCATED: AtomicUsize = AtomicUsize::new(0);
static HEAP: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

fn count(bytes: usize) {
    ALLOCATIONS.fetch_add(1, Relaxed);
    ALLOCATED.fetch_add(bytes, Relaxed);
    PEAK.fetch_max(HEAP.fetch_add(bytes, Relaxed) + bytes, Relaxed);
}

// SAFETY: all calls go to the allocator of the system.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        // SAFETY: the caller's contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size);
        HEAP.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as above.
        unsafe { System.realloc(memory, layout, size) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        HEAP.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as above.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [frame, profile, times, side @ ..] = arguments.as_slice() else {
        return Err("seal_frame FRAME.pgm PROFILE|PACK TIMES [SIDE]".into());
    };
    let times: usize = times.parse()?;
    let file = std::fs::read(frame)?;
    let (width, height, start) = header(&file).ok_or("not a binary PGM of 8 bits")?;
    let frame = CameraFrame::new(PixelFormat::Gray, (width, height), &file[start..], 0)?;
    let focal = 1.2 * f64::from(width.max(height));
    let intrinsics: Intrinsics = format!(
        "SIMPLE_PINHOLE,{width},{height},{focal},{},{}",
        f64::from(width) / 2.0,
        f64::from(height) / 2.0
    )
    .parse()?;
    let mut options = SealOptions::default();
    if let Some(side) = side.first() {
        options =
            options.with_limits(DeviceLimits { max_image_side: side.parse()?, ..DeviceLimits::default() });
    }

    let (published, start) = (std::fs::read(profile)?, Instant::now());
    let profile = match Pack::decode(&published) {
        Ok(pack) => {
            let profile = pack.profile().clone();
            options = options.with_place(KnownPlace::new(pack)?, PackUse::Matches);
            profile
        }
        Err(_) => Profile::decode(&published)?,
    };
    let sealer = Sealer::new(&profile, options)?;
    println!("preparation_milliseconds {:.2}", start.elapsed().as_secs_f64() * 1e3);

    let before = HEAP.load(Relaxed);
    PEAK.store(before, Relaxed);
    let (mut milliseconds, mut counts, mut hash) = (Vec::new(), Vec::new(), 0xcbf2_9ce4_8422_2325_u64);
    let mut last = (0, 0);
    for time in 0..times {
        let counted = [ALLOCATIONS.load(Relaxed), ALLOCATED.load(Relaxed)];
        let start = Instant::now();
        let mut rng = ChaCha20Rng::from_seed([time as u8; 32]);
        let extracted = sealer.extract(Image::from(&frame), intrinsics)?;
        let keypoints = extracted.features().keypoints.len();
        let query = sealer.seal(extracted, &mut rng)?;
        milliseconds.push(start.elapsed().as_secs_f64() * 1e3);
        counts.push([ALLOCATIONS.load(Relaxed) - counted[0], ALLOCATED.load(Relaxed) - counted[1]]);
        last = (query.len(), keypoints);
        for byte in query.encode() {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    let (first, final_counts) = (counts.first().ok_or("0 times")?, counts.last().ok_or("0 times")?);
    println!("rows {}\nkeypoints {}\nhash {hash:016x}", last.0, last.1);
    let mut later = milliseconds.split_off(usize::from(times > 1));
    later.sort_by(f64::total_cmp);
    println!("milliseconds {:.2}", later[later.len() / 2]);
    println!("first_allocations {}", first[0]);
    println!("allocations {}\nallocated_bytes {}", final_counts[0], final_counts[1]);
    println!("peak_bytes {}", PEAK.load(Relaxed) - before);
    if let Some(kib) = resident_kib() {
        println!("resident_bytes {}", kib * 1024);
    }
    Ok(())
}

/// Width and height of a binary PGM of 8 bits without comments, and where its samples begin.
fn header(file: &[u8]) -> Option<(u32, u32, usize)> {
    let mut words = file.splitn(5, |byte| byte.is_ascii_whitespace());
    let mut word = || std::str::from_utf8(words.next()?).ok();
    let (kind, width, height, most) = (word()?, word()?, word()?, word()?);
    let samples = words.next()?;
    (kind == "P5" && most == "255").then_some((
        width.parse().ok()?,
        height.parse().ok()?,
        file.len() - samples.len(),
    ))
}

fn resident_kib() -> Option<usize> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse().ok()
}
