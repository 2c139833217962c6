//! Writes the seeds of all targets into a folder: `cargo run -p fam-hostile --example corpus -- tests/fuzz/corpus`.

use fam_hostile::{MODEL_TARGETS, TARGETS, seeds};
use std::path::PathBuf;

fn main() -> std::io::Result<()> {
    let root = PathBuf::from(
        std::env::args()
            .nth(1)
            .unwrap_or_else(|| "tests/fuzz/corpus".to_owned()),
    );
    for (name, _) in TARGETS.into_iter().chain(MODEL_TARGETS) {
        let folder = root.join(name);
        std::fs::create_dir_all(&folder)?;
        for (n, seed) in seeds::of(name).iter().enumerate() {
            std::fs::write(folder.join(format!("seed-{n:02}")), seed)?;
        }
    }
    Ok(())
}
