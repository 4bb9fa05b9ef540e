//! Scenes put together: supports, objects on them, lamps, rooms.

use super::paint::{self, Border, Pigment};
use super::panorama::{self, Panorama};
use super::plan::{LightKind, Plan, Support};
use super::shapes::{self, Mesher, Shape};
use crate::synth::emitters::{Portal, Sphere};
use crate::synth::environment::Environment;
use crate::synth::glare::Glare;
use crate::synth::random::Rng;
use crate::synth::scene::{Part, Scene};
use crate::synth::scenes::{append, cuboid, rectangle};
use crate::synth::solid;
use glam::{Quat, Vec3};
use recordings::types::Mesh;

/// A body of the scene, in world coordinates.
pub struct Body {
    /// What it is.
    pub name: &'static str,
    /// Its mesh at a cell size.
    pub mesh: Mesher,
    /// Cells are this much larger than on objects.
    pub coarse: f32,
    /// One pigment, or two with a border between; indices into [`Stage::pigments`].
    pub paint: (u8, Option<(u8, Border)>),
    /// Radiance that it emits.
    pub emission: Vec3,
}

/// Where the camera goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Views {
    /// Around a target: azimuth (0 stands on −Y) and elevation in degrees, distance in metres, each `[from, to]`.
    Orbit {
        /// Point looked at.
        target: Vec3,
        /// Azimuth at start and end.
        azimuth_deg: [f32; 2],
        /// Least and largest elevation.
        elevation_deg: [f32; 2],
        /// Least and largest distance.
        distance_m: [f32; 2],
    },
    /// From the middle of a room, all around.
    Tour {
        /// Mean position.
        center: Vec3,
        /// How far it strays, metres.
        wander_m: f32,
        /// Yaw at the start, degrees.
        start_deg: f32,
    },
}

/// A scene before it is meshed.
pub struct Stage {
    /// What there is.
    pub bodies: Vec<Body>,
    /// Materials by index.
    pub pigments: Vec<Pigment>,
    /// Lamps beside the mesh.
    pub spheres: Vec<Sphere>,
    /// Openings of a closed room.
    pub portals: Vec<Portal>,
    /// Distant light, and two others for held-out views.
    pub environments: [Environment; 3],
    /// Kind of the distant light.
    pub panorama: &'static str,
    /// The camera's way.
    pub views: Views,
    /// What the lens scatters.
    pub glare: Glare,
    /// Feet and radii of the objects.
    taken: Vec<(Vec3, f32)>,
}

/// An area that objects stand on.
struct Ground {
    center: Vec3,
    half: [f32; 2],
}

/// Free way about the stem of a lamp, metres.
const CLEARANCE_M: f32 = 0.05;
/// Attempts to find a free place for an object.
const ATTEMPTS: usize = 60;
/// Materials of a scene at most, but for those of a lamp.
const MOST_PIGMENTS: usize = 11;
/// Rounds of choosing a cell size.
const ROUNDS: usize = 3;

impl Stage {
    /// Builds what a plan says.
    #[must_use]
    pub fn new(plan: &Plan) -> Self {
        let mut rng = Rng::new(plan.seed, 2);
        let kind = panorama::kind(&mut rng);
        let (environment, name) = match plan.support {
            Support::Bust => (panorama::daylight(&mut rng), "daylight".into()),
            // Openings are sampled evenly, which a sun would not bear.
            Support::Room => (panorama::panorama(&mut rng, Panorama::Even), "even".into()),
            _ => (panorama::panorama(&mut rng, kind), format!("{kind:?}").to_lowercase()),
        };
        let mut relight = || match plan.support {
            Support::Room => panorama::panorama(&mut rng, Panorama::Coloured),
            _ => {
                let other = panorama::other_kind(&mut rng, kind);
                panorama::panorama(&mut rng, other)
            }
        };
        let environments = [environment, relight(), relight()];
        let share = match plan.support {
            Support::Bust => rng.between(0.05, 0.09),
            _ if rng.chance(0.6) => rng.between(0.003, 0.02),
            _ => rng.between(0.02, 0.05),
        };
        let target = Vec3::new(0.0, 0.0, 0.05);
        let orbit = Views::Orbit { target, azimuth_deg: [0.0; 2], elevation_deg: [25.0, 50.0], distance_m: [0.7, 0.9] };
        let mut stage = Self {
            bodies: Vec::new(),
            pigments: Vec::new(),
            spheres: Vec::new(),
            portals: Vec::new(),
            environments,
            panorama: name.leak(),
            views: orbit,
            glare: Glare { share, core_rad: 0.06 },
            taken: Vec::new(),
        };
        match plan.support {
            Support::Bust => stage.bust(&mut rng),
            Support::Table => stage.table(&mut rng),
            Support::Shelf => stage.shelf(&mut rng),
            Support::Floor => stage.floor(&mut rng),
            Support::Corner => stage.corner(&mut rng),
            Support::Room => stage.room(&mut rng),
        }
        if plan.light == LightKind::Lamps {
            stage.lamps(&mut rng);
        }
        stage
    }

