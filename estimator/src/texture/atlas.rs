//! The atlas: every texel on the surface knows its triangle.

use crate::texture::charts::{ChartLimits, Cutter, Piece};
use crate::texture::pack::pack;
use firmware_config::tuning::TextureTuning;
use glam::{DVec2, Vec2, Vec3};
use rayon::prelude::*;
use recordings::result::Chart;
use recordings::types::Mesh;

/// A texel that shows no surface.
pub const EMPTY: u32 = u32::MAX;
/// Texels around a chart that continue its surface, for filters that reach beyond its border.
const GUTTER: u32 = 2;
/// Two triangles overlap if both cover the centre of a texel, the second with more than this barycentric weight at each corner.
const OVERLAP: f64 = 1e-2;
/// Factor from one attempt to the next where the charts fit no page, and the number of attempts.
const COARSER: f32 = 1.2;
const ATTEMPTS: usize = 24;
/// Share of the page that surface may cover in the first attempt.
const COVERED: f32 = 0.7;

/// Charts on a page.
pub struct Atlas {
    /// Texels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Width of a texel in the mesh's units.
    pub texel: f32,
    /// The charts.
    pub charts: Vec<Chart>,
    /// Index into `charts`: `[triangle]`.
    pub chart: Vec<u32>,
    /// Triangle, or [`EMPTY`]: `[row][column]`.
    pub owner: Vec<u32>,
}

impl Atlas {
    /// An atlas with texels of the given width, or of the smallest larger one at which the charts fit a page; `None` if they fit
    /// none.
    #[must_use]
    pub fn new(mesh: &Mesh, texel: f32, tuning: &TextureTuning) -> Option<Self> {
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize].as_dvec3());
            0.5 * (b - a).cross(c - a).length()
        };
        let surface = mesh.triangles.iter().map(area).sum::<f64>() as f32;
        if !(surface > 0.0 && surface.is_finite() && texel.is_finite()) {
            return None;
        }
        let mut texel = texel.max((surface / COVERED).sqrt() / tuning.max_side as f32);
        let mut cutter = Cutter::new(mesh);
        for _ in 0..ATTEMPTS {
            if let Some(atlas) = Self::with_texels(mesh, &mut cutter, texel, tuning) {
                return Some(atlas);
            }
            texel *= COARSER;
        }
        None
    }

    fn with_texels(mesh: &Mesh, cutter: &mut Cutter, texel: f32, tuning: &TextureTuning) -> Option<Self> {
        let side = tuning.chart_side.min(tuning.max_side - 4 * GUTTER) as f32;
        let angle = tuning.chart_angle_deg.to_radians();
        let limits = ChartLimits { min_cosine: libm::cos(angle) as f32, side: side / std::f32::consts::SQRT_2 * texel };
        let most = u64::from(tuning.max_side).pow(2);
        cutter.restart();
        let (mut grids, mut used) = (Vec::new(), 0);
        let mut chart = vec![EMPTY; mesh.triangles.len()];
        while let Some(piece) = cutter.next(&limits) {
            let (grid, folded) = Grid::new(mesh, &piece, texel);
            cutter.put_back(&folded);
            used += u64::from(grid.width) * u64::from(grid.height);
            if grid.width.max(grid.height) > tuning.max_side || used > most {
                return None;
            }
            piece.triangles.iter().for_each(|&t| chart[t as usize] = grids.len() as u32);
            grids.push(grid);
        }
        let sizes: Vec<[u32; 2]> = grids.iter().map(|g| [g.width, g.height]).collect();
        let page = pack(&sizes, tuning.max_side)?;
        grids.par_iter_mut().for_each(Grid::widen);
        let mut owner = vec![EMPTY; page.width as usize * page.height as usize];
        let mut charts = Vec::with_capacity(grids.len());
        for (grid, [left, top]) in grids.iter().zip(&page.corners) {
            for (row, y) in grid.owner.chunks(grid.width as usize).zip(*top..) {
                let start = y as usize * page.width as usize + *left as usize;
                owner[start..start + row.len()].copy_from_slice(row);
            }
            let Chart { x_offset, y_offset, .. } = grid.chart;
            charts.push(Chart { x_offset: x_offset + *left as f32, y_offset: y_offset + *top as f32, ..grid.chart });
        }
        Some(Self { width: page.width, height: page.height, texel, charts, chart, owner })
    }
}

