//! Frames of a video for structure from motion: decoded by ffmpeg, chosen here by movement and sharpness.
//!
//! A frame is kept when the image has moved by a few percent of its width since the last kept frame: a camera that rests gives one
//! frame, its sharpest, a fast one many. Of the frames within that range the sharpest is kept. The movement is the median displacement of
//! blocks of a small grey image; it counts rotations, too, because frames must overlap to be matched.
//!
//! ```text
//! frames/000001.jpg, …   the kept frames, in the order of the video
//! frames/video.json      the file that they are of, and their numbers in it, from 0; written last
//! ```

use std::collections::VecDeque;
use std::fs;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::{Value, json};
use veiloc_features::{CameraFrame, PixelFormat, Progress};
use veiloc_map::atomic_file::write_atomic;

use super::pycolmap::tail;
use crate::error::MappingError;

/// The commands that bring ffmpeg.
pub const INSTALL_FFMPEG: &str =
    "install ffmpeg with the packages of your system, or: python3 -m pip install imageio-ffmpeg";

/// Width of the grey images that decide, pixels.
const WIDTH: usize = 160;
/// Movement from which a frame is worth taking, in widths of the image.
const MIN_MOVED: f64 = 0.03;
/// Movement at which a frame must be kept, in widths: neighbours still share most of the image.
const MAX_MOVED: f64 = 0.10;
/// Side of a block, and largest displacement that is searched, pixels of the half-sized image.
const BLOCK: usize = 8;
const REACH: i32 = 12;
/// Mean absolute deviation from which a block has texture, grey levels.
const TEXTURE: f64 = 4.0;
/// Frames that one command line names.
const NUMBERS: usize = 1000;

/// Frames of a video.
#[derive(Debug)]
#[non_exhaustive]
pub struct VideoFrames {
    /// The folder of the kept frames.
    pub folder: PathBuf,
    /// Their names, in the order of the video.
    pub names: Vec<String>,
    /// Number of frames of the video; `None` if the frames are of an earlier run.
    pub of: Option<usize>,
}

/// Decodes a video with ffmpeg and keeps the frames that structure from motion needs, in the folder `frames` of `work`. Frames that an
/// earlier run kept of the same file are used again. `python`: a Python that may have imageio-ffmpeg, for a machine without the
/// program ffmpeg.
///
/// # Errors
/// [`MappingError::Video`]: there is no ffmpeg, it cannot decode the file, or the video has fewer than three different views.
pub fn frames_of_video(
    video: &Path,
    work: &Path,
    python: Option<&Path>,
    progress: &dyn Progress,
) -> Result<VideoFrames, MappingError> {
    let folder = work.join("frames");
    let record = folder.join("video.json");
    let file = video.metadata().map_err(MappingError::io(video))?;
    let changed = file.modified().ok().and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok());
    let of = json!([video, file.len(), changed.map(|time| time.as_nanos() as u64)]);
    let known = fs::read_to_string(&record).ok().and_then(|text| serde_json::from_str::<Value>(&text).ok());
    if known.is_some_and(|known| known.get("video") == Some(&of)) {
        return Ok(VideoFrames { names: names_in(&folder)?, folder, of: None });
    }
    let ffmpeg = find_ffmpeg(python)
        .ok_or_else(|| faulty(video, format!("a video needs the program ffmpeg; {INSTALL_FFMPEG}")))?;
    progress.start("frames of the video", 0);
    let mut chooser = Chooser::default();
    decode(&ffmpeg, video, |frame| {
        progress.advance(1);
        chooser.push(&frame);
    })?;
    progress.finish();
    let count = chooser.count;
    let kept = chooser.finish();
    if kept.len() < 3 {
        let reason =
            format!("its {count} frames show fewer than three different views; move through the place");
        return Err(faulty(video, reason));
    }
    fs::create_dir_all(&folder).map_err(MappingError::io(&folder))?;
    let _ = fs::remove_file(&record);
    // Only what an earlier run wrote: the folder may be one of the user's.
    for name in names_in(&folder)? {
        let path = folder.join(name);
        fs::remove_file(&path).map_err(MappingError::io(&path))?;
    }
    extract(&ffmpeg, video, &kept, &folder)?;
    let names = names_in(&folder)?;
    if names.len() != kept.len() {
        return Err(faulty(video, format!("ffmpeg wrote {} of {} frames", names.len(), kept.len())));
    }
    let text = json!({ "video": of, "frames": kept }).to_string();
    write_atomic(&record, text.as_bytes()).map_err(MappingError::io(&record))?;
    Ok(VideoFrames { folder, names, of: Some(count) })
}

