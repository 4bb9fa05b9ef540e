//! The vertices that a model of light is fitted to, and those that are held out to judge it by.

use crate::factorisation::{Colors, Factorised};
use crate::mesh::cells::facing;
use crate::numerics::random::hash;
use crate::numerics::robust::{median, segment_medians};
use glam::{IVec3, Vec3};
use recordings::types::Mesh;
use std::collections::BTreeMap;

/// Vertices in all, shared out by segment size.
const SAMPLES: usize = 5_000;
/// Samples that a segment has at least, if it has so many vertices.
const SEGMENT_SAMPLES: usize = 40;
/// Edge of a block of surface that is held out together, as a share of the scene's size.
const BLOCK: f32 = 0.06;
/// Surface is held out in so many parts, one at a time.
pub const FOLDS: u32 = 5;
/// Lit colours count relative to themselves, but not below this share of the segment's median.
pub const DARK_FLOOR: f64 = 0.15;

/// Sampled vertices. Arrays are `[sample]`, sorted by the segment that they were drawn from.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// Index of the vertex.
    pub vertex: Vec<u32>,
    /// Segment of the vertex.
    pub segment: Vec<u32>,
    /// Vertices it stands for, times its own weight.
    pub weight: Vec<f64>,
    /// Block of surface that it is in; blocks are held out whole.
    pub block: Vec<u32>,
    /// Which of the [`FOLDS`] is held out.
    pub fold: u32,
    /// Patch of surface it belongs to: what a block has of one segment and one direction of the normal.
    pub patch: Vec<u32>,
    /// Lit colour f.
    pub color: Vec<[f64; 3]>,
    /// Number of segments.
    pub segments: usize,
    /// Median lit colour per segment: `[segment][channel]`.
    pub medians: Vec<[f64; 3]>,
}

impl Samples {
    /// Irradiance over π of an answer at the samples: `[sample][channel]`.
    #[must_use]
    pub fn irradiance(&self, of: &Factorised) -> Vec<[f64; 3]> {
        self.vertex.iter().map(|i| of.irradiance[*i as usize].to_array().map(f64::from)).collect()
    }

    /// Samples what was seen unclipped of every segment evenly; `vertex_weight` is that of the vertices' geometry.
    #[must_use]
    pub fn new(mesh: &Mesh, colors: &Colors, vertex_weight: &[f32]) -> Self {
        let mut of_segment: Vec<Vec<usize>> = vec![Vec::new(); colors.segments];
        for i in 0..colors.lit_color.len() {
            let f = colors.lit_color[i];
            let seen = colors.lit_weight[i] > 0.0 && f.is_finite() && f.min_element() >= 0.0 && f.max_element() > 0.0;
            if seen && !colors.clipped[i] {
                of_segment[colors.segment[i] as usize].push(i);
            }
        }
        let total: usize = of_segment.iter().map(Vec::len).sum();
        let block = Blocks::new(mesh);
        let mut samples = Self { segments: colors.segments, ..Self::default() };
        let mut patches = BTreeMap::new();
        for (segment, vertices) in (0u32..).zip(&of_segment) {
            let quota = (SAMPLES * vertices.len() / total.max(1)).max(SEGMENT_SAMPLES);
            let stride = vertices.len().div_ceil(quota).max(1);
            for &i in vertices.iter().step_by(stride) {
                samples.vertex.push(i as u32);
                samples.segment.push(segment);
                let seen = f64::from(colors.lit_weight[i].min(1.0) * vertex_weight[i]);
                samples.weight.push(stride as f64 * seen);
                let cell = block.cell(mesh.positions[i]);
                samples.block.push(Blocks::number(cell));
                let next = patches.len() as u32;
                samples.patch.push(*patches.entry((segment, cell.to_array(), facing(mesh.normals[i]))).or_insert(next));
                samples.color.push(colors.lit_color[i].to_array().map(f64::from));
            }
            let of = &samples.color[samples.color.len() - vertices.len().div_ceil(stride)..];
            samples.medians.push([0, 1, 2].map(|c| median(of.iter().map(|f| f[c])).unwrap_or(0.0)));
        }
        samples
    }

