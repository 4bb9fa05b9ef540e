//! Lamps that the pictures show: what is clipped at one place in the air in several keyframes.
//!
//! A round clipped spot gives a ray and an angular radius. Rays of two keyframes that meet, with radii that agree there, are a candidate;
//! every other keyframe speaks for it or against it. What has a surface there is not a lamp in the air.

use crate::association::keyframe_image::KeyframeImage;
use crate::mesh::unions::Unions;
use crate::numerics::robust::median;
use crate::rays::RayScene;
use glam::{DMat3, DVec3, Vec3};
use recordings::types::Pose;

/// Cells along the width of a picture: spots are sets of cells whose middle pixel is clipped.
const COLUMNS: usize = 160;
/// Spots of fewer cells are noise.
const LEAST_CELLS: usize = 4;
/// The largest spots of a picture, so many at most: a picture of specks is not to take all the time there is.
const MOST_SPOTS: usize = 12;
/// A spot fills this share of the box around it (a disc: 0.79), which is this much longer than wide at most.
const LEAST_FILL: f64 = 0.6;
const MOST_ASPECT: f64 = 1.6;
/// Rays have to cross at this angle at least, radians.
const LEAST_ANGLE: f64 = 0.05;
/// Rays pass the centre by this share of the radius at most, and radii agree up to this factor.
const MOST_MISS: f64 = 0.6;
const MOST_RATIO: f64 = 1.6;
/// Rounds of reweighting, and the miss in radii from which on a ray counts less.
const ROUNDS: usize = 4;
const SMALL_MISS: f64 = 0.05;
/// The air around a lamp is free of surface up to this many radii from its centre, as seen from the camera.
const FREE_RADII: f64 = 1.5;
/// Keyframes that show a lamp at least, and for each one that does not where it should.
const LEAST_VIEWS: usize = 3;
const FOR_EACH_AGAINST: usize = 3;
/// Lamps at most.
const MOST_LAMPS: usize = 4;

/// A ball of light in the air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenLamp {
    /// Centre, world.
    pub center: Vec3,
    /// Radius of what is clipped, in the mesh's units.
    pub radius: f32,
}

/// A round clipped region of a picture.
#[derive(Debug, Clone, Copy)]
struct Spot {
    keyframe: usize,
    origin: DVec3,
    /// Unit direction of its centre, world.
    direction: DVec3,
    /// Radians.
    radius: f64,
}

impl Spot {
    /// Distance along the ray to what is nearest to a point.
    fn along(&self, point: DVec3) -> f64 {
        (point - self.origin).dot(self.direction)
    }

    /// Distance of the ray from a point.
    fn miss(&self, point: DVec3) -> f64 {
        (self.origin + self.direction * self.along(point)).distance(point)
    }

    /// True if it shows a ball there.
    fn shows(&self, center: DVec3, radius: f64) -> bool {
        let along = self.along(center);
        let own = self.radius * along;
        along > 0.0 && self.miss(center) < MOST_MISS * radius && own < MOST_RATIO * radius && radius < MOST_RATIO * own
    }
}

/// The lamps, those that most keyframes show first. `clipped` is the first clipped 8-bit value.
#[must_use]
pub fn seen_lamps(
    images: &[Option<KeyframeImage>],
    world_from_camera: &[Pose],
    scene: &RayScene,
    clipped: u8,
) -> Vec<SeenLamp> {
    let mut spots: Vec<Spot> = Vec::new();
    for (keyframe, (image, pose)) in images.iter().zip(world_from_camera).enumerate() {
        let Some(image) = image else { continue };
        spots.extend(spots_of(image, pose, keyframe, clipped));
    }
    let cameras: Vec<(Pose, &KeyframeImage)> =
        world_from_camera.iter().zip(images).filter_map(|(pose, i)| Some((*pose, i.as_ref()?))).collect();
    let mut found = Vec::new();
    while found.len() < MOST_LAMPS {
        let candidates = pairs(&spots);
        let supported = candidates.into_iter().map(|(center, radius)| {
            let of: Vec<Spot> = spots.iter().copied().filter(|s| s.shows(center, radius)).collect();
            of.into_iter().filter(|s| is_free(scene, s.origin, center, radius)).collect::<Vec<Spot>>()
        });
        let Some(best) = supported.max_by_key(|of| keyframes(of)) else { break };
        if keyframes(&best) < LEAST_VIEWS {
            break;
        }
        let Some(center) = robust_meeting_point(&best) else { break };
        let Some(radius) = median(best.iter().map(|s| s.radius * s.along(center))) else { break };
        let against = cameras.iter().filter(|(pose, image)| {
            is_free(scene, pose.translation, center, radius) && is_dark(image, pose, center, clipped)
        });
        if keyframes(&best) >= FOR_EACH_AGAINST * against.count() {
            found.push(SeenLamp { center: center.as_vec3(), radius: radius as f32 });
        }
        // Used up, whether it is a lamp or not.
        spots.retain(|s| !best.iter().any(|b| b.keyframe == s.keyframe && b.direction == s.direction));
    }
    found
}

