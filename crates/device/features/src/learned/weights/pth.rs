//! PyTorch's files: a dictionary of tensors as a pickle, their numbers beside it.
//!
//! Since 2020 a zip archive (`data.pkl`, `data/KEY`); before, one stream of pickles with the numbers behind them, which is what
//! the official SuperPoint file is. `torch/serialization.py` is the source for both.

use std::collections::{BTreeMap, BTreeSet};

use super::bytes::Bytes;
use super::pickle::{Global, Id, Kind, Pickle, Value};
use super::zip::Archive;
use crate::learned::Tensor;
use crate::learned::WeightsError;

/// The mark at the beginning of files of before 2020, a whole number of ten bytes, and their version.
const MARK: [u8; 10] = [0x6c, 0xfc, 0x9c, 0x46, 0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19];
const VERSION: i64 = 1001;
/// How deep a dictionary of tensors may lie in others (`{"state_dict": {…}}`).
const MOST_DEPTH: usize = 3;

/// How many numbers there may be for one that is stored.
const SHARED: usize = 8;

/// What a number is stored as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Element {
    Half,
    Float,
    Double,
}

impl Element {
    /// Bytes of one.
    pub(super) const fn size(self) -> usize {
        match self {
            Self::Half => 2,
            Self::Float => 4,
            Self::Double => 8,
        }
    }

    /// Number `index` of these bytes, little endian.
    pub(super) fn number(self, bytes: &[u8], index: usize) -> Option<f32> {
        let bytes = bytes.get(index.checked_mul(self.size())?..)?;
        Some(match self {
            Self::Half => half(u16::from_le_bytes(*bytes.first_chunk()?)),
            Self::Float => f32::from_le_bytes(*bytes.first_chunk()?),
            Self::Double => f64::from_le_bytes(*bytes.first_chunk()?) as f32,
        })
    }
}

pub(super) fn of_archive(archive: &Archive<'_>) -> Result<Vec<(String, Tensor)>, WeightsError> {
    let pickle = archive.names().find(|name| name.ends_with("data.pkl")).unwrap_or_default();
    let folder = &pickle[..pickle.len() - "data.pkl".len()];
    if archive.get(&format!("{folder}byteorder")).is_some_and(|order| order != b"little") {
        return Err(WeightsError::Unsupported("a file of a big-endian machine"));
    }
    let pickle = Pickle::read(&mut Bytes(archive.get(pickle).unwrap_or_default()))?;
    let storage = |key: &str| archive.get(&format!("{folder}data/{key}"));
    tensors(&pickle, &storage)
}

pub(super) fn of_stream(file: &[u8]) -> Result<Vec<(String, Tensor)>, WeightsError> {
    let mut bytes = Bytes(file);
    if !file.starts_with(b"\x80") {
        return Err(WeightsError::Format);
    }
    let mark = Pickle::read(&mut bytes)?;
    if *mark.value(mark.root) != Value::Long(MARK.to_vec()) {
        return Err(WeightsError::Format);
    }
    let version = Pickle::read(&mut bytes)?;
    if *version.value(version.root) != Value::Int(VERSION) {
        return Err(WeightsError::Unsupported("a version of PyTorch's old form"));
    }
    let machine = Pickle::read(&mut bytes)?;
    if is_big_endian(&machine) {
        return Err(WeightsError::Unsupported("a file of a big-endian machine"));
    }
    let pickle = Pickle::read(&mut bytes)?;
    let keys = Pickle::read(&mut bytes)?;
    let Value::List(keys_in_order) = keys.value(keys.root) else {
        return Err(WeightsError::Damaged("the list of storages is missing"));
    };
    // How many bytes a number of each storage has, the pickle tells.
    let sizes = sizes(&pickle)?;
    let mut storages = BTreeMap::new();
    for key in keys_in_order {
        let Value::Text(key) = keys.value(*key) else {
            return Err(WeightsError::Damaged("the list of storages is missing"));
        };
        let size = sizes.get(key).copied().ok_or(WeightsError::Damaged("a storage is of nothing"))?;
        let count = usize::try_from(u64::from_le_bytes(bytes.array()?)).ok();
        let length = count.and_then(|count| count.checked_mul(size));
        storages.insert(
            key.as_str(),
            bytes.take(length.ok_or(WeightsError::Damaged("a storage is too large"))?)?,
        );
    }
    tensors(&pickle, &|key| storages.get(key).copied())
}

fn is_big_endian(machine: &Pickle) -> bool {
    let Value::Dict(items) = machine.value(machine.root) else { return false };
    let order = items.iter().find(|(key, _)| *machine.value(*key) == Value::Text("little_endian".to_owned()));
    order.is_some_and(|(_, value)| *machine.value(*value) == Value::Bool(false))
}

/// Bytes of a number, by the key of its storage.
fn sizes(pickle: &Pickle) -> Result<BTreeMap<String, usize>, WeightsError> {
    let mut sizes = BTreeMap::new();
    for (_, id) in named(pickle)? {
        let (key, kind) = storage_of(pickle, id)?;
        sizes.insert(key.to_owned(), kind_size(kind));
    }
    Ok(sizes)
}

fn kind_size(kind: Kind) -> usize {
    match kind {
        Kind::Half => 2,
        Kind::Float => 4,
        Kind::Double => 8,
        Kind::Whole(size) => size,
    }
}