    /// Meshes the scene with about `vertices` vertices.
    #[must_use]
    pub fn scene(&self, vertices: f32) -> Scene {
        let mut cell = 0.006;
        let mut meshes = Vec::new();
        for _ in 0..ROUNDS {
            meshes = self.bodies.iter().map(|b| (b.mesh)(cell * b.coarse)).collect();
            let count: usize = meshes.iter().map(|m: &Mesh| m.positions.len()).sum();
            let ratio = (count as f32 / vertices).sqrt();
            if (0.95..1.05).contains(&ratio) {
                break;
            }
            cell *= ratio;
        }
        let part = |(body, mesh): (&Body, Mesh)| {
            let first = self.pigments[usize::from(body.paint.0)];
            let second = body.paint.1.map(|(k, border)| (self.pigments[usize::from(k)], border));
            let texture = move |p: Vec3| match &second {
                Some((pigment, border)) if border.beyond(p) => pigment.at(p),
                _ => first.at(p),
            };
            Part { name: body.name, material: first.material, texture: Box::new(texture), mesh }
        };
        let parts = self.bodies.iter().zip(meshes).map(part).collect();
        let glowing = self.bodies.iter().enumerate().filter(|(_, b)| b.emission != Vec3::ZERO);
        let glowing: Vec<(usize, Vec3)> = glowing.map(|(k, b)| (k, b.emission)).collect();
        Scene::new(parts, self.environments[0].clone()).with_emitters(self.spheres.clone(), &glowing)
    }

    /// Index into `pigments` of a body's material at a position.
    #[must_use]
    pub fn label(&self, body: usize, p: Vec3) -> u8 {
        match self.bodies[body].paint {
            (_, Some((second, border))) if border.beyond(p) => second,
            (first, _) => first,
        }
    }

    fn pigment(&mut self, pigment: Pigment) -> u8 {
        self.pigments.push(pigment);
        (self.pigments.len() - 1) as u8
    }

    fn put(&mut self, name: &'static str, coarse: f32, paint: u8, mesh: impl Fn(f32) -> Mesh + Send + Sync + 'static) {
        self.bodies.push(Body { name, mesh: Box::new(mesh), coarse, paint: (paint, None), emission: Vec3::ZERO });
    }

    fn sheet(&mut self, name: &'static str, coarse: f32, paint: u8, corner: Vec3, u: Vec3, v: Vec3) {
        self.put(name, coarse, paint, move |cell| rectangle(corner, u, v, cell));
    }

    /// A box from its lower centre.
    fn board(&mut self, name: &'static str, coarse: f32, paint: u8, foot: Vec3, size: Vec3) {
        let half = Vec3::new(0.5 * size.x, 0.5 * size.y, 0.0);
        let (low, high) = (foot - half, foot + half + Vec3::Z * size.z);
        self.put(name, coarse, paint, move |cell| cuboid(low, high, cell, false));
    }