fn faulty(video: &Path, reason: impl Into<String>) -> MappingError {
    MappingError::Video { path: video.to_owned(), reason: reason.into() }
}

/// Names of kept frames: six digits.
fn names_in(folder: &Path) -> Result<Vec<String>, MappingError> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(MappingError::io(folder))? {
        let name = entry.map_err(MappingError::io(folder))?.file_name().to_string_lossy().into_owned();
        let stem = name.strip_suffix(".jpg").unwrap_or_default();
        if stem.len() == 6 && stem.bytes().all(|b| b.is_ascii_digit()) {
            names.push(name);
        }
    }
    names.sort();
    Ok(names)
}

/// `ffmpeg` of the PATH, or that of the Python package imageio-ffmpeg.
fn find_ffmpeg(python: Option<&Path>) -> Option<PathBuf> {
    let runs =
        |path: &Path| Command::new(path).arg("-version").output().is_ok_and(|output| output.status.success());
    let on_path = PathBuf::from("ffmpeg");
    if runs(&on_path) {
        return Some(on_path);
    }
    let script = "import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())";
    let output =
        Command::new(python.unwrap_or_else(|| Path::new("python3"))).args(["-c", script]).output().ok()?;
    let path = PathBuf::from(String::from_utf8_lossy(&output.stdout).trim());
    (output.status.success() && runs(&path)).then_some(path)
}

