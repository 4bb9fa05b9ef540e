//! Tracking: Gauss–Newton on photometric and point-to-plane residuals, coarse to fine.
//!
//! The pose is updated on the camera's side, T ← T · exp(δ), δ = (translation, rotation). Residuals are divided by their
//! standard deviations, so the normal matrix is an information matrix; its eigenvalues say which directions are observed.

use crate::camera::rig::{LEVELS, Rig, Rigid, depth_sigma};
use crate::frame::preprocess::{Frame, Surfel};
use crate::tsdf::volume::{Cursor, Volume};
use firmware_config::FusionConfig;
use glam::{DQuat, DVec3, Vec2, Vec3};
use nalgebra::{Matrix6, SMatrix, SVector, Vector6};
use rayon::prelude::*;
use recordings::types::Pose;

/// Points that a rayon task handles; fixed, so that sums have one order.
const CHUNK: usize = 2048;
/// Pose, brightness gain and brightness offset, read-out time.
const UNKNOWNS: usize = 9;

/// A point of a reference frame with the grey value it had there.
#[derive(Debug, Clone, Copy, Default)]
pub struct PhotoPoint {
    /// Position in the reference's colour camera.
    pub p: Vec3,
    /// Grey value.
    pub grey: f32,
}

/// A frame others are aligned to.
#[derive(Debug, Clone, Default)]
pub struct Reference {
    pub world_from_camera: Pose,
    /// Well textured points, per pyramid level.
    pub photo: [Vec<PhotoPoint>; LEVELS],
    /// Every second sample of the tracking grid, row-major.
    pub coarse: Vec<Surfel>,
    pub median_depth: f32,
    /// Mean grey value of the frame.
    pub mean_grey: f32,
}

impl Reference {
    /// Refills from a tracked frame.
    pub fn fill(&mut self, frame: &Frame, rig: &Rig, world_from_camera: &Pose, levels: std::ops::Range<usize>) {
        self.world_from_camera = *world_from_camera;
        self.median_depth = frame.median_depth;
        self.mean_grey = frame.mean_grey;
        self.coarse.clear();
        for y in (0..rig.grid.height).step_by(2) {
            for x in (0..rig.grid.width).step_by(2) {
                self.coarse.push(frame.grid[y * rig.grid.width + x]);
            }
        }
        for level in 0..LEVELS {
            self.photo[level].clear();
            if levels.contains(&level) {
                photo_points(frame, rig, level, &mut self.photo[level]);
            }
        }
    }
}

/// Least squared grey gradient (per pixel) of a photometric point.
const MIN_GRADIENT2: f32 = 9.0;

/// From each cell of an 80 × 60 grid over the depth image, the sample with the strongest grey gradient at `level`.
fn photo_points(frame: &Frame, rig: &Rig, level: usize, out: &mut Vec<PhotoPoint>) {
    let sweep = frame.motion.of_color(rig);
    let step = (rig.grid_step << level).div_ceil(2).max(1);
    let per_cell = (1usize << (LEVELS - 1 - level)).max(1);
    let (columns, rows) = (rig.depth.width / (step * per_cell), rig.depth.height / (step * per_cell));
    for cy in 0..rows {
        let row = ((cy as f64 + 0.5) / rows as f64) - 0.5;
        let to_color = Rigid::from(&frame.motion.color_from_row(row).compose(&rig.color_from_depth));
        for cx in 0..columns {
            let mut best = (MIN_GRADIENT2, PhotoPoint::default());
            for k in 0..per_cell * per_cell {
                let u = (cx * per_cell + k % per_cell) * step + step / 2;
                let v = (cy * per_cell + k / per_cell) * step + step / 2;
                let z = frame.depth[v * rig.depth.width + u];
                if z <= 0.0 {
                    continue;
                }
                let p = to_color.apply(rig.depth.ray(u as f32, v as f32) * z);
                let (_, q) = sweep.project(&rig.grey[level], p);
                let Some(gradient) = frame.grey[level].smooth_gradient(q) else { continue };
                let strength = gradient.length_squared();
                if strength > best.0
                    && let Some((grey, _)) = frame.grey[level].sample(q)
                {
                    best = (strength, PhotoPoint { p, grey });
                }
            }
            if best.0 > MIN_GRADIENT2 {
                out.push(best.1);
            }
        }
    }
}

