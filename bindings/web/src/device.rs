//! The state between calls: profiles, sealers, sessions, features and queries, each under a handle.

use std::collections::BTreeMap;
use std::rc::Rc;

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::Serialize;
use veiloc_ar::Alignment;
use veiloc_features::PersonSegmenter;
use veiloc_obfuscation::{Sealer, Session, SessionOptions};
use veiloc_protocol::Profile;

use crate::alignment;
use crate::error::WebError;
use crate::inspection;
use crate::message;
use crate::request::Request;
use crate::sealing::{self, StoredFeatures, StoredQuery};

/// Most stored queries, and features that were not sealed; the oldest are dropped. Each takes a few hundred kilobytes.
const MAX_QUERIES: usize = 32;

/// The state of one worker.
#[derive(Default)]
pub struct Device {
    last: u32,
    profiles: BTreeMap<u32, Profile>,
    sealers: BTreeMap<u32, Rc<Sealer>>,
    sessions: BTreeMap<u32, Session>,
    segmenters: BTreeMap<u32, PersonSegmenter>,
    extracted: BTreeMap<u32, StoredFeatures>,
    queries: BTreeMap<u32, StoredQuery>,
    alignments: BTreeMap<u32, Alignment>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct ProfileReply {
    profile: u32,
    id: String,
    descriptor: String,
    max_keypoints: u32,
    max_image_side: u32,
}

#[derive(Serialize)]
struct SealerReply {
    sealer: u32,
    /// Id of its pack.
    pack: Option<String>,
}

#[derive(Serialize)]
struct SessionReply {
    session: u32,
    frames: u32,
    starts: u32,
}

#[derive(Serialize)]
struct AlignmentReply {
    alignment: u32,
}

#[derive(Serialize)]
struct SegmenterReply {
    segmenter: u32,
}

#[derive(Serialize)]
struct EmptyReply {}

impl Device {
    /// Handles a message and returns the reply.
    ///
    /// # Errors
    /// [`WebError`]; the state is then unchanged.
    pub fn answer(&mut self, message: &[u8]) -> Result<Vec<u8>, WebError> {
        let (request, bytes) = message::read::<Request>(message)?;
        match request {
            Request::Profile => self.store_profile(bytes),
            Request::Session { anchors } => {
                let anchors = anchors.map(|text| text.parse()).transpose()?.unwrap_or_default();
                let (mut rng, _) = seeded_rng(bytes)?;
                Ok(self
                    .store_session(Session::new(SessionOptions::default().with_anchors(anchors), &mut rng)))
            }
            Request::SessionFrom => Ok(self.store_session(Session::from_bytes(bytes)?)),
            Request::SessionBytes { session } => {
                let stored = lookup(&self.sessions, "session", session)?;
                Ok(message::write(&EmptyReply {}, &stored.to_bytes()))
            }
            Request::Exif { width, height } => Ok(sealing::exif(bytes, (width, height))),
            Request::Segmenter => {
                let segmenter = PersonSegmenter::read(bytes)?;
                let handle = self.next();
                self.segmenters.insert(handle, segmenter);
                Ok(message::write(&SegmenterReply { segmenter: handle }, &[]))
            }
            Request::Sealer(request) => {
                let profile = lookup(&self.profiles, "profile", request.profile)?;
                let sealer = sealing::sealer(&request, bytes, profile)?;
                let pack = sealer.place().map(|place| place.pack().id().to_string());
                let handle = self.next();
                self.sealers.insert(handle, Rc::new(sealer));
                Ok(message::write(&SealerReply { sealer: handle, pack }, &[]))
            }
            Request::Extract(request) => {
                let sealer = lookup(&self.sealers, "sealer", request.sealer)?;
                let people = request.people.map(|handle| lookup(&self.segmenters, "segmenter", handle));
                let stored = sealing::extract(&request, bytes, sealer, people.transpose()?)?;
                let extracted = self.next();
                let reply = stored.reply(extracted);
                store(&mut self.extracted, extracted, stored);
                Ok(reply)
            }
            Request::Seal { sealer, extracted, session } => {
                let (mut rng, _) = seeded_rng(bytes)?;
                let sealer = lookup(&self.sealers, "sealer", sealer)?.clone();
                let session =
                    session.map(|handle| lookup_mut(&mut self.sessions, "session", handle)).transpose()?;
                // An image is sealed once (rule L7).
                let stored = self
                    .extracted
                    .remove(&extracted)
                    .ok_or(WebError::UnknownHandle { what: "image", handle: extracted })?;
                let stored = stored.seal(sealer, session, &mut rng)?;
                let query = self.next();
                let reply = stored.reply(query);
                store(&mut self.queries, query, stored);
                Ok(reply)
            }
            Request::Step { query, rows } => lookup(&self.queries, "query", query)?.step(rows),
            Request::Show { query } => Ok(inspection::show(lookup(&self.queries, "query", query)?)),
            Request::Exhibit { query } => Ok(inspection::exhibit(lookup(&self.queries, "query", query)?)),
            Request::Attack { attack, query_bytes } => inspection::attack(&attack, query_bytes, bytes),
            Request::Alignment { metres_per_unit } => {
                let begun = alignment::begin(metres_per_unit)?;
                let handle = self.next();
                self.alignments.insert(handle, begun);
                Ok(message::write(&AlignmentReply { alignment: handle }, &[]))
            }
            Request::AlignmentAdd { alignment, pose } => {
                alignment::add(self.alignment(alignment)?, pose, bytes)
            }
            Request::AlignmentMoved { alignment, pose } => {
                alignment::moved(self.alignment(alignment)?, pose)?;
                Ok(message::write(&EmptyReply {}, &[]))
            }
            Request::WorldFromAnchor { alignment, pose } => {
                alignment::world_from_anchor(self.alignment(alignment)?, pose)
            }
            Request::CameraInMap { alignment, pose } => {
                alignment::camera_in_map(self.alignment(alignment)?, pose)
            }
            Request::Free { handle } => {
                self.alignments.remove(&handle);
                self.profiles.remove(&handle);
                self.sealers.remove(&handle);
                self.extracted.remove(&handle);
                self.sessions.remove(&handle);
                self.segmenters.remove(&handle);
                self.queries.remove(&handle);
                Ok(message::write(&EmptyReply {}, &[]))
            }
        }
    }

