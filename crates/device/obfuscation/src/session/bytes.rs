//! A session as bytes, for the device's own disk: it holds a key and the directions of keypoints, and must never be
//! sent.
//!
//! # Form
//! Numbers are little endian; directions and rotations are `f64`. `VSESSION`, version (u32); anchors (u8), band,
//! correction, step (f64), memory (u8), most starts (u32, all ones for any number); key (32 bytes); frames, starts,
//! retries (u32); 1 or 0 for a start, and if there is one the scheme as text (u16 length), camera (3 × u32), 1 or 0 for an
//! orientation and its matrix by columns (9 × f64); number of landmarks (u32), and if there are any the descriptor
//! kind, then of each direction (3 × f64), anchor (u8), angle (f64), start, frame (u32), and their descriptors; SHA-256
//! of all before.

use crate::SealError;
use sha2::{Digest as _, Sha256};
use veiloc_descriptor::{DescriptorKind, Descriptors};
use veiloc_geometry::Anchor;
use veiloc_geometry::nalgebra::{Matrix3, Rotation3, Vector3};
use veiloc_protocol::{CanonicalCamera, Scheme};

use super::memory::{Landmark, MAX_LANDMARKS, Memory};
use super::{Session, SessionAnchors, SessionOptions, Start};
use crate::schemes::dcl::AnchorAngle;

const MAGIC: &[u8; 8] = b"VSESSION";
const VERSION: u32 = 1;
const SUM: usize = 32;
/// Stands for an unlimited number of starts.
const ANY: u32 = u32::MAX;

impl Session {
    /// All of the session, including its secrets: for the device's own disk, in a file that only its owner can read.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Writer(Vec::new());
        out.bytes(MAGIC);
        out.word(VERSION);
        let SessionOptions { anchors, band_deg, max_correction_deg, step, memory, max_starts } = self.options;
        out.byte(match anchors {
            SessionAnchors::Image => 0,
            SessionAnchors::World => 1,
            SessionAnchors::Gravity => 2,
        });
        out.numbers(&[band_deg, max_correction_deg, step]);
        out.byte(memory.into());
        out.word(max_starts.unwrap_or(ANY));
        out.bytes(&self.key);
        out.word(self.frames);
        out.word(self.starts);
        out.word(self.retries);
        out.byte(self.start.is_some().into());
        if let Some(start) = &self.start {
            let scheme = start.scheme.to_string();
            out.bytes(&(scheme.len() as u16).to_le_bytes());
            out.bytes(scheme.as_bytes());
            let (focal, width, height) = start.camera.codes();
            for code in [focal, width, height] {
                out.word(code);
            }
            out.byte(start.layout_from_world.is_some().into());
            if let Some(rotation) = &start.layout_from_world {
                out.numbers(rotation.matrix().as_slice());
            }
        }
        out.word(self.memory.landmarks.len() as u32);
        if let Some(descriptors) = self.memory.descriptors.as_ref().filter(|d| !d.is_empty()) {
            out.bytes(&descriptors.kind().to_bytes());
            for Landmark { direction, sent, start, seen } in &self.memory.landmarks {
                out.numbers(direction.as_slice());
                out.byte(sent.anchor.index() as u8);
                out.numbers(&[sent.angle]);
                out.word(*start);
                out.word(*seen);
            }
            out.bytes(descriptors.as_bytes());
        }
        let sum = Sha256::digest(&out.0);
        out.bytes(&sum);
        out.0
    }

    /// The inverse of [`Self::to_bytes`].
    ///
    /// # Errors
    /// [`SealError`] for anything but what [`Self::to_bytes`] wrote.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, SealError> {
        let mut reader = Reader(bytes);
        if reader.bytes(MAGIC.len()).ok() != Some(MAGIC.as_slice()) {
            return Err(SealError::NotASession);
        }
        let version = reader.word()?;
        if version != VERSION {
            return Err(SealError::SessionVersion { found: version, supported: VERSION });
        }
        let damaged = |what| SealError::SessionDamaged { what };
        let (body, sum) = bytes.split_last_chunk::<SUM>().ok_or(damaged("length"))?;
        if Sha256::digest(body).as_slice() != sum {
            return Err(damaged("checksum"));
        }
        // With a valid checksum, only a faulty program can have written invalid values; they are rejected all the same.
        let mut reader = Reader(body.get(MAGIC.len() + 4..).ok_or(damaged("length"))?);
        let anchors = match reader.byte()? {
            0 => SessionAnchors::Image,
            1 => SessionAnchors::World,
            2 => SessionAnchors::Gravity,
            _ => return Err(damaged("anchors")),
        };
        let [band_deg, max_correction_deg, step] = reader.numbers()?;
        let is_angle = |degrees: f64| (0.0..=180.0).contains(&degrees);
        if !(is_angle(band_deg) && is_angle(max_correction_deg) && (0.0..=1.0).contains(&step)) {
            return Err(damaged("options"));
        }
        let memory = reader.flag()?;
        let most = reader.word()?;
        let options = SessionOptions {
            anchors,
            band_deg,
            max_correction_deg,
            step,
            memory,
            max_starts: (most != ANY).then_some(most),
        };
        let mut key = [0; 32];
        key.copy_from_slice(reader.bytes(32)?);
        let [frames, starts, retries] = [reader.word()?, reader.word()?, reader.word()?];
        if retries > starts {
            return Err(damaged("starts"));
        }
        let start = if reader.flag()? { Some(reader.start()?) } else { None };
        let anchors = match start {
            Some(Start { scheme: Scheme::Dcl(layout), .. }) => layout.anchors(),
            _ => 0,
        };
        let memory = reader.memory(anchors, starts)?;
        if !reader.0.is_empty() {
            return Err(damaged("length"));
        }
        Ok(Self { options, key, start, frames, starts, retries, memory })
    }
}

