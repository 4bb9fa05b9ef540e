//! Keyframes, Eq. (1): |p_a − p_b| ≥ c1, greedily. Candidates are collected during the scan; a small set that covers the
//! surface is chosen at the end.

use crate::camera::pinhole::Pinhole;
use crate::camera::rig::Rig;
use crate::frame::preprocess::Frame;
use crate::tsdf::visibility::{Runs, VisibilityMap};
use firmware_config::FusionConfig;
use firmware_config::tuning::FusionTuning;
use rayon::prelude::*;
use recordings::scan::{FrameId, KeptFrame};
use recordings::types::{Mesh, Pose};

/// A frame whose colour image is kept until the end of the scan.
#[derive(Debug, Clone)]
struct Candidate {
    id: FrameId,
    /// Number of the tracked frame.
    index: usize,
    pose: Pose,
    sharpness: f32,
    /// Number of candidates that it and its predecessors replaced.
    replaced: u32,
}

/// The candidates of a scan.
#[derive(Debug, Default)]
pub struct Candidates {
    list: Vec<Candidate>,
    /// Further frames, as validation frames of scans with few candidates.
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
    pub validation_frames: Vec<KeptFrame>,
    /// Share of the vertices visible to a keyframe, of those that any candidate sees with the full weight.
    pub coverage: f64,
}

/// Distance of two poses, metres: that of the centres, or the angle at a radius of 0.5 m if the camera turns on the spot.
fn view_distance(a: &Pose, b: &Pose) -> f64 {
    let turn = a.rotation.angle_between(b.rotation);
    (a.translation - b.translation).length().max(0.5 * turn)
}

impl Candidates {
    /// An empty list.
    pub fn new(config: &FusionConfig) -> Self {
        // Twice as dense as keyframes: the final choice needs alternatives.
        Self { spacing_m: 0.5 * config.keyframe_spacing_m, ..Self::default() }
    }

    /// Makes a tracked frame a candidate if no other is near it, or if it is sharper; returns its id.
    pub fn offer(&mut self, frame: &Frame, pose: &Pose, config: &FusionConfig) -> Option<FrameId> {
        let tuning = &config.tuning.keyframes;
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
                if frame.sharpness > tuning.sharper as f32 * old.sharpness && old.replaced < tuning.max_replaced {
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

    /// Doubles the spacing and drops the candidates too close to an earlier one.
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

    /// `world_from_camera` of the candidates and of the frames in reserve.
    pub fn poses(&self) -> impl Iterator<Item = Pose> {
        self.list.iter().chain(&self.reserve).map(|c| c.pose)
    }

    /// Chooses keyframes and validation frames for the finished mesh.
    pub fn choose(mut self, mesh: &Mesh, rig: &Rig, config: &FusionConfig) -> Chosen {
        let tuning = &config.tuning;
        self.list.sort_by_key(|c| c.index);
        let stride = mesh.positions.len().div_ceil(tuning.keyframes.max_vertices as usize).max(1);
        let sampled: Vec<usize> = (0..mesh.positions.len()).step_by(stride).collect();
        let runs = Runs::new(mesh);
        let views: Vec<Vec<u8>> =
            self.list.par_iter().map(|c| c.visibility(&runs, &sampled, &rig.grey[1], tuning)).collect();
        let room = self.frames > 0 && self.depth_sum / f64::from(self.frames) > tuning.keyframes.room_depth_m;
        let spacing = config.keyframe_spacing_m * if room { 2.0 } else { 1.0 };
        let chosen = greedy(&self.list, &views, spacing, config);
        let well: Vec<usize> = (0..sampled.len()).filter(|v| views.iter().any(|c| c[*v] > 1)).collect();
        let seen = well.iter().filter(|v| chosen.iter().any(|c| views[*c][**v] > 0)).count();
        let kept = |c: &Candidate| KeptFrame { id: c.id, world_from_camera: c.pose };
        let mut rest: Vec<&Candidate> =
            (0..self.list.len()).filter(|i| !chosen.contains(i)).map(|i| &self.list[i]).collect();
        rest.extend(&self.reserve);
        rest.sort_by_key(|c| c.index);
        let mut keyframes: Vec<usize> = chosen.clone();
        keyframes.sort_unstable();
        Chosen {
            validation_frames: spread(&rest, config.witnesses as usize).into_iter().map(kept).collect(),
            keyframes: keyframes.into_iter().map(|i| kept(&self.list[i])).collect(),
            coverage: seen as f64 / well.len().max(1) as f64,
        }
    }
}

/// The sharpest frame of each of `n` equal parts of the list.
fn spread<'a>(frames: &[&'a Candidate], n: usize) -> Vec<&'a Candidate> {
    let n = n.min(frames.len());
    (0..n)
        .filter_map(|i| {
            let part = &frames[i * frames.len() / n..(i + 1) * frames.len() / n];
            part.iter().copied().max_by(|a, b| a.sharpness.total_cmp(&b.sharpness))
        })
        .collect()
}

impl Candidate {
    /// `[sampled vertex]`: 0 not visible, 1 visible, 2 visible at a good angle (`keyframes.full_cos`).
    fn visibility(&self, runs: &Runs, sampled: &[usize], camera: &Pinhole, tuning: &FusionTuning) -> Vec<u8> {
        let mesh = runs.mesh;
        let map = VisibilityMap::new(runs, &self.pose, camera, &tuning.surface_coverage);
        let quality = |i: &usize| match map.visible_cos(mesh.positions[*i], mesh.normals[*i]) {
            None => 0,
            Some(cos) if cos > tuning.keyframes.full_cos as f32 => 2,
            Some(_) => 1,
        };
        sampled.iter().map(quality).collect()
    }
}

// Eq. (1)
/// Greedy set cover: the next frame is the one with the largest gain at least `spacing` metres from those chosen. A vertex
/// wants `fusion.keyframe_views` views; each further view gains half of the one before. Vertices visible only to closer
/// frames are covered in a second pass without spacing. `views` is `[candidate][sampled vertex]`; returns candidates.
fn greedy(list: &[Candidate], views: &[Vec<u8>], spacing: f64, config: &FusionConfig) -> Vec<usize> {
    let wanted = config.keyframe_views as usize;
    let coverable = (0..views.first().map_or(0, Vec::len)).filter(|v| views.iter().any(|c| c[*v] > 0)).count();
    let least = config.tuning.keyframes.min_gain_share as f32 * coverable as f32;
    let mut chosen: Vec<usize> = Vec::new();
    let mut count = vec![0usize; views.first().map_or(0, Vec::len)];
    for strict in [true, false] {
        while chosen.len() < config.max_keyframes as usize {
            let gain = |c: usize| -> f32 {
                views[c]
                    .iter()
                    .zip(&count)
                    .map(|(seen, n)| {
                        let wants = if strict { *n < wanted } else { *n == 0 };
                        let quality = f32::from(*seen) * 0.5;
                        if wants { quality / (1 << (*n).min(16)) as f32 } else { 0.0 }
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
