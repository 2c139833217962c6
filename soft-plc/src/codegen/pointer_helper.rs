//! Small Wasm functions for pointers, in the modules of programs that use them: whether an address lies in variables, and writing
//! bytes that may be characters of a string, whose length then follows.
//!
//! A table tells where strings lie, and constants, which nobody writes: sorted entries of begin, end and kind (`ENTRY_BYTES`).

use wasm_encoder::{BlockType, Function, Instruction as I, ValType};

use super::helper::{self, Helper, at, function};

/// Begin, end, and what lies there: `CONSTANT`, or twice the capacity in characters, plus 1 for a WSTRING.
pub const ENTRY_BYTES: u32 = 12;
/// Kind of what must not be written.
pub const CONSTANT: u32 = u32::MAX;
/// The bit that makes the kind of a string that of a constant one.
pub const CONSTANT_TEXT: u32 = 1 << 31;
/// `wide` of `TEXT` for a string that is written.
pub const WRITTEN: i32 = 2;

/// Why an address is refused: the detail of the trap.
pub const OUTSIDE: i64 = 0;
pub const IS_CONSTANT: i64 = 1;
pub const NO_STRING: i64 = 2;
pub const BEHIND_STRING: i64 = 3;

/// `(address, bytes, site) -> address`: traps unless all of it lies in variables.
pub const REACH: u32 = helper::COUNT;
/// `(address, value, site)`: writes a byte, 4 bytes, 8 bytes.
pub const PUT8: u32 = helper::COUNT + 1;
pub const PUT32: u32 = helper::COUNT + 2;
pub const PUT64: u32 = helper::COUNT + 3;
/// `(address, bytes, site) -> address`: as `REACH`, for what is written as a whole.
pub const AREA: u32 = helper::COUNT + 4;
/// `(address, wide, site) -> address`: traps unless a string of this kind begins there, with its length.
pub const TEXT: u32 = helper::COUNT + 5;
/// `(address) -> characters`: how many the string there can have.
pub const CAPACITY: u32 = helper::COUNT + 6;
/// `(address) -> entry`: the entry of the table that the address lies in, or 0.
const FIND: u32 = helper::COUNT + 7;
/// `(address, bytes)`: strings in what was copied as a whole have no length beyond their capacity.
pub const SETTLE: u32 = helper::COUNT + 8;
/// How many there are.
pub const COUNT: u32 = 9;

/// Where variables lie, and the table.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reach {
    pub from: u32,
    pub to: u32,
    pub table: u32,
    pub entries: u32,
}

/// All of them in the order of their numbers, behind so many imports.
pub fn all(imports: u32, reach: Reach) -> Vec<Helper> {
    let i32s = |n: usize| vec![ValType::I32; n];
    let one = || vec![ValType::I32];
    let c = Calls { imports };
    let helper = |params: Vec<ValType>, results: Vec<ValType>, code: Function| Helper {
        params,
        results,
        code,
    };
    let long = vec![ValType::I32, ValType::I64, ValType::I32];
    vec![
        helper(i32s(3), one(), c.reach(reach)),
        helper(i32s(3), Vec::new(), c.put8()),
        helper(i32s(3), Vec::new(), c.put_wide(false)),
        helper(long, Vec::new(), c.put_wide(true)),
        helper(i32s(3), one(), c.area()),
        helper(i32s(3), one(), c.text()),
        helper(i32s(1), one(), c.capacity()),
        helper(i32s(1), one(), find(reach)),
        helper(i32s(2), Vec::new(), settle(reach)),
    ]
}

struct Calls {
    imports: u32,
}