    /// Objects on grounds; some stand on others. Materials come from a palette, some bodies have a second paint.
    fn objects(&mut self, rng: &mut Rng, grounds: &[Ground], count: usize, size: f32) {
        let room = MOST_PIGMENTS - self.pigments.len().min(MOST_PIGMENTS);
        let palette: Vec<u8> =
            (0..(1 + rng.below(room.min(9))).min(room.max(1))).map(|_| self.pigment(Pigment::random(rng))).collect();
        let mut placed: Vec<(usize, Vec3, f32)> = Vec::new();
        let mut tops: Vec<(usize, Vec3, f32, f32)> = Vec::new();
        for _ in 0..count {
            let own = size * rng.between(0.6, 1.4);
            let shape = shapes::random(rng, own);
            let place = self.place(rng, grounds, &mut placed, &mut tops, &shape);
            let Some(at) = place else { continue };
            self.taken.push((at, shape.radius));
            let first = palette[rng.below(palette.len())];
            let second = (self.pigments.len() < MOST_PIGMENTS && rng.chance(0.3)).then(|| {
                let base = self.pigments[usize::from(first)];
                let mut other = Pigment { material: base.material, ..Pigment::random(rng) };
                for _ in 0..ATTEMPTS {
                    if ((other.color + 0.02) / (base.color + 0.02) - 1.0).abs().max_element() > 0.5 {
                        break;
                    }
                    other = Pigment { material: base.material, ..Pigment::random(rng) };
                }
                let normal = Vec3::new(rng.normal(), rng.normal(), 1.5 * rng.normal()).normalize_or(Vec3::Z);
                let through = at + Vec3::Z * (shape.height * rng.between(0.35, 0.65));
                (self.pigment(other), Border { through, normal, wave: 0.12 * own })
            });
            let turn = Quat::from_rotation_z(rng.between(0.0, std::f32::consts::TAU));
            let mesh = shape.mesh;
            let moved = move |cell: f32| {
                let mut mesh = mesh(cell);
                mesh.positions.iter_mut().for_each(|p| *p = turn * *p + at);
                mesh.normals.iter_mut().for_each(|n| *n = turn * *n);
                mesh
            };
            let emission = Vec3::ZERO;
            self.bodies.push(Body {
                name: shape.name,
                mesh: Box::new(moved),
                coarse: 1.0,
                paint: (first, second),
                emission,
            });
        }
    }

    fn place(
        &self,
        rng: &mut Rng,
        grounds: &[Ground],
        placed: &mut Vec<(usize, Vec3, f32)>,
        tops: &mut Vec<(usize, Vec3, f32, f32)>,
        shape: &Shape,
    ) -> Option<Vec3> {
        // Objects touch without sharing a surface.
        const GAP_M: f32 = 0.0005;
        if !tops.is_empty() && rng.chance(0.3) {
            let k = rng.below(tops.len());
            let (_, at, _, radius) = tops[k];
            if shape.radius < 0.75 * radius {
                tops.swap_remove(k);
                return Some(at);
            }
        }
        for _ in 0..ATTEMPTS {
            let ground = rng.below(grounds.len());
            let Ground { center, half } = grounds[ground];
            let [x, y] = half.map(|h| (h - shape.radius).max(0.0));
            if half.iter().any(|h| *h < shape.radius) {
                continue;
            }
            let at = center + Vec3::new(rng.between(-x, x), rng.between(-y, y), GAP_M);
            let free = |(g, other, radius): &(usize, Vec3, f32)| {
                *g != ground || (at - *other).truncate().length() > 1.02 * (shape.radius + radius)
            };
            if placed.iter().all(free) {
                placed.push((ground, at, shape.radius));
                if shape.flat {
                    tops.push((ground, at + Vec3::Z * (shape.height + GAP_M), shape.height, shape.radius));
                }
                return Some(at);
            }
        }
        None
    }

    /// Three to twenty-five, and a size that lets them find room on an area.
    fn crowd(rng: &mut Rng, area: f32) -> (usize, f32) {
        let count = match rng.below(3) {
            0 => 3 + rng.below(4),
            1 => 7 + rng.below(6),
            _ => 13 + rng.below(13),
        };
        (count, (0.42 * (area / count as f32).sqrt()).clamp(0.055, 0.45))
    }

    fn bust(&mut self, rng: &mut Rng) {
        let size = rng.between(0.32, 0.42);
        let plaster = Pigment {
            pattern: paint::Pattern::Plain(0.0),
            ..Pigment::plain(Vec3::new(0.78, 0.75, 0.70) * rng.between(0.9, 1.1))
        };
        let plaster = self.pigment(plaster);
        let shape = shapes::bust(rng, size);
        self.bodies.push(Body {
            name: shape.name,
            mesh: shape.mesh,
            coarse: 1.0,
            paint: (plaster, None),
            emission: Vec3::ZERO,
        });
        self.views = Views::Orbit {
            target: Vec3::new(0.0, 0.0, 0.52 * size),
            azimuth_deg: [-150.0, 150.0],
            elevation_deg: [2.0, 24.0],
            distance_m: [0.52, 0.66],
        };
    }

