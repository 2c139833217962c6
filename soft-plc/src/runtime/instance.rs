//! One running MC: its memory, and the call that scans it.

use std::sync::Arc;
use std::sync::atomic::{AtomicPtr, AtomicU32, Ordering};

use wasmtime::{Memory, Store, TypedFunc};

use crate::codegen::{CompiledMc, MEMORY_EXPORT, SCAN_EXPORT};
use crate::layout::{Layout, Region, TypeNode, VariableInfo};
use crate::memory::{MC_TIME_AT, STOP_AT, TRAP_SITE_AT};
use crate::runtime::engine::{Engine, Interruption, Module, RuntimeError};
use crate::runtime::trap::{self, Trap};
use crate::runtime::watchdog::{Watch, Watchdog};
use crate::value::Value;

/// A value that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    #[error("there is no variable `{0}`")]
    Unknown(String),
    #[error("`{0}` is an array or structure; write its parts one by one")]
    NotScalar(String),
    #[error("`{path}` is {expected}, and {value} does not fit")]
    Type {
        path: String,
        expected: String,
        value: Value,
    },
}

/// An MC with memory of its own. It may be moved between threads, and one thread at a time runs it.
pub struct Instance {
    store: Store<()>,
    memory: Memory,
    /// Where the memory begins, with its system area. It has its largest size from the beginning, so that it stays where it is until
    /// the store goes; asking the store for it takes as long as the call of a scan.
    base: AtomicPtr<u8>,
    scan: TypedFunc<(), ()>,
    mc: Arc<CompiledMc>,
    interruption: Interruption,
    /// With `Interruption::Epoch`: how the watchdog sees the instance.
    watched: Option<(Arc<Watchdog>, Arc<Watch>)>,
}

impl Drop for Instance {
    fn drop(&mut self) {
        if let Some((watchdog, watch)) = &self.watched {
            watchdog.forget(watch);
        }
    }
}

impl Instance {
    /// A new instance with the initial values of all variables.
    pub fn new(engine: &Engine, module: &Module) -> Result<Self, RuntimeError> {
        let mut store = Store::new(&engine.inner, ());
        let fail = RuntimeError::Instantiate;
        let instance = module.pre.instantiate(&mut store).map_err(fail)?;
        let memory = instance
            .get_memory(&mut store, MEMORY_EXPORT)
            .ok_or_else(|| fail(wasmtime::Error::msg("the module has no memory")))?;
        let scan = instance
            .get_typed_func(&mut store, SCAN_EXPORT)
            .map_err(fail)?;
        let base = memory.data_ptr(&store);
        let watched = (engine.options.interruption == Interruption::Epoch).then(|| {
            let stop = base.wrapping_add(STOP_AT as usize);
            // SAFETY: the memory stays where it is until the store goes, and `drop` forgets the watch before; while a scan runs
            // nothing here refers to the memory.
            let watch = unsafe { engine.watchdog.watch(stop.cast()) };
            (engine.watchdog.clone(), watch)
        });
        Ok(Self {
            store,
            memory,
            base: AtomicPtr::new(base),
            scan,
            mc: module.mc.clone(),
            interruption: engine.options.interruption,
            watched,
        })
    }

    /// Runs the entry program once, at the given MC time. `budget_ticks` counts ticks of the engine (`Interruption::Epoch`);
    /// the tick that is running already counts as one, so 2 is the smallest useful budget.
    ///
    /// One host call; nothing is allocated unless it traps. After a trap the memory is half updated: the caller restores the
    /// regions, and may go on with the instance.
    pub fn scan(&mut self, mc_time_ns: i64, budget_ticks: u64) -> Result<(), Trap> {
        let base = *self.base.get_mut();
        // SAFETY: `new` says why `base` is valid; both words lie in the system area, which every memory has, aligned to 8 bytes, and
        // nothing else refers to it while `self` is borrowed but the watchdog, to the second one.
        unsafe {
            let time = base.add(MC_TIME_AT as usize).cast::<i64>();
            time.write(mc_time_ns.to_le());
            // The watchdog may have written it when the scan before had already ended.
            let stop = base.add(STOP_AT as usize).cast::<u32>();
            AtomicU32::from_ptr(stop).store(0, Ordering::Relaxed);
        }
        if let Interruption::Fuel(amount) = self.interruption {
            // Only fails in an engine without fuel.
            let _ = self.store.set_fuel(amount);
        }
        if let Some((watchdog, watch)) = &self.watched {
            watchdog.begin(watch, budget_ticks);
        }
        let result = self.scan.call(&mut self.store, ());
        if let Some((_, watch)) = &self.watched {
            watch.end();
        }
        match result {
            Ok(()) => Ok(()),
            Err(error) => Err(self.explain(&error)),
        }
    }

    #[cold]
    fn explain(&mut self, error: &wasmtime::Error) -> Trap {
        let memory = self.memory.data(&self.store);
        let trap = trap::explain(&self.mc, error, memory);
        self.put(TRAP_SITE_AT, &[0; 4]);
        trap
    }

    fn put(&mut self, at: u32, bytes: &[u8]) {
        let at = at as usize;
        self.memory.data_mut(&mut self.store)[at..at + bytes.len()].copy_from_slice(bytes);
    }

    pub fn layout(&self) -> &Layout {
        &self.mc.layout
    }

    pub fn mc(&self) -> &CompiledMc {
        &self.mc
    }

    fn bytes(&self, region: &Region) -> &[u8] {
        let at = region.offset as usize;
        &self.memory.data(&self.store)[at..at + region.len as usize]
    }