/// The texels of one chart.
struct Grid {
    width: u32,
    height: u32,
    chart: Chart,
    owner: Vec<u32>,
}

impl Grid {
    /// The texels of a piece, and the triangles that would cover texels of others: the piece is folded there.
    fn new(mesh: &Mesh, piece: &Piece, texel: f32) -> (Self, Vec<u32>) {
        let axes = piece.axes.map(|a| a / texel);
        let flat = |i: u32| {
            let p = mesh.positions[i as usize];
            Vec2::new(axes[0].dot(p), axes[1].dot(p))
        };
        let corners = piece.triangles.iter().flat_map(|&t| mesh.triangles[t as usize]).map(flat);
        let (low, high) = corners.fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(l, h), q| (l.min(q), h.max(q)));
        let offset = Vec2::splat(GUTTER as f32) - low;
        let size = (high - low).ceil() + (1.0 + 2.0 * GUTTER as f32);
        let (width, height) = (size.x as u32, size.y as u32);
        let chart =
            Chart { x_axis: axes[0].to_array(), y_axis: axes[1].to_array(), x_offset: offset.x, y_offset: offset.y };
        let mut grid = Self { width, height, chart, owner: Vec::new() };
        // Wider than any page: refused by the caller.
        if width.max(height) > recordings::result::MAX_TEXTURE_SIDE {
            return (grid, Vec::new());
        }
        grid.owner = vec![EMPTY; width as usize * height as usize];
        let on_grid = |t: u32| mesh.triangles[t as usize].map(|i| chart.texel(mesh.positions[i as usize]).as_dvec2());
        let folded: Vec<u32> = piece.triangles.iter().copied().filter(|&t| !grid.cover(t, on_grid(t))).collect();
        if let Some(&seed) = piece.triangles.first().filter(|_| grid.owner.iter().all(|o| *o == EMPTY)) {
            let [a, b, c] = on_grid(seed);
            let middle = ((a + b + c) / 3.0).round();
            let at = middle.y as usize * width as usize + middle.x as usize;
            grid.owner[at] = seed;
        }
        (grid, folded)
    }

    /// Covers the free texels with centres in a triangle; false, and nothing is covered, if it overlaps another one.
    fn cover(&mut self, t: u32, corners: [DVec2; 3]) -> bool {
        let [a, b, c] = corners;
        let area = (b - a).perp_dot(c - a);
        if !(area.abs() > 1e-12 && area.is_finite()) {
            return true;
        }
        let low = a.min(b).min(c).ceil().max(DVec2::ZERO);
        let high = a.max(b).max(c).floor().min(DVec2::new(f64::from(self.width - 1), f64::from(self.height - 1)));
        let mut covered = Vec::new();
        for y in low.y as usize..=high.y.max(0.0) as usize {
            for x in low.x as usize..=high.x.max(0.0) as usize {
                let p = DVec2::new(x as f64, y as f64);
                let (u, v) = ((p - a).perp_dot(c - a) / area, (b - a).perp_dot(p - a) / area);
                let least = u.min(v).min(1.0 - u - v);
                let at = y * self.width as usize + x;
                if least > OVERLAP && self.owner[at] != EMPTY {
                    return false;
                }
                if least > -1e-9 && self.owner[at] == EMPTY {
                    covered.push(at);
                }
            }
        }
        covered.into_iter().for_each(|at| self.owner[at] = t);
        true
    }

    /// Continues the triangles at the border into the gutter.
    fn widen(&mut self) {
        (0..GUTTER).for_each(|_| self.widen_once());
    }

    /// The same by one texel.
    fn widen_once(&mut self) {
        let (w, h) = (self.width as usize, self.height as usize);
        let before = self.owner.clone();
        for y in 0..h {
            for x in (0..w).filter(|x| before[y * w + x] == EMPTY) {
                // Neighbours across an edge come before those across a corner.
                let around = [(0, -1), (-1, 0), (1, 0), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)];
                let owner = around.iter().find_map(|&(dx, dy): &(isize, isize)| {
                    let (x, y) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
                    (x < w && y < h && before[y * w + x] != EMPTY).then(|| before[y * w + x])
                });
                self.owner[y * w + x] = owner.unwrap_or(EMPTY);
            }
        }
    }
}

