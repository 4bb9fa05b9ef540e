//! Thresholds of tracking.

use crate::settings::section;

section! {
    /// Frame-to-model tracking: association, alignment cost, acceptance of a pose.
    TrackingTuning = "tracking" {
        /// Smallest share of the tracking grid that must hold valid depth for a frame to be tracked. Source: tuned by hand on recordings.
        min_valid_share: f64 = 0.03, [0.0..=1.0], "", "";
        /// Anchors tried per frame while tracking is lost. Source: tuned by hand on recordings.
        relocalisation_tries: u32 = 4, [1..=64], "anchors", "";
        /// Longest gap between frames over which the last velocity predicts the next pose; relocalisation follows a longer one. Source: tuned by hand on recordings.
        max_prediction_s: f64 = 0.2, [0.0..=10.0], "s", "";
        /// Frame-to-frame association: largest distance between two points, as a share of the depth. Source: KinectFusion's test, value tuned by hand on recordings.
        frame_distance_share: f64 = 0.1, [0.001..=1.0], "", "";
        /// Frame-to-frame association: smallest cosine between the two normals. Source: KinectFusion's test, value tuned by hand on recordings.
        frame_normal_cos: f64 = 0.7, [-1.0..=1.0], "", "";
        /// Frame-to-model association: largest distance to the surface, as a share of the truncation distance. Source: beyond it stored distances are clamped.
        model_distance_share: f64 = 0.95, [0.1..=1.0], "", "";
        /// Frame-to-model association: smallest length of the distance gradient (1 = Euclidean distance). Source: tuned by hand on recordings.
        min_gradient: f64 = 0.3, [0.0..=1.0], "m/m", "";
        /// Frame-to-model association: the length of the distance gradient must stay below this. Source: tuned by hand on recordings.
        max_gradient: f64 = 3.0, [1.0..=100.0], "m/m", "";
        /// Frame-to-model association: smallest cosine between the normals of the frame and of the model. Source: tuned by hand on recordings.
        model_normal_cos: f64 = 0.5, [-1.0..=1.0], "", "";
        /// Smallest grey gradient of a photometric point. Source: tuned by hand on recordings.
        min_grey_gradient: f64 = 3.0, [0.0..=100.0], "grey/px", "";
        /// Alignment cost: weight of the mean photometric residual against the geometric fit. Source: tuned by hand on recordings.
        cost_photometric: f64 = 0.1, [0.0..=10.0], "1/grey", "";
        /// Alignment cost: weight of the share of photometric points outside the image. Source: tuned by hand on recordings.
        cost_unseen: f64 = 0.2, [0.0..=10.0], "", "";
        /// A tracked frame needs this share of `fusion.min_likeness` as its correlation with the anchor or the last frame. Source: tuned by hand on recordings.
        ncc_share: f64 = 0.6, [0.0..=1.0], "", "";
        /// Correlation is computed from at least this many photometric points. Source: tuned by hand on recordings.
        ncc_min_points: u32 = 50, [2..=10000], "points", "";
        /// Correlation is computed if at least this share of the reference's photometric points is in the image. Source: tuned by hand on recordings.
        ncc_min_share: f64 = 1.0 / 3.0, [0.0..=1.0], "", "";
        /// Where the model is incomplete: smallest share of the points with a model association that must agree with it. Source: tuned by hand on recordings.
        min_agreement: f64 = 0.6, [0.0..=1.0], "", "";
        /// Where the model is incomplete: smallest share of the points that must have a model association. Source: tuned by hand on recordings.
        min_overlap: f64 = 0.1, [0.0..=1.0], "", "";
    }
}