/// exp of a twist (translation, rotation): to first order in the coupling, exact in the rotation.
pub fn exp(d: &Vector6<f64>) -> Pose {
    Pose::new(DQuat::from_scaled_axis(DVec3::new(d[3], d[4], d[5])), DVec3::new(d[0], d[1], d[2]))
}

/// The inverse of [`exp`].
pub fn log(p: &Pose) -> Vector6<f64> {
    let q = if p.rotation.w < 0.0 { -p.rotation } else { p.rotation };
    let (t, r) = (p.translation, q.to_scaled_axis());
    Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z)
}

/// A sum of weighted normal equations, H δ = b, and statistics of what went in.
#[derive(Debug, Clone, Copy)]
pub struct System {
    pub h: [[f64; UNKNOWNS]; UNKNOWNS],
    pub b: [f64; UNKNOWNS],
    /// Residuals that went in, and of them those within 3 σ.
    pub count: usize,
    inliers: usize,
    /// Sum of |r|, for the scale.
    pub absolute: f64,
}

impl System {
    pub const ZERO: Self =
        Self { h: [[0.0; UNKNOWNS]; UNKNOWNS], b: [0.0; UNKNOWNS], count: 0, inliers: 0, absolute: 0.0 };

    #[inline(always)]
    /// Adds a residual r with its derivatives j and weight w.
    pub fn add<const N: usize>(&mut self, j: &[f32; N], r: f32, w: f32) {
        let (r, w) = (f64::from(r), f64::from(w));
        let j = j.map(f64::from);
        for a in 0..N {
            let wj = w * j[a];
            for (h, jc) in self.h[a][a..N].iter_mut().zip(&j[a..]) {
                *h += wj * jc;
            }
            self.b[a] -= wj * r;
        }
    }

    fn symmetric(&self, a: usize, c: usize) -> f64 {
        self.h[a.min(c)][a.max(c)]
    }

    fn merge(mut self, other: &Self) -> Self {
        for a in 0..UNKNOWNS {
            for c in a..UNKNOWNS {
                self.h[a][c] += other.h[a][c];
            }
            self.b[a] += other.b[a];
        }
        self.count += other.count;
        self.inliers += other.inliers;
        self.absolute += other.absolute;
        self
    }
}

/// Sums over points in fixed chunks, so that the result does not depend on the number of threads.
fn sum_chunks<T: Sync>(points: &[T], f: impl Fn(&[T]) -> System + Sync + Send) -> System {
    let parts: Vec<System> = points.par_chunks(CHUNK).map(f).collect();
    parts.iter().fold(System::ZERO, |sum, part| sum.merge(part))
}

/// Brightness between reference and frame: grey = gain · reference + offset.
#[derive(Debug, Clone, Copy)]
struct Brightness {
    gain: f32,
    offset: f32,
}

/// Where and how the photometric term compares.
struct Comparison<'a> {
    frame: &'a Frame,
    rig: &'a Rig,
    level: usize,
    points: &'a [PhotoPoint],
    brightness: Brightness,
    sigma: f32,
}

