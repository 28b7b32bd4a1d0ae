//! A client of a positioning service.

use std::collections::BTreeMap;
use std::fmt;

use veiloc_protocol::{
    Answer, ContentAnchor, ContentAnchorError, ContentAnchors, MessageId, Pack, Profile, QueryError,
    RigMessage, SealedQuery, is_map_name,
};

use crate::address::{Address, token};
use crate::cache::{Cache, hash, store};
use crate::refusal::{Refusal, printable};
use crate::transport::{Reply, Transport};
use crate::{ClientError, ClientOptions, LocalizeRequest, Notice};

/// Maximum number of bytes of an answer or an error response.
const MAX_ANSWER: u64 = 64 << 10;
/// Content types of a sealed query and its answer, and of the queries of a session.
const PROTOBUF: &str = "application/x-protobuf";
const SESSION: &str = "application/octet-stream";
/// Content type of content anchors.
const JSON: &str = "application/json";

/// A client of a positioning service. Calls block; several threads may share one client.
pub struct Client {
    transport: Transport,
    cache: Cache,
}

impl Client {
    /// A client of the service at `server`, for example `https://places.example:8443`, which authenticates with
    /// `token`. This sends nothing.
    ///
    /// # Errors
    /// [`ClientError::Address`], [`ClientError::PlainHttp`], [`ClientError::Token`], [`ClientError::Certificates`] for
    /// arguments that cannot be used.
    pub fn new(server: &str, token: Option<&str>, options: ClientOptions) -> Result<Self, ClientError> {
        let address = Address::new(server, options.insecure_http)?;
        let cache = Cache::new(options.cache.as_deref());
        let transport = Transport::new(address, self::token(token)?, options)?;
        Ok(Self { transport, cache })
    }

    /// The current profile of a map: the cached one when the service confirms it. [`Notice::Changed`] reports that it is
    /// another one than the cached one.
    ///
    /// # Errors
    /// [`ClientError`]: the map's name, an error response, the network, an invalid profile, or [`ClientError::OtherId`].
    pub fn profile(&self, map: &str) -> Result<Profile, ClientError> {
        self.published(map)
    }

    /// The current pack of a map, for [`KnownPlace`](veiloc_obfuscation::KnownPlace), cached like a profile. It contains
    /// the profile.
    ///
    /// # Errors
    /// As [`Self::profile`]; [`ClientError::Refused`] where the operator gives no packs.
    pub fn pack(&self, map: &str) -> Result<Pack, ClientError> {
        self.published(map)
    }

    fn published<T: Published>(&self, map: &str) -> Result<T, ClientError> {
        let url = self.transport.address().of_map(map, T::WHAT)?;
        let file = self.cache.file(T::WHAT, &self.transport.address().base, map);
        // A cached file that is damaged or cannot be read is treated as absent.
        let cached = file.as_ref().and_then(|file| std::fs::read(file).ok());
        let cached = cached.and_then(|bytes| Some((hash(&bytes), T::decode(&bytes).ok()?)));
        let tag = cached.as_ref().map(|(hash, _)| format!("\"{hash}\""));
        let reply = self.transport.get(&url, tag.as_deref(), T::MAX)?;
        match (reply.status, cached) {
            (200, cached) => {
                let bad = |reason| ClientError::BadAnswer { what: T::NAME, reason };
                check_type(&reply, PROTOBUF).map_err(bad)?;
                let current = T::decode(&reply.body).map_err(|e| bad(printable(&e.to_string())))?;
                self.check_id(map, &current)?;
                if let Some((_, cached)) = cached.filter(|(_, cached)| cached.id() != current.id()) {
                    let (map, before, now) = (map.to_owned(), cached.id(), current.id());
                    self.transport.options().notify(&Notice::Changed { what: T::WHAT, map, before, now });
                }
                if let Some(file) = file {
                    store(&file, &reply.body, self.transport.options());
                }
                Ok(current)
            }
            (304, Some((_, current))) => self.check_id(map, &current).map(|()| current),
            _ => Err(refused(&reply)),
        }
    }