struct Writer(Vec<u8>);

impl Writer {
    fn bytes(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }

    fn byte(&mut self, byte: u8) {
        self.0.push(byte);
    }

    fn word(&mut self, word: u32) {
        self.bytes(&word.to_le_bytes());
    }

    fn numbers(&mut self, numbers: &[f64]) {
        for number in numbers {
            self.bytes(&number.to_le_bytes());
        }
    }
}

struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8], SealError> {
        let (head, rest) =
            self.0.split_at_checked(count).ok_or(SealError::SessionDamaged { what: "length" })?;
        self.0 = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], SealError> {
        let mut array = [0; N];
        array.copy_from_slice(self.bytes(N)?);
        Ok(array)
    }

    fn byte(&mut self) -> Result<u8, SealError> {
        Ok(self.array::<1>()?[0])
    }

    fn flag(&mut self) -> Result<bool, SealError> {
        match self.byte()? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(SealError::SessionDamaged { what: "flag" }),
        }
    }

    fn word(&mut self) -> Result<u32, SealError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    /// Reads finite numbers.
    fn numbers<const N: usize>(&mut self) -> Result<[f64; N], SealError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = f64::from_le_bytes(self.array()?);
            if !number.is_finite() {
                return Err(SealError::SessionDamaged { what: "number" });
            }
        }
        Ok(numbers)
    }

    fn start(&mut self) -> Result<Start, SealError> {
        let damaged = |what| SealError::SessionDamaged { what };
        let length = usize::from(u16::from_le_bytes(self.array()?));
        let text = std::str::from_utf8(self.bytes(length)?).map_err(|_| damaged("scheme"))?;
        let scheme = text.parse().map_err(|_| damaged("scheme"))?;
        let [focal, width, height] = [self.word()?, self.word()?, self.word()?];
        let camera = CanonicalCamera::from_codes(focal, width, height).map_err(|_| damaged("camera"))?;
        let layout_from_world = if self.flag()? {
            let matrix = Matrix3::from_column_slice(&self.numbers::<9>()?);
            let is_rotation = (matrix * matrix.transpose() - Matrix3::identity()).norm() < 1e-6
                && matrix.determinant() > 0.0;
            if !is_rotation {
                return Err(damaged("orientation"));
            }
            Some(Rotation3::from_matrix_unchecked(matrix))
        } else {
            None
        };
        Ok(Start { scheme, camera, layout_from_world })
    }

    /// `anchors`: how many the layout has.
    fn memory(&mut self, anchors: usize, starts: u32) -> Result<Memory, SealError> {
        let damaged = || SealError::SessionDamaged { what: "landmarks" };
        let count = self.word()? as usize;
        if count == 0 {
            return Ok(Memory::default());
        }
        if count > MAX_LANDMARKS {
            return Err(damaged());
        }
        let kind = DescriptorKind::from_bytes(&self.array()?).map_err(|_| damaged())?;
        let mut landmarks = Vec::with_capacity(count);
        for _ in 0..count {
            let direction = Vector3::from(self.numbers::<3>()?);
            let anchor = usize::from(self.byte()?);
            let anchor = Anchor::new(anchor).filter(|_| anchor < anchors).ok_or_else(damaged)?;
            let [angle] = self.numbers()?;
            let [start, seen] = [self.word()?, self.word()?];
            if (direction.norm() - 1.0).abs() > 1e-6 || start > starts {
                return Err(damaged());
            }
            landmarks.push(Landmark { direction, sent: AnchorAngle { anchor, angle }, start, seen });
        }
        let bytes = self.bytes(count * kind.dim())?.to_vec();
        let descriptors = Descriptors::new(kind, bytes).map_err(|_| damaged())?;
        Ok(Memory { landmarks, descriptors: Some(descriptors) })
    }
}
