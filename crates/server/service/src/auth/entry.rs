//! One token: its name and its permissions.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use crate::auth::error::{LineError, TokensError};
use crate::auth::key::TokenKey;
use crate::auth::timestamp::Timestamp;
use veiloc_map::is_map_name;

use crate::auth::names::is_token_name;

/// A line of the token file. Its `Display` is that line, hash included.
#[derive(Clone, PartialEq, Eq)]
pub struct TokenEntry {
    name: String,
    key: TokenKey,
    /// Whether it may read the metrics.
    pub operator: bool,
    /// Whether it belongs to a gateway, whose clients have their own tokens and limits there: it has no rate limit, its
    /// answers leave at once, and its word is taken for which client a query comes from.
    pub gateway: bool,
    /// Whether it may write content anchors: its own, and as an operator those of others.
    pub anchors: bool,
    /// The maps it may use; `None` for all maps, never empty.
    maps: Option<BTreeSet<String>>,
    /// End of validity.
    pub expires: Option<Timestamp>,
}

impl TokenEntry {
    /// A client token for all maps that never expires.
    ///
    /// # Errors
    /// [`TokensError::Name`]: the name is not valid.
    pub fn new(name: &str, key: TokenKey) -> Result<Self, TokensError> {
        if !is_token_name(name) {
            return Err(TokensError::Name);
        }
        Ok(Self::of(name, key))
    }

    /// A client token of a name that was checked or read.
    fn of(name: &str, key: TokenKey) -> Self {
        let name = name.to_owned();
        Self { name, key, operator: false, gateway: false, anchors: false, maps: None, expires: None }
    }

    /// Restricts the token to these maps.
    ///
    /// # Errors
    /// [`LineError`]: no map is given, or a name is not a valid map name.
    pub fn grant_maps<'a>(&mut self, maps: impl IntoIterator<Item = &'a str>) -> Result<(), LineError> {
        let maps: BTreeSet<String> = maps.into_iter().map(str::to_owned).collect();
        if maps.is_empty() || !maps.iter().all(|map| is_map_name(map)) {
            return Err(LineError::Maps);
        }
        self.maps = Some(maps);
        Ok(())
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its hash.
    pub const fn key(&self) -> TokenKey {
        self.key
    }

    /// The maps it may use; `None` for all maps.
    pub fn maps(&self) -> Option<impl Iterator<Item = &str>> {
        self.maps.as_ref().map(|maps| maps.iter().map(String::as_str))
    }

    /// Whether the token may use a map of this name; the map need not exist.
    pub fn allows_map(&self, map: &str) -> bool {
        self.maps.as_ref().is_none_or(|maps| maps.contains(map))
    }

    /// Whether the token has expired.
    pub fn has_expired(&self, now: Timestamp) -> bool {
        self.expires.is_some_and(|end| now >= end)
    }

    /// The metrics cover all maps, so an operator token cannot be restricted to some.
    pub(crate) fn check(&self) -> Result<(), LineError> {
        if self.operator && self.maps.is_some() { Err(LineError::OperatorOfSome) } else { Ok(()) }
    }
}

impl fmt::Display for TokenEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.name, self.key.hex())?;
        if self.operator {
            f.write_str(" operator")?;
        }
        if self.gateway {
            f.write_str(" gateway")?;
        }
        if self.anchors {
            f.write_str(" anchors")?;
        }
        if let Some(maps) = &self.maps {
            let maps: Vec<&str> = maps.iter().map(String::as_str).collect();
            write!(f, " maps={}", maps.join(","))?;
        }
        if let Some(expires) = self.expires {
            write!(f, " expires={expires}")?;
        }
        Ok(())
    }
}

// The hash is not printed.
impl fmt::Debug for TokenEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Entry").field("name", &self.name).finish_non_exhaustive()
    }
}

impl FromStr for TokenEntry {
    type Err = LineError;

    fn from_str(line: &str) -> Result<Self, LineError> {
        let mut words = line.split_whitespace();
        let (Some(name), Some(hex)) = (words.next(), words.next()) else { return Err(LineError::TooShort) };
        let key = TokenKey::of_hex(hex).ok_or(LineError::Hash)?;
        let mut entry = Self::of(name, key);
        for word in words {
            match word.split_once('=') {
                None if word == "operator" && !entry.operator => entry.operator = true,
                None if word == "gateway" && !entry.gateway => entry.gateway = true,
                None if word == "anchors" && !entry.anchors => entry.anchors = true,
                Some(("maps", maps)) if entry.maps.is_none() => entry.grant_maps(maps.split(','))?,
                Some(("expires", end)) if entry.expires.is_none() => {
                    entry.expires = Some(end.parse().map_err(|_| LineError::Expires)?);
                }
                None if ["operator", "gateway", "anchors"].contains(&word) => {
                    return Err(LineError::WordTwice);
                }
                Some(("maps" | "expires", _)) => return Err(LineError::WordTwice),
                _ => return Err(LineError::Word),
            }
        }
        entry.check()?;
        Ok(entry)
    }
}
