//! A service, and who asks it.

use std::fmt;

use veiloc_protocol::{Answer, Profile, RigMessage, SealedQuery};

use crate::address::{Address, token};
use crate::profile_cache::{ProfileCache, hash, keep};
use crate::refusal::{Refusal, printable};
use crate::transport::{Reply, Transport};
use crate::{ClientError, ClientOptions, LocalizeRequest};

/// Most bytes of a profile that are read.
const MAX_PROFILE: u64 = 2 << 20;
/// Most bytes of an answer or a refusal.
const MAX_ANSWER: u64 = 64 << 10;
/// What a sealed query is sent as and an answer wanted in, and what the queries of a session are.
const PROTOBUF: &str = "application/x-protobuf";
const SESSION: &str = "application/octet-stream";

/// A service, and who asks it. Calls block; one client may be used by several threads.
pub struct Client {
    transport: Transport,
    cache: ProfileCache,
}

impl Client {
    /// A client of the service at `server`, for example `https://places.example:8443`, which identifies with `token`.
    /// Nothing is sent yet.
    ///
    /// # Errors
    /// [`ClientError::Address`], [`ClientError::PlainHttp`], [`ClientError::Token`], [`ClientError::Certificates`] when
    /// what was given cannot be used.
    pub fn new(server: &str, token: Option<&str>, options: ClientOptions) -> Result<Self, ClientError> {
        let address = Address::new(server, options.insecure_http)?;
        let cache = ProfileCache::new(options.cache.as_deref());
        let transport = Transport::new(address, self::token(token)?, options)?;
        Ok(Self { transport, cache })
    }

    /// The current profile of a map: the kept one when the service says that it still is.
    ///
    /// # Errors
    /// [`ClientError`]: the map's name, a refusal, the network, or bytes that are no profile.
    pub fn profile(&self, map: &str) -> Result<Profile, ClientError> {
        let url = self.transport.address().of_map(map, "profile")?;
        let file = self.cache.file(&self.transport.address().base, map);
        // A kept file that cannot be read, or is damaged, is as good as none.
        let kept = file.as_ref().and_then(|file| std::fs::read(file).ok());
        let kept = kept.and_then(|bytes| Some((hash(&bytes), Profile::decode(&bytes).ok()?)));
        let tag = kept.as_ref().map(|(hash, _)| format!("\"{hash}\""));
        let reply = self.transport.get(&url, tag.as_deref(), MAX_PROFILE)?;
        match (reply.status, kept) {
            (200, _) => {
                let bad = |reason| ClientError::BadAnswer { what: "the profile", reason };
                check_type(&reply).map_err(bad)?;
                let profile = Profile::decode(&reply.body).map_err(|e| bad(printable(&e.to_string())))?;
                if let Some(file) = file {
                    keep(&file, &reply.body, self.transport.options());
                }
                Ok(profile)
            }
            (304, Some((_, profile))) => Ok(profile),
            _ => Err(refused(&reply)),
        }
    }

    /// The pose of a sealed query. Whenever it is sent again, by this call or by the next one with the same query, the
    /// same bytes are sent (rule L7).
    ///
    /// # Errors
    /// [`ClientError`]; [`ClientError::may_send_again`] says whether the same query may be tried again later.
    pub fn localize(&self, map: &str, query: &SealedQuery) -> Result<Answer, ClientError> {
        self.localize_with(map, query, &LocalizeRequest::default())
    }

    /// As [`Self::localize`], with what the caller has to say beside the query.
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
        self.ask(&url, PROTOBUF, &query.encode(), request)
    }

    /// The pose of a device that took several images and measured how it moved between them: the answer's pose is that of
    /// the rig that the message's frames hang on. The queries are sent as they were sealed, and the same bytes whenever
    /// they are sent again (rule L7). What a session tells beside its queries: `docs/reference/privacy-rules.md`.
    ///
    /// An image that cannot fix a pose is welcome beside one that can.
    ///
    /// # Errors
    /// [`ClientError::Frames`] for no frame or too many, [`ClientError::Lopsided`] when no query could fix a pose alone;
    /// else as [`Self::localize`].
    pub fn localize_rig(
        &self,
        map: &str,
        rig: &RigMessage,
        request: &LocalizeRequest,
    ) -> Result<Answer, ClientError> {
        let url = self.transport.address().of_map(map, "localize-rig")?;
        if !(1..=RigMessage::MOST_FRAMES).contains(&rig.frames.len()) {
            return Err(ClientError::Frames { frames: rig.frames.len() });
        }
        let sides: Vec<_> = rig.frames.iter().map(|frame| frame.query.check_sides()).collect();
        if let (Some(Err(lopsided)), false) = (sides.first(), sides.iter().any(Result::is_ok)) {
            return Err((*lopsided).into());
        }
        self.ask(&url, SESSION, &rig.encode(), request)
    }

    fn ask(
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
        check_type(&reply).map_err(bad)?;
        let mut answer = Answer::decode(&reply.body).map_err(|e| bad(printable(&e.to_string())))?;
        for doubt in &mut answer.doubts {
            doubt.text = printable(&doubt.text);
        }
        // A service that knows nothing of the wish tells the pose: then it is withheld here.
        Ok(if request.trusted_only { answer.trusted_only() } else { answer })
    }
}

impl fmt::Debug for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Client").field("server", &self.transport.address().base).finish_non_exhaustive()
    }
}

/// Whether a reply says of itself that it is protobuf: a page of a hotel's network does not.
fn check_type(reply: &Reply) -> Result<(), String> {
    let name = reply.content_type.split(';').next().unwrap_or_default().trim();
    if name.eq_ignore_ascii_case(PROTOBUF) {
        return Ok(());
    }
    Err(format!("it is {:?}, not protobuf; perhaps another service answered", printable(name)))
}

fn refused(reply: &Reply) -> ClientError {
    let refusal = Refusal::new(reply.status, &reply.body);
    match (reply.status, refusal.name.as_str()) {
        (422, _) => ClientError::NotLocalized(refusal),
        (409, "wrong-profile") => ClientError::WrongProfile(refusal),
        _ => ClientError::Refused(refusal),
    }
}