    fn table(&mut self, rng: &mut Rng) {
        let half = [rng.between(0.38, 0.52), rng.between(0.30, 0.40)];
        let top = self.pigment(paint::ground(rng));
        let size = Vec3::new(2.0 * half[0], 2.0 * half[1], 0.0);
        let corner = Vec3::new(-half[0], -half[1], 0.0);
        self.sheet("table", 1.5, top, corner, Vec3::X * size.x, Vec3::Y * size.y);
        let walled = rng.chance(0.35);
        if walled {
            let wall = self.pigment(paint::wall(rng));
            let foot = Vec3::new(-half[0], half[1] + 0.002, 0.0);
            self.sheet("wall", 2.0, wall, foot, Vec3::X * size.x, Vec3::Z * 0.45);
        }
        let (count, size) = Self::crowd(rng, 4.0 * half[0] * half[1]);
        self.objects(rng, &[Ground { center: Vec3::ZERO, half: half.map(|h| h - 0.02) }], count, size);
        let middle = rng.between(-180.0, 180.0);
        let azimuth_deg = if walled { [-62.0, 62.0] } else { [middle - 150.0, middle + 150.0] };
        let target = Vec3::new(0.0, 0.0, 0.06);
        self.views = Views::Orbit { target, azimuth_deg, elevation_deg: [22.0, 56.0], distance_m: [0.72, 0.95] };
    }

    fn floor(&mut self, rng: &mut Rng) {
        let half = [rng.between(0.55, 0.75), rng.between(0.5, 0.7)];
        let top = self.pigment(paint::ground(rng));
        let corner = Vec3::new(-half[0], -half[1], 0.0);
        self.sheet("floor", 1.7, top, corner, Vec3::X * (2.0 * half[0]), Vec3::Y * (2.0 * half[1]));
        let (count, size) = Self::crowd(rng, 4.0 * half[0] * half[1]);
        self.objects(rng, &[Ground { center: Vec3::ZERO, half: half.map(|h| h - 0.03) }], count, size);
        let middle = rng.between(-180.0, 180.0);
        self.views = Views::Orbit {
            target: Vec3::new(0.0, 0.0, 0.08),
            azimuth_deg: [middle - 120.0, middle + 120.0],
            elevation_deg: [32.0, 62.0],
            distance_m: [1.0, 1.3],
        };
    }

    fn corner(&mut self, rng: &mut Rng) {
        let half = rng.between(0.36, 0.5);
        let height = rng.between(0.45, 0.7);
        let top = self.pigment(paint::ground(rng));
        let wall = self.pigment(paint::wall(rng));
        let back = if rng.chance(0.5) { wall } else { self.pigment(paint::wall(rng)) };
        let low = Vec3::new(-half, -half, 0.0);
        let side = 2.0 * half;
        self.sheet("floor", 1.5, top, low, Vec3::X * side, Vec3::Y * side);
        self.sheet("wall", 1.7, wall, low, Vec3::Y * side, Vec3::Z * height);
        self.sheet("wall", 1.7, back, Vec3::new(-half, half, 0.0), Vec3::X * side, Vec3::Z * height);
        let (count, size) = Self::crowd(rng, 4.0 * half * half);
        self.objects(rng, &[Ground { center: Vec3::ZERO, half: [half - 0.03; 2] }], count, size);
        self.views = Views::Orbit {
            target: Vec3::new(-0.06, 0.06, 0.12),
            azimuth_deg: [4.0, 86.0],
            elevation_deg: [14.0, 50.0],
            distance_m: [0.85, 1.1],
        };
    }

