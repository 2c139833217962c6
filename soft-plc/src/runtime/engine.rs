//! The engine that compiles modules to machine code, and modules ready to be instantiated.

use std::sync::Arc;

use wasmtime::{Config, Inlining, InstancePre, Linker, OptLevel};
use xxhash_rust::xxh3::xxh3_64;

use crate::codegen::CompiledMc;
use crate::runtime::watchdog::Watchdog;
use crate::runtime::{math, text};

/// How an endless loop is stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Interruption {
    /// By the host's ticks (`Engine::interrupt_tick`): nearly free.
    #[default]
    Epoch,
    /// By a number of Wasm instructions for each scan: the same on every run, at some cost.
    Fuel(u64),
    /// Not at all.
    None,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct EngineOptions {
    pub interruption: Interruption,
}

#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    #[error("the Wasm engine could not be set up: {0:#}")]
    Setup(wasmtime::Error),
    #[error("machine code could not be made from the module: {0:#}")]
    Compile(wasmtime::Error),
    #[error("an instance could not be made: {0:#}")]
    Instantiate(wasmtime::Error),
    #[error("the precompiled module is broken or of another version; compile it anew")]
    Stale,
    #[error("the precompiled module cannot be loaded on this machine: {0:#}; compile it anew")]
    Load(wasmtime::Error),
    #[error(
        "the precompiled module belongs to other logic (hash {found:016x}, expected {expected:016x})"
    )]
    OtherLogic { found: u64, expected: u64 },
}

/// Compiles and loads modules. Cheap to clone; may be shared between threads.
#[derive(Clone)]
pub struct Engine {
    pub(super) inner: wasmtime::Engine,
    pub(super) options: EngineOptions,
    pub(super) watchdog: Arc<Watchdog>,
    linker: Arc<Linker<()>>,
}

/// An MC's machine code with all that is known about it. Cheap to clone.
#[derive(Clone)]
pub struct Module {
    inner: wasmtime::Module,
    pub(super) pre: InstancePre<()>,
    pub(super) mc: Arc<CompiledMc>,
}

/// Marks precompiled modules; the number changes with the form of what follows.
const MAGIC: [u8; 8] = *b"FAMMC\0\0\x01";
const HEADER_BYTES: usize = 24;

impl Engine {
    pub fn new(options: EngineOptions) -> Result<Self, RuntimeError> {
        // Fuel runs out anywhere, and only calls that are left in the code tell in which POU.
        let inlining = !matches!(options.interruption, Interruption::Fuel(_));
        Self::with_inlining(options, inlining)
    }

    /// The same with calls between POUs replaced by what they call, or left alone.
    pub fn with_inlining(options: EngineOptions, inlining: bool) -> Result<Self, RuntimeError> {
        let mut config = Config::new();
        config
            // Compiled code itself makes NaNs canonical where their bits can be seen; doing it after each operation is slow.
            .cranelift_nan_canonicalization(false)
            .cranelift_opt_level(OptLevel::Speed)
            // Function blocks are small and called often: the calls cost more than what they do.
            .compiler_inlining(if inlining {
                Inlining::Yes
            } else {
                Inlining::No
            })
            .wasm_branch_hinting(true)
            .consume_fuel(matches!(options.interruption, Interruption::Fuel(_)));
        let inner = wasmtime::Engine::new(&config).map_err(RuntimeError::Setup)?;
        let mut linker = Linker::new(&inner);
        math::link(&mut linker).map_err(RuntimeError::Setup)?;
        text::link(&mut linker).map_err(RuntimeError::Setup)?;
        Ok(Self {
            inner,
            options,
            watchdog: Arc::new(Watchdog::default()),
            linker: Arc::new(linker),
        })
    }

    /// Compiles to machine code: about 16 us for each statement, so ahead of time.
    pub fn prepare(&self, mc: &CompiledMc) -> Result<Module, RuntimeError> {
        let module = wasmtime::Module::new(&self.inner, &mc.wasm).map_err(RuntimeError::Compile)?;
        self.link(module, mc)
    }

    fn link(&self, module: wasmtime::Module, mc: &CompiledMc) -> Result<Module, RuntimeError> {
        let pre = self
            .linker
            .instantiate_pre(&module)
            .map_err(RuntimeError::Compile)?;
        Ok(Module {
            inner: module,
            pre,
            mc: Arc::new(mc.clone()),
        })
    }

    /// Loads what `Module::serialize` gave for the same logic.
    ///
    /// # Safety
    /// The bytes are machine code that will be run: they must come from `Module::serialize`, from a place that only this
    /// user can write. Damage and other versions are found by a digest, malice is not.
    pub unsafe fn load_precompiled(
        &self,
        mc: &CompiledMc,
        bytes: &[u8],
    ) -> Result<Module, RuntimeError> {
        let Some((header, code)) = bytes.split_at_checked(HEADER_BYTES) else {
            return Err(RuntimeError::Stale);
        };
        let word = |at: usize| {
            let mut raw = [0u8; 8];
            raw.copy_from_slice(&header[at..at + 8]);
            u64::from_le_bytes(raw)
        };
        if header[..8] != MAGIC || word(16) != xxh3_64(code) {
            return Err(RuntimeError::Stale);
        }
        if word(8) != mc.logic_hash {
            return Err(RuntimeError::OtherLogic {
                found: word(8),
                expected: mc.logic_hash,
            });
        }
        // SAFETY: the caller promises that `serialize` made the bytes; the digest shows that they are whole.
        let module = unsafe { wasmtime::Module::deserialize(&self.inner, code) }
            .map_err(RuntimeError::Load)?;
        self.link(module, mc)
    }

    /// One tick of the watchdog: a scan that has used up its ticks is stopped. Called from the shell's watchdog thread.
    pub fn interrupt_tick(&self) {
        self.watchdog.tick();
    }
}

impl Module {
    /// The machine code, to be kept and loaded again with `Engine::load_precompiled`.
    pub fn serialize(&self) -> Result<Vec<u8>, RuntimeError> {
        let code = self.inner.serialize().map_err(RuntimeError::Compile)?;
        let mut bytes = Vec::with_capacity(HEADER_BYTES + code.len());
        bytes.extend_from_slice(&MAGIC);
        bytes.extend_from_slice(&self.mc.logic_hash.to_le_bytes());
        bytes.extend_from_slice(&xxh3_64(&code).to_le_bytes());
        bytes.extend_from_slice(&code);
        Ok(bytes)
    }

    pub fn mc(&self) -> &CompiledMc {
        &self.mc
    }
}
