//! Files of tensors as PyTorch, NumPy and SciPy write them (`scripts/oracle_networks.py`, `scripts/oracle_netvlad.py`), and files
//! that are none.

use std::path::PathBuf;

use veiloc_features::FeatureError;
use veiloc_features::learned::{Weights, WeightsError};

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/learned").join(name)
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(path(name)).expect("a file of the tests")
}

#[test]
fn tensors_of_every_form_are_the_same() {
    for (name, has_turned) in [
        ("plain.pth", true),
        ("old.pth", true),
        ("nested.pth", true),
        ("half.pth", true),
        ("plain.npz", true),
    ] {
        let weights = Weights::open(&path(name)).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(
            weights.names().collect::<Vec<_>>(),
            ["a", "part", "turned"],
            "{name}: whole numbers are left out"
        );
        assert_eq!(
            weights.get("a", &[2, 3]).expect("there").data,
            [0.0, 0.25, 0.5, 0.75, 1.0, 1.25],
            "{name}"
        );
        assert_eq!(weights.get("part", &[1, 3]).expect("there").data, [0.75, 1.0, 1.25], "{name}");
        if has_turned {
            let turned = weights.get("turned", &[3, 2]).expect("there");
            assert_eq!(turned.data, [0.0, 0.75, 0.25, 1.0, 0.5, 1.25], "{name}: by columns");
        }
    }
    let module = Weights::open(&path("module.pth")).expect("a state dictionary");
    assert_eq!(module.get("1.running_var", &[2]).expect("there").data, [1.0, 1.0]);
    assert_eq!(module.channels("0.weight"), Ok(2));
    let parameters = Weights::open(&path("parameters.pth")).expect("a state dictionary");
    assert_eq!(parameters.get("a", &[2, 3]).expect("there").data[5], 1.25);
}

/// Cells, structs and lists of structs; text, whole numbers and answers of yes and no are read over.
#[test]
fn numbers_of_matlab_are_found_by_their_paths() {
    for name in ["plain.mat", "packed.mat"] {
        let weights = Weights::open(&path(name)).unwrap_or_else(|e| panic!("{e}"));
        let names: Vec<&str> = weights.names().collect();
        assert_eq!(names, ["a", "many.0.value", "many.1.value", "s.cells.0", "s.cells.2"], "{name}");
        // By columns: the array of two rows is one of three rows here.
        assert_eq!(weights.get("a", &[3, 2]).expect("there").data, [0.0, 0.75, 0.25, 1.0, 0.5, 1.25]);
        assert_eq!(weights.get("s.cells.2", &[3, 1]).expect("there").data, [1.0, 2.0, 300.0], "stored small");
        assert_eq!(weights.get("many.1.value", &[1, 1]).expect("there").data, [2.5]);
        assert_eq!(Weights::of_bytes(&bytes(name)).expect("the same"), weights);
    }
}

/// What MATLAB files hold beside numbers: nothing of it is a weight, and some of it is a program.
#[test]
fn matlab_files_that_hold_anything_else_are_refused() {
    for (name, part) in [("complex.mat", "complex"), ("sparse.mat", "sparse")] {
        let refused = Weights::open(&path(name)).expect_err(name).to_string();
        assert!(refused.contains(part), "{name}: {refused}");
    }
    let whole = bytes("plain.mat");
    // The first array's class stands behind the header, its tag and the tag of its flags.
    for (class, part) in [(3, "an object"), (16, "a function"), (17, "unknown class"), (0, "unknown class")] {
        let mut file = whole.clone();
        file[128 + 16] = class;
        let refused = Weights::of_bytes(&file).expect_err(part).to_string();
        assert!(refused.contains(part), "{class}: {refused}");
    }
    for (at, by, part) in
        [(124, 2, "another version"), (126, b'M', "another version"), (128, 1, "of the type 1")]
    {
        let mut file = whole.clone();
        file[at] = by;
        let refused = Weights::of_bytes(&file).expect_err(part).to_string();
        assert!(refused.contains(part), "{at}: {refused}");
    }
    assert_eq!(Weights::of_bytes(b"MATLAB 7.3 MAT-file, Platform"), Err(WeightsError::Format));
}

/// A small file that says it has four thousand million numbers, and one whose cells lie in cells for ever.
#[test]
fn matlab_files_do_not_grow() {
    let mut huge = bytes("plain.mat");
    // The sides of the first array: 2 and 3, behind the flags.
    huge[128 + 32..128 + 40].copy_from_slice(&[0xff, 0xff, 0, 0, 0xff, 0xff, 0, 0]);
    assert!(matches!(Weights::of_bytes(&huge), Err(WeightsError::Damaged(_))));
    let array = |class: u8, inner: &[u8]| {
        let mut body = [6, 0, 0, 0, 8, 0, 0, 0, class, 0, 0, 0, 0, 0, 0, 0].to_vec();
        body.extend([5, 0, 0, 0, 8, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0]);
        body.extend(inner);
        [&14_u32.to_le_bytes()[..], &(body.len() as u32).to_le_bytes(), &body].concat()
    };
    let number = [9, 0, 0, 0, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f];
    let within = |depth: usize| {
        let inner = (0..depth).fold(array(6, &number), |inner, _| array(1, &inner));
        [&bytes("plain.mat")[..128], &inner].concat()
    };
    let weights = Weights::of_bytes(&within(10)).expect("ten cells");
    assert_eq!(weights.get(".0.0.0.0.0.0.0.0.0.0", &[1, 1]).expect("there").data, [1.0]);
    for depth in [17, 2000] {
        assert!(matches!(Weights::of_bytes(&within(depth)), Err(WeightsError::NotTensors(_))), "{depth}");
    }
}

