//! Places of a lamp that is not seen: every place costs one more column, so that a lattice of places can be compared; the best ones
//! are solved in full and refined by a simplex. What is left at the samples is least where the errors of the colours are explained as
//! well, so the choice among the refined places is left to held-out surface.

use crate::factorisation::Projection;
use crate::light_model::choose::Columns;
use crate::light_model::lamps::{self, Sphere};
use crate::light_model::samples::{self, DARK_FLOOR, Samples};
use crate::light_model::solve::{self, Channel, Rows, Values};
use crate::numerics::cielab::luminance_f64;
use crate::numerics::sh;
use crate::rays::RayScene;
use glam::Vec3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use recordings::types::Mesh;

/// Places of the lattice along each axis.
const LATTICE: [u32; 3] = [13, 13, 10];
/// The lattice reaches beyond the scene by this share of its longest side.
const MARGIN: f32 = 0.6;
/// Directions of lamps at infinity, and how many scene sizes away they are searched.
const DIRECTIONS: usize = 800;
const FAR: f32 = 20.0;
/// Samples that the places of the lattice are compared by: all of them by a few, and the best share of those by more.
const SKETCH_SAMPLES: usize = 175;
const LATTICE_SAMPLES: usize = 700;
const LIKELY: f64 = 0.25;
/// Best places that are solved in full, no two nearer than this many lattice steps.
const SOLVED: usize = 6;
const APART: f32 = 1.6;
/// Of directions, so many are solved, since those that light little surface can come first, and so many refined: shadows make several
/// that are nearly as good.
const DIRECTIONS_SOLVED: usize = 24;
const DIRECTIONS_REFINED: usize = 3;
/// Where there is no other lamp but those that pictures show, places are not refined unless the best of them leaves less than this share
/// of what none leaves: lamps that were there left 0.96 at most.
const HOPEFUL: f64 = 0.97;
/// First edge of the simplex in lattice steps, evaluations, and edge at which it ends in lattice steps.
const SIMPLEX: f32 = 0.6;
const EVALUATIONS: usize = 60;
const SETTLED: f32 = 0.02;
/// Regularisation of the light beyond the lamp during the search.
const REGULARISATION: f64 = 1e-1;
/// Relative residuals count up to this.
const CAPPED: f64 = 1.5;
/// Weight of the condition on the mean light.
const NORMALISED: f64 = 10.0;

/// What the search knows of the scene.
pub struct Search<'a> {
    mesh: &'a Mesh,
    scene: &'a RayScene,
    /// The samples that are not held out, and the model that a lamp is added to.
    samples: Samples,
    columns: Columns,
    projection: Projection,
    /// Luminance of the samples.
    values: Values,
    /// The model without a lamp more.
    without: Channel,
    /// That has no lamp but those that pictures show.
    is_first: bool,
}

impl<'a> Search<'a> {
    /// Searches for a lamp that is added to the model of `columns`, the first one that no picture shows or a further one; `scene` is the
    /// mesh for rays.
    #[must_use]
    pub fn new(mesh: &'a Mesh, scene: &'a RayScene, samples: &Samples, columns: &Columns, is_first: bool) -> Self {
        let fitted: Vec<usize> = samples.fitted().collect();
        let (samples, columns) = (samples.chosen(&fitted), columns.chosen(&fitted));
        let rows = columns.rows(&samples);
        let (projection, values) = (Projection::new(rows.coefficients), Values::new(&rows, luminance_f64));
        let without = solve::solve_channel(&rows, &values, &projection, REGULARISATION);
        Self { mesh, scene, samples, columns, projection, values, without, is_first }
    }

    /// The best of the places that are possible, seen as points; none where no place explains anything.
    #[must_use]
    pub fn best_places(&self, is_possible: impl Fn(&Vec3) -> bool + Sync + Send) -> Vec<Vec3> {
        let (low, high) = samples::bounds(self.mesh);
        let margin = MARGIN * (high - low).max_element();
        let step = (high - low + 2.0 * margin) / Vec3::from_array(LATTICE.map(|n| (n - 1) as f32));
        let mut places: Vec<Vec3> = Vec::new();
        for x in 0..LATTICE[0] {
            for y in 0..LATTICE[1] {
                for z in 0..LATTICE[2] {
                    places.push(low - margin + step * Vec3::new(x as f32, y as f32, z as f32));
                }
            }
        }
        let places: Vec<Vec3> = places.into_par_iter().filter(&is_possible).collect();
        let best = self.best_of(&places, step, SOLVED, SOLVED);
        let refined = |best| self.refined(best, &[Vec3::X, Vec3::Y, Vec3::Z], step.min_element());
        best.into_par_iter().map(refined).filter(|place| is_possible(place)).collect()
    }