/// Barycentric weights of a texel in its triangle on the chart; beyond the triangle they continue its plane, at most by its own
/// size.
#[must_use]
pub fn weights(chart: &Chart, corners: [Vec3; 3], texel: Vec2) -> [f32; 3] {
    let [a, b, c] = corners.map(|p| chart.texel(p));
    let area = (b - a).perp_dot(c - a);
    if !(area.abs() > 1e-6 && area.is_finite()) {
        return [1.0 / 3.0; 3];
    }
    let u = ((texel - a).perp_dot(c - a) / area).clamp(-1.0, 2.0);
    let v = ((b - a).perp_dot(texel - a) / area).clamp(-1.0, 2.0);
    [1.0 - u - v, u, v]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use recordings::types::vertex_normals;

    fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Mesh {
        Mesh { normals: vertex_normals(&positions, &triangles), positions, triangles }
    }

    /// A grid of n × n quads over the unit square, lifted.
    fn sheet(n: u32, lift: impl Fn(f32, f32) -> Vec3) -> Mesh {
        let at = |i: u32| i as f32 / n as f32;
        let positions = (0..=n).flat_map(|y| (0..=n).map(move |x| (x, y))).map(|(x, y)| lift(at(x), at(y))).collect();
        let corner = |x: u32, y: u32| y * (n + 1) + x;
        let quad = |(x, y)| {
            let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
            [[a, b, c], [a, c, d]]
        };
        mesh(positions, (0..n).flat_map(|y| (0..n).map(move |x| (x, y))).flat_map(quad).collect())
    }

    /// Every texel that a triangle owns lies on it or beside it, and no surface is without texels.
    fn holds(mesh: &Mesh, atlas: &Atlas) -> bool {
        let on = |(at, &t): (usize, &u32)| {
            let chart = &atlas.charts[atlas.chart[t as usize] as usize];
            let corners = mesh.triangles[t as usize].map(|i| chart.texel(mesh.positions[i as usize]));
            let (low, high) =
                corners.iter().fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(l, h), c| (l.min(*c), h.max(*c)));
            let texel = Vec2::new((at % atlas.width as usize) as f32, (at / atlas.width as usize) as f32);
            let reach = GUTTER as f32 + 0.6;
            texel.cmpge(low - reach).all() && texel.cmple(high + reach).all()
        };
        let charted = atlas.chart.iter().all(|c| (*c as usize) < atlas.charts.len());
        charted && atlas.owner.iter().enumerate().filter(|(_, o)| **o != EMPTY).all(on)
    }

    #[test]
    fn a_plane_is_one_chart_and_its_texels_are_where_they_say() {
        let plane = sheet(8, |x, y| Vec3::new(x, 0.3 * y, 0.5));
        let atlas = Atlas::new(&plane, 0.01, &TextureTuning::default()).unwrap();
        assert_eq!((atlas.charts.len(), atlas.texel), (1, 0.01));
        let covered = atlas.owner.iter().filter(|o| **o != EMPTY).count();
        assert!((3000..3700).contains(&covered), "{covered} texels");
        for (at, &t) in atlas.owner.iter().enumerate().filter(|(_, o)| **o != EMPTY) {
            let corners = plane.triangles[t as usize].map(|i| plane.positions[i as usize]);
            let texel = Vec2::new((at % atlas.width as usize) as f32, (at / atlas.width as usize) as f32);
            let w = weights(&atlas.charts[0], corners, texel);
            let point = (0..3).map(|k| corners[k] * w[k]).sum::<Vec3>();
            assert!(atlas.charts[0].texel(point).distance(texel) < 1e-2);
        }
    }

    /// A strip rolled up twice: seen along its axis it lies on itself, seen from any side it is folded.
    #[test]
    fn rolled_surfaces_are_cut() {
        let spiral = sheet(60, |x, y| {
            let (angle, radius) = (4.0 * std::f32::consts::PI * x, 0.2 + 0.1 * x);
            Vec3::new(radius * libm::cosf(angle), radius * libm::sinf(angle), y)
        });
        let atlas = Atlas::new(&spiral, 0.01, &TextureTuning::default()).unwrap();
        assert!(holds(&spiral, &atlas));
        assert!((6..40).contains(&atlas.charts.len()), "{} charts", atlas.charts.len());
    }

    /// A ramp that winds around an axis: its normals agree, so only the overlap tells one turn from the next.
    #[test]
    fn layers_do_not_share_texels() {
        let ramp = sheet(60, |x, y| {
            let (angle, radius) = (6.0 * std::f32::consts::PI * x, 0.2 + 0.3 * y);
            Vec3::new(radius * libm::cosf(angle), radius * libm::sinf(angle), 0.2 * x)
        });
        let atlas = Atlas::new(&ramp, 0.01, &TextureTuning::default()).unwrap();
        let surface = 3.0 * std::f32::consts::PI * (0.25 - 0.04) / 1e-4;
        let covered = atlas.owner.iter().filter(|o| **o != EMPTY).count() as f32;
        assert!(covered > surface, "{covered} texels for {surface}");
    }

    #[test]
    fn what_has_no_area_has_no_atlas() {
        let tuning = TextureTuning::default();
        assert!(Atlas::new(&mesh(vec![Vec3::ZERO; 3], vec![[0, 1, 2]]), 0.0, &tuning).is_none());
        assert!(Atlas::new(&mesh(vec![Vec3::NAN; 3], vec![[0, 1, 2]]), 0.01, &tuning).is_none());
        // More pieces than a page has room for.
        let apart = |i: u32| {
            let x = Vec3::X * (10 * i) as f32;
            [x, x + Vec3::X, x + Vec3::Y]
        };
        let many = mesh((0..400).flat_map(apart).collect(), (0..400).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect());
        let small = TextureTuning { max_side: 64, ..TextureTuning::default() };
        assert!(Atlas::new(&many, 0.1, &small).is_none());
    }

    #[test]
    fn surfaces_too_large_for_the_page_get_coarser_texels() {
        let plane = sheet(8, |x, y| Vec3::new(x, y, 0.0));
        let tuning = TextureTuning { max_side: 128, ..TextureTuning::default() };
        let atlas = Atlas::new(&plane, 1e-4, &tuning).unwrap();
        assert!(atlas.width.max(atlas.height) <= 128 && atlas.texel > 1.0 / 128.0);
    }

    proptest! {
        #[test]
        fn any_triangles_get_charts(
            corners in proptest::collection::vec((0u32..12, 0u32..12, 0u32..12), 1..40),
            points in proptest::collection::vec((-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0), 12),
        ) {
            let positions: Vec<Vec3> = points.into_iter().map(Vec3::from).collect();
            let soup = mesh(positions, corners.into_iter().map(|(a, b, c)| [a, b, c]).collect());
            if let Some(atlas) = Atlas::new(&soup, 0.05, &TextureTuning::default()) {
                prop_assert!(holds(&soup, &atlas));
            }
        }
    }
}