/// Passes each frame as a small grey image. ffmpeg writes binary PGM files, one after another; it turns frames as the file says.
fn decode(ffmpeg: &Path, video: &Path, mut each: impl FnMut(Grey)) -> Result<(), MappingError> {
    let scale = format!("scale={WIDTH}:-2");
    let mut child = Command::new(ffmpeg)
        .args(["-nostdin", "-v", "error", "-i"])
        .arg(video)
        .args(["-an", "-fps_mode", "passthrough", "-vf", &scale, "-pix_fmt", "gray"])
        .args(["-f", "image2pipe", "-c:v", "pgm", "-"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(MappingError::io(ffmpeg))?;
    // Its log, which would fill the pipe if nothing read it.
    let log = child.stderr.take().map(|mut stderr| {
        std::thread::spawn(move || {
            let mut log = Vec::new();
            let _ = stderr.read_to_end(&mut log);
            String::from_utf8_lossy(&log).into_owned()
        })
    });
    let mut read = Ok(());
    if let Some(stdout) = child.stdout.take() {
        let mut stream = BufReader::with_capacity(1 << 16, stdout);
        read = loop {
            match Grey::read(&mut stream) {
                Ok(Some(frame)) => each(frame),
                Ok(None) => break Ok(()),
                Err(error) => break Err(error),
            }
        };
    }
    let status = child.wait().map_err(MappingError::io(ffmpeg))?;
    let log = log.and_then(|log| log.join().ok()).unwrap_or_default();
    if !status.success() {
        return Err(faulty(video, format!("ffmpeg cannot decode it ({status}): {}", tail(&log))));
    }
    read.map_err(|error| faulty(video, format!("ffmpeg's output cannot be read: {error}")))
}

/// Writes the frames of these numbers as JPEG files.
fn extract(ffmpeg: &Path, video: &Path, kept: &[usize], folder: &Path) -> Result<(), MappingError> {
    // A command line has a limit.
    for (part, numbers) in kept.chunks(NUMBERS).enumerate() {
        let chosen: Vec<String> = numbers.iter().map(|number| format!("eq(n\\,{number})")).collect();
        let output = Command::new(ffmpeg)
            .args(["-nostdin", "-v", "error", "-y", "-i"])
            .arg(video)
            .args(["-an", "-fps_mode", "passthrough", "-vf", &format!("select='{}'", chosen.join("+"))])
            .args(["-q:v", "2", "-start_number", &(part * NUMBERS + 1).to_string()])
            .arg(folder.join("%06d.jpg"))
            .output()
            .map_err(MappingError::io(ffmpeg))?;
        if !output.status.success() {
            let log = String::from_utf8_lossy(&output.stderr).into_owned();
            let reason = format!("ffmpeg cannot write its frames ({}): {}", output.status, tail(&log));
            return Err(faulty(video, reason));
        }
    }
    Ok(())
}

/// A grey image.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Grey {
    width: usize,
    height: usize,
    /// `[height · width]`
    pixels: Vec<u8>,
}

impl Grey {
    /// The next binary PGM file of a stream; `None` at its end. The crate `image` could read it, but its feature would make
    /// every reader of photographs accept such files.
    fn read(stream: &mut impl BufRead) -> io::Result<Option<Self>> {
        let invalid = || io::Error::new(io::ErrorKind::InvalidData, "not a PGM image");
        if stream.fill_buf()?.is_empty() {
            return Ok(None);
        }
        let mut words: Vec<String> = Vec::new();
        while words.len() < 4 {
            let mut word = Vec::new();
            // Each of the four words of the header is followed by one white-space character.
            loop {
                let mut byte = [0];
                stream.read_exact(&mut byte)?;
                if byte[0].is_ascii_whitespace() {
                    break;
                }
                word.push(byte[0]);
                if word.len() > 9 {
                    return Err(invalid());
                }
            }
            words.push(String::from_utf8(word).map_err(|_| invalid())?);
        }
        let size = |at: usize| words[at].parse::<usize>().ok().filter(|n| (1..100_000).contains(n));
        let (Some(width), Some(height), "P5", "255") = (size(1), size(2), &*words[0], &*words[3]) else {
            return Err(invalid());
        };
        let mut pixels = vec![0; width * height];
        stream.read_exact(&mut pixels)?;
        Ok(Some(Self { width, height, pixels }))
    }

    fn at(&self, x: usize, y: usize) -> i32 {
        i32::from(self.pixels[y * self.width + x])
    }

    fn sharpness(&self) -> f64 {
        let size = (self.width as u32, self.height as u32);
        CameraFrame::new(PixelFormat::Gray, size, &self.pixels, 0).map_or(0.0, |frame| frame.sharpness())
    }

    /// Half the size, by means of four pixels.
    fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mean = |x: usize, y: usize| {
            let sum = self.at(2 * x, 2 * y)
                + self.at(2 * x + 1, 2 * y)
                + self.at(2 * x, 2 * y + 1)
                + self.at(2 * x + 1, 2 * y + 1);
            ((sum + 2) / 4) as u8
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| mean(x, y));
        Self { pixels: pixels.collect(), width, height }
    }

    /// Mean absolute difference of a block of this image at `(x, y)` and of another image at `(x + dx, y + dy)`; `None` outside.
    fn difference(&self, (x, y): (usize, usize), other: &Self, (dx, dy): (i32, i32)) -> Option<f64> {
        let (u, v) = (x as i32 + dx, y as i32 + dy);
        let (right, bottom) = (u + BLOCK as i32, v + BLOCK as i32);
        if u < 0 || v < 0 || right > other.width as i32 || bottom > other.height as i32 {
            return None;
        }
        let (u, v) = (u as usize, v as usize);
        let sum: i32 = (0..BLOCK)
            .flat_map(|j| (0..BLOCK).map(move |i| (i, j)))
            .map(|(i, j)| (self.at(x + i, y + j) - other.at(u + i, v + j)).abs())
            .sum();
        Some(f64::from(sum) / (BLOCK * BLOCK) as f64)
    }

    /// Mean absolute deviation of a block from its mean.
    fn texture(&self, (x, y): (usize, usize)) -> f64 {
        let values: Vec<f64> = (0..BLOCK)
            .flat_map(|j| (0..BLOCK).map(move |i| (i, j)))
            .map(|(i, j)| f64::from(self.at(x + i, y + j)))
            .collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|value| (value - mean).abs()).sum::<f64>() / values.len() as f64
    }
}

