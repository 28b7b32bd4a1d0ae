//! Valid names of maps.

/// Whether a map may have this name: 1 to 64 letters, digits, `-`, `_` and `.`, which need no escaping in addresses,
/// metrics and logs; not `.` or `..`.
pub fn is_map_name(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    (1..=64).contains(&name.len()) && name.chars().all(allowed) && name != "." && name != ".."
}
