//! Normalised cross-correlation of a frame with a reference.

use crate::camera::pinhole::Rigid;
use crate::camera::rig::LEVELS;
use crate::tracking::problem::AlignmentProblem;
use recordings::types::Pose;

/// Correlation, −1 … 1, of the grey values of the reference's photometric points in the frame and in the reference, at the
/// coarsest level; `None` if too few points are in the image (`tracking.ncc_min_points`, `ncc_min_share`).
pub fn ncc(problem: &AlignmentProblem, world_from_camera: &Pose) -> Option<f32> {
    let AlignmentProblem { frame, rig, reference, config, .. } = *problem;
    let tuning = &config.tuning.tracking;
    let t = Rigid::from(&world_from_camera.inverse().compose(&reference.world_from_camera));
    let level = LEVELS - 1;
    let (camera, points) = (&rig.grey[level], &reference.photo[level]);
    let shutter = frame.motion.of_color(rig);
    let seen: Vec<(f64, f64)> = points
        .iter()
        .filter_map(|point| {
            let x = t.apply(point.p);
            let (value, _) = (x.z > 0.1).then(|| frame.grey[level].sample(shutter.project(camera, x).1)).flatten()?;
            Some((f64::from(point.grey), f64::from(value)))
        })
        .collect();
    let min_count = (tuning.ncc_min_share * points.len() as f64).max(f64::from(tuning.ncc_min_points));
    if (seen.len() as f64) < min_count {
        return None;
    }
    let n = seen.len() as f64;
    let (ma, mb) = seen.iter().fold((0.0, 0.0), |m, (a, b)| (m.0 + a / n, m.1 + b / n));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in seen {
        let (a, b) = (a - ma, b - mb);
        (ab, aa, bb) = (ab + a * b, aa + a * a, bb + b * b);
    }
    Some((ab / (aa * bb).sqrt().max(1e-9)) as f32)
}
