//! The vertices that a model of light is fitted to, and those that are held out to judge it by.

use crate::factorisation::Colors;
use crate::numerics::random::hash;
use crate::numerics::robust::median;
use glam::Vec3;
use recordings::types::Mesh;

/// Vertices in all, shared out by segment size.
const SAMPLES: usize = 5_000;
/// Samples that a segment has at least, if it has so many vertices.
const SEGMENT_SAMPLES: usize = 40;
/// Edge of a block of surface that is held out together, as a share of the scene's size.
const BLOCK: f32 = 0.06;
/// One block in so many is held out.
const FOLDS: u32 = 5;
/// Lit colours count relative to themselves, but not below this share of the segment's median.
pub const DARK_FLOOR: f64 = 0.15;

/// Sampled vertices. Arrays are `[sample]`, sorted by segment.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// Index of the vertex.
    pub vertex: Vec<u32>,
    /// Segment of the vertex.
    pub segment: Vec<u32>,
    /// Vertices it stands for, times its own weight.
    pub weight: Vec<f64>,
    /// Block of surface it is held out with, if it is.
    pub held_out: Vec<Option<u32>>,
    /// Lit colour f.
    pub color: Vec<[f64; 3]>,
    /// Number of segments.
    pub segments: usize,
    /// Median lit colour per segment: `[segment][channel]`.
    pub medians: Vec<[f64; 3]>,
}

impl Samples {
    /// Samples every segment evenly. `usable` vertices were seen unclipped; `vertex_weight` is that of their geometry.
    #[must_use]
    pub fn new(mesh: &Mesh, colors: &Colors, vertex_weight: &[f32], usable: impl Fn(usize) -> bool) -> Self {
        let mut of_segment: Vec<Vec<usize>> = vec![Vec::new(); colors.segments];
        for i in 0..colors.lit_color.len() {
            let f = colors.lit_color[i];
            let seen = colors.lit_weight[i] > 0.0 && f.is_finite() && f.min_element() >= 0.0 && f.max_element() > 0.0;
            if seen && usable(i) {
                of_segment[colors.segment[i] as usize].push(i);
            }
        }
        let total: usize = of_segment.iter().map(Vec::len).sum();
        let block = Blocks::new(mesh);
        let mut samples = Self { segments: colors.segments, ..Self::default() };
        for (segment, vertices) in (0u32..).zip(&of_segment) {
            let quota = (SAMPLES * vertices.len() / total.max(1)).max(SEGMENT_SAMPLES);
            let stride = vertices.len().div_ceil(quota).max(1);
            for &i in vertices.iter().step_by(stride) {
                samples.vertex.push(i as u32);
                samples.segment.push(segment);
                let seen = f64::from(colors.lit_weight[i].min(1.0) * vertex_weight[i]);
                samples.weight.push(stride as f64 * seen);
                samples.held_out.push(block.held_out(mesh.positions[i]));
                samples.color.push(colors.lit_color[i].to_array().map(f64::from));
            }
            let of = &samples.color[samples.color.len() - vertices.len().div_ceil(stride)..];
            samples.medians.push([0, 1, 2].map(|c| median(of.iter().map(|f| f[c])).unwrap_or(0.0)));
        }
        samples
    }

    /// Samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.vertex.len()
    }
}

/// Cubes that surface is held out by.
struct Blocks {
    origin: Vec3,
    edge: f32,
}

impl Blocks {
    fn new(mesh: &Mesh) -> Self {
        let (low, high) = bounds(mesh);
        Self { origin: low, edge: (BLOCK * low.distance(high)).max(f32::MIN_POSITIVE) }
    }

    fn held_out(&self, position: Vec3) -> Option<u32> {
        let cell = ((position - self.origin) / self.edge).floor().as_ivec3();
        let block = hash(hash(cell.x as u32, cell.y as u32), cell.z as u32);
        block.is_multiple_of(FOLDS).then_some(block)
    }
}

/// Corners of the box that holds all but the outermost hundredth of the vertices on each side.
#[must_use]
pub fn bounds(mesh: &Mesh) -> (Vec3, Vec3) {
    let quantiles = |axis: usize| {
        let mut x: Vec<f32> = mesh.positions.iter().map(|p| p[axis]).filter(|x| x.is_finite()).collect();
        if x.is_empty() {
            return (0.0, 0.0);
        }
        x.sort_unstable_by(f32::total_cmp);
        (x[x.len() / 100], x[x.len() - 1 - x.len() / 100])
    };
    let q = [0, 1, 2].map(quantiles);
    (Vec3::from_array(q.map(|q| q.0)), Vec3::from_array(q.map(|q| q.1)))
}