    /// Unit vectors from the scene towards the best lamps at infinity; none where no lamp explains anything.
    #[must_use]
    pub fn best_directions(&self) -> Vec<Vec3> {
        let (low, high) = samples::bounds(self.mesh);
        let (middle, distance) = (0.5 * (low + high), FAR * low.distance(high));
        let places: Vec<Vec3> =
            sh::even_directions(DIRECTIONS).iter().map(|d| middle + d.as_vec3() * distance).collect();
        let step = distance * (4.0 * std::f32::consts::PI / DIRECTIONS as f32).sqrt();
        let best = self.best_of(&places, Vec3::splat(step), DIRECTIONS_SOLVED, DIRECTIONS_REFINED);
        let refined = |best: (f64, Vec3)| {
            let (across, up) = (best.1 - middle).normalize_or(Vec3::Z).any_orthonormal_pair();
            (self.refined(best, &[across, up], step) - middle).normalize_or_zero()
        };
        best.into_par_iter().map(refined).collect()
    }

    /// The best of these places, `step` apart, with their costs; so many of them are solved, and so many of those remain.
    fn best_of(&self, places: &[Vec3], step: Vec3, solved: usize, remain: usize) -> Vec<(f64, Vec3)> {
        let sketched = by_gain(places, &self.gains(places, SKETCH_SAMPLES));
        let likely = &sketched[..(LIKELY * sketched.len() as f64).ceil() as usize];
        let mut apart: Vec<Vec3> = Vec::new();
        for place in by_gain(likely, &self.gains(likely, LATTICE_SAMPLES)) {
            if apart.iter().all(|p| ((place - *p) / step).length() > APART) {
                apart.push(place);
            }
            if apart.len() >= solved {
                break;
            }
        }
        let mut tried: Vec<(f64, Vec3)> = apart.into_par_iter().map(|p| (self.cost(p), p)).collect();
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        tried.truncate(remain);
        // A first lamp explains much of what is left, if there is any.
        let most = if self.is_first { HOPEFUL * self.unexplained(&self.without) } else { f64::INFINITY };
        if tried.first().is_none_or(|best| best.0 > most) {
            return Vec::new();
        }
        tried
    }

    /// How much each place lowers the quadratic form over about so many samples, the rows divided by the light of the model without it.
    fn gains(&self, places: &[Vec3], most: usize) -> Vec<f64> {
        let Self { values, without, .. } = self;
        let Rows { samples, columns, shared, .. } = self.columns.rows(&self.samples);
        let few: Vec<usize> = (0..samples.len()).step_by(samples.len().div_ceil(most).max(1)).collect();
        let total: f64 = few.iter().map(|n| samples.weight[*n]).sum();
        let explained = |n: usize| values.color[n] / without.albedo[samples.segment[n] as usize].max(1e-30);
        let mean = few.iter().map(|n| samples.weight[*n] * explained(*n)).sum::<f64>() / total.max(1e-30);
        let size = |n: usize| (0.5 * (explained(n) + without.irradiance[n])).max(DARK_FLOOR * mean);
        // Columns of the model: light at low order, lamps and emitters, secondary light.
        let dim = columns + 1;
        let entry = |n: usize, j: usize| {
            if j < columns { f64::from(shared[n * columns + j]) } else { values.secondary[n] }
        };
        let rows = DMatrix::from_fn(few.len(), dim, |n, j| entry(few[n], j));
        let weights: Vec<f64> = few.iter().map(|n| samples.weight[*n] / (size(*n) * size(*n))).collect();
        let relative: Vec<f64> = few.iter().map(|n| samples.weight[*n] / (size(*n) * total)).collect();
        let mut squares = vec![0.0; samples.segments];
        let mut crosses = vec![DVector::<f64>::zeros(dim); samples.segments];
        let mut gram = DMatrix::<f64>::zeros(dim, dim);
        let mut level = DVector::<f64>::zeros(dim);
        for (r, &n) in few.iter().enumerate() {
            let (s, f) = (samples.segment[n] as usize, values.color[n]);
            let row = rows.row(r).transpose();
            squares[s] += weights[r] * f * f;
            crosses[s].axpy(weights[r] * f, &row, 1.0);
            gram.ger(weights[r], &row, &row, 1.0);
            level.axpy(relative[r], &row, 1.0);
        }
        for (square, cross) in squares.iter().zip(&crosses).filter(|(s, _)| **s > 0.0) {
            gram.ger(-1.0 / square, cross, cross, 1.0);
        }
        let held = NORMALISED * total;
        gram.ger(held, &level, &level, 1.0);
        let ridge = 1e-6 * gram.trace() / dim as f64;
        (0..dim).for_each(|j| gram[(j, j)] += ridge);
        let Some(factor) = gram.cholesky() else { return vec![0.0; places.len()] };
        let base = factor.solve(&(&level * held));
        // Vertex by vertex: rays from one point to neighbouring places pass through the same parts of the scene.
        let at_vertex = |n: &usize| -> Vec<f32> {
            let at = |place: &Vec3| {
                let sphere = Sphere { center: *place, radius: 0.0 };
                lamps::form_factor(self.mesh, self.scene, samples.vertex[*n] as usize, &sphere)
            };
            places.iter().map(at).collect()
        };
        let factors: Vec<Vec<f32>> = few.par_iter().map(at_vertex).collect();
        (0..places.len())
            .into_par_iter()
            .map(|place| {
                let column: Vec<f64> = factors.iter().map(|of_vertex| f64::from(of_vertex[place])).collect();
                let mut lamp_cross = vec![0.0; samples.segments];
                let (mut square, mut lamp_level) = (0.0, 0.0);
                let mut cross = DVector::<f64>::zeros(dim);
                for (r, &n) in few.iter().enumerate().filter(|(r, _)| column[*r] > 0.0) {
                    lamp_cross[samples.segment[n] as usize] += weights[r] * values.color[n] * column[r];
                    square += weights[r] * column[r] * column[r];
                    lamp_level += relative[r] * column[r];
                    let scale = weights[r] * column[r];
                    cross.iter_mut().zip(rows.row(r).iter()).for_each(|(c, x)| *c += scale * x);
                }
                let whole = square;
                for ((l, s), c) in lamp_cross.iter().zip(&squares).zip(&crosses).filter(|((l, _), _)| **l > 0.0) {
                    square -= l * l / s;
                    cross.axpy(-l / s, c, 1.0);
                }
                cross.axpy(held * lamp_level, &level, 1.0);
                square += held * lamp_level * lamp_level;
                let left = square - cross.dot(&factor.solve(&cross));
                let power = (held * lamp_level - cross.dot(&base)) / left;
                if left > 1e-9 * whole && power > 0.0 { power * power * left } else { 0.0 }
            })
            .collect()
    }

