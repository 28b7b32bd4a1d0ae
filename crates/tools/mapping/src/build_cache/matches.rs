//! Cached matches of image pairs: one record per pair, keyed by the hash of both images' descriptors. Each process
//! appends to its own file and reads the files of the others.

use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use sha2::{Digest as _, Sha256};
use veiloc_descriptor::{Match, MatchOptions};
use veiloc_map::atomic_file::TargetLock;

use crate::MappingError;
use crate::build_cache::key::CacheKey;

/// Bytes before the matches of a record: key, number of matches, hash of the matches.
const HEADER_BYTES: usize = 16 + 8 + 8;
/// Bytes of a match: descriptor rows in both images, distance, ratio.
const MATCH_BYTES: usize = 16;

type PairKey = [u8; 16];

/// All files of a folder; one of them is written.
#[derive(Debug)]
pub(crate) struct MatchFiles {
    own: Mutex<MatchFile>,
    others: Vec<Mutex<MatchFile>>,
    /// Held as long as the file is open: two processes would corrupt each other's records.
    _lock: TargetLock,
}

/// `matches-0.bin`, `matches-1.bin` and so on: one for each process that ever wrote to the folder at the same time.
fn numbered(folder: &Path, number: usize) -> PathBuf {
    folder.join(format!("matches-{number}.bin"))
}

impl MatchFiles {
    /// Opens the first file without a writer for writing, and reads the present content of the others.
    pub(crate) fn in_folder(folder: &Path) -> Result<Self, MappingError> {
        let (mut own, mut others) = (None, Vec::new());
        for path in (0..).map(|number| numbered(folder, number)) {
            let lock = match &own {
                None => TargetLock::try_acquire(&path).map_err(MappingError::io(&path))?,
                Some(_) => None,
            };
            if let Some(lock) = lock {
                own = Some((lock, MatchFile::writing(&path)?));
            } else if path.is_file() {
                others.push(Mutex::new(MatchFile::reading(&path)?));
            } else if own.is_some() {
                break;
            }
        }
        let (lock, own) = own.expect("the numbers are unbounded, so some file is unused");
        Ok(Self { own: Mutex::new(own), others, _lock: lock })
    }

    pub(crate) fn get(&self, a: &[u8; 32], b: &[u8; 32], options: &MatchOptions) -> Option<Vec<Match>> {
        let key = key_of(a, b, options);
        let files = std::iter::once(&self.own).chain(&self.others);
        files.into_iter().find_map(|file| file.lock().unwrap_or_else(PoisonError::into_inner).get(&key))
    }

    pub(crate) fn store(
        &self,
        a: &[u8; 32],
        b: &[u8; 32],
        options: &MatchOptions,
        matches: &[Match],
    ) -> Result<(), MappingError> {
        let record = record(key_of(a, b, options), matches);
        self.own.lock().unwrap_or_else(PoisonError::into_inner).append(key_of(a, b, options), &record)
    }
}

/// One file.
#[derive(Debug)]
struct MatchFile {
    path: PathBuf,
    file: File,
    /// Offset of the record of each pair.
    records: HashMap<PairKey, u64>,
    end: u64,
}

impl MatchFile {
    /// Opens or creates a file for writing; removes a record that an interruption truncated.
    fn writing(path: &Path) -> Result<Self, MappingError> {
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path);
        let file = Self::indexed(path, file.map_err(MappingError::io(path))?)?;
        file.file.set_len(file.end).map_err(MappingError::io(path))?;
        Ok(file)
    }

    /// Opens a file that another process may be writing.
    fn reading(path: &Path) -> Result<Self, MappingError> {
        Self::indexed(path, File::open(path).map_err(MappingError::io(path))?)
    }

    fn indexed(path: &Path, mut file: File) -> Result<Self, MappingError> {
        let length = file.metadata().map_err(MappingError::io(path))?.len();
        let (mut records, mut end) = (HashMap::new(), 0);
        while end + HEADER_BYTES as u64 <= length {
            let (key, count, _) = read_header(&mut file, end).map_err(MappingError::io(path))?;
            let Some(next) = after(end, count).filter(|next| *next <= length) else { break };
            records.insert(key, end);
            end = next;
        }
        Ok(Self { path: path.to_owned(), file, records, end })
    }

    fn get(&mut self, key: &PairKey) -> Option<Vec<Match>> {
        let (_, count, sum) = read_header(&mut self.file, *self.records.get(key)?).ok()?;
        let mut bytes = vec![0; usize::try_from(count).ok()?.checked_mul(MATCH_BYTES)?];
        self.file.read_exact(&mut bytes).ok()?;
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
        Some(bytes.chunks_exact(MATCH_BYTES).map(matched).collect())
    }

    fn append(&mut self, key: PairKey, record: &[u8]) -> Result<(), MappingError> {
        let begin = self.end;
        let written = self.file.seek(SeekFrom::Start(begin)).and_then(|_| self.file.write_all(record));
        written.map_err(MappingError::io(&self.path))?;
        self.records.insert(key, begin);
        self.end = begin + record.len() as u64;
        Ok(())
    }
}