    fn bytes_mut<'a>(memory: Memory, store: &'a mut Store<()>, region: &Region) -> &'a mut [u8] {
        let at = region.offset as usize;
        &mut memory.data_mut(store)[at..at + region.len as usize]
    }

    /// The bytes of region number `index` of the layout.
    pub fn region(&self, index: usize) -> &[u8] {
        self.bytes(&self.mc.layout.regions[index])
    }

    pub fn region_mut(&mut self, index: usize) -> &mut [u8] {
        Self::bytes_mut(self.memory, &mut self.store, &self.mc.layout.regions[index])
    }

    pub fn inputs(&self) -> &[u8] {
        self.bytes(&self.mc.layout.inputs)
    }

    pub fn inputs_mut(&mut self) -> &mut [u8] {
        Self::bytes_mut(self.memory, &mut self.store, &self.mc.layout.inputs)
    }

    pub fn outputs(&self) -> &[u8] {
        self.bytes(&self.mc.layout.outputs)
    }

    pub fn outputs_mut(&mut self) -> &mut [u8] {
        Self::bytes_mut(self.memory, &mut self.store, &self.mc.layout.outputs)
    }

    /// Sets all regions and the outputs to their initial values, and the inputs to 0.
    pub fn reset(&mut self) {
        let mc = self.mc.clone();
        for (index, bytes) in mc.layout.initial.iter().enumerate() {
            self.region_mut(index).copy_from_slice(bytes);
        }
        self.outputs_mut()
            .copy_from_slice(&mc.layout.initial_outputs);
        self.inputs_mut().fill(0);
    }

    /// The value of a scalar variable, by its path (`MC1.timer.ET`, `MC1.a[3]`).
    pub fn read(&self, path: &str) -> Option<Value> {
        self.read_variable(&self.mc.layout.find(path)?)
    }

    pub fn read_variable(&self, variable: &VariableInfo) -> Option<Value> {
        let elem = variable.ty.elem()?;
        let area = self.bytes(self.mc.layout.area(variable.area));
        let at = variable.offset as usize;
        let bytes = &area[at..at + variable.len as usize];
        Some(match variable.bit {
            Some(bit) => Value::Bool(bytes[0] >> bit & 1 == 1),
            None => Value::load(elem, &bytes[..elem.image_bytes() as usize]),
        })
    }

    /// The text of a STRING or WSTRING.
    pub fn read_text(&self, variable: &VariableInfo) -> Option<String> {
        let TypeNode::Text { wide, len } = &*variable.ty else {
            return None;
        };
        let area = self.bytes(self.mc.layout.area(variable.area));
        let at = variable.offset as usize;
        let bytes = &area[at..at + variable.len as usize];
        let mut header = [0; 4];
        header.copy_from_slice(&bytes[..4]);
        let count = u32::from_le_bytes(header).min(*len) as usize;
        Some(if *wide {
            let units = bytes[4..4 + count * 2]
                .chunks_exact(2)
                .map(|c| u16::from_le_bytes([c[0], c[1]]));
            char::decode_utf16(units)
                .map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER))
                .collect()
        } else {
            bytes[4..4 + count].iter().map(|b| char::from(*b)).collect()
        })
    }

    /// Writes a STRING or WSTRING, cut to its length. Answers whether the variable is one.
    pub fn write_text(&mut self, variable: &VariableInfo, text: &str) -> bool {
        let TypeNode::Text { wide, len } = *variable.ty else {
            return false;
        };
        let region = self.mc.layout.area(variable.area).clone();
        let area = Self::bytes_mut(self.memory, &mut self.store, &region);
        let at = variable.offset as usize;
        let bytes = &mut area[at..at + variable.len as usize];
        bytes.fill(0);
        let units: Vec<u16> = text.encode_utf16().take(len as usize).collect();
        bytes[..4].copy_from_slice(&(units.len() as u32).to_le_bytes());
        for (index, unit) in units.iter().enumerate() {
            if wide {
                let at = 4 + index * 2;
                bytes[at..at + 2].copy_from_slice(&unit.to_le_bytes());
            } else {
                bytes[4 + index] = u8::try_from(*unit).unwrap_or(b'?');
            }
        }
        true
    }

    /// Writes a scalar variable. An integer is accepted for every integer or bit string type that it fits.
    pub fn write(&mut self, path: &str, value: Value) -> Result<(), WriteError> {
        let variable = self
            .mc
            .layout
            .find(path)
            .ok_or_else(|| WriteError::Unknown(path.to_owned()))?;
        self.write_variable(&variable, value)
    }

    pub fn write_variable(
        &mut self,
        variable: &VariableInfo,
        value: Value,
    ) -> Result<(), WriteError> {
        let Some(elem) = variable.ty.elem() else {
            return Err(WriteError::NotScalar(variable.path.clone()));
        };
        if !value.fits(elem) {
            return Err(WriteError::Type {
                path: variable.path.clone(),
                expected: elem.to_string(),
                value,
            });
        }
        let region = self.mc.layout.area(variable.area).clone();
        let area = Self::bytes_mut(self.memory, &mut self.store, &region);
        let at = variable.offset as usize;
        let bytes = &mut area[at..at + variable.len as usize];
        match (variable.bit, value) {
            (Some(bit), Value::Bool(on)) => {
                bytes[0] = bytes[0] & !(1 << bit) | u8::from(on) << bit;
            }
            _ => value.store(bytes),
        }
        Ok(())
    }
}