    /// Mean capped residual of the model with a lamp at this place.
    fn cost(&self, place: Vec3) -> f64 {
        let (rows, values) = (self.columns.rows(&self.samples), &self.values);
        let sphere = Sphere { center: place, radius: 0.0 };
        let column = lamps::form_factors(self.mesh, self.scene, &self.samples.vertex, &sphere);
        let (shared, columns) = rows.with_column(&column);
        let rows = Rows { shared: &shared, columns, ..rows };
        self.unexplained(&solve::solve_channel(&rows, values, &self.projection, REGULARISATION))
    }

    /// Mean capped residual of a model.
    fn unexplained(&self, solved: &Channel) -> f64 {
        let (samples, values) = (&self.samples, &self.values);
        let mean: f64 = solved.irradiance.iter().zip(&samples.weight).map(|(e, w)| e * w).sum::<f64>()
            / samples.weight.iter().sum::<f64>().max(1e-30);
        let (mut sum, mut total) = (0.0, 0.0);
        for n in 0..samples.len() {
            let explained = values.color[n] / solved.albedo[samples.segment[n] as usize].max(1e-30);
            let size = (0.5 * (explained + solved.irradiance[n])).max(DARK_FLOOR * mean);
            sum += samples.weight[n] * ((explained - solved.irradiance[n]).abs() / size).min(CAPPED);
            total += samples.weight[n];
        }
        if total > 0.0 { sum / total } else { f64::INFINITY }
    }

    /// Nelder and Mead's simplex, from a place of the lattice along these axes.
    fn refined(&self, from: (f64, Vec3), axes: &[Vec3], step: f32) -> Vec3 {
        let cost = |place: Vec3| (self.cost(place), place);
        let mut simplex = vec![from];
        simplex.par_extend(axes.par_iter().map(|axis| cost(from.1 + *axis * (SIMPLEX * step))));
        let last = axes.len();
        let mut evaluations = last;
        while evaluations < EVALUATIONS {
            simplex.sort_by(|a, b| a.0.total_cmp(&b.0));
            let edge = simplex.iter().map(|v| v.1.distance(simplex[0].1)).fold(0.0, f32::max);
            if edge < SETTLED * step {
                break;
            }
            let center = simplex[..last].iter().map(|v| v.1).sum::<Vec3>() / last as f32;
            let worst = simplex[last];
            let reflected = cost(center + (center - worst.1));
            evaluations += 1;
            if reflected.0 < simplex[0].0 {
                let expanded = cost(center + (center - worst.1) * 2.0);
                evaluations += 1;
                simplex[last] = if expanded.0 < reflected.0 { expanded } else { reflected };
            } else if reflected.0 < simplex[last - 1].0 {
                simplex[last] = reflected;
            } else {
                let toward = if reflected.0 < worst.0 { reflected.1 } else { worst.1 };
                let contracted = cost(center + (toward - center) * 0.5);
                evaluations += 1;
                if contracted.0 < worst.0.min(reflected.0) {
                    simplex[last] = contracted;
                } else {
                    let best = simplex[0].1;
                    simplex[1..].par_iter_mut().for_each(|v| *v = cost(best + (v.1 - best) * 0.5));
                    evaluations += last;
                }
            }
        }
        simplex.sort_by(|a, b| a.0.total_cmp(&b.0));
        simplex[0].1
    }
}

/// The places that gain anything, the best first.
fn by_gain(places: &[Vec3], gains: &[f64]) -> Vec<Vec3> {
    let mut order: Vec<usize> = (0..places.len()).filter(|i| gains[*i] > 0.0).collect();
    order.sort_by(|a, b| gains[*b].total_cmp(&gains[*a]).then(a.cmp(b)));
    order.into_iter().map(|i| places[i]).collect()
}
