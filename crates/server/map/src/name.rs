//! What maps may be called.

/// Whether a map can have this name: 1 to 64 of letters, digits, `-`, `_` and `.`, so that nothing in addresses, metrics
/// and logs needs escaping; not `.` or `..`.
pub fn is_map_name(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    (1..=64).contains(&name.len()) && name.chars().all(allowed) && name != "." && name != ".."
}
