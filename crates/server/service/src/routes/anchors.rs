//! Content anchors of a map: who may use the map reads them, tokens with the permission `anchors` write their own.
//!
//! The file beside the map is read for every request: several services may share it, and `veiloc map` changes it too. Its length
//! is bounded. Answers are not padded (rule L12): the list is the same for all clients that own nothing, and says nothing of a
//! query. Which single anchor a client asks for is seen by the service, and by its length perhaps by others; so clients fetch
//! the list.

use std::sync::Arc;

use axum::Extension;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, ETAG};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use veiloc_map::{AnchorsEdit, MapError, MapFile, is_map_name, read_anchors};
use veiloc_protocol::{ContentAnchor, ContentAnchorError, ContentAnchors};

use super::authorize::{authenticate, resolve_map};
use super::localize::{check_media, read, refuse};
use super::versions::{precondition, version};
use crate::auth::tokens::Caller;
use crate::http::problem::Problem;
use crate::maps::LoadedMap;
use crate::queue::Connection;
use crate::serve::state::App;
use crate::telemetry::RequestContext;
use crate::web_page::Content;

const JSON: &str = "application/json";

/// A client, and a map that it may use.
struct Access {
    caller: Arc<Caller>,
    loaded: Arc<LoadedMap>,
}

type AnchorPath = Result<Path<(String, String)>, PathRejection>;

/// All content anchors of a map. A client sorts them by distance itself: the service need not learn where it is.
#[utoipa::path(get, operation_id = "list_anchors", path = "/v1/maps/{name}/anchors", security(("token" = [])),
    params(("name" = String, Path, description = "Name of the map")),
    responses(
        (status = 200, description = "All anchors, by name", body = ContentAnchors),
        (status = 304, description = "The client has the current anchors (If-None-Match)"),
))]
pub(super) async fn list(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let name = name.map(|Path(name)| name);
    let access = Access::of(&app, &connection, &context, &headers, name.map_err(|_| Problem::UnknownMap)?)?;
    let content = blocking(move || Ok(Content::new(access.read()?.encode()))).await?;
    Ok(answered(&content, &headers))
}

/// One content anchor.
#[utoipa::path(get, operation_id = "get_anchor", path = "/v1/maps/{name}/anchors/{anchor}", security(("token" = [])),
    params(("name" = String, Path, description = "Name of the map"), ("anchor" = String, Path, description = "Its name")),
    responses(
        (status = 200, description = "The anchor", body = ContentAnchor),
        (status = 304, description = "The client has it (If-None-Match)"),
))]
pub(super) async fn one(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    path: AnchorPath,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (map, anchor) = parts(path)?;
    let access = Access::of(&app, &connection, &context, &headers, map)?;
    let found = move || access.read()?.get(&anchor).map(content).ok_or(Problem::UnknownAnchor);
    Ok(answered(&blocking(found).await?, &headers))
}

/// Writes a content anchor: a new one, or one that the token owns. Without `If-Match` and `If-None-Match` the last writer wins.
#[utoipa::path(put, operation_id = "put_anchor", path = "/v1/maps/{name}/anchors/{anchor}", security(("token" = [])),
    params(("name" = String, Path, description = "Name of the map"), ("anchor" = String, Path, description = "Its name")),
    request_body = ContentAnchor,
    responses(
        (status = 200, description = "The anchor, replaced", body = ContentAnchor),
        (status = 201, description = "The anchor, new", body = ContentAnchor),
))]
pub(super) async fn put(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    path: AnchorPath,
    headers: HeaderMap,
    mut body: Body,
) -> Response {
    let answer = async {
        let (access, anchor) = Access::to_write(&app, &connection, &context, &headers, path)?;
        check_media(&headers, &[JSON])?;
        let bytes = read(&app, &context, &mut body, ContentAnchor::MAX_BYTES).await.map_err(|problem| {
            let is_long = matches!(problem, Problem::TooLarge { .. });
            if is_long { Problem::BadAnchor(ContentAnchorError::Content) } else { problem }
        })?;
        let anchor = ContentAnchor::decode(&anchor, &bytes).map_err(Problem::BadAnchor)?;
        let demanded = headers.clone();
        blocking(move || access.write(anchor, &demanded)).await
    };
    match answer.await {
        Ok((status, written)) => {
            (status, [(CONTENT_TYPE, JSON)], [(ETAG, written.etag())], written.bytes().clone())
                .into_response()
        }
        Err(problem) => refuse(problem, body, &headers, app.options.timeouts.head).await,
    }
}

