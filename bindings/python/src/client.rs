//! A positioning service, asked from Python.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use veiloc_client::{ClientOptions, Enough, LocalizeRequest, ProgressiveAnswer, RigMessage};
use veiloc_protocol::{PositionHint, SealedQuery};

use crate::answer::Answer;
use crate::arrays;
use crate::errors::{Fault, Result};
use crate::map::frames_of;
use crate::profile::Profile;
use crate::waiting::abandonable;

/// A service, and who asks it. It sends sealed queries and nothing else; retries send the same bytes.
///
/// Args:
///     server: its address, `https://…`; plain HTTP with this machine only.
///     token: who asks, if the service wants one.
///     certificates: PEM of whom to trust beside the system's, bytes.
///     insecure_http: allow plain HTTP to other machines.
///     timeout: seconds an answer may take.
///     retries: how often a busy service or a failing network is asked again.
///     cache: a folder to keep profiles in.
///
/// Raises:
///     ServiceError: an address, a token or certificates that cannot be used.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct Client {
    client: Arc<veiloc_client::Client>,
    server: String,
}

fn request(trusted_only: bool, near: Option<&Bound<'_, PyAny>>) -> Result<LocalizeRequest> {
    let near = near.map(|near| {
        let [x, y, z, sd] = arrays::vector::<4>("near", near)?;
        Ok::<_, Fault>(PositionHint::new([x, y, z], sd)?)
    });
    let mut request = LocalizeRequest::default();
    (request.trusted_only, request.near) = (trusted_only, near.transpose()?);
    Ok(request)
}

#[pymethods]
impl Client {
    #[new]
    #[pyo3(signature = (server, token=None, *, certificates=None, insecure_http=false, timeout=60.0, retries=4, cache=None))]
    fn new(
        server: &str,
        token: Option<&str>,
        certificates: Option<Vec<u8>>,
        insecure_http: bool,
        timeout: f64,
        retries: u32,
        cache: Option<PathBuf>,
    ) -> Result<Self> {
        let mut options = ClientOptions::default();
        options.certificates = certificates;
        options.insecure_http = insecure_http;
        options.timeout = Duration::try_from_secs_f64(timeout)
            .map_err(|_| Fault::input(format_args!("timeout: {timeout} is no number of seconds")))?;
        options.retry.retries = retries;
        options.cache = cache;
        let client = veiloc_client::Client::new(server, token, options)?;
        Ok(Self { client: Arc::new(client), server: server.to_owned() })
    }

    /// What is needed to seal for a map of the service.
    ///
    /// Raises:
    ///     ServiceError: the service refuses, or is not reached.
    fn profile(&self, py: Python<'_>, map: String) -> Result<Profile> {
        let client = Arc::clone(&self.client);
        Ok(Profile(abandonable(py, move || client.profile(&map))??))
    }

    /// Asks where a sealed query was taken.
    ///
    /// Args:
    ///     map: the map's name there.
    ///     query: the query's bytes.
    ///     trusted_only: a doubtful pose is withheld.
    ///     near: `(x, y, z, sd)`, where the camera roughly is, map units. The service learns that much.
    ///
    /// Raises:
    ///     NotLocalizedError, WrongProfileError, BusyError, RefusedError, ServiceError.
    #[pyo3(signature = (map, query, *, trusted_only=false, near=None))]
    fn localize(
        &self,
        py: Python<'_>,
        map: String,
        query: &[u8],
        trusted_only: bool,
        near: Option<&Bound<'_, PyAny>>,
    ) -> Result<Answer> {
        let (query, request) = (SealedQuery::decode(query)?, request(trusted_only, near)?);
        let client = Arc::clone(&self.client);
        Answer::of_service(&abandonable(py, move || client.localize_with(&map, &query, &request))??)
    }

    /// Asks in steps: no more rows are sent than a trusted pose takes.
    ///
    /// Args:
    ///     map, query, trusted_only, near: as of `localize`.
    ///     profile: the one that the query was sealed with.
    ///     position_sd: how exact a position is enough, map units. Default: any that is trusted.
    ///
    /// Returns:
    ///     The answer, and a list of dictionaries `rows`, `bytes`, `outcome`, one a step.
    ///
    /// Raises:
    ///     As `localize`.
    #[pyo3(signature = (map, query, profile, *, position_sd=None, trusted_only=false, near=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn localize_progressive<'py>(
        &self,
        py: Python<'py>,
        map: String,
        query: &[u8],
        profile: &Profile,
        position_sd: Option<f64>,
        trusted_only: bool,
        near: Option<&Bound<'py, PyAny>>,
    ) -> Result<(Answer, Vec<Bound<'py, PyDict>>)> {
        let (query, request) = (SealedQuery::decode(query)?, request(trusted_only, near)?);
        let enough = match position_sd {
            None => Enough::default(),
            Some(sd) => Enough::accurate_to(sd)
                .ok_or_else(|| Fault::input(format_args!("position_sd: {sd} is not above 0")))?,
        };
        let (client, profile) = (Arc::clone(&self.client), profile.0.clone());
        let found: ProgressiveAnswer =
            abandonable(py, move || client.localize_progressive(&map, &query, &profile, enough, &request))??;
        let step = |step: &veiloc_client::Step| -> PyResult<Bound<'py, PyDict>> {
            let told = PyDict::new(py);
            told.set_item("rows", step.rows)?;
            told.set_item("bytes", step.bytes)?;
            told.set_item("outcome", step.outcome.name())?;
            Ok(told)
        };
        let steps = found.steps.iter().map(step).collect::<PyResult<_>>()?;
        Ok((Answer::of_service(&found.answer)?, steps))
    }

    /// Asks with several images of one device at once.
    ///
    /// Args:
    ///     frames: as of `Map.localize_rig`.
    ///     map, trusted_only, near: as of `localize`.
    ///
    /// Raises:
    ///     As `localize`.
    #[pyo3(signature = (map, frames, *, trusted_only=false, near=None))]
    fn localize_rig(
        &self,
        py: Python<'_>,
        map: String,
        frames: &Bound<'_, PyAny>,
        trusted_only: bool,
        near: Option<&Bound<'_, PyAny>>,
    ) -> Result<Answer> {
        let (rig, request) = (RigMessage { frames: frames_of(frames)? }, request(trusted_only, near)?);
        let client = Arc::clone(&self.client);
        Answer::of_service(&abandonable(py, move || client.localize_rig(&map, &rig, &request))??)
    }

    fn __repr__(&self) -> String {
        format!("<Client of {}>", self.server)
    }
}
