//! The narrow interface to whatever executes an MC.

use fam_proto::TrapInfo;

/// One instance of one MC's logic.
pub trait McRuntime: Send {
    /// Runs the Control program once, at this MC time.
    ///
    /// # Errors
    /// Where and why the logic trapped; memory may then be half updated, and the caller restores it.
    fn scan(&mut self, mc_time_us: u64) -> Result<(), TrapInfo>;
    /// The checkpoint region: control variables, actions, serialized state.
    fn checkpoint(&self) -> &[u8];
    /// The checkpoint region, to be written.
    fn checkpoint_mut(&mut self) -> &mut [u8];
    /// The input image.
    fn inputs_mut(&mut self) -> &mut [u8];
    /// The output image.
    fn outputs(&self) -> &[u8];
    /// The output image, to be written.
    fn outputs_mut(&mut self) -> &mut [u8];
    /// All memory back to its initial values.
    fn reset(&mut self);
}
