//! A result beside the truth of its scene.

use crate::metrics::{self, AlbedoError};
use crate::truth::{Truth, json};
use recordings::result::Estimate;
use recordings::scan::Scan;
use recordings::types::Pose;

/// Errors of a result, over the vertices that at least two keyframes see.
#[derive(Debug, Clone)]
pub struct Figures {
    /// RMS over keyframes of the error of the log gains (mean over channels), after one factor.
    pub exposure: f64,
    /// Mean over keyframes of the median distance, in pixels, between vertices projected with the poses as given and
    /// with the true ones.
    pub given_pose_px: f64,
    /// The same for the poses found.
    pub pose_px: f64,
    /// Share of the vertices that have a colour (confidence above 0).
    pub covered: f64,
    /// Relative error of the albedo.
    pub albedo: AlbedoError,
    /// Median and 90th percentile of the relative error of irradiance at the reference vertices, interreflection included.
    pub irradiance: (f64, f64),
    /// Adjusted Rand index of segments and materials.
    pub ari: f64,
    /// Area under the ROC curve of `w_s` for segments of glossy materials; `None` where all segments are alike.
    pub auc: Option<f64>,
}

/// Compares a result with the truth. Its mesh has to be that of the truth (an imported mesh keeps its vertices).
///
/// # Panics
/// The mesh is another one, or a file of the truth is missing or damaged.
#[must_use]
pub fn evaluate(truth: &Truth, scan: &Scan, found: &Estimate) -> Figures {
    assert_eq!(found.mesh.positions, truth.mesh.positions, "an imported mesh keeps its vertices");
    let seen: Vec<usize> = (0..truth.seen.len()).filter(|&i| truth.seen[i] >= 2).collect();
    let albedo: Vec<[f64; 3]> = found.albedo.iter().map(|a| a.to_array().map(f64::from)).collect();
    let pick = |labels: &[u32]| seen.iter().map(|&i| labels[i]).collect::<Vec<u32>>();
    let glossy = |&i: &usize| (found.segment[i], truth.glossy[truth.material[i] as usize]);
    let given: Vec<Pose> = scan.keyframes.iter().map(|k| k.world_from_camera).collect();
    let poses: Vec<Pose> = found.keyframes.iter().map(|k| k.world_from_camera).collect();
    Figures {
        exposure: exposure_error(truth, found),
        given_pose_px: pose_error(truth, scan, &given),
        pose_px: pose_error(truth, scan, &poses),
        covered: seen.iter().filter(|&&i| found.confidence[i] > 0.0).count() as f64 / seen.len() as f64,
        albedo: metrics::albedo(&albedo, &truth.albedo, &truth.material, |i| truth.seen[i] >= 2),
        irradiance: metrics::scene_irradiance(&truth.transfer().gi, &found.light.coefficients, &truth.light),
        ari: metrics::adjusted_rand_index(&pick(&truth.material), &pick(&found.segment)),
        auc: metrics::gloss_auc(seen.iter().map(glossy), |s| found.segments[s as usize].w_s),
    }
}

fn exposure_error(truth: &Truth, found: &Estimate) -> f64 {
    let exposures = json(&truth.folder.join("truth/exposures.json"));
    let gains = exposures["gain"].as_array().expect("gain").iter().map(|g| libm::log(g.as_f64().expect("a number")));
    let found = found.keyframes.iter().map(|k| k.gain.iter().map(|g| libm::log(*g)).sum::<f64>() / 3.0);
    metrics::rms_about_median(&found.zip(gains).map(|(found, gain)| found - gain).collect::<Vec<f64>>())
}

fn pose_error(truth: &Truth, scan: &Scan, poses: &[Pose]) -> f64 {
    let document = json(&truth.folder.join("truth/poses.json"));
    let frames = document["frames"].as_array().expect("frames");
    let matrix = |frame: &serde_json::Value| -> [[f64; 4]; 4] {
        serde_json::from_value(frame["camera_to_world"].clone()).expect("a matrix of four by four")
    };
    let right: Vec<Pose> = frames.iter().map(|frame| Pose::from_rows(&matrix(frame)).expect("a pose")).collect();
    let camera = scan.keyframes[0].camera.intrinsics;
    let step = (truth.mesh.positions.len() / 3000).max(1);
    metrics::pixel_shifts(&camera, &truth.mesh.positions, step, poses, &right).iter().sum::<f64>() / poses.len() as f64
}