/// Number of keyframes that spots are of; they are in the order of the keyframes.
fn keyframes(spots: &[Spot]) -> usize {
    spots.chunk_by(|a, b| a.keyframe == b.keyframe).count()
}

/// Centre and radius of every ball that two keyframes agree on.
fn pairs(spots: &[Spot]) -> Vec<(DVec3, f64)> {
    let mut candidates = Vec::new();
    for (i, a) in spots.iter().enumerate() {
        for b in &spots[i + 1..] {
            if a.keyframe == b.keyframe || a.direction.cross(b.direction).length() < LEAST_ANGLE {
                continue;
            }
            let Some(center) = meeting_point(&[*a, *b], |_| 1.0) else { continue };
            let radius = 0.5 * (a.radius * a.along(center) + b.radius * b.along(center));
            if a.shows(center, radius) && b.shows(center, radius) {
                candidates.push((center, radius));
            }
        }
    }
    candidates
}

/// Where the rays meet, those that pass by counting less: two lamps may be one spot in a picture.
fn robust_meeting_point(spots: &[Spot]) -> Option<DVec3> {
    let mut center = meeting_point(spots, |_| 1.0)?;
    for _ in 0..ROUNDS {
        let weight = |s: &Spot| {
            let share = s.miss(center) / (SMALL_MISS * s.radius * s.along(center));
            1.0 / (1.0 + share * share)
        };
        center = meeting_point(spots, weight)?;
    }
    Some(center)
}

/// The point with the least weighted sum of squared distances from the rays; `None` if they are parallel.
fn meeting_point(spots: &[Spot], weight: impl Fn(&Spot) -> f64) -> Option<DVec3> {
    let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for s in spots {
        let d = s.direction;
        let across = (DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z)) * weight(s);
        matrix += across;
        right += across * s.origin;
    }
    let point = matrix.inverse() * right;
    point.is_finite().then_some(point)
}

/// True if no surface is between a camera and the far side of a ball.
pub(super) fn is_free(scene: &RayScene, origin: DVec3, center: DVec3, radius: f64) -> bool {
    let to = center - origin;
    let distance = to.length();
    !scene.occluded_within(origin.as_vec3(), (to / distance).as_vec3(), (distance + FREE_RADII * radius) as f32)
}

/// True if a picture has a point inside and is not clipped there.
fn is_dark(image: &KeyframeImage, world_from_camera: &Pose, center: DVec3, clipped: u8) -> bool {
    let p = world_from_camera.inverse().transform(center);
    let k = &image.camera;
    let (u, v) = k.project(p);
    let is_inside = p.z > 0.0 && u >= 0.0 && v >= 0.0 && u < f64::from(k.width) && v < f64::from(k.height);
    is_inside && !image.is_clipped(u as usize, v as usize, clipped)
}

/// The largest of the round clipped regions of a picture that its border does not cut.
fn spots_of(image: &KeyframeImage, world_from_camera: &Pose, keyframe: usize, clipped: u8) -> Vec<Spot> {
    let k = &image.camera;
    let step = (k.width as usize / COLUMNS).max(1);
    let (w, h) = (k.width as usize / step, k.height as usize / step);
    let is_clipped = |x: usize, y: usize| image.is_clipped(x * step + step / 2, y * step + step / 2, clipped);
    let white: Vec<bool> = (0..w * h).map(|i| is_clipped(i % w, i / w)).collect();
    let mut unions = Unions::new(w * h);
    for i in (0..w * h).filter(|i| white[*i]) {
        for neighbour in [(i % w > 0).then(|| i - 1), (i >= w).then(|| i - w)].into_iter().flatten() {
            if white[neighbour] {
                unions.join(i as u32, neighbour as u32);
            }
        }
    }
    let mut boxes = std::collections::BTreeMap::<u32, Region>::new();
    for i in (0..w * h).filter(|i| white[*i]) {
        boxes.entry(unions.first(i as u32)).or_default().add(i % w, i / w);
    }
    let spot = |r: &Region| {
        let (x, y) = r.is_round_within(w, h).then(|| r.middle())?;
        let pixel = |c: f64| c * step as f64 + (step / 2) as f64;
        let local = DVec3::new((pixel(x) - k.cx) / k.fx, (pixel(y) - k.cy) / k.fy, 1.0);
        // Off the axis a pixel is a smaller angle.
        let radius = (r.cells as f64 / std::f64::consts::PI).sqrt() * step as f64 / k.fx.abs() / local.length_squared();
        let direction = (world_from_camera.transform(local) - world_from_camera.translation).normalize();
        Some(Spot { keyframe, origin: world_from_camera.translation, direction, radius })
    };
    let mut spots: Vec<Spot> = boxes.values().filter_map(spot).collect();
    if spots.len() > MOST_SPOTS {
        spots.sort_by(|a, b| b.radius.total_cmp(&a.radius));
        spots.truncate(MOST_SPOTS);
    }
    spots
}