    /// The same samples in other segments: `segment` is `[vertex]`.
    #[must_use]
    pub fn in_segments(&self, segment: &[u32], segments: usize) -> Self {
        let segment: Vec<u32> = self.vertex.iter().map(|i| segment[*i as usize]).collect();
        let colors = segment.iter().zip(&self.color).map(|(s, color)| (*s, *color, 1.0));
        Self { medians: segment_medians(segments, colors), segment, segments, ..self.clone() }
    }

    /// The same samples with another fold held out.
    #[must_use]
    pub fn in_fold(&self, fold: u32) -> Self {
        Self { fold, ..self.clone() }
    }

    /// Block of a sample, if it is held out.
    #[must_use]
    pub fn held_out(&self, n: usize) -> Option<u32> {
        (self.block[n] % FOLDS == self.fold).then_some(self.block[n])
    }

    /// Samples that are not held out, by number.
    pub fn fitted(&self) -> impl Iterator<Item = usize> {
        (0..self.len()).filter(|n| self.held_out(*n).is_none())
    }

    /// Some of the samples, by number.
    #[must_use]
    pub fn chosen(&self, numbers: &[usize]) -> Self {
        Self {
            vertex: numbers.iter().map(|n| self.vertex[*n]).collect(),
            segment: numbers.iter().map(|n| self.segment[*n]).collect(),
            weight: numbers.iter().map(|n| self.weight[*n]).collect(),
            block: numbers.iter().map(|n| self.block[*n]).collect(),
            fold: self.fold,
            patch: numbers.iter().map(|n| self.patch[*n]).collect(),
            color: numbers.iter().map(|n| self.color[*n]).collect(),
            segments: self.segments,
            medians: self.medians.clone(),
        }
    }

    /// Weight of the samples that `counts` is true of: `[segment]`.
    #[must_use]
    pub fn surface(&self, counts: impl Fn(usize) -> bool) -> Vec<f64> {
        let mut surface = vec![0.0; self.segments];
        let samples = self.segment.iter().zip(&self.weight).enumerate().filter(|(n, _)| counts(*n));
        samples.for_each(|(_, (s, w))| surface[*s as usize] += w);
        surface
    }

    /// Every patch as one sample: prints and noise average out, what a model of light misses does not.
    #[must_use]
    pub fn patches(&self) -> Self {
        let mut first = BTreeMap::new();
        for (n, p) in self.patch.iter().enumerate() {
            first.entry(*p).or_insert(n);
        }
        let first: Vec<usize> = first.into_values().collect();
        let mut weight = vec![0.0; first.len()];
        self.patch.iter().zip(&self.weight).for_each(|(p, w)| weight[*p as usize] += w);
        let color = self.patch_means(|n| self.color[n]);
        Self { weight, patch: (0..first.len() as u32).collect(), color, ..self.chosen(&first) }
    }

    /// Means over every patch of what is given at every sample.
    pub fn patch_means(&self, values: impl Fn(usize) -> [f64; 3]) -> Vec<[f64; 3]> {
        let count = self.patch.iter().max().map_or(0, |p| *p as usize + 1);
        let mut sums = vec![([0.0; 3], 0.0); count];
        for (n, (p, weight)) in self.patch.iter().zip(&self.weight).enumerate() {
            let (sum, total) = &mut sums[*p as usize];
            sum.iter_mut().zip(values(n)).for_each(|(s, v)| *s += weight * v);
            *total += weight;
        }
        sums.into_iter().map(|(sum, total)| sum.map(|s| s / total.max(f64::MIN_POSITIVE))).collect()
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

    fn cell(&self, position: Vec3) -> IVec3 {
        ((position - self.origin) / self.edge).floor().as_ivec3()
    }

    fn number(cell: IVec3) -> u32 {
        hash(hash(cell.x as u32, cell.y as u32), cell.z as u32)
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