/// Deletes a content anchor that the token owns.
#[utoipa::path(delete, operation_id = "delete_anchor", path = "/v1/maps/{name}/anchors/{anchor}", security(("token" = [])),
    params(("name" = String, Path, description = "Name of the map"), ("anchor" = String, Path, description = "Its name")),
    responses((status = 204, description = "Deleted")),
)]
pub(super) async fn delete(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    path: AnchorPath,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (access, anchor) = Access::to_write(&app, &connection, &context, &headers, path)?;
    blocking(move || access.delete(&anchor, &headers)).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

impl Access {
    fn of(
        app: &App,
        connection: &Connection,
        context: &RequestContext,
        headers: &HeaderMap,
        map: String,
    ) -> Result<Self, Problem> {
        let caller = authenticate(app, connection, context, headers)?;
        let loaded = resolve_map(app, &caller, Ok(Path(map)))?;
        context.set_map(loaded.name.as_str().into());
        Ok(Self { caller, loaded })
    }

    fn to_write(
        app: &App,
        connection: &Connection,
        context: &RequestContext,
        headers: &HeaderMap,
        path: AnchorPath,
    ) -> Result<(Self, String), Problem> {
        let (map, anchor) = parts(path)?;
        let access = Self::of(app, connection, context, headers, map)?;
        if !access.caller.writes_anchors() {
            return Err(Problem::AnchorsReadOnly);
        }
        if !is_map_name(&anchor) {
            return Err(Problem::BadAnchor(ContentAnchorError::Name));
        }
        Ok((access, anchor))
    }

    /// The file and the content of the map; a gateway has none.
    fn map(&self) -> Result<(&std::path::Path, &MapFile), Problem> {
        self.loaded.file.as_deref().zip(self.loaded.map()).ok_or(Problem::NoAnchors)
    }

    /// What the client gets.
    fn read(&self) -> Result<ContentAnchors, Problem> {
        let anchors = read_anchors(self.map()?.0).map_err(|error| unavailable(&error))?;
        self.check_frame(&anchors)?;
        Ok(anchors.for_client(|owner| self.shows(owner)))
    }

    /// Whether the answer names this owner.
    fn shows(&self, owner: &str) -> bool {
        self.caller.is_operator() || owner == self.caller.name()
    }

    /// Anchors of a map that was replaced by one in another coordinate frame would be in wrong places.
    fn check_frame(&self, anchors: &ContentAnchors) -> Result<(), Problem> {
        let (_, map) = self.map()?;
        anchors.is_of_frame(map.frame_images()).then_some(()).ok_or(Problem::OtherFrame)
    }

    /// Begins a change: of an anchor that the client may change, and that is as it demands.
    fn edit(&self, name: &str, headers: &HeaderMap) -> Result<AnchorsEdit, Problem> {
        let edit = AnchorsEdit::begin(self.map()?.0).map_err(|error| unavailable(&error))?;
        self.check_frame(&edit.anchors)?;
        let current = edit.anchors.get(name);
        let is_own = |anchor: &ContentAnchor| anchor.owner.as_deref() == Some(self.caller.name());
        if !current.is_none_or(is_own) && !self.caller.is_operator() {
            return Err(Problem::NotOwner);
        }
        // A client that may change an anchor gets its owner in answers, so the tag is that of these.
        precondition(headers, current.map(content).as_ref())?;
        Ok(edit)
    }

    fn write(&self, anchor: ContentAnchor, headers: &HeaderMap) -> Result<(StatusCode, Content), Problem> {
        let mut edit = self.edit(&anchor.name, headers)?;
        let current = edit.anchors.get(&anchor.name);
        let status = if current.is_some() { StatusCode::OK } else { StatusCode::CREATED };
        // An operator that corrects an anchor does not take it away.
        let owner = current.and_then(|current| current.owner.clone());
        let anchor = ContentAnchor { owner: owner.or_else(|| Some(self.caller.name().to_owned())), ..anchor };
        let written = content(&anchor);
        edit.anchors.set(anchor).map_err(Problem::BadAnchor)?;
        edit.anchors.set_frame(self.map()?.1.frame_images());
        edit.write().map_err(|error| unavailable(&error))?;
        Ok((status, written))
    }

    fn delete(&self, name: &str, headers: &HeaderMap) -> Result<(), Problem> {
        let mut edit = self.edit(name, headers)?;
        if !edit.anchors.remove(name) {
            return Err(Problem::UnknownAnchor);
        }
        edit.write().map_err(|error| unavailable(&error))
    }
}

fn parts(path: AnchorPath) -> Result<(String, String), Problem> {
    path.map(|Path(parts)| parts).map_err(|_| Problem::UnknownMap)
}

fn content(anchor: &ContentAnchor) -> Content {
    Content::new(anchor.encode())
}

fn answered(content: &Content, headers: &HeaderMap) -> Response {
    ([(CACHE_CONTROL, "no-cache")], version(content, None, JSON, headers)).into_response()
}

/// The error of a file: its message has the path and the place, and nothing of a request.
fn unavailable(error: &MapError) -> Problem {
    tracing::error!(%error, "content anchors cannot be read or written");
    Problem::AnchorsUnavailable
}

/// Files are read and written on a thread of their own.
async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    tokio::task::spawn_blocking(work).await.unwrap_or(Err(Problem::Broken))
}
