//! Texts of the built-in descriptions (`models/`, `globals/`).

use std::path::Path;

/// Built-in descriptions.
pub(crate) const BUILT_IN: [(&str, &str); 10] = [
    ("models/xfeat.toml", include_str!("../../models/xfeat.toml")),
    ("models/xfeat-compact.toml", include_str!("../../models/xfeat-compact.toml")),
    ("models/alike.toml", include_str!("../../models/alike.toml")),
    ("models/alike-t.toml", include_str!("../../models/alike-t.toml")),
    ("models/alike-t-compact.toml", include_str!("../../models/alike-t-compact.toml")),
    ("models/aliked-t16.toml", include_str!("../../models/aliked-t16.toml")),
    ("models/aliked-n16.toml", include_str!("../../models/aliked-n16.toml")),
    ("models/aliked-n16rot.toml", include_str!("../../models/aliked-n16rot.toml")),
    ("models/aliked-n32.toml", include_str!("../../models/aliked-n32.toml")),
    ("models/superpoint.toml", include_str!("../../models/superpoint.toml")),
];

/// Built-in descriptions of global descriptors.
pub(crate) const GLOBALS: [(&str, &str); 2] = [
    ("globals/netvlad.toml", include_str!("../../globals/netvlad.toml")),
    ("globals/xfeat-netvlad.toml", include_str!("../../globals/xfeat-netvlad.toml")),
];

/// The text of the built-in description of this name.
pub(crate) fn of(name: &str) -> Option<&'static str> {
    let own = |file: &str| Path::new(file).file_stem().is_some_and(|stem| stem == name);
    BUILT_IN.iter().find(|(file, _)| own(file)).map(|(_, text)| *text)
}
