//! `fam new`: a small cell to begin with.

use std::collections::BTreeMap;

const FILES: [(&str, &str); 5] = [
    ("README.md", include_str!("../templates/new/README.md")),
    ("cell.toml", include_str!("../templates/new/cell.toml")),
    (
        "deployment.toml",
        include_str!("../templates/new/deployment.toml"),
    ),
    (
        "logic/loader.st",
        include_str!("../templates/new/logic/loader.st"),
    ),
    (
        "logic/stamper.st",
        include_str!("../templates/new/logic/stamper.st"),
    ),
];

/// Its files, by their path in the new folder.
#[must_use]
pub fn files() -> BTreeMap<String, String> {
    FILES
        .iter()
        .map(|(name, text)| ((*name).to_owned(), (*text).to_owned()))
        .collect()
}
