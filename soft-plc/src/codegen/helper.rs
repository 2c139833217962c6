//! Small Wasm functions that stand in every module before those of the POUs: the trap, and loops over strings.

use wasm_encoder::{BlockType, Function, Instruction as I, MemArg, ValType};

use crate::memory::{TRAP_DETAIL_AT, TRAP_SITE_AT};

/// Numbers of the helpers.
pub const TRAP: u32 = 0;
const ASSIGN: u32 = 1;
const COMPARE: u32 = 3;
const FIND: u32 = 5;
/// `(destination, source, bytes)`: copies few bytes without the call that `memory.copy` is; the areas may overlap.
pub const MOVE: u32 = 7;
/// How many there are.
pub const COUNT: u32 = 8;

/// `(destination, capacity, source, length)`: stores a string, cut to its capacity; what is left of a longer one becomes 0.
pub fn assign(wide: bool) -> u32 {
    ASSIGN + u32::from(wide)
}

/// `(a, length, b, length) -> i32`: negative, 0 or positive.
pub fn compare(wide: bool) -> u32 {
    COMPARE + u32::from(wide)
}

/// `(text, length, wanted, length) -> i32`: where it begins, counted from 1; 0 if it is not there.
pub fn find(wide: bool) -> u32 {
    FIND + u32::from(wide)
}

pub struct Helper {
    pub params: Vec<ValType>,
    pub results: Vec<ValType>,
    pub code: Function,
}

/// All helpers in the order of their numbers, behind so many imports. `ended`: a string has a 0 behind its last character.
pub fn all(imports: u32, ended: bool) -> Vec<Helper> {
    let four = || vec![ValType::I32; 4];
    let mut list = vec![Helper {
        params: vec![ValType::I32, ValType::I64],
        results: Vec::new(),
        code: trap_function(),
    }];
    for wide in [false, true] {
        list.push(Helper {
            params: four(),
            results: Vec::new(),
            code: assign_function(wide, imports + MOVE, ended),
        });
    }
    for wide in [false, true] {
        list.push(Helper {
            params: four(),
            results: vec![ValType::I32],
            code: compare_function(wide),
        });
    }
    for wide in [false, true] {
        list.push(Helper {
            params: four(),
            results: vec![ValType::I32],
            code: find_function(wide),
        });
    }
    list.push(Helper {
        params: vec![ValType::I32; 3],
        results: Vec::new(),
        code: move_function(),
    });
    list
}

pub fn at(offset: u32, align: u32) -> MemArg {
    MemArg {
        offset: u64::from(offset),
        align,
        memory_index: 0,
    }
}

pub fn function(locals: u32, code: Vec<I<'static>>) -> Function {
    let mut f = Function::new([(locals, ValType::I32)]);
    for instruction in code {
        f.instruction(&instruction);
    }
    f.instruction(&I::End);
    f
}

fn trap_function() -> Function {
    let mut f = Function::new([]);
    for instruction in [
        I::I32Const(0),
        I::LocalGet(0),
        I::I32Store(at(TRAP_SITE_AT, 2)),
        I::I32Const(0),
        I::LocalGet(1),
        I::I64Store(at(TRAP_DETAIL_AT, 3)),
        I::Unreachable,
        I::End,
    ] {
        f.instruction(&instruction);
    }
    f
}

/// Pushes the local, shifted to bytes.
fn bytes(local: u32, wide: bool, code: &mut Vec<I<'static>>) {
    code.push(I::LocalGet(local));
    if wide {
        code.extend([I::I32Const(1), I::I32Shl]);
    }
}

fn assign_function(wide: bool, mover: u32, ended: bool) -> Function {
    // 0 destination, 1 capacity, 2 source, 3 length, 4 length before
    let mut c = vec![
        I::LocalGet(3),
        I::LocalGet(1),
        I::LocalGet(3),
        I::LocalGet(1),
        I::I32LtU,
        I::Select,
        I::LocalSet(3),
        I::LocalGet(0),
        I::I32Load(at(0, 2)),
        I::LocalSet(4),
        I::LocalGet(0),
        I::I32Const(4),
        I::I32Add,
        I::LocalGet(2),
    ];
    bytes(3, wide, &mut c);
    c.push(I::Call(mover));
    c.extend([
        I::LocalGet(4),
        I::LocalGet(3),
        I::I32GtU,
        I::If(BlockType::Empty),
        I::LocalGet(0),
        I::I32Const(4),
        I::I32Add,
    ]);
    bytes(3, wide, &mut c);
    c.extend([
        I::I32Add,
        I::I32Const(0),
        I::LocalGet(4),
        I::LocalGet(3),
        I::I32Sub,
    ]);
    if wide {
        c.extend([I::I32Const(1), I::I32Shl]);
    }
    c.extend([
        I::MemoryFill(0),
        I::End,
        I::LocalGet(0),
        I::LocalGet(3),
        I::I32Store(at(0, 2)),
    ]);
    if ended {
        c.push(I::LocalGet(0));
        bytes(3, wide, &mut c);
        c.extend([I::I32Add, I::I32Const(0)]);
        c.push(if wide {
            I::I32Store16(at(4, 0))
        } else {
            I::I32Store8(at(4, 0))
        });
    }
    function(1, c)
}