    fn shelf(&mut self, rng: &mut Rng) {
        let (width, depth, gap) = (rng.between(0.7, 0.95), rng.between(0.24, 0.34), rng.between(0.26, 0.36));
        let wood = self.pigment(if rng.chance(0.5) { paint::ground(rng) } else { paint::wall(rng) });
        let back = if rng.chance(0.4) { wood } else { self.pigment(paint::wall(rng)) };
        const BOARD_M: f32 = 0.018;
        let boards = 2 + rng.below(2);
        let height = gap * boards as f32;
        let mut grounds = Vec::new();
        for k in 0..boards {
            let foot = Vec3::new(0.0, 0.0, gap * k as f32);
            self.board("board", 1.6, wood, foot, Vec3::new(width, depth, BOARD_M));
            let half = [0.5 * width - 0.02, 0.5 * depth - 0.01];
            grounds.push(Ground { center: foot + Vec3::Z * BOARD_M, half });
        }
        for x in [-0.5, 0.5] {
            let foot = Vec3::new(x * (width + BOARD_M), 0.0, 0.0);
            self.board("side", 1.6, wood, foot, Vec3::new(BOARD_M, depth, height));
        }
        let low = Vec3::new(-0.5 * width, 0.5 * depth + 0.002, 0.0);
        self.sheet("back", 1.8, back, low, Vec3::X * width, Vec3::Z * height);
        let (count, _) = Self::crowd(rng, width * depth * boards as f32);
        let size =
            (0.5 * (width * depth * boards as f32 / count as f32).sqrt()).clamp(0.06, 0.75 * depth).min(0.6 * gap);
        self.objects(rng, &grounds, count.max(4), size);
        self.views = Views::Orbit {
            target: Vec3::new(0.0, 0.0, 0.5 * height),
            azimuth_deg: [-48.0, 48.0],
            elevation_deg: [-6.0, 30.0],
            distance_m: [0.95, 1.25],
        };
    }

    /// One to three lamps over dim distant light: beside the mesh, or bulbs on a stem in it.
    fn lamps(&mut self, rng: &mut Rng) {
        let Views::Orbit { target, azimuth_deg, .. } = self.views else { return };
        let dim = rng.between(0.25, 0.6);
        let [first, ..] = &mut self.environments;
        *first = first.clone().scaled(dim);
        let count = if rng.chance(0.6) { 1 } else { 2 + rng.below(2) };
        let mut standing = None;
        // Behind or beside what is looked at, so that it is not in the camera's way.
        let middle = 0.5 * (azimuth_deg[0] + azimuth_deg[1]);
        let around = |rng: &mut Rng, out: f32| {
            let (s, c) = libm::sincosf((middle + 180.0 + rng.between(-110.0, 110.0)).to_radians());
            Vec3::new(target.x + out * s, target.y - out * c, 0.0)
        };
        for k in 0..count {
            let free = |at: &Vec3| self.taken.iter().all(|(p, r)| (*p - *at).truncate().length() > r + CLEARANCE_M);
            let beside = (0..ATTEMPTS).map(|k| around(rng, 0.15 + 0.13 * k as f32 / ATTEMPTS as f32)).find(free);
            let (away, up) = (rng.between(0.0, 0.6), rng.between(0.3, 1.1));
            let above = around(rng, away) + Vec3::Z * up;
            let strength = rng.between(1.5, 4.0) / (1.0 + 0.7 * k as f32);
            let warm = rng.between(0.35, 0.95);
            let color = Vec3::new(1.0, 0.6 + 0.4 * warm, warm);
            let stand = beside.filter(|_| standing.is_none() && rng.chance(0.5));
            let inside = stand.is_some();
            let center = stand.map_or(above, |at| at + Vec3::Z * rng.between(0.16, 0.32));
            let radius_m = if inside { rng.between(0.022, 0.035) } else { rng.between(0.02, 0.07) };
            let squared = (center - target).length_squared().max(0.09);
            // Radiance for `strength` times the irradiance of even light of radiance 1.
            let radiance = color * (strength * squared / (radius_m * radius_m));
            if inside {
                standing = Some(center);
                self.bulb(rng, center, radius_m, radiance);
                let stem = center.with_z(0.0);
                let grey = self.pigment(Pigment::plain(Vec3::splat(0.25)));
                let height = center.z - radius_m;
                self.put("stem", 0.8, grey, move |cell| {
                    let low = Vec3::new(-0.02, -0.02, -0.005);
                    let mut mesh = solid::mesh(
                        &|p| {
                            solid::rounded_box(p - Vec3::Z * 0.5 * height, Vec3::new(0.011, 0.011, 0.5 * height), 0.009)
                        },
                        low,
                        Vec3::new(0.02, 0.02, height + 0.01),
                        cell.min(0.006),
                    );
                    mesh.positions.iter_mut().for_each(|p| *p += stem);
                    mesh
                });
            } else {
                self.spheres.push(Sphere { center, radius_m, radiance });
            }
        }
    }

