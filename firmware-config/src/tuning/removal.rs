//! Thresholds of removing objects from a result.

use crate::settings::section;

section! {
    /// Which vertices go with an object. Source of the values: removals on the rendered and recorded scenes.
    RemovalTuning = "removal" {
        /// A connected component with a larger share of the vertices is the scene, not an object in it.
        largest_component: f64 = 0.3, [0.0..=1.0], "", "";
        /// Share of an object from which a segment stands for all of it.
        whole_object: f64 = 0.5, [0.0..=1.0], "", "";
        /// Components that only a removed segment supported go with it up to this share of its size.
        small_component: f64 = 0.1, [0.0..=1.0], "", "";
        /// Vertices whose tangent planes are tried as the support of an object.
        support_candidates: u32 = 256, [1..=65536], "", "";
        /// Smallest share of the vertices that make a support.
        smallest_support: f64 = 0.02, [0.0..=1.0], "", "";
        /// Vertices of a support lie within this distance of its plane.
        support_thickness: f64 = 2.0, [0.1..=50.0], "edges", "";
        /// Normals of a support agree with its plane to this cosine.
        support_normal: f64 = 0.9, [0.0..=1.0], "", "";
        /// Planes whose normals agree beyond this cosine are one plane.
        same_plane: f64 = 0.98, [0.0..=1.0], "", "";
        /// Share of an object's border that must lie on its support; otherwise the plane cuts the object in two.
        border_on_support: f64 = 0.7, [0.0..=1.0], "", "";
        /// A larger share of the vertices is the scene, not an object on its support.
        largest_object: f64 = 0.75, [0.0..=1.0], "", "";
    }
}