/// The photometric system of a reference's points in the frame: r = I(π(x)) − (gain · I_ref + offset). `columns` makes the
/// residual's derivatives of those by pose, gain and offset, and of the pixel.
fn photometric<const N: usize>(
    comparison: &Comparison,
    camera_from_reference: &Pose,
    columns: impl Fn([f32; 8], Vec2) -> [f32; N] + Sync,
) -> System {
    let Comparison { frame, rig, level, points, brightness, sigma } = *comparison;
    let t = Rigid::from(camera_from_reference);
    let camera = &rig.grey[level];
    let grey = &frame.grey[level];
    let sweep = frame.motion.of_color(rig);
    sum_chunks(points, |points| {
        let mut system = System::ZERO;
        for point in points {
            let x = t.apply(point.p);
            if x.z < 0.1 {
                continue;
            }
            let (x, q) = sweep.project(camera, x);
            let Some((value, gradient)) = grey.sample(q) else { continue };
            let r = value - (brightness.gain * point.grey + brightness.offset);
            let iz = 1.0 / x.z;
            let (gx, gy) = (gradient.x * camera.fx * iz, gradient.y * camera.fy * iz);
            // ∂r/∂x; moving the camera by δ moves x by −(v + ω × x).
            let a = Vec3::new(gx, gy, -(gx * x.x + gy * x.y) * iz);
            let c = x.cross(a);
            let scaled = r / sigma;
            // Student's t with 5 degrees of freedom.
            let w = 6.0 / (5.0 + scaled * scaled) / (sigma * sigma);
            let j = [-a.x, -a.y, -a.z, -c.x, -c.y, -c.z, -point.grey, -1.0];
            system.add(&columns(j, q), r, w);
            system.count += 1;
            system.inliers += usize::from(scaled.abs() < 3.0);
            system.absolute += f64::from(r.abs());
        }
        system
    })
}

/// Fewest points, and least share of a reference's points seen, that pictures are compared by.
const LEAST_COMPARED: (usize, usize) = (50, 3);

/// Correlation, −1 … 1, of what the frame shows at the reference's points with what they looked like, at the coarsest
/// level; `None` where too few of them are seen.
pub fn likeness(scene: &Scene, world_from_camera: &Pose) -> Option<f32> {
    let t = Rigid::from(&world_from_camera.inverse().compose(&scene.reference.world_from_camera));
    let level = LEVELS - 1;
    let (camera, points) = (&scene.rig.grey[level], &scene.reference.photo[level]);
    let sweep = scene.frame.motion.of_color(scene.rig);
    let seen: Vec<(f64, f64)> = points
        .iter()
        .filter_map(|point| {
            let x = t.apply(point.p);
            let (value, _) =
                (x.z > 0.1).then(|| scene.frame.grey[level].sample(sweep.project(camera, x).1)).flatten()?;
            Some((f64::from(point.grey), f64::from(value)))
        })
        .collect();
    if seen.len() < LEAST_COMPARED.0 || seen.len() * LEAST_COMPARED.1 < points.len() {
        return None;
    }
    let n = seen.len() as f64;
    let (ma, mb) = seen.iter().fold((0.0, 0.0), |m, (a, b)| (m.0 + a / n, m.1 + b / n));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in seen {
        let (a, b) = (a - ma, b - mb);
        (ab, aa, bb) = (ab + a * b, aa + a * a, bb + b * b);
    }
    Some((ab / (aa * bb).sqrt().max(1e-9)) as f32)
}

/// A frame's point with the plane of the model it belongs to, world coordinates.
#[derive(Debug, Clone, Copy)]
struct Association {
    /// Point in the camera.
    p: Vec3,
    /// Plane n · x = d, n towards the free side.
    n: Vec3,
    d: f32,
}

