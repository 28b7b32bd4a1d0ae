//! Client of a localization service.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use veiloc_client::{ClientOptions, LocalizeRequest, ProgressiveAnswer, RigMessage, StopCriterion};
use veiloc_protocol::{AnchorPose, ContentAnchor, PositionHint, SealedQuery};

use crate::answer::Answer;
use crate::arrays;
use crate::attacks::json_to_python;
use crate::blocking::abandonable;
use crate::errors::{BindingError, Result};
use crate::map::frames_of;
use crate::pack::Pack;
use crate::profile::Profile;

/// A client of a localization service. It sends sealed queries and nothing else; a retry sends the same bytes.
///
/// Args:
///     server: address of the service, `https://…`; plain `http://` only for this machine.
///     token: bearer token, if the service requires one.
///     certificates: CA certificates to trust in addition to the system's, PEM, bytes.
///     insecure_http: allow plain HTTP to other machines.
///     timeout: most seconds to wait for an answer.
///     retries: how many times to retry when the service is busy or the network fails.
///     cache: folder in which profiles and packs are cached.
///     profile_ids: dictionary from names of maps to the ids of their profiles, as their operator publishes them; a map
///         with another profile is an error. Default: any profile.
///     pack_ids: the same for packs.
///
/// Raises:
///     ServiceError: the address, the token or the certificates cannot be used.
#[pyclass(frozen, module = "veiloc")]
pub(crate) struct Client {
    client: Arc<veiloc_client::Client>,
    server: String,
}

fn request(trusted_only: bool, near: Option<&Bound<'_, PyAny>>) -> Result<LocalizeRequest> {
    let near = near.map(|near| {
        let [x, y, z, sd] = arrays::vector::<4>("near", near)?;
        Ok::<_, BindingError>(PositionHint::new([x, y, z], sd)?)
    });
    let mut request = LocalizeRequest::default();
    (request.trusted_only, request.near) = (trusted_only, near.transpose()?);
    Ok(request)
}

#[pymethods]
impl Client {
    #[new]
    #[pyo3(signature = (server, token=None, *, certificates=None, insecure_http=false, timeout=60.0, retries=4, cache=None, profile_ids=None, pack_ids=None))]
    #[expect(clippy::too_many_arguments, reason = "keywords in Python")]
    fn new(
        server: &str,
        token: Option<&str>,
        certificates: Option<Vec<u8>>,
        insecure_http: bool,
        timeout: f64,
        retries: u32,
        cache: Option<PathBuf>,
        profile_ids: Option<BTreeMap<String, String>>,
        pack_ids: Option<BTreeMap<String, String>>,
    ) -> Result<Self> {
        let mut options = ClientOptions::default();
        options.certificates = certificates;
        options.insecure_http = insecure_http;
        options.timeout = Duration::try_from_secs_f64(timeout).map_err(|_| {
            BindingError::input(format_args!("timeout: {timeout} is not a valid number of seconds"))
        })?;
        options.retry.retries = retries;
        options.cache = cache;
        for (map, id) in profile_ids.unwrap_or_default() {
            options.profile_ids.insert(map, id.parse()?);
        }
        for (map, id) in pack_ids.unwrap_or_default() {
            options.pack_ids.insert(map, id.parse()?);
        }
        let client = veiloc_client::Client::new(server, token, options)?;
        Ok(Self { client: Arc::new(client), server: server.to_owned() })
    }

    /// Fetches the profile of a map of the service; a `Sealer` needs it.
    ///
    /// Raises:
    ///     ServiceError: the service refused the request, cannot be reached, or has another profile than `profile_ids`.
    fn profile(&self, py: Python<'_>, map: String) -> Result<Profile> {
        let client = Arc::clone(&self.client);
        Ok(Profile(abandonable(py, move || client.profile(&map))??))
    }

    /// Fetches the pack of a map of the service, for a `Sealer` that sends only what the place knows. It contains the
    /// profile.
    ///
    /// Raises:
    ///     RefusedError: the operator gives no packs, or the service refused the request.
    ///     ServiceError: the service cannot be reached, or has another pack than `pack_ids`.
    fn pack(&self, py: Python<'_>, map: String) -> Result<Pack> {
        let client = Arc::clone(&self.client);
        Ok(abandonable(py, move || client.pack(&map))??.into())
    }

