//! Writes datasets in named groups as one file.

use std::collections::BTreeMap;
use std::path::Path;

use hdf5_pure::{
    AttrValue, Datatype, DatatypeByteOrder, FileBuilder, FinishedGroup, FloatingPointLayout, GroupBuilder,
};
use veiloc_map::atomic_file::write_atomic;

use crate::MappingError;
use crate::importers::hloc::binary16;

/// Numbers as they are stored.
pub(crate) enum Values {
    Half(Vec<f32>),
    Single(Vec<f32>),
    Whole(Vec<i64>),
    Small(Vec<i32>),
}

/// A dataset to be written.
pub(crate) struct NewDataset {
    pub(crate) name: &'static str,
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Values,
    pub(crate) attribute: Option<(&'static str, f64)>,
}

/// A group: its datasets, and the groups in it.
#[derive(Default)]
pub(crate) struct GroupTree {
    datasets: Vec<NewDataset>,
    groups: BTreeMap<String, Self>,
}

impl GroupTree {
    /// Writes the file atomically: the old one stays until the new one is complete.
    pub(crate) fn put(&mut self, name: &str, datasets: Vec<NewDataset>) -> Result<(), MappingError> {
        let refused =
            |reason: &str| MappingError::Unwritable { name: name.to_owned(), reason: reason.to_owned() };
        let mut at = self;
        for part in name.split('/') {
            if part.is_empty() || part == "." || part == ".." {
                return Err(refused("its folders are not valid group names"));
            }
            if !at.datasets.is_empty() {
                return Err(refused("one of its folders is also an image"));
            }
            at = at.groups.entry(part.to_owned()).or_default();
        }
        if !at.datasets.is_empty() || !at.groups.is_empty() {
            return Err(refused("it occurs twice, or is a folder of other images"));
        }
        at.datasets = datasets;
        Ok(())
    }

    /// Writes the file; the old one stays whole until the new one is.
    pub(crate) fn save(self, path: &Path) -> Result<(), MappingError> {
        let mut file = FileBuilder::new();
        for (name, tree) in self.groups {
            let group = file.create_group(&name);
            file.add_group(tree.finish(group));
        }
        let bytes = file.finish().map_err(|e| MappingError::Unwritable {
            name: path.display().to_string(),
            reason: e.to_string(),
        })?;
        write_atomic(path, &bytes).map_err(|source| MappingError::Io { path: path.to_owned(), source })
    }

    fn finish(self, mut group: GroupBuilder) -> FinishedGroup {
        for dataset in self.datasets {
            let builder = group.create_dataset(dataset.name);
            match dataset.values {
                Values::Half(values) => {
                    let bytes: Vec<u8> =
                        values.iter().flat_map(|value| binary16::to_bits(*value).to_le_bytes()).collect();
                    builder.with_raw_data(half_type(), bytes, values.len() as u64);
                }
                Values::Single(values) => _ = builder.with_f32_data(&values),
                Values::Whole(values) => _ = builder.with_i64_data(&values),
                Values::Small(values) => _ = builder.with_i32_data(&values),
            }
            let shape: Vec<u64> = dataset.shape.iter().map(|side| *side as u64).collect();
            builder.with_shape(&shape);
            if let Some((name, value)) = dataset.attribute {
                builder.set_attr(name, AttrValue::F64(value));
            }
        }
        for (name, tree) in self.groups {
            let below = group.create_group(&name);
            group.add_group(tree.finish(below));
        }
        group.finish()
    }
}

/// IEEE 754's binary16, little endian: NumPy's float16.
const fn half_type() -> Datatype {
    Datatype::FloatingPoint {
        size: 2,
        byte_order: DatatypeByteOrder::LittleEndian,
        layout: FloatingPointLayout {
            bit_offset: 0,
            bit_precision: 16,
            exponent_location: 10,
            exponent_size: 5,
            mantissa_location: 0,
            mantissa_size: 10,
            exponent_bias: 15,
        },
    }
}
