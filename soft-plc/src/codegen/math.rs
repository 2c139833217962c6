//! SIN, COS, EXP, LN and ATAN of LREAL in Wasm, for the arguments that programs have. A call out of the module costs as much as
//! the function itself; what is seldom (huge, tiny, not a number, close to a multiple of pi/2) goes there all the same.
//!
//! The formulas are those of the `libm` crate, operation by operation, so that both give the same bits. They come from FreeBSD's
//! msun, whose files say:
//!
//! > Copyright (C) 1993, 2004 by Sun Microsystems, Inc. All rights reserved.
//! > Developed at SunPro, a Sun Microsystems, Inc. business. Permission to use, copy, modify, and distribute this software is
//! > freely granted, provided that this notice is preserved.

#![expect(
    clippy::excessive_precision,
    reason = "the coefficients stand as msun has them"
)]

use std::ops::{Add, Div, Mul, Sub};

use wasm_encoder::{BlockType, Function, Instruction as I, ValType};

use super::linked;

type Code = Vec<I<'static>>;

/// The argument of every formula.
const X: u32 = 0;
/// Further locals: LREALs from 1 on, then a word.
const REALS: u32 = 7;
const WORD: u32 = 8;

/// 1.5 times 2^52: a small number that is added to it is rounded to a whole one, which stands in the last bits.
const WHOLE: f64 = 6_755_399_441_055_744.0;

/// One function of the module.
pub struct Formula {
    name: &'static str,
    code: Code,
}

impl Formula {
    /// The formula of the function that is imported as `name`, under the number `import`.
    pub fn of(name: &'static str, import: u32) -> Option<Self> {
        let mut code = match name {
            "sin" => circle(0),
            "cos" => circle(1),
            "exp" => exponential(),
            "log" => logarithm(),
            "atan" => arc_tangent(),
            _ => return None,
        };
        code.extend([I::LocalGet(X), I::Call(import), I::End]);
        Some(Self { name, code })
    }

    pub fn name(&self) -> &'static str {
        self.name
    }

    pub fn encode(&self, import_count: u32) -> Function {
        let mut f = Function::new([(REALS, ValType::F64), (1, ValType::I32)]);
        for instruction in &self.code {
            f.instruction(&linked(instruction, import_count));
        }
        f
    }
}

/// Code that pushes one LREAL.
#[derive(Clone)]
struct Real(Code);

fn real(value: f64) -> Real {
    Real(vec![I::F64Const(value.into())])
}

fn get(local: u32) -> Real {
    Real(vec![I::LocalGet(local)])
}

impl Real {
    fn then(mut self, instruction: I<'static>) -> Self {
        self.0.push(instruction);
        self
    }

    fn with(mut self, other: Self, instruction: I<'static>) -> Self {
        self.0.extend(other.0);
        self.then(instruction)
    }

    /// The upper half of its bits.
    fn high_word(self) -> Code {
        let mut code = self.then(I::I64ReinterpretF64).0;
        code.extend([I::I64Const(32), I::I64ShrU, I::I32WrapI64]);
        code
    }

    fn abs(self) -> Self {
        self.then(I::F64Abs)
    }
}

impl Add for Real {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        self.with(other, I::F64Add)
    }
}

impl Sub for Real {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self.with(other, I::F64Sub)
    }
}

impl Mul for Real {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        self.with(other, I::F64Mul)
    }
}

impl Div for Real {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        self.with(other, I::F64Div)
    }
}

/// Code of several parts.
fn all<const N: usize>(parts: [Code; N]) -> Code {
    parts.concat()
}

fn set(local: u32, value: Real) -> Code {
    value.then(I::LocalSet(local)).0
}

fn give(value: Real) -> Code {
    value.then(I::Return).0
}

fn when(condition: Code, then: Code) -> Code {
    let begin = vec![I::If(BlockType::Empty)];
    all([condition, begin, then, vec![I::End]])
}

fn either(condition: Code, then: Code, otherwise: Code) -> Code {
    let begin = vec![I::If(BlockType::Empty)];
    let end = vec![I::End];
    all([condition, begin, then, vec![I::Else], otherwise, end])
}

fn less(a: Real, b: f64) -> Code {
    a.with(real(b), I::F64Lt).0
}

/// Whether the unsigned word is less.
fn below(word: Code, limit: u32) -> Code {
    all([word, vec![I::I32Const(limit as i32), I::I32LtU]])
}

