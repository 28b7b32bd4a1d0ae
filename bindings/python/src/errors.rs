//! Errors of the libraries as exceptions of the package (`veiloc.errors`).

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
    //! The classes, where Python defines them.
    pyo3::import_exception!(veiloc.errors, Error);
    pyo3::import_exception!(veiloc.errors, InputError);
    pyo3::import_exception!(veiloc.errors, ImageError);
    pyo3::import_exception!(veiloc.errors, MapError);
    pyo3::import_exception!(veiloc.errors, QueryError);
    pyo3::import_exception!(veiloc.errors, WrongProfileError);
    pyo3::import_exception!(veiloc.errors, NotLocalizedError);
    pyo3::import_exception!(veiloc.errors, ServiceError);
    pyo3::import_exception!(veiloc.errors, BusyError);
    pyo3::import_exception!(veiloc.errors, RefusedError);
}

/// What a call ends with: an exception, made where the cause is known.
#[derive(Debug)]
pub(crate) struct Fault(PyErr);

pub(crate) type Result<T> = std::result::Result<T, Fault>;

impl Fault {
    /// An argument that is refused.
    pub(crate) fn input(message: impl Display) -> Self {
        Self(python::InputError::new_err(message.to_string()))
    }

    /// Something that is none of the others' business.
    pub(crate) fn other(message: impl Display) -> Self {
        Self(python::Error::new_err(message.to_string()))
    }

    /// A file of what crosses the network that cannot be read.
    pub(crate) fn file(path: &Path, why: impl Display) -> Self {
        Self(python::QueryError::new_err(format!("{}: {why}", path.display())))
    }

    fn image(message: impl Display) -> Self {
        Self(python::ImageError::new_err(message.to_string()))
    }

    /// A map that cannot be used.
    pub(crate) fn map(message: impl Display) -> Self {
        Self(python::MapError::new_err(message.to_string()))
    }

    fn service(message: impl Display) -> Self {
        Self(python::ServiceError::new_err(message.to_string()))
    }

    /// Somebody pressed Ctrl-C.
    pub(crate) fn interrupted() -> Self {
        Self(PyKeyboardInterrupt::new_err(()))
    }
}

impl From<Fault> for PyErr {
    fn from(fault: Fault) -> Self {
        fault.0
    }
}

impl From<PyErr> for Fault {
    fn from(error: PyErr) -> Self {
        Self(error)
    }
}

impl From<IntrinsicsError> for Fault {
    fn from(error: IntrinsicsError) -> Self {
        Self::input(error)
    }
}

impl From<PoseError> for Fault {
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

impl From<LocalizeError> for Fault {
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

impl From<QueryError> for Fault {
    fn from(error: QueryError) -> Self {
        Self(python::QueryError::new_err(error.to_string()))
    }
}

impl From<SealError> for Fault {
    fn from(error: SealError) -> Self {
        match error {
            error @ SealError::Image(_) => Self::image(error),
            error @ (SealError::NotASession
            | SealError::SessionVersion { .. }
            | SealError::SessionDamaged { .. }) => Self::other(error),
            error => Self(python::QueryError::new_err(error.to_string())),
        }
    }
}

impl From<FeatureError> for Fault {
    fn from(error: FeatureError) -> Self {
        Self::image(error)
    }
}

impl From<DatasetError> for Fault {
    fn from(error: DatasetError) -> Self {
        Self::image(error)
    }
}

impl From<MapError> for Fault {
    fn from(error: MapError) -> Self {
        Self::map(error)
    }
}

impl From<MappingError> for Fault {
    fn from(error: MappingError) -> Self {
        match error {
            MappingError::BadImages(_) => Self::image(format_args!(
                "{error}; mend these, leave them out of the list, or give skip_bad=True"
            )),
            error => Self::map(error),
        }
    }
}

impl From<ClientError> for Fault {
    fn from(error: ClientError) -> Self {
        let message = error.to_string();
        match error {
            ClientError::Busy { retry_after, .. } => {
                Self::with_attributes(python::BusyError::new_err(message), |value| {
                    value.setattr("retry_after", retry_after.map(|pause| pause.as_secs_f64()))
                })
            }
            ClientError::NotLocalized(_) => Self(python::NotLocalizedError::new_err(message)),
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

impl Fault {
    fn with_attributes(error: PyErr, set: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<()>) -> Self {
        Python::attach(|py| set(error.value(py))).map_or_else(Self, |()| Self(error))
    }
}
