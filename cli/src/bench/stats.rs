//! Medians and tails.

/// Percentiles of a set of measurements, by the nearest-rank method.
#[derive(Debug, Clone, Default)]
pub struct Stats {
    sorted: Vec<f64>,
}

impl Stats {
    /// Sorts the measurements.
    pub fn new(mut values: Vec<f64>) -> Stats {
        values.sort_by(f64::total_cmp);
        Stats { sorted: values }
    }

    /// How many there are.
    pub fn n(&self) -> usize {
        self.sorted.len()
    }

    /// The value that `percent` of the measurements do not exceed; `None` without measurements.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss
    )]
    pub fn percentile(&self, percent: f64) -> Option<f64> {
        let rank = (percent / 100.0 * self.sorted.len() as f64).ceil() as usize;
        self.sorted.get(rank.max(1) - 1).copied()
    }

    /// Rounded to microseconds, as the JSON prints it.
    pub fn ms(&self, percent: f64) -> Option<f64> {
        self.percentile(percent)
            .map(|ms| (ms * 1_000.0).round() / 1_000.0)
    }
}

#[cfg(test)]
mod tests {
    use super::Stats;

    #[test]
    fn nearest_rank() {
        let s = Stats::new((1..=100).map(f64::from).collect());
        assert_eq!(
            (s.percentile(50.0), s.percentile(99.0), s.percentile(100.0)),
            (Some(50.0), Some(99.0), Some(100.0))
        );
        assert_eq!(Stats::new(vec![]).percentile(50.0), None);
        assert_eq!(Stats::new(vec![7.0]).percentile(99.0), Some(7.0));
    }
}
