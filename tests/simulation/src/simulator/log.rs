//! The event log of a run: written only when asked for, for a run can always be repeated from its seed.

use std::hash::Hasher;

/// The log.
#[derive(Debug, Default)]
pub struct Log {
    lines: Option<Vec<String>>,
    digest: Fnv,
}

impl Log {
    /// A log that is written, or one that only has a digest of what happened.
    #[must_use]
    pub fn new(written: bool) -> Log {
        Log {
            lines: written.then(Vec::new),
            digest: Fnv::default(),
        }
    }

    /// Notes that something of a kind happened, for the digest.
    pub fn mark(&mut self, at_us: u64, kind: u64, detail: u64) {
        self.digest.write_u64(at_us);
        self.digest.write_u64(kind ^ detail.rotate_left(32));
    }

    /// Writes a line.
    pub fn line(&mut self, at_us: u64, text: impl FnOnce() -> String) {
        if let Some(lines) = &mut self.lines {
            lines.push(format!("{:>12.6}  {}", at_us as f64 / 1e6, text()));
        }
    }

    /// Digest of all that happened.
    #[must_use]
    pub fn digest(&self) -> u64 {
        self.digest.finish()
    }

    /// The lines.
    #[must_use]
    pub fn into_lines(self) -> Vec<String> {
        self.lines.unwrap_or_default()
    }
}

/// FNV-1a: the same on every machine and in every build.
#[derive(Debug)]
struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Fnv {
        Fnv(0xCBF2_9CE4_8422_2325)
    }
}

impl Hasher for Fnv {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3);
        }
    }
    fn write_u64(&mut self, word: u64) {
        self.0 = (self.0 ^ word)
            .wrapping_mul(0x9E37_79B9_7F4A_7C15)
            .rotate_left(23);
    }
}