/// `c[0] + z * (c[1] + z * (...))`.
fn polynomial(z: u32, c: &[f64]) -> Real {
    match c {
        [last] => real(*last),
        [first, rest @ ..] => real(*first) + get(z) * polynomial(z, rest),
        [] => real(0.0),
    }
}

/// Up to here sine and cosine need no reduction; a little less than pi/4.
const QUARTER: f64 = std::f64::consts::FRAC_PI_4 - 1e-4;

const S1: f64 = -1.666_666_666_666_663_243_48e-1;
const S: [f64; 5] = [
    8.333_333_333_322_489_461_24e-3,
    -1.984_126_982_985_794_931_34e-4,
    2.755_731_370_707_006_767_89e-6,
    -2.505_076_025_340_686_341_95e-8,
    1.589_690_995_211_550_102_21e-10,
];
const C: [f64; 6] = [
    4.166_666_666_666_660_190_37e-2,
    -1.388_888_888_887_410_957_49e-3,
    2.480_158_728_947_672_941_78e-5,
    -2.755_731_435_139_066_330_35e-7,
    2.087_572_321_298_174_827_90e-9,
    -1.135_964_755_778_819_482_65e-11,
];

/// Sine of `y + tail` below pi/4; `z`, `w` are for its own use.
fn sine_of(y: u32, tail: Option<u32>, z: u32, w: u32) -> Code {
    let square = all([set(z, get(y) * get(y)), set(w, get(z) * get(z))]);
    let r = polynomial(z, &S[..3]) + get(z) * get(w) * polynomial(z, &S[3..]);
    let prepare = all([square, set(w, r)]);
    let v = || get(z) * get(y);
    let value = match tail {
        None => get(y) + v() * (real(S1) + get(z) * get(w)),
        Some(tail) => {
            let small = get(z) * (real(0.5) * get(tail) - v() * get(w)) - get(tail);
            get(y) - (small - v() * real(S1))
        }
    };
    all([prepare, value.0])
}

fn cosine_of(y: u32, tail: Option<u32>, z: u32, w: u32) -> Code {
    let square = all([set(z, get(y) * get(y)), set(w, get(z) * get(z))]);
    let r = get(z) * polynomial(z, &C[..3]) + get(w) * get(w) * polynomial(z, &C[3..]);
    let last = match tail {
        None => get(z) * r,
        Some(tail) => get(z) * r - get(y) * get(tail),
    };
    let half = || real(0.5) * get(z);
    // The rounding of 1 - half is put back.
    let one = || real(1.0) - half();
    let value = one() + ((real(1.0) - one() - half()) + last);
    all([square, value.0])
}

/// Sine, or a quarter of a turn further, cosine.
fn circle(turn: i32) -> Code {
    let (size, whole, y, tail, z, w) = (1, 2, 3, 4, 5, 6);
    let direct = if turn == 0 {
        let tiny = 1.0 / f64::from(1 << 26);
        let value = all([sine_of(X, None, z, w), vec![I::Return]]);
        when(get(size).with(real(tiny), I::F64Ge).0, value)
    } else {
        all([cosine_of(X, None, z, w), vec![I::Return]])
    };
    // x = whole * pi/2 + y + tail, by pi/2 in two parts.
    let rounded = get(X) * real(std::f64::consts::FRAC_2_PI) + real(WHOLE);
    let quadrant = rounded.then(I::LocalTee(whole)).then(I::I64ReinterpretF64);
    let quadrant = all([
        quadrant.0,
        vec![I::I32WrapI64, I::I32Const(turn), I::I32Add],
        vec![I::LocalSet(WORD)],
        set(whole, get(whole) - real(WHOLE)),
    ]);
    let high = f64::from_bits(0x3ff9_21fb_5440_0000);
    let low = f64::from_bits(0x3dd0_b461_1a62_6331);
    let reduce = all([
        set(z, get(X) - get(whole) * real(high)),
        set(w, get(whole) * real(low)),
        set(y, get(z) - get(w)),
        set(tail, get(z) - get(y) - get(w)),
    ]);
    // Where the difference keeps too few bits (so beyond 51,000) or lies at the edge, the whole reduction is asked.
    let close = get(size) * real(1.0 / 65_536.0);
    let good = all([
        get(y).abs().with(real(QUARTER), I::F64Le).0,
        get(y).abs().with(close, I::F64Ge).0,
        vec![I::I32And],
    ]);
    let odd = vec![I::LocalGet(WORD), I::I32Const(1), I::I32And];
    let value = all([
        odd,
        vec![I::If(BlockType::Result(ValType::F64))],
        cosine_of(y, Some(tail), z, w),
        vec![I::Else],
        sine_of(y, Some(tail), z, w),
        vec![I::End],
    ]);
    let signed = all([
        set(z, Real(value)),
        when(
            vec![I::LocalGet(WORD), I::I32Const(2), I::I32And],
            give(get(z).then(I::F64Neg)),
        ),
        give(get(z)),
    ]);
    let far = all([quadrant, reduce, when(good, signed)]);
    all([
        set(size, get(X).abs()),
        either(less(get(size), QUARTER), direct, far),
    ])
}

