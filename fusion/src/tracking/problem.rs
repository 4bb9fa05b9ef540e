//! What a frame is aligned to.

use crate::camera::rig::Rig;
use crate::frame::preprocess::Frame;
use crate::tracking::reference::Reference;
use crate::tsdf::volume::Volume;
use firmware_config::FusionConfig;

/// What every frame of a scan is aligned with.
#[derive(Clone, Copy)]
pub struct AlignmentContext<'a> {
    pub rig: &'a Rig,
    pub volume: &'a Volume,
    pub config: &'a FusionConfig,
}

impl<'a> AlignmentContext<'a> {
    /// The alignment of a frame to a reference and the volume.
    pub fn problem(self, frame: &'a Frame, reference: &'a Reference) -> AlignmentProblem<'a> {
        AlignmentProblem { frame, reference, rig: self.rig, volume: self.volume, config: self.config }
    }
}

/// A frame, and the reference and the volume to which it is aligned.
#[derive(Clone, Copy)]
pub struct AlignmentProblem<'a> {
    pub frame: &'a Frame,
    pub reference: &'a Reference,
    pub rig: &'a Rig,
    pub volume: &'a Volume,
    pub config: &'a FusionConfig,
}