    /// Localizes a sealed query at the service.
    ///
    /// Args:
    ///     map: name of the map at the service.
    ///     query: bytes of the sealed query.
    ///     trusted_only: return no pose when it is doubtful.
    ///     near: `(x, y, z, sd)`: approximate position of the camera and its standard deviation, map units. The service
    ///         learns this position.
    ///
    /// Raises:
    ///     NotLocalizedError: the service found no pose.
    ///     WrongProfileError: the query was sealed for another map.
    ///     BusyError: the service is busy.
    ///     RefusedError: the service refused the request.
    ///     ServiceError: the service cannot be reached, or its answer cannot be read.
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
        Ok(Answer::of_service(abandonable(py, move || client.localize_with(&map, &query, &request))??))
    }

    /// Localizes in steps, and stops sending rows as soon as the pose is trusted.
    ///
    /// Args:
    ///     map, query, trusted_only, near: as for `localize`.
    ///     profile: the profile with which the query was sealed.
    ///     position_sd: stop only when the standard deviation of the position is below this, map units. Default: stop
    ///         at the first trusted pose.
    ///
    /// Returns:
    ///     The answer, and a dictionary with `rows`, `bytes` and `outcome` for each step.
    ///
    /// Raises:
    ///     NotLocalizedError, WrongProfileError, BusyError, RefusedError, ServiceError: as for `localize`.
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
        let criterion = match position_sd {
            None => StopCriterion::default(),
            Some(sd) => StopCriterion::accurate_to(sd)
                .ok_or_else(|| BindingError::input(format_args!("position_sd: {sd} must be above 0")))?,
        };
        let (client, profile) = (Arc::clone(&self.client), profile.0.clone());
        let found: ProgressiveAnswer = abandonable(py, move || {
            client.localize_progressive(&map, &query, &profile, criterion, &request)
        })??;
        let step = |step: &veiloc_client::Step| -> PyResult<Bound<'py, PyDict>> {
            let dict = PyDict::new(py);
            dict.set_item("rows", step.rows)?;
            dict.set_item("bytes", step.bytes)?;
            dict.set_item("outcome", step.outcome.name())?;
            Ok(dict)
        };
        let steps = found.steps.iter().map(step).collect::<PyResult<_>>()?;
        Ok((Answer::of_service(found.answer), steps))
    }

    /// Localizes several images of one device together. They must be sealed in one session (`Sealer.in_session`): two lines of a
    /// keypoint from separate seals would cross in it.
    ///
    /// Args:
    ///     frames: as for `Map.localize_rig`.
    ///     map, trusted_only, near: as for `localize`.
    ///
    /// Raises:
    ///     InputError: the frames are not of one session; nothing was sent.
    ///     NotLocalizedError, WrongProfileError, BusyError, RefusedError, ServiceError: as for `localize`.
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
        Ok(Answer::of_service(abandonable(py, move || client.localize_rig(&map, &rig, &request))??))
    }

    /// Fetches all content anchors of a map.
    ///
    /// Args:
    ///     map: name of the map at the service.
    ///     near: `(x, y, z)`: a place in the map; the nearest anchor comes first, and each has its `distance` from there, map
    ///         units. The service does not learn it.
    ///
    /// Returns:
    ///     Dictionaries with `name`, `map_from_anchor` (`q`: w, x, y, z, and `t`), `content`, and `owner` of own anchors.
    ///
    /// Raises:
    ///     RefusedError: the service refused the request.
    ///     ServiceError: the service cannot be reached, or its answer cannot be read.
    #[pyo3(signature = (map, *, near=None))]
    fn anchors<'py>(
        &self,
        py: Python<'py>,
        map: String,
        near: Option<&Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyAny>> {
        let near = near.map(|near| arrays::vector::<3>("near", near)).transpose()?;
        let client = Arc::clone(&self.client);
        let anchors = abandonable(py, move || client.anchors(&map))??;
        let document = match near {
            None => serde_json::to_value(anchors.anchors()),
            Some(near) => anchors
                .nearest(near)
                .into_iter()
                .map(|(anchor, distance)| {
                    let mut anchor = serde_json::to_value(anchor)?;
                    anchor["distance"] = distance.into();
                    Ok(anchor)
                })
                .collect(),
        };
        json_to_python(py, document.map(|document| document.to_string()))
    }

    /// Writes a content anchor: a new one, or one that the token owns. The last writer wins.
    ///
    /// Args:
    ///     map: name of the map at the service.
    ///     name: of the anchor: letters, digits, `-`, `_` and `.`.
    ///     q: quaternion w, x, y, z from the content's axes to the map's.
    ///     t: position in the map, map units.
    ///     content: what `json.dumps` takes, at most 4096 bytes.
    ///
    /// Raises:
    ///     InputError: no service takes this anchor; nothing was sent.
    ///     RefusedError: the token lacks the permission `anchors`, or another token owns the anchor.
    ///     ServiceError: the service cannot be reached.
    #[pyo3(signature = (map, name, *, q, t, content=None))]
    fn put_anchor(
        &self,
        py: Python<'_>,
        map: String,
        name: String,
        q: &Bound<'_, PyAny>,
        t: &Bound<'_, PyAny>,
        content: Option<&Bound<'_, PyAny>>,
    ) -> Result<()> {
        let (q, t) = (arrays::vector::<4>("q", q)?, arrays::vector::<3>("t", t)?);
        let content = match content {
            None => serde_json::Value::Null,
            Some(content) => {
                let text: String = py.import("json")?.call_method1("dumps", (content,))?.extract()?;
                serde_json::from_str(&text).map_err(|e| BindingError::input(format_args!("content: {e}")))?
            }
        };
        let anchor = ContentAnchor { name, map_from_anchor: AnchorPose { q, t }, content, owner: None };
        let client = Arc::clone(&self.client);
        Ok(abandonable(py, move || client.put_anchor(&map, &anchor))??)
    }

    /// Deletes a content anchor that the token owns.
    ///
    /// Raises:
    ///     InputError, RefusedError, ServiceError: as for `put_anchor`.
    fn delete_anchor(&self, py: Python<'_>, map: String, name: String) -> Result<()> {
        let client = Arc::clone(&self.client);
        Ok(abandonable(py, move || client.delete_anchor(&map, &name))??)
    }

    fn __repr__(&self) -> String {
        format!("<Client of {}>", self.server)
    }
}
