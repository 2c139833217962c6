//! Machine code of MCs, kept between starts: a directory of files named after the module's content and this build's version.

use fam_proto::{Digest, McId};
use fam_soft_plc::{CompiledMc, Engine, Module, RuntimeError};
use std::path::{Path, PathBuf};

/// Gives the machine code of a module: from the cache directory if it is there and whole, else compiled and put there.
///
/// # Errors
/// If it does not compile. A cache that cannot be read or written costs time and is no error.
pub(crate) fn prepare(
    engine: &Engine,
    mc: &McId,
    compiled: &CompiledMc,
    cache: Option<&Path>,
) -> Result<Module, RuntimeError> {
    let Some(directory) = cache else {
        return engine.prepare(compiled);
    };
    let file = directory.join(name(mc, compiled));
    if let Ok(bytes) = std::fs::read(&file) {
        // SAFETY: the directory is this user's own (`private`), and what lies there came from `Module::serialize`; the loader
        // checks digest, version and logic.
        match unsafe { engine.load_precompiled(compiled, &bytes) } {
            Ok(module) => return Ok(module),
            Err(error) => tracing::info!(mc = %mc, "{} is not used: {error}", file.display()),
        }
    }
    let module = engine.prepare(compiled)?;
    let written = private(directory).and_then(|()| {
        let code = module.serialize().map_err(std::io::Error::other)?;
        replace(&file, &code)
    });
    if let Err(error) = written {
        tracing::info!(mc = %mc, "machine code of {mc} is not kept in {}: {error}", file.display());
    }
    Ok(module)
}

/// The module's content, and the version of what made the machine code.
fn name(mc: &McId, compiled: &CompiledMc) -> PathBuf {
    let digest = Digest::of(compiled.logic_hash, &compiled.wasm);
    let hex: String = digest.0.iter().map(|b| format!("{b:02x}")).collect();
    PathBuf::from(format!("{mc}-{hex}-{}.code", env!("CARGO_PKG_VERSION")))
}

/// Makes the directory, for this user alone; one that others may write is refused.
fn private(directory: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::{DirBuilderExt, MetadataExt};
    std::fs::DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(directory)?;
    let found = std::fs::metadata(directory)?;
    // SAFETY: it always succeeds and touches no memory.
    let me = unsafe { libc::geteuid() };
    if found.mode() & 0o022 != 0 || found.uid() != me {
        return Err(std::io::Error::other(
            "others may write this directory, and its files are run",
        ));
    }
    Ok(())
}

/// Whole or not at all, also with several nodes at once.
fn replace(file: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let part = file.with_extension(format!("{}.part", std::process::id()));
    std::fs::write(&part, bytes)?;
    std::fs::rename(&part, file)
}