    fn bulb(&mut self, rng: &mut Rng, center: Vec3, radius: f32, radiance: Vec3) {
        let white = self.pigment(Pigment::plain(Vec3::splat(rng.between(0.6, 0.8))));
        let mesh = move |cell: f32| {
            let reach = Vec3::splat(1.5 * radius);
            let cell = cell.min(0.35 * radius);
            solid::mesh(&|p| solid::sphere(p - center, radius), center - reach, center + reach, cell)
        };
        self.bodies.push(Body {
            name: "bulb",
            mesh: Box::new(mesh),
            coarse: 0.8,
            paint: (white, None),
            emission: radiance,
        });
    }

    fn room(&mut self, rng: &mut Rng) {
        let half = Vec3::new(rng.between(1.5, 2.1), rng.between(1.4, 1.9), rng.between(2.3, 2.6));
        let walls = self.pigment(paint::wall(rng));
        let floor = self.pigment(paint::ground(rng));
        let ceiling = self.pigment(Pigment::plain(Vec3::splat(rng.between(0.7, 0.9))));
        // The opening in the wall at y = +half.y: a window, or a door ajar.
        let window = rng.chance(0.6);
        let (x0, x1, z0, z1) = if window {
            let (wide, x) = (rng.between(0.7, 1.2), rng.between(-0.5, 0.5));
            (x - 0.5 * wide, x + 0.5 * wide, 0.85, rng.between(1.8, 2.1))
        } else {
            let x = rng.between(-0.9, 0.6);
            (x, x + 0.16, 0.0, 2.0)
        };
        self.portals
            .push(Portal { corner: Vec3::new(x0, half.y, z0), edges: [Vec3::X * (x1 - x0), Vec3::Z * (z1 - z0)] });
        let shell = move |cell: f32| {
            let mut mesh = Mesh::default();
            let (low, w, d) = (Vec3::new(-half.x, -half.y, 0.0), 2.0 * half.x, 2.0 * half.y);
            append(&mut mesh, rectangle(low + Vec3::X * w, -Vec3::X * w, Vec3::Z * half.z, cell));
            append(&mut mesh, rectangle(low, Vec3::Y * d, Vec3::Z * half.z, cell));
            append(&mut mesh, rectangle(Vec3::new(half.x, half.y, 0.0), -Vec3::Y * d, Vec3::Z * half.z, cell));
            let pieces =
                [(-half.x, x0, 0.0, half.z), (x1, half.x, 0.0, half.z), (x0, x1, 0.0, z0), (x0, x1, z1, half.z)];
            for (a, b, c, d) in pieces {
                if b - a > 0.01 && d - c > 0.01 {
                    append(&mut mesh, rectangle(Vec3::new(a, half.y, c), Vec3::X * (b - a), Vec3::Z * (d - c), cell));
                }
            }
            mesh
        };
        self.put("walls", 1.6, walls, shell);
        let corner = Vec3::new(-half.x, -half.y, 0.0);
        self.sheet("floor", 1.6, floor, corner, Vec3::X * (2.0 * half.x), Vec3::Y * (2.0 * half.y));
        let above = corner + Vec3::Z * half.z;
        self.sheet("ceiling", 1.8, ceiling, above, Vec3::Y * (2.0 * half.y), Vec3::X * (2.0 * half.x));
        let grounds = self.furniture(rng, half);
        self.posters(rng, half, [x0, x1]);
        self.room_lights(rng, half, window);
        let (count, _) = Self::crowd(rng, 2.0);
        self.objects(rng, &grounds, count.clamp(6, 16), 0.28);
        self.views = Views::Tour {
            center: Vec3::new(0.0, -0.1, 1.4),
            wander_m: rng.between(0.5, 0.8),
            start_deg: rng.between(0.0, 360.0),
        };
    }

