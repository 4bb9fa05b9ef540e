//! Normal equations of the delay of depth and the read-out time, at an aligned pose.

use crate::camera::pinhole::Rigid;
use crate::tracking::align::{Aligner, Alignment};
use crate::tracking::geometric::geometric;
use crate::tracking::photometric::{Comparison, photometric};
use crate::tracking::problem::AlignmentProblem;
use crate::tracking::schedule::Stage;
use crate::tracking::solve::{Eliminated, eliminate_brightness};
use nalgebra::{SMatrix, SVector, Vector6};

/// Normal equations H x = b of x = (twist (6), delay of depth, read-out time): metres, radians, seconds.
#[derive(Debug, Clone, Copy)]
pub struct TimingSystem {
    pub h: SMatrix<f64, 8, 8>,
    pub b: SVector<f64, 8>,
}

impl Aligner {
    /// The system of the frame just aligned (`found`, whose last stage was `stage`). With the camera moving by the twist v
    /// per second, a depth image τ later than assumed has residuals r + J (δ − τ v), those of the colour image stay r + J δ,
    /// and a read-out longer than assumed by T adds s T J v to the residuals in row s = −½ … ½ of either image.
    pub fn timing_system(&self, problem: &AlignmentProblem, found: &Alignment, stage: &Stage) -> TimingSystem {
        let AlignmentProblem { frame, rig, reference, config, .. } = *problem;
        let velocity = frame.motion.velocity;
        let dot = |j: &[f32], v: &Vector6<f64>| j.iter().zip(v.iter()).map(|(j, v)| j * *v as f32).sum::<f32>();
        let to_depth = Rigid::from(&rig.depth_from_color);
        let seen = found.observed * velocity;
        let geo = geometric(&self.associations, &found.world_from_camera, stage.cut, &rig.noise, |j, p| {
            let row = rig.depth.row(rig.depth.project(to_depth.apply(p)).y);
            let [a, b, c, d, e, f] = j;
            [a, b, c, d, e, f, row * dot(&j, &seen)]
        });
        let camera_from_reference = found.world_from_camera.inverse().compose(&reference.world_from_camera);
        let (points, level) = (&reference.photo[stage.level], stage.level);
        let comparison = Comparison { frame, rig, level, points, brightness: found.brightness, sigma: found.sigma };
        let photo = photometric(&comparison, &camera_from_reference, |j, q| {
            let [a, b, c, d, e, f, gain, offset] = j;
            [a, b, c, d, e, f, gain, offset, rig.grey[level].row(q.y) * dot(&j[..6], &velocity)]
        });

        // Each term's unknowns as functions of the common unknowns: of the geometry only the directions that it observes, of
        // the image the system without brightness.
        let mut from_geo = SMatrix::<f64, 8, 7>::zeros();
        from_geo.fixed_view_mut::<6, 6>(0, 0).copy_from(&found.observed.transpose());
        from_geo.fixed_view_mut::<1, 6>(6, 0).copy_from(&(-seen.transpose()));
        from_geo[(7, 6)] = 1.0;
        let h_geo = SMatrix::<f64, 7, 7>::from_fn(|a, c| geo.symmetric(a, c));
        let b_geo = SVector::<f64, 7>::from_fn(|a, _| geo.b[a]);
        let mut from_photo = SMatrix::<f64, 8, 7>::zeros();
        from_photo.fixed_view_mut::<6, 6>(0, 0).fill_with_identity();
        from_photo[(7, 6)] = 1.0;
        let kept = [0, 1, 2, 3, 4, 5, 8];
        let Eliminated { h, b, .. } = eliminate_brightness(&photo, &kept, config.photometric_weight);
        TimingSystem {
            h: from_geo * h_geo * from_geo.transpose() + from_photo * h * from_photo.transpose(),
            b: from_geo * b_geo + from_photo * b,
        }
    }
}
