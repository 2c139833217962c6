//! Sequential function charts against a direct reading of clause 6.7.
