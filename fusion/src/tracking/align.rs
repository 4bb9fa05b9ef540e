//! Alignment of a frame to a reference and the volume: Gauss–Newton, coarse to fine.

use crate::camera::twist::{exp, log};
use crate::tracking::geometric::{Association, associate_reference, associate_volume, geometric};
use crate::tracking::photometric::{Brightness, Comparison, photometric};
use crate::tracking::problem::AlignmentProblem;
use crate::tracking::schedule::{Geometry, Stage};
use crate::tracking::solve::solve;
use crate::tracking::tilt::{normal_variance, of_tilted_normals};
use firmware_config::tuning::TrackingTuning;
use nalgebra::Matrix6;
use recordings::types::Pose;

/// Range of the brightness gain, and largest brightness offset in grey values.
const GAIN: (f32, f32) = (0.2, 5.0);
const MAX_OFFSET: f32 = 128.0;
/// Standard deviation over mean absolute value of a normal distribution, √(π/2).
const SIGMA_PER_MEAN_ABSOLUTE: f32 = 1.2533;

/// Result of an alignment.
#[derive(Debug, Clone, Copy)]
pub struct Alignment {
    pub world_from_camera: Pose,
    /// Share of the tested grid points that agree with the geometry within 3 σ.
    pub fit: f32,
    /// Share of the tested grid points with an association.
    pub overlap: f32,
    /// Mean absolute photometric residual of the last stage, grey values.
    pub photo_error: f32,
    /// Share of the photometric points in the image.
    pub photo_seen: f32,
    /// Smallest over largest eigenvalue of the geometric system, less what noise of the normals adds.
    pub condition: f64,
    /// Projector to the twists that the geometry observes, each with the share that is not noise of the normals.
    pub observed: Matrix6<f64>,
    pub brightness: Brightness,
    /// Scale of the photometric residuals, grey values.
    pub sigma: f32,
}

impl Alignment {
    /// Cost by which alignments of the same frame are compared: photometric residual, misfitting geometry, unseen points.
    pub fn cost(&self, tuning: &TrackingTuning) -> f32 {
        tuning.cost_photometric as f32 * self.photo_error - self.fit
            + tuning.cost_unseen as f32 * (1.0 - self.photo_seen)
    }
}

/// Gauss–Newton alignment with its buffers.
#[derive(Default)]
pub struct Aligner {
    /// Associations of the last alignment.
    pub associations: Vec<Association>,
    /// Squared sines of the angles between the normals of the last frame-to-frame association.
    tilts: Vec<f32>,
}

impl Aligner {
    /// Aligns a frame, starting at `start`. `predicted` is the pose of the motion prior, which determines the directions that
    /// nothing observes. Poses are `world_from_camera`.
    pub fn align(
        &mut self,
        problem: &AlignmentProblem,
        start: &Pose,
        predicted: &Pose,
        schedule: &[Stage],
    ) -> Alignment {
        let AlignmentProblem { frame, rig, reference, config, .. } = *problem;
        let mut pose = *start;
        let mut brightness = Brightness {
            gain: ((frame.mean_grey + 1.0) / (reference.mean_grey + 1.0)).clamp(GAIN.0, GAIN.1),
            offset: 0.0,
        };
        let mut out = Alignment {
            world_from_camera: pose,
            fit: 0.0,
            overlap: 0.0,
            photo_error: 0.0,
            photo_seen: 0.0,
            condition: 0.0,
            observed: Matrix6::identity(),
            brightness,
            sigma: 0.0,
        };
        let floor = config.photometric_sigma as f32;
        let mut sigma = 4.0 * floor;
        for stage in schedule {
            let points = &reference.photo[stage.level];
            for _ in 0..stage.rounds {
                let tested = match stage.geometry {
                    Geometry::Reference => associate_reference(problem, &pose, &mut self.associations, &mut self.tilts),
                    Geometry::Volume { stride } => associate_volume(problem, &pose, stride, &mut self.associations),
                };
                let mut tilted = None;
                for _ in 0..2 {
                    let camera_from_reference = pose.inverse().compose(&reference.world_from_camera);
                    let comparison = Comparison { frame, rig, level: stage.level, points, brightness, sigma };
                    let photo = photometric(&comparison, &camera_from_reference, |j, _| j);
                    let geo = geometric(&self.associations, &pose, stage.cut, &rig.noise, |j, _| j);
                    let to_prediction = log(&pose.inverse().compose(predicted));
                    // Hardly changes from one iteration to the next. Normals of the volume are means over many frames.
                    let tilted = tilted.get_or_insert_with(|| match stage.geometry {
                        Geometry::Reference => {
                            of_tilted_normals(&self.associations, &pose, stage.cut, &rig.noise, &geo)
                                * normal_variance(&mut self.tilts)
                        }
                        Geometry::Volume { .. } => Matrix6::zeros(),
                    });
                    let step = solve(&geo, tilted, &photo, &to_prediction, f64::from(frame.median_depth), config);
                    pose = pose.compose(&exp(&step.delta));
                    brightness.gain = (brightness.gain + step.gain).clamp(GAIN.0, GAIN.1);
                    brightness.offset = (brightness.offset + step.offset).clamp(-MAX_OFFSET, MAX_OFFSET);
                    out.fit = geo.inliers as f32 / tested.max(1) as f32;
                    out.overlap = geo.count as f32 / tested.max(1) as f32;
                    out.photo_error = (photo.absolute / photo.count.max(1) as f64) as f32;
                    out.photo_seen = photo.count as f32 / points.len().max(1) as f32;
                    out.condition = step.condition;
                    out.observed = step.observed;
                    (out.brightness, out.sigma) = (brightness, sigma);
                    sigma = (SIGMA_PER_MEAN_ABSOLUTE * out.photo_error).clamp(floor, 8.0 * floor);
                    if step.delta.norm() < 1e-5 {
                        break;
                    }
                }
            }
        }
        out.world_from_camera = pose;
        out
    }
}