    /// Pictures on the walls, and a rug.
    fn posters(&mut self, rng: &mut Rng, half: Vec3, opening: [f32; 2]) {
        const THICK_M: f32 = 0.02;
        let prints = [0; 2].map(|_| self.pigment(Pigment::random(rng)));
        for wall in 0..4 {
            let size = [rng.between(0.4, 0.8), rng.between(0.4, 0.7)];
            let along = rng.between(-0.5, 0.5);
            let foot = match wall {
                0 => Vec3::new(-half.x + THICK_M, along, 1.2),
                1 => Vec3::new(half.x - THICK_M, -0.9 + 0.2 * along, 1.2),
                2 => Vec3::new(along, -half.y + THICK_M, 1.25),
                _ => Vec3::new(if opening[0] + opening[1] > 0.0 { -0.95 } else { 0.95 }, half.y - THICK_M, 1.1),
            };
            let size =
                if wall < 2 { Vec3::new(THICK_M, size[0], size[1]) } else { Vec3::new(size[0], THICK_M, size[1]) };
            self.board("picture", 1.0, prints[wall % 2], foot, size);
        }
        let rug = self.pigment(paint::ground(rng));
        self.board("rug", 1.3, rug, Vec3::new(-0.1, 0.0, 0.001), Vec3::new(1.3, 1.0, 0.012));
    }

    /// A table, a cupboard and a chest along the walls; what things can stand on.
    fn furniture(&mut self, rng: &mut Rng, half: Vec3) -> Vec<Ground> {
        let wood = self.pigment(paint::ground(rng));
        let paint = self.pigment(Pigment::random(rng));
        let table = Vec3::new(rng.between(0.9, 1.3), rng.between(0.55, 0.7), 0.04);
        let at = Vec3::new(rng.between(-0.4, 0.4), -half.y + 0.5 * table.y + 0.05, 0.70);
        self.board("table", 1.0, wood, at, table);
        for side in [-0.45, 0.45] {
            self.board("leg", 1.2, wood, Vec3::new(at.x + side * table.x, at.y, 0.0), Vec3::new(0.06, 0.4, 0.698));
        }
        let cupboard = Vec3::new(0.42, rng.between(0.8, 1.2), rng.between(0.9, 1.7));
        let stand = Vec3::new(half.x - 0.5 * cupboard.x - 0.02, rng.between(-0.3, 0.3), 0.002);
        self.board("cupboard", 1.2, paint, stand, cupboard);
        let chest = Vec3::new(0.5, rng.between(0.6, 1.0), rng.between(0.35, 0.5));
        let low = Vec3::new(-half.x + 0.5 * chest.x + 0.03, rng.between(-0.4, 0.5), 0.002);
        self.board("chest", 1.2, if rng.chance(0.5) { wood } else { paint }, low, chest);
        vec![
            Ground { center: at + Vec3::Z * table.z, half: [0.5 * table.x - 0.03, 0.5 * table.y - 0.03] },
            Ground { center: low + Vec3::Z * chest.z, half: [0.5 * chest.x - 0.02, 0.5 * chest.y - 0.02] },
            Ground { center: Vec3::new(0.3, half.y - 0.45, 0.0), half: [0.7, 0.4] },
        ]
    }

    /// Ceiling panels and bulbs; dimmer beside a window.
    fn room_lights(&mut self, rng: &mut Rng, half: Vec3, window: bool) {
        let white = self.pigment(Pigment::plain(Vec3::splat(0.7)));
        let warm = rng.between(0.5, 0.95);
        let color = Vec3::new(1.0, 0.6 + 0.4 * warm, warm);
        let level = if window { rng.between(0.3, 1.0) } else { 1.0 };
        if rng.chance(0.65) {
            for x in if rng.chance(0.4) { vec![-0.6, 0.6] } else { vec![rng.between(-0.4, 0.4)] } {
                let size = [rng.between(0.25, 0.6), rng.between(0.25, 0.6)];
                let corner = Vec3::new(x - 0.5 * size[0], -0.5 * size[1], half.z - 0.02);
                let (u, v) = (Vec3::Y * size[1], Vec3::X * size[0]);
                let mesh = move |cell: f32| rectangle(corner, u, v, cell.min(0.08));
                let emission = color * (level * 2.5 / (size[0] * size[1]));
                self.bodies.push(Body {
                    name: "panel",
                    mesh: Box::new(mesh),
                    coarse: 1.0,
                    paint: (white, None),
                    emission,
                });
            }
        } else {
            let radius = rng.between(0.05, 0.11);
            let center = Vec3::new(rng.between(-0.5, 0.5), rng.between(-0.3, 0.5), half.z - rng.between(0.25, 0.5));
            self.bulb(rng, center, radius, color * (level * 0.9 / (radius * radius)));
        }
    }
}
