//! Settings of the estimator.

use crate::settings::{choices, section};

choices! {
    /// How much of light transport the transfer holds.
    TransferChoice {
        /// By evidence.
        Auto = "auto",
        /// Cosine only.
        Diffuse = "diffuse",
        /// Cosine × visibility.
        Shade = "shade",
        /// Plus interreflections.
        Gi = "gi",
    }
}

choices! {
    /// Exposure model of a keyframe.
    ExposureChoice {
        /// By held-out error.
        Auto = "auto",
        /// None: all gains are 1.
        None = "none",
        /// One gain a keyframe.
        Scalar = "scalar",
        /// Three gains a keyframe.
        Rgb = "rgb",
    }
}

choices! {
    /// On, off, or by evidence.
    Switch {
        /// By evidence.
        Auto = "auto",
        /// Always.
        On = "on",
        /// Never.
        Off = "off",
    }
}

choices! {
    /// Named points of the trade of speed against accuracy.
    Quality {
        /// A quick look.
        Draft = "draft",
        /// What the scene requires.
        Standard = "standard",
        /// Everything that still helps a little.
        Best = "best",
    }
}

choices! {
    /// How light and albedo are separated.
    SolverChoice {
        /// Non-negative radiance, robust segment albedos.
        Robust = "robust",
        /// Eqs. (10)–(12) to the letter.
        Literal = "literal",
        /// One segment, constant albedo.
        Nonsegmented = "nonsegmented",
    }
}

section! {
    /// Data association, segmentation, transfer, factorisation, specular.
    EstimatorConfig = "estimator" {
        /// Cosine of the steepest view accepted at first.
        view_cosine_first: f64 = 0.5, [0.0..=1.0], "", "c2, Eq. (3)";
        /// Cosine of the steepest view accepted in the last round.
        view_cosine_last: f64 = 0.17, [0.0..=1.0], "", "c2, Eq. (3)";
        /// Neighbour hits farther than this many edges or footprints mark a geometric edge.
        edge_distance: f64 = 3.0, [0.5..=50.0], "edges", "c3, Eq. (4)";
        /// Neighbour normals that differ by more mark a geometric edge.
        edge_angle_deg: f64 = 40.0, [1.0..=180.0], "deg", "c4, Eq. (4)";
        /// Pixels with a channel of this 8-bit value or more are clipped.
        clipped_from: u32 = 250, [2..=256], "", "";
        /// Linear samples below this tell no exposure.
        dark_below: f64 = 0.004, [0.0..=0.5], "", "";
        /// Rounds of lit colour, exposure and pose.
        association_rounds: u32 = 6, [1..=50], "", "";
        /// Exposure model.
        exposure: ExposureChoice = ExposureChoice::Auto, [()], "", "e_j, Eq. (5)";
        /// Pose refinement.
        refine_poses: Switch = Switch::Auto, [()], "", "";
        /// Mesh regularisation: target edge as a multiple of the median edge; 0 keeps the mesh as it is.
        regularise: f64 = 1.0, [0.0..=8.0], "median edges", "";
        /// Components with a smaller share of the largest component's vertices are specks and go.
        speck_share: f64 = 0.001, [0.0..=1.0], "", "";
        /// A fused mesh is regularised to at most about this many vertices: the estimator's memory and time grow with them.
        max_vertices: u32 = 80000, [1000..=2000000], "vertices", "";
        /// Weight of colour in the segmentation distance.
        segment_color: f64 = 1.0, [0.0..=100.0], "", "w1, Eq. (6)";
        /// Weight of concavity in the segmentation distance.
        segment_concavity: f64 = 0.5, [0.0..=100.0], "", "w2, Eq. (6)";
        /// Weight of the shape diameter in the segmentation distance.
        segment_thickness: f64 = 0.25, [0.0..=100.0], "", "w3, Eq. (6)";
        /// Neighbours that make a core point.
        segment_min_points: u32 = 4, [1..=100], "", "minPts";
        /// Regions whose border is weaker than this belong together.
        segment_merge: f64 = 5.0, [0.0..=100.0], "CIELAB", "";
        /// Segments with a smaller share of the vertices join their best neighbour.
        segment_min_share: f64 = 0.002, [0.0..=0.5], "", "";
        /// Transfer level.
        transfer: TransferChoice = TransferChoice::Auto, [()], "", "Eq. (8)";
        /// Rays per vertex; 0 = by standard error.
        rays: u32 = 0, [0..=65536], "", "N";
        /// Light bounces in gi transfer, the rest in proportion to them; 0 = until they no longer matter.
        bounces: u32 = 0, [0..=64], "", "";
        /// Share of blocked rays from which interreflection is modelled by default.
        gi_from_blocked: f64 = 0.02, [0.0..=1.0], "", "";
        /// SH bands (l_max + 1); 0 = by evidence.
        bands: u32 = 0, [0..=9], "", "";
        /// Solver of the factorisation.
        solver: SolverChoice = SolverChoice::Robust, [()], "", "Eqs. (10)–(12)";
        /// Specular weights.
        specular: Switch = Switch::Auto, [()], "", "Eq. (13)";
        /// Point of the trade that is taken where a setting leaves the choice.
        quality: Quality = Quality::Standard, [()], "", "";
        /// Seed of every random direction.
        seed: u32 = 1, [0..=4294967295], "", "";
    } with crate::tuning::EstimatorTuning
}
