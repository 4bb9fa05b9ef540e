//! Keyframes, Eq. (1): candidates while scanning, the smallest covering set at the end.

use crate::camera::rig::{Pinhole, Rig};
use crate::frame::preprocess::Frame;
use crate::tsdf::visibility::View;
use firmware_config::FusionConfig;
use rayon::prelude::*;
use recordings::scan::{FrameId, KeptFrame};
use recordings::types::{Mesh, Pose};

/// Vertices that coverage is judged on, at most.
const JUDGED_VERTICES: usize = 30_000;
/// A vertex is seen well if the angle between its normal and the direction to the camera has a greater cosine (c2).
const WELL_COS: f32 = 0.5;
/// A frame replaces a candidate near it if it is sharper by this factor.
const SHARPER: f32 = 1.15;
/// Times that a candidate may be replaced.
const MAX_REPLACED: u32 = 3;
/// Median depth from which a scan counts as one of a room, metres.
const ROOM_DEPTH_M: f32 = 1.5;
/// A keyframe must add this share of the coverable vertices.
const MIN_GAIN: f32 = 0.002;

/// A frame whose colour is kept until the end.
#[derive(Debug, Clone)]
struct Candidate {
    id: FrameId,
    index: usize,
    pose: Pose,
    sharpness: f32,
    replaced: u32,
}

/// The candidates of a scan.
#[derive(Debug, Default)]
pub struct Candidates {
    list: Vec<Candidate>,
    /// Frames kept only as possible witnesses, when too few candidates come about.
    reserve: Vec<Candidate>,
    next_id: u32,
    spacing_m: f64,
    depth_sum: f64,
    frames: u32,
}

/// The chosen frames.
#[derive(Debug, Default)]
pub struct Chosen {
    pub keyframes: Vec<KeptFrame>,
    pub witnesses: Vec<KeptFrame>,
    /// Share of the mesh's vertices, of those that any candidate saw well, that a keyframe sees.
    pub coverage: f64,
}

/// Distance of two views: that of their centres, or of what their centre rays meet if they turn on the spot.
fn view_distance(a: &Pose, b: &Pose) -> f64 {
    let turn = a.rotation.angle_between(b.rotation);
    (a.translation - b.translation).length().max(0.5 * turn)
}

impl Candidates {
    /// An empty list.
    pub fn new(config: &FusionConfig) -> Self {
        // Twice as dense as keyframes may stand: the choice at the end needs something to choose from.
        Self { spacing_m: 0.5 * config.keyframe_spacing_m, ..Self::default() }
    }

    /// Decides whether a tracked frame becomes a candidate.
    pub fn offer(&mut self, frame: &Frame, pose: &Pose, config: &FusionConfig) -> Option<FrameId> {
        self.depth_sum += f64::from(frame.median_depth);
        self.frames += 1;
        let nearest = self
            .list
            .iter()
            .enumerate()
            .map(|(i, c)| (view_distance(&c.pose, pose), i))
            .filter(|(d, _)| *d < self.spacing_m)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let mut new = |sharpness, replaced| {
            let id = FrameId(self.next_id);
            self.next_id += 1;
            let index = self.frames as usize;
            (id, Candidate { id, index, pose: *pose, sharpness, replaced })
        };
        match nearest {
            None => {
                let (id, candidate) = new(frame.sharpness, 0);
                self.list.push(candidate);
                if self.list.len() > 4 * config.max_keyframes as usize {
                    self.thin();
                }
                Some(id)
            }
            Some((_, i)) => {
                let old = &self.list[i];
                if frame.sharpness > SHARPER * old.sharpness && old.replaced < MAX_REPLACED {
                    let (id, candidate) = new(frame.sharpness, old.replaced + 1);
                    self.list[i] = candidate;
                    Some(id)
                } else if self.frames.is_power_of_two() && self.frames > 8 {
                    let (id, candidate) = new(frame.sharpness, 0);
                    self.reserve.push(candidate);
                    Some(id)
                } else {
                    None
                }
            }
        }
    }

    /// Doubles the spacing and drops what is then too close to an earlier candidate.
    fn thin(&mut self) {
        self.spacing_m *= 2.0;
        let mut kept: Vec<Candidate> = Vec::new();
        for c in self.list.drain(..) {
            if kept.iter().all(|k| view_distance(&k.pose, &c.pose) >= self.spacing_m) {
                kept.push(c);
            }
        }
        self.list = kept;
    }

    /// Where the candidates stand, and the frames in reserve.
    pub fn poses(&self) -> impl Iterator<Item = Pose> {
        self.list.iter().chain(&self.reserve).map(|c| c.pose)
    }