    fn alignment(&mut self, handle: u32) -> Result<&mut Alignment, WebError> {
        lookup_mut(&mut self.alignments, "alignment", handle)
    }

    fn store_profile(&mut self, bytes: &[u8]) -> Result<Vec<u8>, WebError> {
        let profile = Profile::decode(bytes).map_err(WebError::Profile)?;
        let handle = self.next();
        let reply = ProfileReply {
            profile: handle,
            id: profile.id().to_string(),
            descriptor: profile.descriptor_kind().name().to_owned(),
            max_keypoints: profile.limits().max_keypoints,
            max_image_side: profile.limits().max_image_side,
        };
        self.profiles.insert(handle, profile);
        Ok(message::write(&reply, &[]))
    }

    fn store_session(&mut self, session: Session) -> Vec<u8> {
        let handle = self.next();
        let reply = SessionReply { session: handle, frames: session.frames(), starts: session.starts() };
        self.sessions.insert(handle, session);
        message::write(&reply, &[])
    }

    const fn next(&mut self) -> u32 {
        self.last = self.last.wrapping_add(1);
        self.last
    }
}

/// Stores an object, and drops the oldest when there are too many.
fn store<T>(stored: &mut BTreeMap<u32, T>, handle: u32, object: T) {
    stored.insert(handle, object);
    while stored.len() > MAX_QUERIES {
        stored.pop_first();
    }
}

fn lookup<'a, T>(stored: &'a BTreeMap<u32, T>, what: &'static str, handle: u32) -> Result<&'a T, WebError> {
    stored.get(&handle).ok_or(WebError::UnknownHandle { what, handle })
}

fn lookup_mut<'a, T>(
    stored: &'a mut BTreeMap<u32, T>,
    what: &'static str,
    handle: u32,
) -> Result<&'a mut T, WebError> {
    stored.get_mut(&handle).ok_or(WebError::UnknownHandle { what, handle })
}

/// A generator seeded with the first 32 bytes of the payload, and the rest of the payload.
fn seeded_rng(bytes: &[u8]) -> Result<(ChaCha20Rng, &[u8]), WebError> {
    let none = || WebError::Request { reason: "the payload must begin with 32 random bytes".to_owned() };
    let (seed, rest) = bytes.split_first_chunk::<32>().ok_or_else(none)?;
    Ok((ChaCha20Rng::from_seed(*seed), rest))
}
