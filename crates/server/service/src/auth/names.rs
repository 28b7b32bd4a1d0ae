//! Valid names of tokens.

/// Whether a new token may have this name: the characters of map names, also `@` and `+` (for mail addresses), and
/// not `nobody`, which is a keyword of the file. Names in existing lines may hold anything but spaces.
pub fn is_token_name(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.' | '@' | '+');
    (1..=64).contains(&name.len()) && name.chars().all(allowed) && name != "nobody"
}