    /// Chooses keyframes and witnesses for the finished mesh.
    pub fn choose(mut self, mesh: &Mesh, rig: &Rig, config: &FusionConfig) -> Chosen {
        self.list.sort_by_key(|c| c.index);
        let stride = mesh.positions.len().div_ceil(JUDGED_VERTICES).max(1);
        let judged: Vec<usize> = (0..mesh.positions.len()).step_by(stride).collect();
        let views: Vec<Vec<u8>> = self.list.par_iter().map(|c| c.sees(mesh, &judged, &rig.grey[1])).collect();
        let room = self.frames > 0 && self.depth_sum / f64::from(self.frames) > f64::from(ROOM_DEPTH_M);
        let spacing = config.keyframe_spacing_m * if room { 2.0 } else { 1.0 };
        let chosen = greedy(&self.list, &views, spacing, config);
        let well: Vec<usize> = (0..judged.len()).filter(|v| views.iter().any(|c| c[*v] > 1)).collect();
        let seen = well.iter().filter(|v| chosen.iter().any(|c| views[*c][**v] > 0)).count();
        let kept = |c: &Candidate| KeptFrame { id: c.id, world_from_camera: c.pose };
        let mut rest: Vec<&Candidate> =
            (0..self.list.len()).filter(|i| !chosen.contains(i)).map(|i| &self.list[i]).collect();
        rest.extend(&self.reserve);
        rest.sort_by_key(|c| c.index);
        let mut keyframes: Vec<usize> = chosen.clone();
        keyframes.sort_unstable();
        Chosen {
            witnesses: spread(&rest, config.witnesses as usize).into_iter().map(kept).collect(),
            keyframes: keyframes.into_iter().map(|i| kept(&self.list[i])).collect(),
            coverage: seen as f64 / well.len().max(1) as f64,
        }
    }
}

/// `n` frames spread evenly over the list, the sharpest of each stretch.
fn spread<'a>(frames: &[&'a Candidate], n: usize) -> Vec<&'a Candidate> {
    let n = n.min(frames.len());
    (0..n)
        .filter_map(|i| {
            let stretch = &frames[i * frames.len() / n..(i + 1) * frames.len() / n];
            stretch.iter().copied().max_by(|a, b| a.sharpness.total_cmp(&b.sharpness))
        })
        .collect()
}

impl Candidate {
    /// For each judged vertex: 0 not seen, 1 seen, 2 seen well.
    fn sees(&self, mesh: &Mesh, judged: &[usize], camera: &Pinhole) -> Vec<u8> {
        let view = View::new(mesh, &self.pose, camera);
        let quality = |i: &usize| match view.sees(mesh.positions[*i], mesh.normals[*i]) {
            None => 0,
            Some(cos) if cos > WELL_COS => 2,
            Some(_) => 1,
        };
        judged.iter().map(quality).collect()
    }
}

// Eq. (1)
/// Greedy set cover: the frame that adds most comes next, as long as it stands at least `spacing` from those chosen.
/// A vertex asks for `keyframe_views` views, each less urgently than the one before. What only a frame closer than that
/// shows is covered at last, spacing or not.
fn greedy(list: &[Candidate], views: &[Vec<u8>], spacing: f64, config: &FusionConfig) -> Vec<usize> {
    let wanted = config.keyframe_views as usize;
    let coverable = (0..views.first().map_or(0, Vec::len)).filter(|v| views.iter().any(|c| c[*v] > 0)).count();
    let least = MIN_GAIN * coverable as f32;
    let mut chosen: Vec<usize> = Vec::new();
    let mut count = vec![0usize; views.first().map_or(0, Vec::len)];
    for strict in [true, false] {
        while chosen.len() < config.max_keyframes as usize {
            let gain = |c: usize| -> f32 {
                views[c]
                    .iter()
                    .zip(&count)
                    .map(|(seen, n)| {
                        let asked = if strict { *n < wanted } else { *n == 0 };
                        let quality = f32::from(*seen) * 0.5;
                        if asked { quality / (1 << (*n).min(16)) as f32 } else { 0.0 }
                    })
                    .sum()
            };
            let best = (0..list.len())
                .filter(|c| !chosen.contains(c))
                .filter(|c| {
                    !strict
                        || chosen
                            .iter()
                            .all(|k| (list[*k].pose.translation - list[*c].pose.translation).length() >= spacing)
                })
                .map(|c| (gain(c), c))
                .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
            let Some((_, c)) = best.filter(|(gain, _)| *gain > least || chosen.is_empty()) else { break };
            chosen.push(c);
            for (n, seen) in count.iter_mut().zip(&views[c]) {
                *n += usize::from(*seen > 0);
            }
        }
    }
    chosen
}