/// The point-to-plane system: r = n · (T p) − d, robust by Tukey's weights at `cut` standard deviations.
/// `columns` makes the residual's derivatives of those by the pose, and of the point.
fn geometric<const N: usize>(
    associations: &[Association],
    world_from_camera: &Pose,
    cut: f32,
    columns: impl Fn([f32; 6], Vec3) -> [f32; N] + Sync,
) -> System {
    let t = Rigid::from(world_from_camera);
    let back = t.r.transpose();
    sum_chunks(associations, |associations| {
        let mut system = System::ZERO;
        for a in associations {
            let r = a.n.dot(t.apply(a.p)) - a.d;
            let sigma = depth_sigma(a.p.z);
            let scaled = r / (cut * sigma);
            let taper = 1.0 - scaled * scaled;
            system.count += 1;
            if taper <= 0.0 {
                continue;
            }
            let m = back * a.n;
            let c = a.p.cross(m);
            system.add(&columns([m.x, m.y, m.z, c.x, c.y, c.z], a.p), r, taper * taper / (sigma * sigma));
            system.inliers += usize::from(r.abs() < 3.0 * sigma);
            system.absolute += f64::from(r.abs());
        }
        system
    })
}

/// Projective association with a reference's grid (KinectFusion's, frame to frame).
fn associate_reference(
    frame: &Frame,
    rig: &Rig,
    reference: &Reference,
    pose: &Pose,
    out: &mut Vec<Association>,
) -> usize {
    out.clear();
    let mut asked = 0;
    let world_from_reference = Rigid::from(&reference.world_from_camera);
    let reference_from_camera = Rigid::from(&reference.world_from_camera.inverse().compose(pose));
    let to_depth = Rigid::from(&rig.depth_from_color);
    let columns = rig.grid.width.div_ceil(2);
    for y in (0..rig.grid.height).step_by(2) {
        for x in (0..rig.grid.width).step_by(2) {
            let s = frame.grid[y * rig.grid.width + x];
            if !s.is_valid() {
                continue;
            }
            asked += 1;
            let p = reference_from_camera.apply(s.p);
            let Some(pixel) = rig.grid.pixel(to_depth.apply(p)) else { continue };
            let (u, v) = (pixel % rig.grid.width / 2, pixel / rig.grid.width / 2);
            let Some(m) = reference.coarse.get(v * columns + u).filter(|m| m.is_valid()) else { continue };
            let apart = (m.p - p).length_squared();
            if apart > (0.1 * p.z) * (0.1 * p.z) || (reference_from_camera.r * s.n).dot(m.n) < 0.7 {
                continue;
            }
            let n = world_from_reference.r * m.n;
            out.push(Association { p: s.p, n, d: n.dot(world_from_reference.apply(m.p)) });
        }
    }
    asked
}

/// Association with the volume: the plane through the surface point nearest to each of the frame's points.
fn associate_volume(frame: &Frame, volume: &Volume, pose: &Pose, stride: usize, out: &mut Vec<Association>) -> usize {
    let t = Rigid::from(pose);
    let limit = 0.95 * volume.truncation_m();
    let parts: Vec<(Vec<Association>, usize)> = frame
        .grid
        .par_chunks(CHUNK)
        .map(|surfels| {
            let mut found = Vec::with_capacity(surfels.len() / stride);
            let mut asked = 0;
            let mut cursor = Cursor::default();
            for s in surfels.iter().step_by(stride).filter(|s| s.is_valid()) {
                asked += 1;
                let p = t.apply(s.p);
                let Some(sample) = volume.sample(p, &mut cursor) else { continue };
                let steepness = sample.gradient.length();
                if sample.distance.abs() > limit || !(0.3..3.0).contains(&steepness) {
                    continue;
                }
                let n = sample.gradient / steepness;
                if (t.r * s.n).dot(n) < 0.5 {
                    continue;
                }
                found.push(Association { p: s.p, n, d: n.dot(p) - sample.distance / steepness });
            }
            (found, asked)
        })
        .collect();
    out.clear();
    let mut asked = 0;
    for (found, n) in parts {
        out.extend(found);
        asked += n;
    }
    asked
}