    /// Refuses another one than that whose id is given for this map.
    fn check_id<T: Published>(&self, map: &str, current: &T) -> Result<(), ClientError> {
        match T::ids(self.transport.options()).get(map) {
            Some(expected) if *expected != current.id() => Err(ClientError::OtherId {
                what: T::WHAT,
                map: map.to_owned(),
                expected: *expected,
                actual: current.id(),
            }),
            _ => Ok(()),
        }
    }

    /// The pose of a sealed query. Every retry, by this call or by a later one with the same query, sends the same
    /// bytes (rule L7).
    ///
    /// # Errors
    /// [`ClientError`]; [`ClientError::is_retryable`] says whether the same query may be sent again later.
    pub fn localize(&self, map: &str, query: &SealedQuery) -> Result<Answer, ClientError> {
        self.localize_with(map, query, &LocalizeRequest::default())
    }

    /// As [`Self::localize`], with options of the request.
    ///
    /// # Errors
    /// As [`Self::localize`].
    pub fn localize_with(
        &self,
        map: &str,
        query: &SealedQuery,
        request: &LocalizeRequest,
    ) -> Result<Answer, ClientError> {
        let url = self.transport.address().of_map(map, "localize")?;
        query.check_sides()?;
        self.post_query(&url, PROTOBUF, &query.encode(), request)
    }

    /// The pose of a device that took several images and measured its motion between them: the answer's pose is that of
    /// the rig to which the frames belong. The queries are sent as they were sealed, and every retry sends the same
    /// bytes (rule L7). `docs/reference/privacy-rules.md` says what a session reveals beyond its queries.
    ///
    /// Frames that cannot determine a pose alone are allowed beside one that can.
    ///
    /// # Errors
    /// [`ClientError::Frames`] for no frame or too many, [`ClientError::SeparateAnchors`] for frames that were not sealed in
    /// one session, [`ClientError::UnbalancedAnchors`] when no query could determine a pose alone; otherwise as
    /// [`Self::localize`].
    pub fn localize_rig(
        &self,
        map: &str,
        rig: &RigMessage,
        request: &LocalizeRequest,
    ) -> Result<Answer, ClientError> {
        let url = self.transport.address().of_map(map, "localize-rig")?;
        if !(1..=RigMessage::MAX_FRAMES).contains(&rig.frames.len()) {
            return Err(ClientError::Frames { frames: rig.frames.len() });
        }
        rig.check_anchors()?;
        let sides: Vec<_> = rig.frames.iter().map(|frame| frame.query.check_sides()).collect();
        if let (Some(Err(unbalanced)), false) = (sides.first(), sides.iter().any(Result::is_ok)) {
            return Err((*unbalanced).into());
        }
        self.post_query(&url, SESSION, &rig.encode(), request)
    }

    /// All content anchors of a map. Sort them by [`ContentAnchors::nearest`]: fetched whole, the list tells the service neither
    /// where the device is nor which anchor its user looks at.
    ///
    /// # Errors
    /// [`ClientError`]: the map's name, an error response, the network, or an invalid document.
    pub fn anchors(&self, map: &str) -> Result<ContentAnchors, ClientError> {
        let url = self.transport.address().of_map(map, "anchors")?;
        let reply = self.transport.get(&url, None, ContentAnchors::MAX_FILE as u64)?;
        if reply.status != 200 {
            return Err(refused(&reply));
        }
        let bad = |reason| ClientError::BadAnswer { what: "the list of anchors", reason };
        check_type(&reply, JSON).map_err(bad)?;
        ContentAnchors::decode(&reply.body).map_err(|error| bad(error.to_string()))
    }

    /// Writes a content anchor: a new one, or one that the token owns. The last writer wins. The token needs the permission
    /// `anchors`.
    ///
    /// # Errors
    /// [`ClientError::Anchor`] for an anchor that no service takes; otherwise as [`Self::anchors`].
    pub fn put_anchor(&self, map: &str, anchor: &ContentAnchor) -> Result<(), ClientError> {
        let url = self.anchor_url(map, &anchor.name)?;
        let body = anchor.encode();
        // What a service would refuse is not sent.
        ContentAnchor::decode(&anchor.name, &body).map_err(ClientError::Anchor)?;
        let headers = [("content-type", JSON.to_owned())];
        let reply = self.transport.put(&url, JSON, &headers, &body, MAX_ANSWER)?;
        if matches!(reply.status, 200 | 201) { Ok(()) } else { Err(refused(&reply)) }
    }

