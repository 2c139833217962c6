//! One running MC: its memory, and the call that scans it.

use std::sync::Arc;
use std::sync::atomic::{AtomicPtr, AtomicU32, Ordering};

use wasmtime::{Store, TypedFunc};

use crate::codegen::{CompiledMc, MEMORY_EXPORT, SCAN_EXPORT};
use crate::layout::{Layout, Region, TypeNode, VariableInfo};
use crate::memory::{MC_TIME_AT, SCAN_NUMBER_AT, STOP_AT, TRAP_SITE_AT};
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
    /// Where the memory begins, with its system area, and how long it is. It has its largest size from the beginning, so that it
    /// stays where it is until the store goes; asking the store for it takes as long as the call of a scan. The watchdog may
    /// write the word at `STOP_AT` at any time: no reference may cover it.
    base: AtomicPtr<u8>,
    len: usize,
    scan: TypedFunc<(), ()>,
    /// Number of the latest scan; never 0 again.
    scan_number: u32,
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
        let (base, len) = (memory.data_ptr(&store), memory.data_size(&store));
        let watched = (engine.options.interruption == Interruption::Epoch).then(|| {
            let stop = base.wrapping_add(STOP_AT as usize);
            // SAFETY: `base` is valid until the store goes, and `drop` forgets the watch before.
            let watch = unsafe { engine.watchdog.watch(stop.cast()) };
            (engine.watchdog.clone(), watch)
        });
        Ok(Self {
            store,
            base: AtomicPtr::new(base),
            len,
            scan,
            scan_number: 0,
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
        self.scan_number = self.scan_number.wrapping_add(1);
        // SAFETY: `base` says why it is valid; the words lie in the system area, which every memory has, aligned to 8 bytes, and
        // nothing refers to them while `self` is borrowed.
        unsafe {
            if self.scan_number == 0 {
                // The numbers come again: what was written for one of the last 2^32 scans goes.
                self.scan_number = 1;
                let stop = base.add(STOP_AT as usize).cast::<u32>();
                AtomicU32::from_ptr(stop).store(0, Ordering::Relaxed);
            }
            let time = base.add(MC_TIME_AT as usize).cast::<i64>();
            time.write(mc_time_ns.to_le());
            let number = base.add(SCAN_NUMBER_AT as usize).cast::<u32>();
            number.write(self.scan_number.to_le());
        }
        if let Interruption::Fuel(amount) = self.interruption {
            // Only fails in an engine without fuel.
            let _ = self.store.set_fuel(amount);
        }
        if let Some((watchdog, watch)) = &self.watched {
            watchdog.begin(watch, self.scan_number, budget_ticks);
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
        let trap = trap::explain(&self.mc, error, self.part(0, STOP_AT));
        self.part_mut(TRAP_SITE_AT, 4).fill(0);
        trap
    }

    /// Bytes of the memory. Panics if they lie outside of it or cover the word of the watchdog: layouts that say so are none.
    fn part(&self, offset: u32, len: u32) -> &[u8] {
        let (at, len) = self.checked(offset, len);
        // SAFETY: `base` says why it is valid; `checked` has shown that the bytes lie inside and are not the watchdog's; Wasm writes
        // them only during `scan`, which borrows `self`.
        unsafe { std::slice::from_raw_parts(self.base.load(Ordering::Relaxed).add(at), len) }
    }

    fn part_mut(&mut self, offset: u32, len: u32) -> &mut [u8] {
        let (at, len) = self.checked(offset, len);
        // SAFETY: as in `part`, and `self` is borrowed alone.
        unsafe { std::slice::from_raw_parts_mut(self.base.get_mut().add(at), len) }
    }

    fn checked(&self, offset: u32, len: u32) -> (usize, usize) {
        let (at, end) = (offset as usize, offset as usize + len as usize);
        let stop = STOP_AT as usize;
        assert!(
            end <= self.len && (end <= stop || at >= stop + 4),
            "bytes {at} to {end} of a memory of {}",
            self.len
        );
        (at, len as usize)
    }

    pub fn layout(&self) -> &Layout {
        &self.mc.layout
    }

    pub fn mc(&self) -> &CompiledMc {
        &self.mc
    }

    fn bytes(&self, region: &Region) -> &[u8] {
        self.part(region.offset, region.len)
    }

    /// The bytes of region number `index` of the layout.
    pub fn region(&self, index: usize) -> &[u8] {
        self.bytes(&self.mc.layout.regions[index])
    }

    pub fn region_mut(&mut self, index: usize) -> &mut [u8] {
        let region = &self.mc.layout.regions[index];
        self.part_mut(region.offset, region.len)
    }

    pub fn inputs(&self) -> &[u8] {
        self.bytes(&self.mc.layout.inputs)
    }

    pub fn inputs_mut(&mut self) -> &mut [u8] {
        let region = &self.mc.layout.inputs;
        self.part_mut(region.offset, region.len)
    }

    pub fn outputs(&self) -> &[u8] {
        self.bytes(&self.mc.layout.outputs)
    }

    pub fn outputs_mut(&mut self) -> &mut [u8] {
        let region = &self.mc.layout.outputs;
        self.part_mut(region.offset, region.len)
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
        let area = self.part_mut(region.offset, region.len);
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
        let area = self.part_mut(region.offset, region.len);
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