/// Where the frame was found.
#[derive(Debug, Clone, Copy)]
pub struct Alignment {
    pub world_from_camera: Pose,
    /// Share of the asked grid points that agree with the geometry (within 3 σ), of those asked.
    pub fit: f32,
    /// Share of the asked grid points where the geometry is known.
    pub overlap: f32,
    /// Mean photometric residual of the last level, grey values.
    pub photo_error: f32,
    /// Share of the photometric points that were seen.
    pub photo_seen: f32,
    /// Smallest eigenvalue of the information matrix over the largest.
    pub condition: f64,
    /// Projector to the directions that the geometry observes.
    observed: Matrix6<f64>,
    brightness: Brightness,
    sigma: f32,
}

impl Alignment {
    /// What to compare alignments of one frame by: photometric residual and disagreeing geometry.
    pub fn misfit(&self) -> f32 {
        0.1 * self.photo_error - self.fit + 0.2 * (1.0 - self.photo_seen)
    }
}

/// What geometry a step of the schedule aligns to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Geometry {
    /// The reference frame's own points.
    Reference,
    /// The volume, with every `stride`-th grid point.
    Volume {
        /// Grid points per one used.
        stride: usize,
    },
}

/// One step of a coarse-to-fine schedule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Pyramid level of the photometric term.
    pub level: usize,
    /// Geometric term.
    pub geometry: Geometry,
    /// Associations to make, each followed by two Gauss–Newton iterations.
    pub rounds: usize,
    /// Standard deviations at which a geometric residual loses all weight.
    pub cut: f32,
}

/// Scratch of the tracker.
#[derive(Default)]
pub struct Tracker {
    associations: Vec<Association>,
}

/// The frame and what it is aligned to.
pub struct Scene<'a> {
    pub frame: &'a Frame,
    pub rig: &'a Rig,
    pub reference: &'a Reference,
    pub volume: &'a Volume,
    pub config: &'a FusionConfig,
}

impl Tracker {
    /// Aligns the frame, starting at `start`; `predicted` is the motion prior's pose, which holds unobserved directions.
    pub fn align(&mut self, scene: &Scene, start: &Pose, predicted: &Pose, schedule: &[Step]) -> Alignment {
        let Scene { frame, rig, reference, volume, config } = *scene;
        let mut pose = *start;
        let mut brightness =
            Brightness { gain: ((frame.mean_grey + 1.0) / (reference.mean_grey + 1.0)).clamp(0.2, 5.0), offset: 0.0 };
        let mut out = Alignment {
            world_from_camera: pose,
            fit: 0.0,
            overlap: 0.0,
            photo_error: 0.0,
            photo_seen: 0.0,
            condition: 0.0,
            observed: Matrix6::identity(),
            brightness,
            sigma: 0.0,
        };
        let floor = config.photometric_sigma as f32;
        let mut sigma = 4.0 * floor;
        for step in schedule {
            let points = &reference.photo[step.level];
            for _ in 0..step.rounds {
                let asked = match step.geometry {
                    Geometry::Reference => associate_reference(frame, rig, reference, &pose, &mut self.associations),
                    Geometry::Volume { stride } => {
                        associate_volume(frame, volume, &pose, stride, &mut self.associations)
                    }
                };
                for _ in 0..2 {
                    let camera_from_reference = pose.inverse().compose(&reference.world_from_camera);
                    let comparison = Comparison { frame, rig, level: step.level, points, brightness, sigma };
                    let photo = photometric(&comparison, &camera_from_reference, |j, _| j);
                    let geo = geometric(&self.associations, &pose, step.cut, |j, _| j);
                    let offset = log(&pose.inverse().compose(predicted));
                    let solution = solve(&geo, &photo, &offset, f64::from(frame.median_depth), config);
                    pose = pose.compose(&exp(&solution.delta));
                    brightness.gain = (brightness.gain + solution.gain).clamp(0.2, 5.0);
                    brightness.offset = (brightness.offset + solution.offset).clamp(-128.0, 128.0);
                    out.fit = geo.inliers as f32 / asked.max(1) as f32;
                    out.overlap = geo.count as f32 / asked.max(1) as f32;
                    out.photo_error = (photo.absolute / photo.count.max(1) as f64) as f32;
                    out.photo_seen = photo.count as f32 / points.len().max(1) as f32;
                    out.condition = solution.condition;
                    out.observed = solution.observed;
                    (out.brightness, out.sigma) = (brightness, sigma);
                    sigma = (1.2533 * out.photo_error).clamp(floor, 8.0 * floor);
                    if solution.delta.norm() < 1e-5 {
                        break;
                    }
                }
            }
        }
        out.world_from_camera = pose;
        out
    }
}