    /// Deletes a content anchor that the token owns.
    ///
    /// # Errors
    /// As [`Self::put_anchor`].
    pub fn delete_anchor(&self, map: &str, name: &str) -> Result<(), ClientError> {
        let reply = self.transport.delete(&self.anchor_url(map, name)?, MAX_ANSWER)?;
        if reply.status == 204 { Ok(()) } else { Err(refused(&reply)) }
    }

    fn anchor_url(&self, map: &str, name: &str) -> Result<String, ClientError> {
        if !is_map_name(name) {
            return Err(ClientError::Anchor(ContentAnchorError::Name));
        }
        self.transport.address().of_map(map, &format!("anchors/{name}"))
    }

    fn post_query(
        &self,
        url: &str,
        content_type: &str,
        body: &[u8],
        request: &LocalizeRequest,
    ) -> Result<Answer, ClientError> {
        let mut headers = request.headers();
        headers.push(("content-type", content_type.to_owned()));
        let reply = self.transport.post(url, PROTOBUF, &headers, body, MAX_ANSWER)?;
        if reply.status != 200 {
            return Err(refused(&reply));
        }
        let bad = |reason| ClientError::BadAnswer { what: "the answer", reason };
        check_type(&reply, PROTOBUF).map_err(bad)?;
        let mut answer = Answer::decode(&reply.body).map_err(|e| bad(printable(&e.to_string())))?;
        for doubt in &mut answer.doubts {
            doubt.text = printable(&doubt.text);
        }
        // A service that does not know the option returns doubtful poses too; then this client withholds them.
        Ok(if request.trusted_only { answer.trusted_only() } else { answer })
    }
}

/// What a service publishes of a map for devices.
trait Published: Sized {
    /// The word in addresses and names of files.
    const WHAT: &str;
    /// The name in messages.
    const NAME: &str;
    /// Maximum number of bytes.
    const MAX: u64;

    fn decode(bytes: &[u8]) -> Result<Self, QueryError>;
    fn id(&self) -> MessageId;
    /// The ids that the operator publishes elsewhere, by map.
    fn ids(options: &ClientOptions) -> &BTreeMap<String, MessageId>;
}

impl Published for Profile {
    const WHAT: &str = "profile";
    const NAME: &str = "the profile";
    const MAX: u64 = 2 << 20;

    fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        Self::decode(bytes)
    }

    fn id(&self) -> MessageId {
        self.id()
    }

    fn ids(options: &ClientOptions) -> &BTreeMap<String, MessageId> {
        &options.profile_ids
    }
}

impl Published for Pack {
    const WHAT: &str = "pack";
    const NAME: &str = "the pack";
    const MAX: u64 = 256 << 20;

    fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        Self::decode(bytes)
    }

    fn id(&self) -> MessageId {
        self.id()
    }

    fn ids(options: &ClientOptions) -> &BTreeMap<String, MessageId> {
        &options.pack_ids
    }
}

impl fmt::Debug for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Client").field("server", &self.transport.address().base).finish_non_exhaustive()
    }
}

/// Whether a reply declares itself as of this type: the login page of a captive portal does not.
fn check_type(reply: &Reply, expected: &str) -> Result<(), String> {
    let name = reply.content_type.split(';').next().unwrap_or_default().trim();
    if name.eq_ignore_ascii_case(expected) {
        return Ok(());
    }
    let form = if expected == JSON { "JSON" } else { "protobuf" };
    Err(format!("it is {:?}, not {form}; perhaps another service answered", printable(name)))
}

fn refused(reply: &Reply) -> ClientError {
    let refusal = Refusal::new(reply.status, &reply.body);
    match (reply.status, refusal.name.as_str()) {
        (422, _) => ClientError::NotLocalized(refusal),
        (409, "wrong-profile") => ClientError::WrongProfile(refusal),
        _ => ClientError::Refused(refusal),
    }
}
