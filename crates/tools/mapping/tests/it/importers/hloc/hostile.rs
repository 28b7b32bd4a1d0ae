//! Damaged and hostile files give an error, never a panic, with memory in proportion to the file.

use std::path::{Path, PathBuf};

use veiloc_mapping::MappingError;
use veiloc_mapping::importers::hloc::{FeaturesFile, GlobalsFile, MatchesFile};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/importers/hloc").join(name)
}

/// Reads everything; returns the number of readable images.
fn read_all(path: &Path) -> Result<usize, MappingError> {
    let file = FeaturesFile::open(path)?;
    let names = file.names()?;
    Ok(names.iter().filter(|name| file.read(name).is_ok()).count())
}

/// A small random generator: xorshift.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % bound as u64) as usize
    }
}

/// Hundreds of variants of each file, with changed bytes and truncated ends. They never needed more than a bounded part
/// of the address space (800,000 files under `ulimit -v 400000`, decision 0025).
#[test]
fn damaged_files_give_errors_or_fewer_entries() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("damaged.h5");
    let mut random = Random(88_172_645_463_325_252);
    for name in
        ["feats-half.h5", "feats-single-packed.h5", "feats-double-v114.h5", "matches.h5", "globals.h5"]
    {
        let good = std::fs::read(data(name)).expect("a file");
        let (mut refused, mut read) = (0, 0);
        for case in 0..240 {
            let mut bytes = good.clone();
            if case % 3 == 0 {
                bytes.truncate(random.below(good.len()));
            } else {
                for _ in 0..=random.below(8) {
                    let at = random.below(bytes.len());
                    bytes[at] = [0, 0xff, random.below(256) as u8][random.below(3)];
                }
            }
            std::fs::write(&path, &bytes).expect("written");
            match read_all(&path) {
                Ok(_) => read += 1,
                Err(_) => refused += 1,
            }
            if let Ok(file) = MatchesFile::open(&path) {
                let _ = file.read("query.png", "db/a.jpg");
            }
            if let Ok(file) = GlobalsFile::open(&path) {
                let _ = file.read("query.png");
            }
        }
        assert!(refused > 40 && read > 0, "{name}: {refused} refused, {read} read");
    }
}

#[test]
fn recursive_groups_terminate() {
    let error = FeaturesFile::open(&data("cycle.h5")).expect("a file").names().expect_err("no end");
    assert!(error.to_string().contains("deep"), "{error}");
}

#[test]
fn non_hdf5_files_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("feats.h5");
    for bytes in [&b""[..], b"no hdf5 at all", b"\x89HDF\r\n\x1a\n", &[0; 4096]] {
        std::fs::write(&path, bytes).expect("written");
        assert!(matches!(FeaturesFile::open(&path), Err(MappingError::NotHdf5 { .. })), "{bytes:?}");
    }
    assert!(matches!(FeaturesFile::open(folder.path()), Err(MappingError::Io { .. })));
    assert!(matches!(FeaturesFile::open(&folder.path().join("none.h5")), Err(MappingError::Io { .. })));
}