impl Calls {
    fn call(&self, helper: u32) -> I<'static> {
        I::Call(helper + self.imports)
    }

    /// Stops with the site in the local, if the i32 on the stack is not 0.
    fn trap(&self, site: u32, detail: i64, c: &mut Vec<I<'static>>) {
        c.extend([
            I::If(BlockType::Empty),
            I::LocalGet(site),
            I::I64Const(detail),
            self.call(helper::TRAP),
            I::Unreachable,
            I::End,
        ]);
    }

    fn reach(&self, reach: Reach) -> Function {
        let span = reach.to.saturating_sub(reach.from) as i32;
        let mut c = vec![
            I::LocalGet(1),
            I::I32Const(span),
            I::I32GtU,
            I::LocalGet(0),
            I::I32Const(reach.from as i32),
            I::I32Sub,
            I::I32Const(span),
            I::LocalGet(1),
            I::I32Sub,
            I::I32GtU,
            I::I32Or,
        ];
        self.trap(2, OUTSIDE, &mut c);
        c.push(I::LocalGet(0));
        function(0, c)
    }

    fn put8(&self) -> Function {
        // 0 address, 1 value, 2 site, 3 entry and then begin, 4 kind, 5 index of the character, 6 capacity, 7 wide, 8 length
        const ENTRY: u32 = 3;
        const BEGIN: u32 = 3;
        const KIND: u32 = 4;
        const INDEX: u32 = 5;
        const CAPACITY: u32 = 6;
        const WIDE: u32 = 7;
        const LENGTH: u32 = 8;
        let byte = [I::LocalGet(0), I::LocalGet(1), I::I32Store8(at(0, 0))];
        let mut c = vec![
            I::LocalGet(0),
            self.call(FIND),
            I::LocalTee(ENTRY),
            I::I32Eqz,
            I::If(BlockType::Empty),
        ];
        c.extend(byte.clone());
        c.extend([
            I::Return,
            I::End,
            I::LocalGet(ENTRY),
            I::I32Load(at(8, 2)),
            I::LocalTee(KIND),
            I::I32Const(0),
            I::I32LtS,
        ]);
        self.trap(2, IS_CONSTANT, &mut c);
        c.extend([
            I::LocalGet(ENTRY),
            I::I32Load(at(0, 2)),
            I::LocalSet(BEGIN),
            I::LocalGet(KIND),
            I::I32Const(1),
            I::I32And,
            I::LocalSet(WIDE),
            I::LocalGet(KIND),
            I::I32Const(1),
            I::I32ShrU,
            I::LocalSet(CAPACITY),
            I::LocalGet(0),
            I::LocalGet(BEGIN),
            I::I32Sub,
            I::I32Const(4),
            I::I32Sub,
            I::LocalGet(WIDE),
            I::I32ShrU,
            I::LocalTee(INDEX),
            // At its end a string has a 0, and nothing else fits there. Its length, which lies before the characters, is no
            // variable (as a number without sign the index is large): what is copied or cleared over it takes care of itself.
            I::LocalGet(CAPACITY),
            I::I32GeU,
            I::If(BlockType::Empty),
            I::LocalGet(1),
            I::I32Const(255),
            I::I32And,
            I::I32Const(0),
            I::I32Ne,
            I::LocalGet(INDEX),
            I::LocalGet(CAPACITY),
            I::I32Eq,
            I::I32And,
        ]);
        self.trap(2, BEHIND_STRING, &mut c);
        c.extend([I::Return, I::End]);
        c.extend(byte);
        c.extend([
            I::LocalGet(BEGIN),
            I::I32Load(at(0, 2)),
            I::LocalSet(LENGTH),
            I::LocalGet(INDEX),
            I::LocalGet(LENGTH),
            I::I32LtU,
            I::If(BlockType::Empty),
        ]);
        unit(BEGIN, INDEX, WIDE, &mut c);
        c.extend([
            I::I32Eqz,
            I::If(BlockType::Empty),
            I::LocalGet(BEGIN),
            I::LocalGet(INDEX),
            I::I32Store(at(0, 2)),
            // What stood behind is no more.
            I::LocalGet(BEGIN),
            I::I32Const(4),
            I::I32Add,
            I::LocalGet(INDEX),
            I::LocalGet(WIDE),
            I::I32Shl,
            I::I32Add,
            I::I32Const(0),
            I::LocalGet(CAPACITY),
            I::LocalGet(INDEX),
            I::I32Sub,
            I::LocalGet(WIDE),
            I::I32Shl,
            I::MemoryFill(0),
            I::End,
            I::Return,
            I::End,
            I::LocalGet(INDEX),
            I::LocalGet(LENGTH),
            I::I32Eq,
            I::If(BlockType::Empty),
            // On to the next 0.
            I::Block(BlockType::Empty),
            I::Loop(BlockType::Empty),
            I::LocalGet(INDEX),
            I::LocalGet(CAPACITY),
            I::I32GeU,
            I::BrIf(1),
        ]);
        unit(BEGIN, INDEX, WIDE, &mut c);
        c.extend([
            I::I32Eqz,
            I::BrIf(1),
            I::LocalGet(INDEX),
            I::I32Const(1),
            I::I32Add,
            I::LocalSet(INDEX),
            I::Br(0),
            I::End,
            I::End,
            I::LocalGet(BEGIN),
            I::LocalGet(INDEX),
            I::I32Store(at(0, 2)),
            I::End,
        ]);
        function(6, c)
    }

    /// 4 or 8 bytes: at once where no string and no constant is touched, else byte by byte.
    fn put_wide(&self, long: bool) -> Function {
        let bytes = if long { 8 } else { 4 };
        let mut c = vec![
            I::LocalGet(0),
            self.call(FIND),
            I::LocalGet(0),
            I::I32Const(bytes - 1),
            I::I32Add,
            self.call(FIND),
            I::I32Or,
            I::I32Eqz,
            I::If(BlockType::Empty),
            I::LocalGet(0),
            I::LocalGet(1),
            if long {
                I::I64Store(at(0, 0))
            } else {
                I::I32Store(at(0, 0))
            },
            I::Return,
            I::End,
        ];
        for byte in 0..bytes {
            c.extend([I::LocalGet(0), I::I32Const(byte), I::I32Add, I::LocalGet(1)]);
            if long {
                c.extend([I::I64Const(i64::from(byte) * 8), I::I64ShrU, I::I32WrapI64]);
            } else {
                c.extend([I::I32Const(byte * 8), I::I32ShrU]);
            }
            c.extend([I::I32Const(255), I::I32And, I::LocalGet(2), self.call(PUT8)]);
        }
        function(0, c)
    }

    fn area(&self) -> Function {
        let mut c = vec![
            I::LocalGet(0),
            I::LocalGet(1),
            I::LocalGet(2),
            self.call(REACH),
            I::Drop,
        ];
        for last in [false, true] {
            c.push(I::LocalGet(0));
            if last {
                c.extend([I::LocalGet(1), I::I32Add, I::I32Const(1), I::I32Sub]);
            }
            c.extend([
                self.call(FIND),
                I::LocalTee(3),
                I::If(BlockType::Empty),
                I::LocalGet(3),
                I::I32Load(at(8, 2)),
                I::I32Const(0),
                I::I32LtS,
            ]);
            self.trap(2, IS_CONSTANT, &mut c);
            c.push(I::End);
        }
        c.push(I::LocalGet(0));
        function(1, c)
    }

    fn text(&self) -> Function {
        // 3 entry
        let mut c = vec![I::LocalGet(0), self.call(FIND), I::LocalTee(3), I::I32Eqz];
        self.trap(2, NO_STRING, &mut c);
        c.extend([
            I::LocalGet(3),
            I::I32Load(at(0, 2)),
            I::LocalGet(0),
            I::I32Ne,
            I::LocalGet(3),
            I::I32Load(at(8, 2)),
            I::I32Const(CONSTANT as i32),
            I::I32Eq,
            I::I32Or,
            I::LocalGet(3),
            I::I32Load(at(8, 2)),
            I::I32Const(1),
            I::I32And,
            I::LocalGet(1),
            I::I32Const(1),
            I::I32And,
            I::I32Ne,
            I::I32Or,
        ]);
        self.trap(2, NO_STRING, &mut c);
        c.extend([
            I::LocalGet(3),
            I::I32Load(at(8, 2)),
            I::I32Const(0),
            I::I32LtS,
            I::LocalGet(1),
            I::I32Const(1),
            I::I32ShrU,
            I::I32And,
        ]);
        self.trap(2, IS_CONSTANT, &mut c);
        c.push(I::LocalGet(0));
        function(1, c)
    }

    fn capacity(&self) -> Function {
        let c = vec![
            I::LocalGet(0),
            self.call(FIND),
            I::I32Load(at(8, 2)),
            I::I32Const(1),
            I::I32ShrU,
        ];
        function(0, c)
    }
}

