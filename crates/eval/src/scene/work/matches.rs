//! Matches of pairs of map images, kept: one file, a record a pair, found by the hash of both images' descriptors.

use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use sha2::{Digest as _, Sha256};
use veiloc_descriptor::{DescriptorView, Match, MatchOptions};
use veiloc_mapping::KeptMatches;

use super::io;
use super::key::Key;
use crate::error::EvalError;

/// Bytes before the matches of a record: key, number of matches, hash of the matches.
const HEAD: usize = 16 + 8 + 8;
/// Bytes of a match: rows of both images, distance, ratio.
const MATCH: usize = 16;

type PairKey = [u8; 16];

/// The file.
#[derive(Debug)]
pub(in crate::scene) struct MatchFile {
    path: PathBuf,
    inside: Mutex<Inside>,
}

#[derive(Debug)]
struct Inside {
    file: File,
    /// Where the record of a pair begins.
    records: HashMap<PairKey, u64>,
    end: u64,
    /// The first that went wrong; who builds a map is told at the end.
    fault: Option<std::io::Error>,
}

impl MatchFile {
    /// Opens it, made if need be; what an interruption cut short at its end is cut off.
    pub(super) fn open(path: &Path) -> Result<Self, EvalError> {
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(io(path))?;
        let length = file.metadata().map_err(io(path))?.len();
        let (mut records, mut end) = (HashMap::new(), 0);
        while end + HEAD as u64 <= length {
            let (key, count, _) = head(&mut file, end).map_err(io(path))?;
            let Some(next) = after(end, count).filter(|next| *next <= length) else { break };
            records.insert(key, end);
            end = next;
        }
        file.set_len(end).map_err(io(path))?;
        let inside = Mutex::new(Inside { file, records, end, fault: None });
        Ok(Self { path: path.to_owned(), inside })
    }

    /// What went wrong with writing, if anything did.
    pub(in crate::scene) fn finish(&self) -> Result<(), EvalError> {
        let mut inside = self.inside.lock().unwrap_or_else(PoisonError::into_inner);
        inside.fault.take().map_or(Ok(()), |fault| Err(io(&self.path)(fault)))
    }
}

/// Where the record after one begins.
fn after(begin: u64, count: u64) -> Option<u64> {
    begin.checked_add(HEAD as u64)?.checked_add(count.checked_mul(MATCH as u64)?)
}

fn head(file: &mut File, begin: u64) -> std::io::Result<(PairKey, u64, u64)> {
    let mut bytes = [0; HEAD];
    file.seek(SeekFrom::Start(begin))?;
    file.read_exact(&mut bytes)?;
    let number = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"));
    Ok((bytes[..16].try_into().expect("sixteen bytes"), number(16), number(24)))
}

fn key_of(a: &[u8; 32], b: &[u8; 32], options: &MatchOptions) -> PairKey {
    let mut key = Key::new("matches");
    key.bytes(a);
    key.bytes(b);
    key.debug(options);
    key.digest()[..16].try_into().expect("sixteen bytes")
}

fn check_sum(bytes: &[u8]) -> u64 {
    u64::from_le_bytes(Sha256::digest(bytes)[..8].try_into().expect("eight bytes"))
}

impl KeptMatches for MatchFile {
    fn name(&self, descriptors: DescriptorView<'_>) -> [u8; 32] {
        let mut key = Key::new("descriptors");
        key.debug(&descriptors.kind());
        key.bytes(descriptors.as_bytes());
        key.digest()
    }

    fn get(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions) -> Option<Vec<Match>> {
        let mut inside = self.inside.lock().unwrap_or_else(PoisonError::into_inner);
        let begin = *inside.records.get(&key_of(a, b, options))?;
        let (_, count, sum) = head(&mut inside.file, begin).ok()?;
        let mut bytes = vec![0; usize::try_from(count).ok()?.checked_mul(MATCH)?];
        inside.file.read_exact(&mut bytes).ok()?;
        drop(inside);
        if check_sum(&bytes) != sum {
            return None;
        }
        let matched = |m: &[u8]| {
            let word = |at: usize| m[at..at + 4].try_into().expect("four bytes");
            Match {
                query: u32::from_le_bytes(word(0)),
                database: u32::from_le_bytes(word(4)),
                distance: f32::from_le_bytes(word(8)),
                ratio: f32::from_le_bytes(word(12)),
            }
        };
        Some(bytes.chunks_exact(MATCH).map(matched).collect())
    }

    fn keep(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions, matches: &[Match]) {
        let key = key_of(a, b, options);
        let mut body = Vec::with_capacity(matches.len() * MATCH);
        for m in matches {
            body.extend([m.query.to_le_bytes(), m.database.to_le_bytes()].concat());
            body.extend([m.distance.to_le_bytes(), m.ratio.to_le_bytes()].concat());
        }
        let mut record = key.to_vec();
        record.extend((matches.len() as u64).to_le_bytes());
        record.extend(check_sum(&body).to_le_bytes());
        record.extend(body);
        let mut inside = self.inside.lock().unwrap_or_else(PoisonError::into_inner);
        let begin = inside.end;
        let written = inside.file.seek(SeekFrom::Start(begin)).and_then(|_| inside.file.write_all(&record));
        match written {
            Ok(()) => {
                inside.records.insert(key, begin);
                inside.end = begin + record.len() as u64;
            }
            Err(fault) => {
                inside.fault.get_or_insert(fault);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_are_found_again_and_a_cut_or_damaged_record_is_not() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("matches.bin");
        let found = |n: u32| {
            let one = |k: u32| Match { query: k, database: 2 * k, distance: 1.5, ratio: 0.25 };
            (0..n).map(one).collect::<Vec<_>>()
        };
        let options = MatchOptions::default();
        let (a, b, c) = ([1; 32], [2; 32], [3; 32]);
        let file = MatchFile::open(&path).expect("made");
        assert!(file.get(&a, &b, &options).is_none());
        file.keep(&a, &b, &options, &found(3));
        file.keep(&b, &c, &options, &found(0));
        file.keep(&a, &c, &options, &found(5));
        file.finish().expect("written");
        drop(file);
        let file = MatchFile::open(&path).expect("opened");
        assert_eq!(file.get(&a, &b, &options), Some(found(3)));
        assert_eq!(file.get(&b, &c, &options), Some(Vec::new()));
        assert_eq!(file.get(&b, &a, &options), None, "the other way round is another pair");
        assert_eq!(file.get(&a, &b, &options.clone().with_mutual(false)), None);
        drop(file);
        let bytes = std::fs::read(&path).expect("there");
        std::fs::write(&path, &bytes[..bytes.len() - 1]).expect("written");
        let file = MatchFile::open(&path).expect("opened");
        assert_eq!(file.get(&a, &c, &options), None, "cut short");
        file.keep(&a, &c, &options, &found(5));
        assert_eq!(file.get(&a, &c, &options), Some(found(5)));
        drop(file);
        let mut bytes = std::fs::read(&path).expect("there");
        bytes[HEAD + 1] ^= 1;
        std::fs::write(&path, &bytes).expect("written");
        let file = MatchFile::open(&path).expect("opened");
        assert_eq!(file.get(&a, &b, &options), None, "damaged");
        assert_eq!(file.get(&a, &c, &options), Some(found(5)));
        // A count that no file can hold ends the file there.
        bytes[16..24].copy_from_slice(&u64::MAX.to_le_bytes());
        std::fs::write(&path, &bytes).expect("written");
        assert_eq!(MatchFile::open(&path).expect("opened").get(&a, &c, &options), None);
    }
}
