//! Thresholds of data association.

use crate::settings::section;

section! {
    /// Data association: samples of the keyframes at the vertices (Eqs. 3–4).
    AssociationTuning = "association" {
        /// Weight of a clipped or hardly eligible observation relative to a good one. Source: measured on the rendered scenes.
        poor_weight: f64 = 0.02, [1e-6..=1.0], "", "";
    }
}