/// Pushes the character number `index` of the string that begins at `begin`.
fn unit(begin: u32, index: u32, wide: u32, c: &mut Vec<I<'static>>) {
    c.extend([
        I::LocalGet(begin),
        I::LocalGet(index),
        I::LocalGet(wide),
        I::I32Shl,
        I::I32Add,
        I::I32Load16U(at(4, 0)),
        I::I32Const(0xff),
        I::I32Const(0xffff),
        I::LocalGet(wide),
        I::I32Eqz,
        I::Select,
        I::I32And,
    ]);
}

/// Pushes how many entries begin at or before the address in local 0; locals 1 to 3 are used.
fn search(reach: Reach, c: &mut Vec<I<'static>>) {
    c.extend([
        I::I32Const(0),
        I::LocalSet(1),
        I::I32Const(reach.entries as i32),
        I::LocalSet(2),
        I::Block(BlockType::Empty),
        I::Loop(BlockType::Empty),
        I::LocalGet(1),
        I::LocalGet(2),
        I::I32GeU,
        I::BrIf(1),
        I::LocalGet(1),
        I::LocalGet(2),
        I::I32Add,
        I::I32Const(1),
        I::I32ShrU,
        I::LocalTee(3),
        I::I32Const(ENTRY_BYTES as i32),
        I::I32Mul,
        I::I32Load(at(reach.table, 2)),
        I::LocalGet(0),
        I::I32LeU,
        I::If(BlockType::Empty),
        I::LocalGet(3),
        I::I32Const(1),
        I::I32Add,
        I::LocalSet(1),
        I::Else,
        I::LocalGet(3),
        I::LocalSet(2),
        I::End,
        I::Br(0),
        I::End,
        I::End,
    ]);
}

