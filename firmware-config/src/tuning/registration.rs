//! Thresholds of the registration of pictures to the texture.

use crate::settings::section;

section! {
    /// Registration of the keyframes' pictures to each other, and of validation frames to the texture.
    RegistrationTuning = "registration" {
        /// Rounds over all keyframes, each against the blend of the others; 0 = the poses of the light are used.
        rounds: u32 = 2, [0..=100], "rounds", "";
        /// Largest number of Gauss–Newton steps in a round, per width of the window.
        steps: u32 = 4, [1..=1000], "steps", "";
        /// Points of the surface that are compared.
        points: u32 = 8000, [100..=10000000], "points", "";
        /// A picture that shows fewer of them stays where it is.
        min_points: u32 = 200, [12..=10000000], "points", "";
        /// Points that count as one independent observation: errors of neighbouring points are correlated.
        points_per_observation: f64 = 10.0, [1.0..=1e6], "points", "";
        /// Standard deviation of the given poses.
        pose_px: f64 = 2.0, [1e-3..=1e6], "px", "";
        /// Standard deviation of the motion while the rows of a picture are read; 0.001 = none.
        sweep_px: f64 = 3.0, [1e-3..=1e6], "px", "";
    }
}