/// x = k * ln 2 + r, and e^r by a quotient of polynomials.
fn exponential() -> Code {
    let (k, high, low, r, c) = (1, 2, 3, 4, 5);
    const P: [f64; 5] = [
        1.666_666_666_666_660_190_37e-1,
        -2.777_777_777_701_559_338_42e-3,
        6.613_756_321_437_934_361_17e-5,
        -1.653_390_220_546_525_153_90e-6,
        4.138_136_797_057_238_460_39e-8,
    ];
    let size = all([
        get(X).high_word(),
        vec![I::I32Const(0x7fff_ffff), I::I32And, I::LocalSet(WORD)],
    ]);
    let word = || vec![I::LocalGet(WORD)];
    let signed = |of: Real| of.with(get(X), I::F64Copysign);
    let nearest = real(std::f64::consts::LOG2_E) * get(X) + signed(real(0.5));
    // k is 0 up to half of ln 2, and 1 up to one and a half.
    let multiple = either(
        below(word(), 0x3fd6_2e43),
        set(k, real(0.0)),
        either(
            below(word(), 0x3ff0_a2b2),
            set(k, signed(real(1.0))),
            set(k, nearest.then(I::F64Trunc)),
        ),
    );
    let ln2_high = f64::from_bits(0x3fe6_2e42_fee0_0000);
    let ln2_low = f64::from_bits(0x3dea_39ef_3579_3c76);
    let reduce = all([
        set(high, get(X) - get(k) * real(ln2_high)),
        set(low, get(k) * real(ln2_low)),
        set(r, get(high) - get(low)),
        set(c, get(r) * get(r)),
        set(c, get(r) - get(c) * polynomial(c, &P)),
    ]);
    let power = get(r) * get(c) / (real(2.0) - get(c)) - get(low) + get(high);
    // 2^k: k goes to where the exponent is.
    let mut scale = (get(k) + real(WHOLE)).then(I::I64ReinterpretF64).0;
    scale.extend([I::I64Const(52), I::I64Shl]);
    scale.extend([I::I64Const(1023 << 52), I::I64Add, I::F64ReinterpretI64]);
    let value = give((real(1.0) + power) * Real(scale));
    let usual = all([
        less(get(X).abs(), 708.0),
        vec![I::LocalGet(WORD), I::I32Const(0x3e30_0000), I::I32GtU],
        vec![I::I32And],
    ]);
    all([size, when(usual, all([multiple, reduce, value]))])
}

/// x = 2^k * (1 + f) with 1 + f around 1, and ln(1 + f) by a polynomial.
fn logarithm() -> Code {
    let (f, half, s, z, w, k, m) = (1, 2, 3, 4, 5, 6, 7);
    const EVEN: [f64; 3] = [
        3.999_999_999_940_941_908e-1,
        2.222_219_843_214_978_396e-1,
        1.531_383_769_920_937_332e-1,
    ];
    const ODD: [f64; 4] = [
        6.666_666_666_666_735_130e-1,
        2.857_142_874_366_239_149e-1,
        1.818_357_216_161_805_012e-1,
        1.479_819_860_511_658_591e-1,
    ];
    const ROOT_HALF: i64 = 0x3fe6_a09e << 32;
    let bits = || get(m).then(I::I64ReinterpretF64).0;
    let mut shifted = get(X).then(I::I64ReinterpretF64).0;
    shifted.extend([I::I64Const((0x3ff0_0000 << 32) - ROOT_HALF), I::I64Add]);
    let mut exponent = bits();
    exponent.extend([I::I64Const(52), I::I64ShrU, I::I32WrapI64]);
    exponent.extend([I::I32Const(0x3ff), I::I32Sub, I::F64ConvertI32S]);
    let mut mantissa = bits();
    mantissa.extend([I::I64Const((1 << 52) - 1), I::I64And]);
    mantissa.extend([I::I64Const(ROOT_HALF), I::I64Add, I::F64ReinterpretI64]);
    let reduce = all([
        set(m, Real(shifted).then(I::F64ReinterpretI64)),
        set(k, Real(exponent)),
        set(f, Real(mantissa) - real(1.0)),
        set(half, real(0.5) * get(f) * get(f)),
        set(s, get(f) / (real(2.0) + get(f))),
        set(z, get(s) * get(s)),
        set(w, get(z) * get(z)),
    ]);
    let series = get(z) * polynomial(w, &ODD) + get(w) * polynomial(w, &EVEN);
    let ln2_high = f64::from_bits(0x3fe6_2e42_fee0_0000);
    let ln2_low = f64::from_bits(0x3dea_39ef_3579_3c76);
    let value = get(s) * (get(half) + series) + get(k) * real(ln2_low) - get(half)
        + get(f)
        + get(k) * real(ln2_high);
    let normal = all([
        get(X).high_word(),
        vec![I::I32Const(0x0010_0000), I::I32Sub],
    ]);
    when(
        below(normal, 0x7ff0_0000 - 0x0010_0000),
        all([reduce, give(value)]),
    )
}