/// A frame with what decides about it.
#[derive(Debug)]
struct Frame {
    number: usize,
    sharpness: f64,
    half: Grey,
}

/// Median displacement of the textured blocks of one half-sized image in another, in widths of the image. `None` if most of them are not
/// found: the camera moved farther, or the view is another one. 0 without texture.
fn moved(from: &Grey, to: &Grey) -> Option<f64> {
    let reach = REACH;
    let mut lengths: Vec<f64> = Vec::new();
    let mut textured = 0;
    let columns = (0..from.width / BLOCK).map(|i| i * BLOCK);
    let blocks = columns.flat_map(|x| (0..from.height / BLOCK).map(move |j| (x, j * BLOCK)));
    for block in blocks {
        let texture = from.texture(block);
        if texture < TEXTURE {
            continue;
        }
        textured += 1;
        let shifts = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)));
        let best = shifts
            .filter_map(|shift| Some((from.difference(block, to, shift)?, shift)))
            // Of equal ones the shortest: repeated texture.
            .min_by(|(a, s), (b, t)| {
                a.total_cmp(b).then((s.0.pow(2) + s.1.pow(2)).cmp(&(t.0.pow(2) + t.1.pow(2))))
            });
        if let Some((difference, (dx, dy))) = best
            && difference < 0.6 * texture
        {
            lengths.push(f64::from(dx * dx + dy * dy).sqrt());
        }
    }
    if textured == 0 {
        return Some(0.0);
    }
    if 2 * lengths.len() < textured {
        return None;
    }
    lengths.sort_by(f64::total_cmp);
    Some(lengths[lengths.len() / 2] / from.width.max(1) as f64)
}

/// Chooses frames as they come.
#[derive(Debug, Default)]
struct Chooser {
    /// Frames that came.
    count: usize,
    kept: Vec<usize>,
    /// The half-sized image from which movement counts: that of the last kept frame, or of the first frame of its rest.
    key: Option<Grey>,
    /// That of the last kept frame.
    sharpness: f64,
    /// Frames since then that moved far enough.
    waiting: VecDeque<Frame>,
}

impl Chooser {
    fn push(&mut self, frame: &Grey) {
        let frame = Frame { number: self.count, sharpness: frame.sharpness(), half: frame.halved() };
        self.count += 1;
        let mut queue = VecDeque::from([frame]);
        while let Some(frame) = queue.pop_front() {
            let Some(key) = &self.key else {
                self.keep(frame);
                continue;
            };
            match moved(key, &frame.half) {
                Some(moved) if moved < MIN_MOVED => self.replace_if_sharper(&frame),
                Some(moved) if moved < MAX_MOVED => self.waiting.push_back(frame),
                _ if self.waiting.is_empty() => self.keep(frame),
                _ => {
                    let later = self.keep_sharpest();
                    // They are judged again, from the frame that was kept.
                    queue.push_front(frame);
                    for frame in later.into_iter().rev() {
                        queue.push_front(frame);
                    }
                }
            }
        }
    }

    fn keep(&mut self, frame: Frame) {
        self.kept.push(frame.number);
        self.key = Some(frame.half);
        self.sharpness = frame.sharpness;
        self.waiting.clear();
    }

    /// While the camera rests, a sharper frame takes the place of the kept one, which is often blurred by the movement before.
    fn replace_if_sharper(&mut self, frame: &Frame) {
        if let Some(kept) = self.kept.last_mut()
            && self.waiting.is_empty()
            && frame.sharpness > self.sharpness
        {
            (*kept, self.sharpness) = (frame.number, frame.sharpness);
        }
    }

    /// Keeps the sharpest waiting frame, and returns those after it.
    fn keep_sharpest(&mut self) -> VecDeque<Frame> {
        let sharpest = (0..self.waiting.len()).max_by(|a, b| {
            // Of equally sharp ones the first.
            self.waiting[*a].sharpness.total_cmp(&self.waiting[*b].sharpness).then(b.cmp(a))
        });
        let mut frames = std::mem::take(&mut self.waiting);
        let mut later = frames.split_off(sharpest.map_or(0, |at| at + 1));
        match frames.pop_back() {
            Some(frame) => self.keep(frame),
            None => later.clear(),
        }
        later
    }

