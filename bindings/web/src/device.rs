//! What is kept between two calls, under handles: profiles, sessions, queries.

use std::collections::BTreeMap;
use std::rc::Rc;

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::Serialize;
use veiloc_obfuscation::{Session, SessionOptions};
use veiloc_protocol::Profile;

use crate::error::WebError;
use crate::message;
use crate::request::Request;
use crate::sealing::{self, Kept};
use crate::shown;

/// Queries that are kept; the oldest gives way. One is a few hundred kilobytes.
const MOST_QUERIES: usize = 32;

/// A device: what a worker holds.
#[derive(Default)]
pub struct Device {
    last: u32,
    profiles: BTreeMap<u32, Rc<Profile>>,
    sessions: BTreeMap<u32, Session>,
    queries: BTreeMap<u32, Kept>,
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
struct SessionReply {
    session: u32,
    frames: u32,
    starts: u32,
}

#[derive(Serialize)]
struct Nothing {}

impl Device {
    /// The reply to a message.
    ///
    /// # Errors
    /// [`WebError`]; nothing of the device has changed then.
    pub fn answer(&mut self, message: &[u8]) -> Result<Vec<u8>, WebError> {
        let (request, bytes) = message::read::<Request>(message)?;
        match request {
            Request::Profile => self.keep_profile(bytes),
            Request::Session { anchors } => {
                let anchors = anchors.map(|text| text.parse()).transpose()?.unwrap_or_default();
                let (mut rng, _) = generator(bytes)?;
                Ok(self.keep_session(Session::new(SessionOptions::default().with_anchors(anchors), &mut rng)))
            }
            Request::SessionFrom => Ok(self.keep_session(Session::from_bytes(bytes)?)),
            Request::SessionBytes { session } => {
                let kept = found(&self.sessions, "session", session)?;
                Ok(message::write(&Nothing {}, &kept.to_bytes()))
            }
            Request::Seal(seal) => {
                let (mut rng, pixels) = generator(bytes)?;
                let profile = found(&self.profiles, "profile", seal.profile)?.clone();
                let session = match seal.session {
                    Some(handle) => Some(
                        self.sessions.get_mut(&handle).ok_or(WebError::Gone { what: "session", handle })?,
                    ),
                    None => None,
                };
                let kept = sealing::seal(&seal, pixels, profile, session, &mut rng)?;
                let query = self.next();
                let reply = kept.reply(query);
                self.queries.insert(query, kept);
                while self.queries.len() > MOST_QUERIES {
                    self.queries.pop_first();
                }
                Ok(reply)
            }
            Request::Step { query, rows } => found(&self.queries, "query", query)?.step(rows),
            Request::Show { query } => Ok(shown::show(found(&self.queries, "query", query)?)),
            Request::Exhibit { query } => Ok(shown::exhibit(found(&self.queries, "query", query)?)),
            Request::Attack { attack, query_bytes } => shown::attack(&attack, query_bytes, bytes),
            Request::Free { handle } => {
                self.profiles.remove(&handle);
                self.sessions.remove(&handle);
                self.queries.remove(&handle);
                Ok(message::write(&Nothing {}, &[]))
            }
        }
    }

    fn keep_profile(&mut self, bytes: &[u8]) -> Result<Vec<u8>, WebError> {
        let profile = Profile::decode(bytes).map_err(WebError::Profile)?;
        let handle = self.next();
        let reply = ProfileReply {
            profile: handle,
            id: profile.id().to_string(),
            descriptor: profile.descriptor_kind().name().to_owned(),
            max_keypoints: profile.limits().max_keypoints,
            max_image_side: profile.limits().max_image_side,
        };
        self.profiles.insert(handle, Rc::new(profile));
        Ok(message::write(&reply, &[]))
    }

    fn keep_session(&mut self, session: Session) -> Vec<u8> {
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

fn found<'a, T>(kept: &'a BTreeMap<u32, T>, what: &'static str, handle: u32) -> Result<&'a T, WebError> {
    kept.get(&handle).ok_or(WebError::Gone { what, handle })
}

/// The generator of the 32 random bytes that a message begins with, and what stands behind them.
fn generator(bytes: &[u8]) -> Result<(ChaCha20Rng, &[u8]), WebError> {
    let none = || WebError::Request { reason: "32 random bytes are expected first".to_owned() };
    let (seed, rest) = bytes.split_first_chunk::<32>().ok_or_else(none)?;
    Ok((ChaCha20Rng::from_seed(*seed), rest))
}
