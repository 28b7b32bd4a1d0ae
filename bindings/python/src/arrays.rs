//! Arrays of Python to values of the libraries and back: shapes and numbers are checked here, and named when they are wrong.
//!
//! An array of doubles is read where it lies; lists and other types of numbers are converted by numpy first.

use numpy::ndarray::Ix2;
use numpy::{AllowTypeChange, IntoPyArray, PyArray1, PyArray2, PyArrayLike, PyArrayMethods as _};
use pyo3::prelude::*;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix3, Vector3};
use veiloc_geometry::{Pixel, Point3};

use crate::errors::{Fault, Result};

/// Rows of `K` numbers, `[N, K]`.
pub(crate) fn rows<const K: usize>(what: &str, array: &Bound<'_, PyAny>) -> Result<Vec<[f64; K]>> {
    let refused =
        |shape: &str| Fault::input(format_args!("{what}: an array [N, {K}] of numbers is needed{shape}"));
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

/// As many rows as a minimal sample has, `[N, K]`.
pub(crate) fn sample<const N: usize, const K: usize>(
    what: &str,
    array: &Bound<'_, PyAny>,
) -> Result<[[f64; K]; N]> {
    let rows = rows::<K>(what, array)?;
    let actual = rows.len();
    rows.try_into().map_err(|_| Fault::input(format_args!("{what}: {N} rows are needed, not {actual}")))
}

/// One number each, `[N]`.
pub(crate) fn numbers<T>(what: &str, array: &Bound<'_, PyAny>) -> Result<Vec<T>>
where
    T: numpy::Element + Copy + for<'a, 'b> FromPyObject<'a, 'b>,
{
    let array = (array.extract::<PyArrayLike<'_, T, numpy::ndarray::Ix1, AllowTypeChange>>())
        .map_err(|_| Fault::input(format_args!("{what}: an array [N] of numbers is needed")))?;
    Ok(array.as_array().iter().copied().collect())
}

/// `K` numbers, `[K]`.
pub(crate) fn vector<const K: usize>(what: &str, array: &Bound<'_, PyAny>) -> Result<[f64; K]> {
    let values = numbers::<f64>(what, array)
        .map_err(|_| Fault::input(format_args!("{what}: {K} numbers are needed")))?;
    let actual = values.len();
    values.try_into().map_err(|_| Fault::input(format_args!("{what}: {K} numbers are needed, not {actual}")))
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
