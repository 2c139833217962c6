//! Mathematical functions that Wasm has not: the same software implementation on every host, so that an MC computes the same
//! bits wherever it runs.

use wasmtime::Linker;

use crate::check::stdfun::{StdFun, real_f32, real_f64};
use crate::codegen::MATH_MODULE;
use crate::value::{canonical_f32, canonical_f64};

pub fn link(linker: &mut Linker<()>) -> wasmtime::Result<()> {
    for (name, single, fun) in [
        ("log", "logf", StdFun::Ln),
        ("log10", "log10f", StdFun::Log),
        ("exp", "expf", StdFun::Exp),
        ("sin", "sinf", StdFun::Sin),
        ("cos", "cosf", StdFun::Cos),
        ("tan", "tanf", StdFun::Tan),
        ("asin", "asinf", StdFun::Asin),
        ("acos", "acosf", StdFun::Acos),
        ("atan", "atanf", StdFun::Atan),
    ] {
        linker.func_wrap(MATH_MODULE, name, move |v: f64| real_f64(fun, v))?;
        linker.func_wrap(MATH_MODULE, single, move |v: f32| real_f32(fun, v))?;
    }
    linker.func_wrap(MATH_MODULE, "pow", |a: f64, b: f64| {
        canonical_f64(libm::pow(a, b))
    })?;
    linker.func_wrap(MATH_MODULE, "powf", |a: f32, b: f32| {
        canonical_f32(libm::powf(a, b))
    })?;
    linker.func_wrap(MATH_MODULE, "atan2", |y: f64, x: f64| {
        canonical_f64(libm::atan2(y, x))
    })?;
    linker.func_wrap(MATH_MODULE, "atan2f", |y: f32, x: f32| {
        canonical_f32(libm::atan2f(y, x))
    })?;
    Ok(())
}