/// Normal equations H x = b for x = (pose 6, delay of depth, read-out time), at a pose found: metres, radians, seconds.
#[derive(Debug, Clone, Copy)]
pub struct TimingSystem {
    pub h: SMatrix<f64, 8, 8>,
    pub b: SVector<f64, 8>,
}

impl Tracker {
    /// What the frame just aligned says about instants. With the camera moving by the twist v per second, a depth that is
    /// τ later than thought has residuals r + J (δ − τ v), the picture's stay r + J δ, and a read-out that takes T longer
    /// than thought adds s T J v to those in row s = −½ … ½ of either image.
    pub fn timing(&self, scene: &Scene, found: &Alignment, step: &Step) -> TimingSystem {
        let Scene { frame, rig, reference, config, .. } = *scene;
        let velocity = frame.motion.velocity;
        let dot = |j: &[f32], v: &Vector6<f64>| j.iter().zip(v.iter()).map(|(j, v)| j * *v as f32).sum::<f32>();
        let to_depth = Rigid::from(&rig.depth_from_color);
        let seen = found.observed * velocity;
        let geo = geometric(&self.associations, &found.world_from_camera, step.cut, |j, p| {
            let row = rig.depth.row(rig.depth.project(to_depth.apply(p)).y);
            let [a, b, c, d, e, f] = j;
            [a, b, c, d, e, f, row * dot(&j, &seen)]
        });
        let camera_from_reference = found.world_from_camera.inverse().compose(&reference.world_from_camera);
        let (points, level) = (&reference.photo[step.level], step.level);
        let comparison = Comparison { frame, rig, level, points, brightness: found.brightness, sigma: found.sigma };
        let photo = photometric(&comparison, &camera_from_reference, |j, q| {
            let [a, b, c, d, e, f, gain, offset] = j;
            [a, b, c, d, e, f, gain, offset, rig.grey[level].row(q.y) * dot(&j[..6], &velocity)]
        });

        // Each term's unknowns by the common ones: of the geometry only the directions that it observes, of the picture
        // what is left with the brightness eliminated.
        let mut from_geo = SMatrix::<f64, 8, 7>::zeros();
        from_geo.fixed_view_mut::<6, 6>(0, 0).copy_from(&found.observed.transpose());
        from_geo.fixed_view_mut::<1, 6>(6, 0).copy_from(&(-seen.transpose()));
        from_geo[(7, 6)] = 1.0;
        let h_geo = SMatrix::<f64, 7, 7>::from_fn(|a, c| geo.symmetric(a, c));
        let b_geo = SVector::<f64, 7>::from_fn(|a, _| geo.b[a]);
        let mut from_photo = SMatrix::<f64, 8, 7>::zeros();
        from_photo.fixed_view_mut::<6, 6>(0, 0).fill_with_identity();
        from_photo[(7, 6)] = 1.0;
        let kept = [0, 1, 2, 3, 4, 5, 8];
        let Eliminated { h, b, .. } = eliminate_brightness(&photo, &kept, config.photometric_weight);
        TimingSystem {
            h: from_geo * h_geo * from_geo.transpose() + from_photo * h * from_photo.transpose(),
            b: from_geo * b_geo + from_photo * b,
        }
    }
}

/// A photometric system without its two brightness unknowns.
struct Eliminated<const N: usize> {
    h: SMatrix<f64, N, N>,
    b: SVector<f64, N>,
    /// The brightness that belongs to x is `offset` − `slope` x.
    offset: SVector<f64, 2>,
    slope: SMatrix<f64, 2, N>,
}