#[test]
fn tensors_that_are_not_as_expected_are_named() {
    let weights = Weights::open(&path("plain.pth")).expect("weights");
    assert_eq!(weights.get("b", &[1]), Err(WeightsError::Missing("b".to_owned())));
    let shape = weights.get("a", &[3, 2]).expect_err("another shape").to_string();
    assert_eq!(shape, "its tensor a is [2, 3] and not [3, 2]");
    let none = veiloc_features::learned::Tensor { shape: vec![1], data: vec![f32::NAN] };
    assert_eq!(weights.with("n", none).get("n", &[1]), Err(WeightsError::NotFinite("n".to_owned())));
}

#[test]
fn files_that_hold_anything_else_are_refused() {
    for (name, part) in [
        ("whole-module.pth", "\"Sequential\""),
        ("function.pth", "\"print\""),
        ("objects.npz", "something else"),
        ("packed.npz", "packed"),
    ] {
        let refused = Weights::open(&path(name)).expect_err(name);
        assert!(matches!(refused, FeatureError::Weights { .. }), "{name}: {refused}");
        assert!(refused.to_string().contains(part), "{name}: {refused}");
    }
    assert_eq!(Weights::of_bytes(b""), Err(WeightsError::Format));
    assert_eq!(Weights::of_bytes(b"no weights at all"), Err(WeightsError::Format));
    assert!(matches!(Weights::open(&path("gone.pth")), Err(FeatureError::Read { .. })));
}

/// `os.system("…")` as a pickle, alone and in the place of the state dictionary.
#[test]
fn a_file_that_would_run_something_is_refused() {
    let program = b"\x80\x02cos\nsystem\nX\x04\x00\x00\x00true\x85R.";
    let old = bytes("old.pth");
    // The first three pickles say what the file is; the fourth is the dictionary.
    let ends: Vec<usize> =
        old.windows(2).enumerate().filter(|(_, w)| *w == b".\x80").map(|(i, _)| i + 1).collect();
    let hostile = [&old[..ends[2]], &program[..], &old[ends[3]..]].concat();
    let refused = Weights::of_bytes(&hostile).expect_err("it would run");
    assert!(refused.to_string().contains("\"system\" of \"os\""), "{refused}");
    for instruction in
        [&b"\x80\x02cposix\nsystem\n."[..], b"\x80\x02i", b"\x80\x02P0\n.", b"\x80\x02\x81.", b"\x80\x05."]
    {
        let hostile = [&old[..ends[2]], instruction].concat();
        assert!(matches!(Weights::of_bytes(&hostile), Err(WeightsError::NotTensors(_))), "{instruction:?}");
    }
}

/// Any beginning of a file, and any file with one byte changed, gives an error or tensors; nothing panics or grows.
#[test]
fn damaged_files_are_refused() {
    for name in ["plain.pth", "old.pth", "nested.pth", "plain.npz", "half.pth", "plain.mat", "packed.mat"] {
        let whole = bytes(name);
        let readable = (0..whole.len()).filter(|end| Weights::of_bytes(&whole[..*end]).is_ok()).count();
        // A MATLAB file may end behind each of its three variables.
        assert_eq!(readable, if name.ends_with("mat") { 2 } else { 0 }, "{name}");
        let mut changed = whole.clone();
        for at in 0..whole.len() {
            for value in [0, 0xff, whole[at] ^ 1, whole[at].wrapping_add(0x80)] {
                changed[at] = value;
                if let Ok(weights) = Weights::of_bytes(&changed) {
                    assert!(weights.names().count() <= 5, "{name}: byte {at}");
                }
            }
            changed[at] = whole[at];
        }
    }
}

/// Sums of a zip's entries are checked: numbers that are damaged are not taken.
#[test]
fn a_damaged_number_is_found() {
    let mut file = bytes("plain.pth");
    let number = 1.25_f32.to_le_bytes();
    let at = file.windows(4).position(|w| w == number).expect("the number");
    file[at] ^= 1;
    assert!(matches!(Weights::of_bytes(&file), Err(WeightsError::Damaged(_))));
}

fn pickled(body: &[u8]) -> Vec<u8> {
    let old = bytes("old.pth");
    let ends: Vec<usize> =
        old.windows(2).enumerate().filter(|(_, w)| *w == b".\x80").map(|(i, _)| i + 1).collect();
    [&old[..ends[2]], b"\x80\x02", body].concat()
}

/// Small files that would become large, or never end.
#[test]
fn values_that_hold_themselves_end() {
    // A dictionary in itself; a list in itself, a hundred thousand tuples around each other.
    let dictionary = b"}q\x00X\x01\x00\x00\x00ah\x00s.";
    let list = b"]q\x00h\x00a.";
    let mut deep = b")".to_vec();
    deep.extend(vec![b'\x85'; 100_000]);
    deep.push(b'.');
    // Each tuple of two of the one before: 2^60 values, if anybody counted.
    let mut wide = b")q\x00".to_vec();
    for _ in 0..60 {
        wide.extend(b"h\x00h\x00\x86q\x00");
    }
    wide.push(b'.');
    for body in [&dictionary[..], list, &deep, &wide] {
        let refused = Weights::of_bytes(&pickled(body)).expect_err("no tensors");
        assert!(matches!(refused, WeightsError::NotTensors(_) | WeightsError::Damaged(_)), "{refused}");
    }
}