/// A connected set of cells.
#[derive(Debug, Clone, Copy)]
struct Region {
    cells: usize,
    sums: [usize; 2],
    least: [usize; 2],
    most: [usize; 2],
}

impl Default for Region {
    fn default() -> Self {
        Self { cells: 0, sums: [0; 2], least: [usize::MAX; 2], most: [0; 2] }
    }
}

impl Region {
    fn add(&mut self, x: usize, y: usize) {
        self.cells += 1;
        for (axis, at) in [x, y].into_iter().enumerate() {
            self.sums[axis] += at;
            self.least[axis] = self.least[axis].min(at);
            self.most[axis] = self.most[axis].max(at);
        }
    }

    /// Mean column and row.
    fn middle(&self) -> (f64, f64) {
        let [x, y] = self.sums.map(|s| s as f64 / self.cells as f64);
        (x, y)
    }

    /// True for a disc, seen a little from the side, that the border of `w` × `h` cells does not touch.
    fn is_round_within(&self, w: usize, h: usize) -> bool {
        let inside = self.least.iter().all(|l| *l > 0) && self.most[0] + 1 < w && self.most[1] + 1 < h;
        let [width, height] = [0, 1].map(|axis| (self.most[axis] + 1).saturating_sub(self.least[axis]) as f64);
        let aspect = width.max(height) / width.min(height);
        inside && self.cells >= LEAST_CELLS && aspect < MOST_ASPECT && self.cells as f64 > LEAST_FILL * width * height
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::association::vignetting::Vignetting;
    use glam::DQuat;
    use recordings::types::{Intrinsics, Mesh};

    const RADIUS: f64 = 0.05;

    /// A picture of balls, from a camera that looks at the origin.
    fn picture(origin: DVec3, balls: &[DVec3]) -> (KeyframeImage, Pose) {
        let camera = Intrinsics { width: 320, height: 240, fx: 260.0, fy: 260.0, cx: 159.5, cy: 119.5 };
        let z = -origin.normalize();
        let x = DVec3::Z.cross(z).normalize() * -1.0;
        let rotation = DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z));
        let mut data = Vec::new();
        for i in 0..320 * 240 {
            let local =
                DVec3::new((f64::from(i % 320) - camera.cx) / 260.0, (f64::from(i / 320) - camera.cy) / 260.0, 1.0);
            let d = (rotation * local).normalize();
            let hits =
                balls.iter().any(|b| (*b - origin).reject_from(d).length() < RADIUS && (*b - origin).dot(d) > 0.0);
            data.extend([if hits { 255 } else { 90 }; 3]);
        }
        let world_from_camera = Pose { rotation, translation: origin };
        (KeyframeImage { camera, data, vignetting: Vignetting::default() }, world_from_camera)
    }

    fn found(balls: impl Fn(usize) -> Vec<DVec3>, floor_z: f32) -> Vec<SeenLamp> {
        let places = (0..6).map(|i| DVec3::new(libm::cos(f64::from(i)), libm::sin(f64::from(i)), 0.6));
        let pictures = places.enumerate().map(|(i, p)| picture(p, &balls(i)));
        let (images, poses): (Vec<_>, Vec<_>) = pictures.map(|(image, pose)| (Some(image), pose)).unzip();
        let corner = |x: f32, y: f32| Vec3::new(3.0 * x, 3.0 * y, floor_z);
        let mesh = Mesh {
            positions: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
            normals: vec![Vec3::Z; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        seen_lamps(&images, &poses, &RayScene::new(&mesh), 250)
    }

    #[test]
    fn balls_in_the_air_are_found_where_they_are() {
        let lamps = [DVec3::new(0.1, 0.05, 0.1), DVec3::new(-0.15, 0.1, 0.15)];
        let seen = found(|_| lamps.to_vec(), -0.6);
        assert_eq!(seen.len(), 2, "{seen:?}");
        for lamp in lamps {
            let near = |s: &SeenLamp| s.center.as_dvec3().distance(lamp) < 0.005;
            let found = seen.iter().find(|s| near(s)).unwrap_or_else(|| panic!("{lamp}: {seen:?}"));
            assert!((f64::from(found.radius) / RADIUS - 1.0).abs() < 0.1, "{}", found.radius);
        }
    }

    #[test]
    fn what_shines_on_a_surface_or_in_two_pictures_is_no_lamp() {
        let lamp = DVec3::new(0.1, 0.05, 0.1);
        assert_eq!(found(|_| vec![lamp], 0.08), [], "on the floor");
        assert_eq!(found(|i| if i < 2 { vec![lamp] } else { vec![] }, -0.6), [], "in two pictures");
        assert_eq!(found(|i| if i < 4 { vec![lamp] } else { vec![] }, -0.6), [], "not in two of six");
    }
}