fn move_function() -> Function {
    // 0 destination, 1 source, 2 bytes. Everything is read before anything is written, so that the areas may overlap.
    let mut c = vec![
        I::LocalGet(2),
        I::I32Const(16),
        I::I32GtU,
        I::If(BlockType::Empty),
        I::LocalGet(0),
        I::LocalGet(1),
        I::LocalGet(2),
        I::MemoryCopy {
            src_mem: 0,
            dst_mem: 0,
        },
        I::Return,
        I::End,
    ];
    // Two words that overlap: the first bytes and the last ones.
    for (width, load, store) in [
        (8, I::I64Load(at(0, 0)), I::I64Store(at(0, 0))),
        (4, I::I32Load(at(0, 0)), I::I32Store(at(0, 0))),
        (2, I::I32Load16U(at(0, 0)), I::I32Store16(at(0, 0))),
        (1, I::I32Load8U(at(0, 0)), I::I32Store8(at(0, 0))),
    ] {
        let last = |base: u32| {
            [
                I::LocalGet(base),
                I::LocalGet(2),
                I::I32Add,
                I::I32Const(width),
                I::I32Sub,
            ]
        };
        c.extend([
            I::LocalGet(2),
            I::I32Const(width),
            I::I32GeU,
            I::If(BlockType::Empty),
        ]);
        c.push(I::LocalGet(0));
        c.extend([I::LocalGet(1), load.clone()]);
        c.extend(last(0));
        c.extend(last(1));
        c.extend([load, store.clone(), store, I::Return, I::End]);
    }
    function(0, c)
}

/// Pushes the character at `base + index`.
fn unit(base: u32, index: u32, wide: bool, code: &mut Vec<I<'static>>) {
    code.push(I::LocalGet(base));
    bytes(index, wide, code);
    code.push(I::I32Add);
    code.push(if wide {
        I::I32Load16U(at(0, 0))
    } else {
        I::I32Load8U(at(0, 0))
    });
}

fn compare_function(wide: bool) -> Function {
    // 0 a, 1 its length, 2 b, 3 its length, 4 index, 5 shorter length, 6 difference
    let mut c = vec![
        I::LocalGet(1),
        I::LocalGet(3),
        I::LocalGet(1),
        I::LocalGet(3),
        I::I32LtU,
        I::Select,
        I::LocalSet(5),
        I::Block(BlockType::Empty),
        I::Loop(BlockType::Empty),
        I::LocalGet(4),
        I::LocalGet(5),
        I::I32GeU,
        I::BrIf(1),
    ];
    unit(0, 4, wide, &mut c);
    unit(2, 4, wide, &mut c);
    c.extend([
        I::I32Sub,
        I::LocalTee(6),
        I::If(BlockType::Empty),
        I::LocalGet(6),
        I::Return,
        I::End,
        I::LocalGet(4),
        I::I32Const(1),
        I::I32Add,
        I::LocalSet(4),
        I::Br(0),
        I::End,
        I::End,
        I::LocalGet(1),
        I::LocalGet(3),
        I::I32Sub,
    ]);
    function(3, c)
}

fn find_function(wide: bool) -> Function {
    // 0 text, 1 its length, 2 wanted, 3 its length, 4 start, 5 index, 6 place
    let mut c = vec![
        I::LocalGet(3),
        I::I32Eqz,
        I::If(BlockType::Empty),
        I::I32Const(0),
        I::Return,
        I::End,
        I::Block(BlockType::Empty),
        I::Loop(BlockType::Empty),
        I::LocalGet(4),
        I::LocalGet(3),
        I::I32Add,
        I::LocalGet(1),
        I::I32GtU,
        I::BrIf(1),
        I::I32Const(0),
        I::LocalSet(5),
        I::Block(BlockType::Empty),
        I::Loop(BlockType::Empty),
        I::LocalGet(5),
        I::LocalGet(3),
        I::I32Eq,
        I::If(BlockType::Empty),
        I::LocalGet(4),
        I::I32Const(1),
        I::I32Add,
        I::Return,
        I::End,
        I::LocalGet(4),
        I::LocalGet(5),
        I::I32Add,
        I::LocalSet(6),
    ];
    unit(0, 6, wide, &mut c);
    unit(2, 5, wide, &mut c);
    c.extend([
        I::I32Ne,
        I::BrIf(1),
        I::LocalGet(5),
        I::I32Const(1),
        I::I32Add,
        I::LocalSet(5),
        I::Br(0),
        I::End,
        I::End,
        I::LocalGet(4),
        I::I32Const(1),
        I::I32Add,
        I::LocalSet(4),
        I::Br(0),
        I::End,
        I::End,
        I::I32Const(0),
    ]);
    function(3, c)
}
