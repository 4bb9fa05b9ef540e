//! Settings of the estimator.

use crate::settings::{Value, choices, section};

choices! {
    /// Level of light transport in the transfer.
    TransferChoice {
        /// Chosen by evidence.
        Auto = "auto",
        /// Cosine only.
        Diffuse = "diffuse",
        /// Cosine × visibility.
        Shade = "shade",
        /// Cosine × visibility, plus interreflections.
        Gi = "gi",
    }
}

choices! {
    /// Exposure model of a keyframe.
    ExposureChoice {
        /// By held-out error.
        Auto = "auto",
        /// No model: all gains are 1.
        None = "none",
        /// One gain per keyframe.
        Scalar = "scalar",
        /// Three gains per keyframe.
        Rgb = "rgb",
    }
}

choices! {
    /// On, off, or chosen by evidence.
    Switch {
        /// Chosen by evidence.
        Auto = "auto",
        /// Always.
        On = "on",
        /// Never.
        Off = "off",
    }
}

choices! {
    /// Named compromises between speed and accuracy.
    Quality {
        /// Fast preview.
        Draft = "draft",
        /// What the scene requires.
        Standard = "standard",
        /// Also options with a small benefit.
        Best = "best",
    }
}

choices! {
    /// Method that separates light and albedo.
    SolverChoice {
        /// Non-negative radiance, robust segment albedos.
        Robust = "robust",
        /// The additive update of the paper, Eqs. (10)–(12).
        Literal = "literal",
        /// One segment, constant albedo.
        Nonsegmented = "nonsegmented",
    }
}

/// Resolution of the texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TextureChoice {
    /// No texture.
    Off,
    /// As fine as the keyframes show the surface.
    Auto,
    /// Width of a texel in millimetres.
    Texel(f64),
}

impl Value for TextureChoice {
    /// Millimetres.
    type Range = std::ops::RangeInclusive<f64>;
    fn from_toml(value: &toml::Value, range: &Self::Range) -> Result<Self, String> {
        match value.as_str() {
            Some("off") => Ok(Self::Off),
            Some("auto") => Ok(Self::Auto),
            Some(_) => Err(Self::describe(range)),
            None => f64::from_toml(value, range).map(Self::Texel).map_err(|_| Self::describe(range)),
        }
    }
    fn to_toml(&self) -> String {
        match self {
            Self::Off => "\"off\"".into(),
            Self::Auto => "\"auto\"".into(),
            Self::Texel(mm) => mm.to_toml(),
        }
    }
    fn describe(range: &Self::Range) -> String {
        format!("off, auto, or {} … {} mm a texel", range.start(), range.end())
    }
}

section! {
    /// Data association, segmentation, transfer, factorisation, specular.
    EstimatorConfig = "estimator" {
        /// Smallest accepted cosine between normal and view direction in the first round.
        view_cosine_first: f64 = 0.5, [0.0..=1.0], "", "c2, Eq. (3)";
        /// Smallest accepted cosine between normal and view direction in the last round.
        view_cosine_last: f64 = 0.17, [0.0..=1.0], "", "c2, Eq. (3)";
        /// Neighbour hits farther apart than this many edge lengths or pixel footprints mark a geometric edge.
        edge_distance: f64 = 3.0, [0.5..=50.0], "edges", "c3, Eq. (4)";
        /// Neighbour normals that differ by a larger angle mark a geometric edge.
        edge_angle_deg: f64 = 40.0, [1.0..=180.0], "deg", "c4, Eq. (4)";
        /// A pixel counts as clipped if a channel has this 8-bit value or more.
        clipped_from: u32 = 250, [2..=256], "", "";
        /// Linear samples below this value are not used to estimate the exposure.
        dark_below: f64 = 0.004, [0.0..=0.5], "", "";
        /// Rounds of lit colour, exposure and pose.
        association_rounds: u32 = 6, [1..=50], "", "";
        /// Exposure model.
        exposure: ExposureChoice = ExposureChoice::Auto, [()], "", "e_j, Eq. (5)";
        /// Pose refinement.
        refine_poses: Switch = Switch::Auto, [()], "", "";
        /// Mesh regularisation: target edge as a multiple of the median edge; 0 keeps the mesh as it is.
        regularise: f64 = 1.0, [0.0..=8.0], "median edges", "";
        /// Connected components with fewer vertices than this share of the largest component are removed.
        speck_share: f64 = 0.001, [0.0..=1.0], "", "";
        /// Approximate upper bound of the number of vertices of a regularised fused mesh: memory and time of the estimator grow with it.
        max_vertices: u32 = 56000, [1000..=2000000], "vertices", "";
        /// Weight of colour in the segmentation distance.
        segment_color: f64 = 1.0, [0.0..=100.0], "", "w1, Eq. (6)";
        /// Weight of concavity in the segmentation distance.
        segment_concavity: f64 = 0.5, [0.0..=100.0], "", "w2, Eq. (6)";
        /// Weight of the shape diameter in the segmentation distance.
        segment_thickness: f64 = 0.25, [0.0..=100.0], "", "w3, Eq. (6)";
        /// Smallest number of neighbours of a core point (DBSCAN).
        segment_min_points: u32 = 4, [1..=100], "", "minPts";
        /// Regions with a colour difference below this at their border are merged.
        segment_merge: f64 = 5.0, [0.0..=100.0], "CIELAB", "";
        /// Segments with a smaller share of the vertices are merged into their best neighbour.
        segment_min_share: f64 = 0.002, [0.0..=0.5], "", "";
        /// Transfer level.
        transfer: TransferChoice = TransferChoice::Auto, [()], "", "Eq. (8)";
        /// Rays per vertex; 0 = chosen by the standard error.
        rays: u32 = 0, [0..=65536], "", "N";
        /// Number of light bounces in gi transfer; further bounces are extrapolated in proportion. 0 = until they are negligible.
        bounces: u32 = 0, [0..=64], "", "";
        /// Share of blocked rays from which interreflection is modelled when `transfer` is `auto`.
        gi_from_blocked: f64 = 0.02, [0.0..=1.0], "", "";
        /// SH bands (l_max + 1); 0 = chosen by evidence.
        bands: u32 = 0, [0..=9], "", "";
        /// Solver of the factorisation.
        solver: SolverChoice = SolverChoice::Robust, [()], "", "Eqs. (10)–(12)";
        /// Specular weights.
        specular: Switch = Switch::Auto, [()], "", "Eq. (13)";
        /// Texture: albedo at the resolution of the photographs. Off, auto (as fine as the keyframes show the surface), or the width of a texel.
        texture: TextureChoice = TextureChoice::Auto, [0.05..=100.0], "mm", "";
        /// Compromise between speed and accuracy, for every choice that the other settings leave open.
        quality: Quality = Quality::Standard, [()], "", "";
        /// Seed of all random directions.
        seed: u32 = 1, [0..=4294967295], "", "";
    } with crate::tuning::EstimatorTuning
}