fn find(reach: Reach) -> Function {
    let mut c = Vec::new();
    search(reach, &mut c);
    c.extend([
        I::LocalGet(1),
        I::I32Eqz,
        I::If(BlockType::Empty),
        I::I32Const(0),
        I::Return,
        I::End,
        I::LocalGet(1),
        I::I32Const(1),
        I::I32Sub,
        I::I32Const(ENTRY_BYTES as i32),
        I::I32Mul,
        I::I32Const(reach.table as i32),
        I::I32Add,
        I::LocalTee(2),
        I::I32Const(0),
        I::LocalGet(0),
        I::LocalGet(2),
        I::I32Load(at(4, 2)),
        I::I32LtU,
        I::Select,
    ]);
    function(3, c)
}

fn settle(reach: Reach) -> Function {
    // 0 address and then the end, 1 bytes and then entry, 4 begin of the area, 5 begin of the string, 6 capacity
    let mut c = vec![
        I::LocalGet(0),
        I::LocalSet(4),
        I::LocalGet(0),
        I::LocalGet(1),
        I::I32Add,
        I::I32Const(1),
        I::I32Sub,
        I::LocalSet(0),
    ];
    search(reach, &mut c);
    c.extend([
        I::Block(BlockType::Empty),
        I::Loop(BlockType::Empty),
        I::LocalGet(1),
        I::I32Eqz,
        I::BrIf(1),
        I::LocalGet(1),
        I::I32Const(1),
        I::I32Sub,
        I::LocalTee(1),
        I::I32Const(ENTRY_BYTES as i32),
        I::I32Mul,
        I::LocalTee(2),
        I::I32Load(at(reach.table + 4, 2)),
        I::LocalGet(4),
        I::I32LeU,
        I::BrIf(1),
        I::LocalGet(2),
        I::I32Load(at(reach.table + 8, 2)),
        I::LocalTee(6),
        I::I32Const(0),
        I::I32LtS,
        I::BrIf(0),
        I::LocalGet(2),
        I::I32Load(at(reach.table, 2)),
        I::LocalTee(5),
        I::I32Load(at(0, 2)),
        I::LocalGet(6),
        I::I32Const(1),
        I::I32ShrU,
        I::I32GtU,
        I::If(BlockType::Empty),
        I::LocalGet(5),
        I::LocalGet(6),
        I::I32Const(1),
        I::I32ShrU,
        I::I32Store(at(0, 2)),
        I::End,
        I::Br(0),
        I::End,
        I::End,
    ]);
    function(5, c)
}
