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
/// `(destination, bytes)`: sets few bytes to 0 without the call that `memory.fill` is.
const CLEAR: u32 = 8;
/// How many there are.
pub const COUNT: u32 = 9;

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
            code: assign_function(wide, imports, ended),
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
    list.push(Helper {
        params: vec![ValType::I32; 2],
        results: Vec::new(),
        code: clear_function(),
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

fn assign_function(wide: bool, imports: u32, ended: bool) -> Function {
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
    c.push(I::Call(imports + MOVE));
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
    c.extend([I::I32Add, I::LocalGet(4), I::LocalGet(3), I::I32Sub]);
    if wide {
        c.extend([I::I32Const(1), I::I32Shl]);
    }
    c.extend([
        I::Call(imports + CLEAR),
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

/// More bytes than that are left to the instruction of Wasm.
const FEW: i32 = 64;

/// Sizes from which on so many words of so many bytes at either end cover all that is to be written; they overlap in the middle.
const COVERS: [(i32, i32, i32); 6] = [
    (33, 16, 2),
    (16, 16, 1),
    (8, 8, 1),
    (4, 4, 1),
    (2, 2, 1),
    (1, 1, 1),
];

/// Offsets of the words from the first byte, and before the end.
fn words(width: i32, each: i32) -> impl Iterator<Item = (bool, i32)> {
    let first = (0..each).map(move |n| (false, n * width));
    let last = (1..=each).map(move |n| (true, n * width));
    first.chain(last)
}

/// Pushes the address of a word of the area at `base`, which has `bytes` bytes.
fn word_at(base: u32, bytes: u32, (from_end, distance): (bool, i32)) -> Vec<I<'static>> {
    let mut code = vec![I::LocalGet(base)];
    if from_end {
        code.extend([I::LocalGet(bytes), I::I32Add]);
        code.extend([I::I32Const(distance), I::I32Sub]);
    } else if distance > 0 {
        code.extend([I::I32Const(distance), I::I32Add]);
    }
    code
}

fn load(width: i32) -> I<'static> {
    match width {
        16 => I::V128Load(at(0, 0)),
        8 => I::I64Load(at(0, 0)),
        4 => I::I32Load(at(0, 0)),
        2 => I::I32Load16U(at(0, 0)),
        _ => I::I32Load8U(at(0, 0)),
    }
}

fn store(width: i32) -> I<'static> {
    match width {
        16 => I::V128Store(at(0, 0)),
        8 => I::I64Store(at(0, 0)),
        4 => I::I32Store(at(0, 0)),
        2 => I::I32Store16(at(0, 0)),
        _ => I::I32Store8(at(0, 0)),
    }
}

/// `many` for more than a few bytes, else what `cover` makes of the words that cover them.
fn by_size(
    bytes: u32,
    many: Vec<I<'static>>,
    cover: impl Fn(i32, i32) -> Vec<I<'static>>,
) -> Vec<I<'static>> {
    let begin = |limit: i32, compare: I<'static>| {
        let size = [I::LocalGet(bytes), I::I32Const(limit), compare];
        [size.as_slice(), &[I::If(BlockType::Empty)]].concat()
    };
    let mut code = begin(FEW, I::I32GtU);
    code.extend(many);
    code.extend([I::Return, I::End]);
    for (least, width, each) in COVERS {
        code.extend(begin(least, I::I32GeU));
        code.extend(cover(width, each));
        code.extend([I::Return, I::End]);
    }
    code
}

fn move_function() -> Function {
    // 0 destination, 1 source, 2 bytes
    let copy = I::MemoryCopy {
        src_mem: 0,
        dst_mem: 0,
    };
    let many = vec![I::LocalGet(0), I::LocalGet(1), I::LocalGet(2), copy];
    let code = by_size(2, many, |width, each| {
        // Everything is read before anything is written, so that the areas may overlap.
        let mut code = Vec::new();
        for word in words(width, each) {
            code.extend(word_at(0, 2, word));
            code.extend(word_at(1, 2, word));
            code.push(load(width));
        }
        code.extend(words(width, each).map(|_| store(width)));
        code
    });
    function(0, code)
}

fn clear_function() -> Function {
    // 0 destination, 1 bytes
    let many = vec![
        I::LocalGet(0),
        I::I32Const(0),
        I::LocalGet(1),
        I::MemoryFill(0),
    ];
    let code = by_size(1, many, |width, each| {
        let mut code = Vec::new();
        for word in words(width, each) {
            code.extend(word_at(0, 1, word));
            code.push(match width {
                16 => I::V128Const(0),
                8 => I::I64Const(0),
                _ => I::I32Const(0),
            });
            code.push(store(width));
        }
        code
    });
    function(0, code)
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