/// Names of tensors and their values: the dictionary itself, or dictionaries in it.
fn named(pickle: &Pickle) -> Result<Vec<(String, Id)>, WeightsError> {
    let mut found = Vec::new();
    let mut open = vec![(pickle.root, 0)];
    while let Some((id, depth)) = open.pop() {
        let Value::Dict(items) = pickle.value(id) else {
            return Err(WeightsError::NotTensors("no dictionary".to_owned()));
        };
        for (key, value) in items {
            let Value::Text(name) = pickle.value(*key) else {
                return Err(WeightsError::NotTensors(
                    "a dictionary by something other than names".to_owned(),
                ));
            };
            match pickle.value(*value) {
                Value::Tensor(_) => found.push((name.clone(), *value)),
                Value::Dict(_) if depth < MOST_DEPTH => open.push((*value, depth + 1)),
                // Beside the tensors: the number of an epoch, options.
                Value::None | Value::Bool(_) | Value::Int(_) | Value::Float | Value::Text(_) => {}
                _ => return Err(WeightsError::NotTensors(format!("what is under {name:?}"))),
            }
            if found.len() + open.len() > 100_000 {
                return Err(WeightsError::NotTensors("more names than any network has".to_owned()));
            }
        }
    }
    Ok(found)
}

fn form(_: ()) -> WeightsError {
    WeightsError::NotTensors("a tensor of another form".to_owned())
}

fn ints(pickle: &Pickle, id: Id) -> Result<Vec<usize>, WeightsError> {
    let Value::Tuple(items) = pickle.value(id) else { return Err(form(())) };
    let int = |id: &Id| match pickle.value(*id) {
        Value::Int(value) => usize::try_from(*value).map_err(|_| form(())),
        _ => Err(form(())),
    };
    if items.len() > 8 {
        return Err(form(()));
    }
    items.iter().map(int).collect()
}

fn arguments(pickle: &Pickle, id: Id) -> Result<[Id; 4], WeightsError> {
    let Value::Tensor(arguments) = pickle.value(id) else { return Err(form(())) };
    let Value::Tuple(items) = pickle.value(*arguments) else { return Err(form(())) };
    items.first_chunk().copied().ok_or_else(|| form(()))
}

/// `('storage', FloatStorage, key, place, count, …)`.
fn storage_of(pickle: &Pickle, tensor: Id) -> Result<(&str, Kind), WeightsError> {
    let [storage, ..] = arguments(pickle, tensor)?;
    let Value::Storage(id) = pickle.value(storage) else { return Err(form(())) };
    let Value::Tuple(items) = pickle.value(*id) else { return Err(form(())) };
    let [word, kind, key, ..] = items[..] else { return Err(form(())) };
    match (pickle.value(word), pickle.value(kind), pickle.value(key)) {
        (Value::Text(word), Value::Global(Global::Storage(kind)), Value::Text(key)) if word == "storage" => {
            Ok((key, *kind))
        }
        _ => Err(form(())),
    }
}

fn tensors<'a>(
    pickle: &Pickle,
    storage: &dyn Fn(&str) -> Option<&'a [u8]>,
) -> Result<Vec<(String, Tensor)>, WeightsError> {
    let mut all = Vec::new();
    // Tensors may share their numbers, but a file of few numbers must not become many.
    let mut left = 0_usize;
    let mut seen = BTreeSet::new();
    for (name, id) in named(pickle)? {
        let (key, kind) = storage_of(pickle, id)?;
        let element = match kind {
            Kind::Half => Element::Half,
            Kind::Float => Element::Float,
            Kind::Double => Element::Double,
            Kind::Whole(_) => continue,
        };
        let bytes = storage(key).ok_or(WeightsError::Damaged("a storage is missing"))?;
        let [_, offset, size, stride] = arguments(pickle, id)?;
        let Value::Int(offset) = pickle.value(offset) else { return Err(form(())) };
        let offset = usize::try_from(*offset).map_err(|_| form(()))?;
        let (shape, stride) = (ints(pickle, size)?, ints(pickle, stride)?);
        if seen.insert(key) {
            left = left.saturating_add(SHARED * (bytes.len() / element.size()));
        }
        let data = by_rows(bytes, element, offset, &shape, &stride, left)
            .ok_or(WeightsError::Damaged("a tensor is larger than its storage"))?;
        left -= data.len();
        all.push((name, Tensor { shape, data }));
    }
    Ok(all)
}

/// The numbers of a tensor in the order of its rows. `None` when it reaches beyond its storage, or has more numbers than `most`
/// or than its storage (steps of zero).
fn by_rows(
    storage: &[u8],
    element: Element,
    offset: usize,
    shape: &[usize],
    stride: &[usize],
    most: usize,
) -> Option<Vec<f32>> {
    if shape.len() != stride.len() {
        return None;
    }
    let count = shape.iter().try_fold(1_usize, |all, side| all.checked_mul(*side))?;
    if count > most.min(storage.len() / element.size()) {
        return None;
    }
    let mut data = Vec::with_capacity(count);
    for index in 0..count {
        let (mut rest, mut at) = (index, offset);
        for (side, step) in shape.iter().zip(stride).rev() {
            at = at.checked_add((rest % side).checked_mul(*step)?)?;
            rest /= side;
        }
        data.push(element.number(storage, at)?);
    }
    Some(data)
}

/// IEEE 754 half precision.
fn half(bits: u16) -> f32 {
    let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f32::from(bits & 0x3ff));
    sign * match exponent {
        0 => fraction * 2.0_f32.powi(-24),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1.0 + fraction / 1024.0) * 2.0_f32.powi(exponent - 15),
    }
}
