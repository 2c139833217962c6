//! What IEC 61131-3 programs mean, told a second time, to check the compiler by: an interpreter over the typed tree that
//! follows the text of the standard (and what `docs/iec61131.md` decides where the standard leaves room) and shares nothing with
//! the code generator; a generator of random programs; and the comparison of both after every scan. For tests only.

pub mod chart;
pub mod compare;
pub mod generate;
pub mod machine;
pub mod memory;
pub mod random;
pub mod session;
pub mod shrink;
pub mod text;
pub mod value;
