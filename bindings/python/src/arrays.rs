//! Converts Python arrays to values of the libraries and back; checks shapes, and names the argument in each error.
//!
//! An array of doubles is read without a copy; numpy converts lists and other number types first.

use numpy::ndarray::Ix2;
use numpy::{AllowTypeChange, IntoPyArray, PyArray1, PyArray2, PyArrayLike, PyArrayMethods as _};
use pyo3::prelude::*;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix3, Vector3};
use veiloc_geometry::{Pixel, Point3};

use crate::errors::{BindingError, Result};

/// Rows of `K` numbers, `[N, K]`.
pub(crate) fn rows<const K: usize>(what: &str, array: &Bound<'_, PyAny>) -> Result<Vec<[f64; K]>> {
    let refused = |shape: &str| {
        BindingError::input(format_args!("{what}: must be an array [N, {K}] of numbers{shape}"))
    };
    if is_complex(array) {
        return Err(refused(", not complex ones"));
    }
    let array = array.extract::<PyArrayLike<'_, f64, Ix2, AllowTypeChange>>().map_err(|_| refused(""))?;
    let view = array.as_array();
    if view.ncols() != K {
        return Err(refused(&format!(", not [{}, {}]", view.nrows(), view.ncols())));
    }
    let row = |values: &[f64]| -> [f64; K] { std::array::from_fn(|k| values[k]) };
    Ok(match view.as_slice() {
        Some(values) => values.chunks_exact(K).map(row).collect(),
        None => view.rows().into_iter().map(|values| std::array::from_fn(|k| values[k])).collect(),
    })
}

/// Whether it is an array of complex numbers, whose imaginary parts numpy would drop.
fn is_complex(array: &Bound<'_, PyAny>) -> bool {
    let kind = array.getattr("dtype").and_then(|dtype| dtype.getattr("kind"));
    kind.and_then(|kind| kind.extract::<char>()).is_ok_and(|kind| kind == 'c')
}

/// Rows of a minimal sample, `[N, K]` with fixed `N`.
pub(crate) fn sample<const N: usize, const K: usize>(
    what: &str,
    array: &Bound<'_, PyAny>,
) -> Result<[[f64; K]; N]> {
    let rows = rows::<K>(what, array)?;
    let actual = rows.len();
    rows.try_into().map_err(|_| BindingError::input(format_args!("{what}: must have {N} rows, not {actual}")))
}

/// Numbers, `[N]`.
pub(crate) fn numbers<T>(what: &str, array: &Bound<'_, PyAny>) -> Result<Vec<T>>
where
    T: numpy::Element + Copy + for<'a, 'b> FromPyObject<'a, 'b>,
{
    if is_complex(array) {
        return Err(BindingError::input(format_args!(
            "{what}: must be an array [N] of numbers, not complex ones"
        )));
    }
    let array = (array.extract::<PyArrayLike<'_, T, numpy::ndarray::Ix1, AllowTypeChange>>())
        .map_err(|_| BindingError::input(format_args!("{what}: must be an array [N] of numbers")))?;
    Ok(array.as_array().iter().copied().collect())
}

/// `K` numbers, `[K]`.
pub(crate) fn vector<const K: usize>(what: &str, array: &Bound<'_, PyAny>) -> Result<[f64; K]> {
    let values = numbers::<f64>(what, array)
        .map_err(|_| BindingError::input(format_args!("{what}: must be {K} numbers")))?;
    let actual = values.len();
    values
        .try_into()
        .map_err(|_| BindingError::input(format_args!("{what}: must be {K} numbers, not {actual}")))
}

/// Positions in the image, `[N, 2]` pixels.
pub(crate) fn pixels(what: &str, array: &Bound<'_, PyAny>) -> Result<Vec<Pixel>> {
    Ok(rows::<2>(what, array)?.into_iter().map(|[u, v]| Pixel::new(u, v)).collect())
}

/// Points of the map, `[N, 3]` map units.
pub(crate) fn points(what: &str, array: &Bound<'_, PyAny>) -> Result<Vec<Point3<World>>> {
    Ok(rows::<3>(what, array)?.into_iter().map(|[x, y, z]| Point3::new(x, y, z)).collect())
}

/// Rows as an array `[N, K]`.
pub(crate) fn matrix<const K: usize>(
    py: Python<'_>,
    rows: impl ExactSizeIterator<Item = [f64; K]>,
) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let count = rows.len();
    let values: Vec<f64> = rows.flatten().collect();
    values.into_pyarray(py).reshape([count, K])
}

/// A matrix `[3, 3]`.
pub(crate) fn matrix3<'py>(py: Python<'py>, m: &Matrix3<f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
    matrix(py, (0..3).map(|i| std::array::from_fn::<f64, 3, _>(|j| m[(i, j)])))
}

/// A vector `[3]`.
pub(crate) fn vector3<'py>(py: Python<'py>, v: &Vector3<f64>) -> Bound<'py, PyArray1<f64>> {
    vec![v.x, v.y, v.z].into_pyarray(py)
}
