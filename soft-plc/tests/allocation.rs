//! A scan allocates nothing: it runs on the real-time thread.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use fam_soft_plc::{
    CheckOptions, CompileSpec, Engine, EngineOptions, Instance, SourceFile, check, compile,
    parse_project,
};

struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as promised by the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as promised by the caller.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn a_scan_allocates_nothing() {
    let text = "
FUNCTION_BLOCK B VAR_INPUT x : REAL; END_VAR VAR y : REAL; t : TON; END_VAR
y := y * 0.5 + SIN(x); t(IN := y > 0.0, PT := T#1s); END_FUNCTION_BLOCK
PROGRAM P VAR b : ARRAY[0..9] OF B; i : INT; q AT %QX0.0 : BOOL; s AT %IX0.0 : BOOL; END_VAR
FOR i := 0 TO 9 DO b[i](x := INT_TO_REAL(i)); END_FOR; q := s; END_PROGRAM";
    let (project, problems) = parse_project(&[SourceFile::new("t.st", text)]);
    assert!(problems.is_empty());
    let typed = check(&project, CheckOptions::default()).expect("checks");
    let spec = CompileSpec {
        entry: "P".into(),
        ..CompileSpec::default()
    };
    let mc = compile(&typed, &spec).expect("compiles");
    let engine = Engine::new(EngineOptions::default()).expect("engine");
    let module = engine.prepare(&mc).expect("module");
    let mut instance = Instance::new(&engine, &module).expect("instance");
    instance.scan(0, 1000).expect("first scan");
    let before = ALLOCATIONS.load(Ordering::Relaxed);
    for scan in 1..100 {
        instance.inputs_mut()[0] = 1;
        instance.scan(scan * 1_000_000, 1000).expect("scan");
        assert_eq!(instance.outputs()[0], 1);
    }
    assert_eq!(ALLOCATIONS.load(Ordering::Relaxed), before);
}