/// Around 0, 1/2, 1, 3/2 or infinity: atan x = atan c + atan((x - c) / (1 + c x)).
fn arc_tangent() -> Code {
    let (a, high, low, z, w, sum) = (1, 2, 3, 4, 5, 6);
    const EVEN: [f64; 6] = [
        3.333_333_333_333_293_180_27e-1,
        1.428_571_427_250_346_637_11e-1,
        9.090_887_133_436_506_561_96e-2,
        6.661_073_137_387_531_206_69e-2,
        4.976_877_994_615_932_360_17e-2,
        1.628_582_011_536_578_236_23e-2,
    ];
    const ODD: [f64; 5] = [
        -1.999_999_999_987_648_324_76e-1,
        -1.111_111_040_546_235_578_80e-1,
        -7.691_876_205_044_829_994_95e-2,
        -5.833_570_133_790_573_486_45e-2,
        -3.653_157_274_421_691_552_70e-2,
    ];
    let word = || vec![I::LocalGet(WORD)];
    let size = all([
        get(X).high_word(),
        vec![I::I32Const(0x7fff_ffff), I::I32And, I::LocalSet(WORD)],
    ]);
    // Where the interval ends, atan c in two parts, and the argument that is left.
    let near = |bits: [u64; 2], argument: Real| {
        all([
            set(high, real(f64::from_bits(bits[0]))),
            set(low, real(f64::from_bits(bits[1]))),
            set(a, argument),
        ])
    };
    let x = || get(a);
    let half = near(
        [0x3fdd_ac67_0561_bb4f, 0x3c7a_2b7f_222f_65e2],
        (real(2.0) * x() - real(1.0)) / (real(2.0) + x()),
    );
    let one = near(
        [0x3fe9_21fb_5444_2d18, 0x3c81_a626_3314_5c07],
        (x() - real(1.0)) / (x() + real(1.0)),
    );
    let more = near(
        [0x3fef_730b_d281_f69b, 0x3c70_0788_7af0_cbbd],
        (x() - real(1.5)) / (real(1.0) + real(1.5) * x()),
    );
    let far = near(
        [0x3ff9_21fb_5444_2d18, 0x3c91_a626_3314_5c07],
        real(-1.0) / x(),
    );
    let series = || {
        let even = get(z) * polynomial(w, &EVEN);
        let odd = get(w) * polynomial(w, &ODD);
        all([
            set(z, x() * x()),
            set(w, get(z) * get(z)),
            set(sum, x() * (even + odd)),
        ])
    };
    let small = all([set(a, get(X)), series(), give(x() - get(sum))]);
    let large = all([
        set(a, get(X).abs()),
        either(
            below(word(), 0x3ff3_0000),
            either(below(word(), 0x3fe6_0000), half, one),
            either(below(word(), 0x4003_8000), more, far),
        ),
        series(),
        set(z, get(high) - (get(sum) - get(low) - x())),
        give(get(z).with(get(X), I::F64Copysign)),
    ]);
    let usual = all([
        word(),
        vec![I::I32Const(0x3e40_0000), I::I32Sub],
        vec![I::I32Const(0x4410_0000 - 0x3e40_0000), I::I32LtU],
    ]);
    all([
        size,
        when(usual, either(below(word(), 0x3fdc_0000), small, large)),
    ])
}
