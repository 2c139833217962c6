//! Programs as trees of lines, so that a failing one can be made smaller by leaving parts out.

use std::fmt::Write;

/// A line, what stands inside, and a closing line (or none).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Piece {
    pub open: String,
    pub inner: Vec<Piece>,
    pub close: String,
}

impl Piece {
    pub fn line(text: impl Into<String>) -> Piece {
        Piece {
            open: text.into(),
            ..Piece::default()
        }
    }

    pub fn block(open: impl Into<String>, inner: Vec<Piece>, close: impl Into<String>) -> Piece {
        Piece {
            open: open.into(),
            inner,
            close: close.into(),
        }
    }

    pub fn render(&self) -> String {
        let mut text = String::new();
        self.write(&mut text, 0);
        text
    }

    fn write(&self, text: &mut String, depth: usize) {
        for (line, inner) in [(&self.open, true), (&self.close, false)] {
            if !line.is_empty() {
                let _ = writeln!(text, "{:width$}{line}", "", width = depth * 2);
            }
            if inner {
                let deeper = depth + usize::from(!self.open.is_empty());
                self.inner.iter().for_each(|p| p.write(text, deeper));
            }
        }
    }

    fn count(&self) -> usize {
        1 + self.inner.iter().map(Piece::count).sum::<usize>()
    }

    /// Changes piece number `at` (this one is 0): takes it out, or puts what is inside in its place.
    fn without(&self, at: usize, keep_inner: bool) -> Option<Piece> {
        let mut next = 1;
        let mut copy = self.clone();
        for (index, piece) in self.inner.iter().enumerate() {
            let size = piece.count();
            if at == next {
                let inside = if keep_inner {
                    if piece.inner.is_empty() {
                        return None;
                    }
                    piece.inner.clone()
                } else {
                    Vec::new()
                };
                copy.inner.splice(index..=index, inside);
                return Some(copy);
            }
            if at < next + size {
                copy.inner[index] = piece.without(at - next, keep_inner)?;
                return Some(copy);
            }
            next += size;
        }
        None
    }
}

/// Trees that are tried at most: each is compiled.
const TRIES_MAX: u32 = 1500;

/// The smallest tree found, by leaving out one piece after the other, for which `fails` still holds.
pub fn shrink(whole: &Piece, mut fails: impl FnMut(&Piece) -> bool) -> Piece {
    let mut best = whole.clone();
    let mut tries = 0;
    loop {
        let before = best.count();
        for keep_inner in [false, true] {
            let mut at = 1;
            while at < best.count() {
                tries += 1;
                if tries > TRIES_MAX {
                    return best;
                }
                match best.without(at, keep_inner) {
                    Some(smaller) if fails(&smaller) => best = smaller,
                    _ => at += 1,
                }
            }
        }
        if best.count() == before {
            return best;
        }
    }
}