/// Returns the offset of the next record.
fn after(begin: u64, count: u64) -> Option<u64> {
    begin.checked_add(HEADER_BYTES as u64)?.checked_add(count.checked_mul(MATCH_BYTES as u64)?)
}

fn read_header(file: &mut File, begin: u64) -> std::io::Result<(PairKey, u64, u64)> {
    let mut bytes = [0; HEADER_BYTES];
    file.seek(SeekFrom::Start(begin))?;
    file.read_exact(&mut bytes)?;
    let number = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"));
    Ok((bytes[..16].try_into().expect("sixteen bytes"), number(16), number(24)))
}

fn record(key: PairKey, matches: &[Match]) -> Vec<u8> {
    let mut body = Vec::with_capacity(matches.len() * MATCH_BYTES);
    for m in matches {
        body.extend([m.query.to_le_bytes(), m.database.to_le_bytes()].concat());
        body.extend([m.distance.to_le_bytes(), m.ratio.to_le_bytes()].concat());
    }
    let mut record = key.to_vec();
    record.extend((matches.len() as u64).to_le_bytes());
    record.extend(check_sum(&body).to_le_bytes());
    record.extend(body);
    record
}

fn key_of(a: &[u8; 32], b: &[u8; 32], options: &MatchOptions) -> PairKey {
    let mut key = CacheKey::new("matches");
    key.bytes(a);
    key.bytes(b);
    key.debug(options);
    key.digest()[..16].try_into().expect("sixteen bytes")
}

fn check_sum(bytes: &[u8]) -> u64 {
    u64::from_le_bytes(Sha256::digest(bytes)[..8].try_into().expect("eight bytes"))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn found(n: u32) -> Vec<Match> {
        (0..n).map(|k| Match { query: k, database: 2 * k, distance: 1.5, ratio: 0.25 }).collect()
    }

    #[test]
    fn matches_round_trip_and_damaged_records_are_ignored() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = numbered(folder.path(), 0);
        let open = || MatchFiles::in_folder(folder.path()).expect("opened");
        let options = MatchOptions::default();
        let (a, b, c) = ([1; 32], [2; 32], [3; 32]);
        let files = open();
        assert!(files.get(&a, &b, &options).is_none());
        files.store(&a, &b, &options, &found(3)).expect("kept");
        files.store(&b, &c, &options, &found(0)).expect("kept");
        files.store(&a, &c, &options, &found(5)).expect("kept");
        drop(files);
        let files = open();
        assert_eq!(files.get(&a, &b, &options), Some(found(3)));
        assert_eq!(files.get(&b, &c, &options), Some(Vec::new()));
        assert_eq!(files.get(&b, &a, &options), None, "the reversed pair has another key");
        assert_eq!(files.get(&a, &b, &options.clone().with_mutual(false)), None);
        drop(files);
        let bytes = fs::read(&path).expect("there");
        fs::write(&path, &bytes[..bytes.len() - 1]).expect("written");
        let files = open();
        assert_eq!(files.get(&a, &c, &options), None, "cut short");
        files.store(&a, &c, &options, &found(5)).expect("kept");
        assert_eq!(files.get(&a, &c, &options), Some(found(5)));
        drop(files);
        let mut bytes = fs::read(&path).expect("there");
        bytes[HEADER_BYTES + 1] ^= 1;
        fs::write(&path, &bytes).expect("written");
        let files = open();
        assert_eq!(files.get(&a, &b, &options), None, "damaged");
        assert_eq!(files.get(&a, &c, &options), Some(found(5)));
        drop(files);
        // A count that exceeds the file ends the file there.
        bytes[16..24].copy_from_slice(&u64::MAX.to_le_bytes());
        fs::write(&path, &bytes).expect("written");
        assert_eq!(open().get(&a, &c, &options), None);
    }

    #[test]
    fn concurrent_writers_use_separate_files() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let options = MatchOptions::default();
        let (a, b, c) = ([1; 32], [2; 32], [3; 32]);
        let first = MatchFiles::in_folder(folder.path()).expect("opened");
        let second = MatchFiles::in_folder(folder.path()).expect("opened");
        first.store(&a, &b, &options, &found(2)).expect("kept");
        second.store(&b, &c, &options, &found(4)).expect("kept");
        assert!(numbered(folder.path(), 1).is_file());
        let third = MatchFiles::in_folder(folder.path()).expect("opened");
        assert_eq!(third.get(&a, &b, &options), Some(found(2)));
        assert_eq!(third.get(&b, &c, &options), Some(found(4)));
        drop((first, third));
        // An unused file between others is reused before a new one is created.
        let again = MatchFiles::in_folder(folder.path()).expect("opened");
        again.store(&a, &c, &options, &found(6)).expect("kept");
        drop((again, second));
        let last = MatchFiles::in_folder(folder.path()).expect("opened");
        for (pair, count) in [([a, b], 2), ([b, c], 4), ([a, c], 6)] {
            assert_eq!(last.get(&pair[0], &pair[1], &options), Some(found(count)));
        }
    }
}
