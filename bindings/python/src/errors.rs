//! Converts errors of the libraries to exceptions of the package (`veiloc.errors`).

use std::fmt::Display;
use std::path::Path;

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use veiloc_client::{ClientError, Refusal, SealError};
use veiloc_datasets::DatasetError;
use veiloc_features::FeatureError;
use veiloc_geometry::IntrinsicsError;
use veiloc_localization::LocalizeError;
use veiloc_map::MapError;
use veiloc_mapping::MappingError;
use veiloc_pose::PoseError;
use veiloc_protocol::QueryError;

mod python {
    //! The exception classes that Python defines.
    pyo3::import_exception!(veiloc.errors, Error);
    pyo3::import_exception!(veiloc.errors, InputError);
    pyo3::import_exception!(veiloc.errors, ImageError);
    pyo3::import_exception!(veiloc.errors, MapError);
    pyo3::import_exception!(veiloc.errors, QueryError);
    pyo3::import_exception!(veiloc.errors, WrongProfileError);
    pyo3::import_exception!(veiloc.errors, NotLocalizedError);
    pyo3::import_exception!(veiloc.errors, NotThisPlaceError);
    pyo3::import_exception!(veiloc.errors, ServiceError);
    pyo3::import_exception!(veiloc.errors, BusyError);
    pyo3::import_exception!(veiloc.errors, RefusedError);
}

/// A Python exception, created where the cause is known.
#[derive(Debug)]
pub(crate) struct BindingError(PyErr);

pub(crate) type Result<T> = std::result::Result<T, BindingError>;

impl BindingError {
    /// An argument is invalid.
    pub(crate) fn input(message: impl Display) -> Self {
        Self(python::InputError::new_err(message.to_string()))
    }

    /// Any error without a class of its own.
    pub(crate) fn other(message: impl Display) -> Self {
        Self(python::Error::new_err(message.to_string()))
    }

    /// A query, profile, pack or session file cannot be read.
    pub(crate) fn file(path: &Path, why: impl Display) -> Self {
        Self(python::QueryError::new_err(format!("{}: {why}", path.display())))
    }

    /// An image cannot be used.
    pub(crate) fn image(message: impl Display) -> Self {
        Self(python::ImageError::new_err(message.to_string()))
    }

    /// A map cannot be used.
    pub(crate) fn map(message: impl Display) -> Self {
        Self(python::MapError::new_err(message.to_string()))
    }

    fn service(message: impl Display) -> Self {
        Self(python::ServiceError::new_err(message.to_string()))
    }

    /// The user pressed Ctrl-C.
    pub(crate) fn interrupted() -> Self {
        Self(PyKeyboardInterrupt::new_err(()))
    }
}

impl From<BindingError> for PyErr {
    fn from(error: BindingError) -> Self {
        error.0
    }
}

impl From<PyErr> for BindingError {
    fn from(error: PyErr) -> Self {
        Self(error)
    }
}

impl From<IntrinsicsError> for BindingError {
    fn from(error: IntrinsicsError) -> Self {
        Self::input(error)
    }
}

impl From<PoseError> for BindingError {
    fn from(error: PoseError) -> Self {
        match error {
            PoseError::NoConsensus { .. } | PoseError::Chance { .. } | PoseError::OneSided { .. } => {
                Self(python::NotLocalizedError::new_err(error.to_string()))
            }
            PoseError::Stopped => Self::interrupted(),
            error => Self::input(error),
        }
    }
}

impl From<LocalizeError> for BindingError {
    fn from(error: LocalizeError) -> Self {
        match error {
            LocalizeError::WrongProfile { .. } => Self(python::WrongProfileError::new_err(error.to_string())),
            LocalizeError::EmptyMap => Self::map(error),
            LocalizeError::Stopped => Self::interrupted(),
            LocalizeError::NoPose { .. } => Self(python::NotLocalizedError::new_err(error.to_string())),
            LocalizeError::Frame { frame, source } => {
                let of_frame = format!("frame {frame}: {source}");
                match *source {
                    LocalizeError::WrongProfile { .. } => Self(python::WrongProfileError::new_err(of_frame)),
                    _ => Self::input(of_frame),
                }
            }
        }
    }
}

impl From<QueryError> for BindingError {
    fn from(error: QueryError) -> Self {
        Self(python::QueryError::new_err(error.to_string()))
    }
}

impl From<SealError> for BindingError {
    fn from(error: SealError) -> Self {
        match error {
            error @ SealError::Image(_) => Self::image(error),
            error @ SealError::NotThisPlace { .. } => {
                Self(python::NotThisPlaceError::new_err(error.to_string()))
            }
            error @ (SealError::NotASession
            | SealError::SessionVersion { .. }
            | SealError::SessionDamaged { .. }) => Self::other(error),
            error => Self(python::QueryError::new_err(error.to_string())),
        }
    }
}

impl From<FeatureError> for BindingError {
    fn from(error: FeatureError) -> Self {
        Self::image(error)
    }
}

impl From<DatasetError> for BindingError {
    fn from(error: DatasetError) -> Self {
        Self::image(error)
    }
}

impl From<MapError> for BindingError {
    fn from(error: MapError) -> Self {
        Self::map(error)
    }
}

impl From<MappingError> for BindingError {
    fn from(error: MappingError) -> Self {
        match error {
            MappingError::BadImages(_) => Self::image(format_args!(
                "{error}; repair these images, remove them from the list, or pass skip_bad=True"
            )),
            MappingError::OtherCoordinateFrame { .. } => Self::map(format_args!(
                "{error}\ngive poses in one coordinate frame, or transform those of the named images with other_coordinate_frame=\"align\""
            )),
            error => Self::map(error),
        }
    }
}

impl From<ClientError> for BindingError {
    fn from(error: ClientError) -> Self {
        let message = error.to_string();
        match error {
            ClientError::Busy { retry_after, .. } => {
                Self::with_attributes(python::BusyError::new_err(message), |value| {
                    value.setattr("retry_after", retry_after.map(|pause| pause.as_secs_f64()))
                })
            }
            ClientError::NotLocalized(_) => Self(python::NotLocalizedError::new_err(message)),
            ClientError::SeparateAnchors(_) | ClientError::Anchor(_) => Self::input(message),
            ClientError::WrongProfile(_) => Self(python::WrongProfileError::new_err(message)),
            ClientError::Refused(Refusal { status, name, .. }) => {
                Self::with_attributes(python::RefusedError::new_err(message), |value| {
                    value.setattr("status", status)?;
                    value.setattr("name", name)
                })
            }
            _ => Self::service(message),
        }
    }
}

impl BindingError {
    fn with_attributes(error: PyErr, set: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<()>) -> Self {
        Python::attach(|py| set(error.value(py))).map_or_else(Self, |()| Self(error))
    }
}