    /// The numbers of the kept frames, ascending.
    fn finish(mut self) -> Vec<usize> {
        while !self.waiting.is_empty() {
            let later = self.keep_sharpest();
            let Some(key) = &self.key else { break };
            self.waiting = later
                .into_iter()
                .filter(|frame| moved(key, &frame.half).is_none_or(|moved| moved >= MIN_MOVED))
                .collect();
        }
        self.kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A window of a large texture, blurred by `blur` passes.
    fn view(x: usize, blur: usize) -> Grey {
        let (width, height) = (WIDTH, 120);
        let value = |x: usize, y: usize| {
            let hash =
                ((x / 4) as u32).wrapping_mul(0x9E37_79B1) ^ ((y / 4) as u32).wrapping_mul(0x85EB_CA77);
            (hash.wrapping_mul(0xC2B2_AE3D) >> 24) as u8
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |i| value(x + i, y))).collect();
        let mut image = Grey { width, height, pixels };
        for _ in 0..blur {
            let old = image.clone();
            for y in 0..height {
                for x in 1..width - 1 {
                    let mean = (old.at(x - 1, y) + 2 * old.at(x, y) + old.at(x + 1, y)) / 4;
                    image.pixels[y * width + x] = mean as u8;
                }
            }
        }
        image
    }

    fn chosen(frames: impl IntoIterator<Item = Grey>) -> Vec<usize> {
        let mut chooser = Chooser::default();
        frames.into_iter().for_each(|frame| chooser.push(&frame));
        chooser.finish()
    }

    #[test]
    fn camera_that_rests_gives_one_frame() {
        assert_eq!(chosen((0..50).map(|_| view(40, 0))), [0]);
    }

    #[test]
    fn sharpest_frame_of_a_rest_is_kept() {
        let moving = [view(0, 0), view(100, 3), view(101, 2)];
        let resting = (0..9).map(|_| view(102, 0));
        assert_eq!(chosen(moving.into_iter().chain(resting)), [0, 3]);
    }

    #[test]
    fn kept_frames_are_one_step_of_the_image_apart() {
        // Two pixels of 160 a frame: 1.25 % of the width.
        let kept = chosen((0..80).map(|i| view(2 * i, 0)));
        let steps: Vec<usize> = kept.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let within = |step: &usize| {
            let moved = 0.0125 * *step as f64;
            (MIN_MOVED - 0.01..=MAX_MOVED + 0.01).contains(&moved)
        };
        assert!(kept.len() > 8 && steps.iter().all(within), "{kept:?}");
    }

    #[test]
    fn sharpest_frame_of_a_step_is_kept() {
        // Every fourth frame is sharp, and the video ends just after one.
        let kept = chosen((0..78).map(|i| view(2 * i, if i % 4 == 0 { 0 } else { 3 })));
        assert!(kept.len() > 5 && kept.iter().all(|number| number % 4 == 0), "{kept:?}");
    }

    #[test]
    fn frame_of_another_view_is_kept_at_once() {
        assert_eq!(chosen([view(0, 0), view(900, 0), view(900, 0), view(1800, 0)]), [0, 1, 3]);
    }

    #[test]
    fn pgm_stream_is_read_and_damage_is_an_error() {
        let bytes = b"P5\n2 1\n255\n\x0a\x20P5\n1 1\n255\n\x07";
        let mut stream = &bytes[..];
        let first = Grey::read(&mut stream).expect("an image").expect("not the end");
        assert_eq!(first, Grey { width: 2, height: 1, pixels: vec![10, 32] });
        let second = Grey::read(&mut stream).expect("an image").expect("not the end");
        assert_eq!(second.pixels, [7]);
        assert!(Grey::read(&mut stream).expect("the end").is_none());
        for bad in
            [&b"P6\n2 1\n255\nxx"[..], b"P5\n2 1\n255\nx", b"P5\n0 1\n255\n", b"P5 no size at all 255 "]
        {
            assert!(Grey::read(&mut &bad[..]).is_err(), "{bad:?}");
        }
    }
}
