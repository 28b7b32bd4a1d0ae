//! What tokens may be called.

/// Whether a new token can have this name: as a map, `@` and `+` too (people have addresses), and not `nobody`, which
/// means that there is none. Names of older lines may hold anything but spaces.
pub fn is_token_name(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.' | '@' | '+');
    (1..=64).contains(&name.len()) && name.chars().all(allowed) && name != "nobody"
}