/// Eliminates gain and offset, which get a weak prior for frames without texture.
fn eliminate_brightness<const N: usize>(photo: &System, kept: &[usize; N], weight: f64) -> Eliminated<N> {
    let prior = SMatrix::<f64, 2, 2>::from_diagonal_element(1e-3);
    let h_brightness = SMatrix::<f64, 2, 2>::from_fn(|a, c| weight * photo.symmetric(6 + a, 6 + c)) + prior;
    let coupling = SMatrix::<f64, N, 2>::from_fn(|a, c| weight * photo.symmetric(kept[a], 6 + c));
    let rhs = SVector::<f64, 2>::new(photo.b[6], photo.b[7]) * weight;
    let inverse = h_brightness.try_inverse().unwrap_or_else(SMatrix::zeros);
    let gain = coupling * inverse;
    Eliminated {
        h: SMatrix::from_fn(|a, c| weight * photo.symmetric(kept[a], kept[c])) - gain * coupling.transpose(),
        b: SVector::from_fn(|a, _| weight * photo.b[kept[a]]) - gain * rhs,
        offset: inverse * rhs,
        slope: gain.transpose(),
    }
}

struct Solution {
    observed: Matrix6<f64>,
    delta: Vector6<f64>,
    gain: f32,
    offset: f32,
    condition: f64,
}

/// Solves for the step. Directions in which the geometry's eigenvalue is too small against its largest are not observed
/// by it (noise in the normals alone gives some): there its measurements are dropped, and texture and the prior
/// (`offset`: from the present pose to the predicted one) decide.
fn solve(geo: &System, photo: &System, offset: &Vector6<f64>, depth: f64, config: &FusionConfig) -> Solution {
    // Rotations are measured by the length they move a point at the median depth.
    let lever = depth.max(0.1);
    let scale = Vector6::new(1.0, 1.0, 1.0, 1.0 / lever, 1.0 / lever, 1.0 / lever);

    let eigen = Matrix6::from_fn(|a, c| geo.symmetric(a, c) * scale[a] * scale[c]).symmetric_eigen();
    let largest = eigen.eigenvalues.max().max(1e-9);
    let rhs = Vector6::from_fn(|a, _| geo.b[a] * scale[a]);
    let mut h = Matrix6::zeros();
    let mut b = Vector6::zeros();
    let mut observed = Matrix6::zeros();
    for i in 0..6 {
        let axis = eigen.eigenvectors.column(i).into_owned();
        if eigen.eigenvalues[i] > config.unobserved_below * largest {
            h += axis * axis.transpose() * eigen.eigenvalues[i];
            b += axis * axis.dot(&rhs);
            observed += axis * axis.transpose();
        }
    }

    let units = Matrix6::from_diagonal(&scale);
    let picture = eliminate_brightness(photo, &[0, 1, 2, 3, 4, 5], config.photometric_weight);
    let (h_photo, b_photo) = (units * picture.h * units, units * picture.b);

    let prior = Vector6::from_fn(|a, _| {
        let sigma = if a < 3 { config.prior_sigma_m } else { config.prior_sigma_rad * lever };
        1.0 / (sigma * sigma)
    });
    let pull = prior.component_mul(&offset.component_div(&scale));
    let step = (h + h_photo + Matrix6::from_diagonal(&prior))
        .cholesky()
        .map_or_else(Vector6::zeros, |c| c.solve(&(b + b_photo + pull)));
    let delta = step.component_mul(&scale);
    let brightness = picture.offset - picture.slope * delta;
    Solution {
        // Of twists in metres and radians.
        observed: units * observed * Matrix6::from_diagonal(&scale.map(|s| 1.0 / s)),
        delta,
        gain: brightness[0] as f32,
        offset: brightness[1] as f32,
        condition: eigen.eigenvalues.min() / largest,
    }
}
