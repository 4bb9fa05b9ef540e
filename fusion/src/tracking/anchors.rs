//! Anchor frames: tracking aligns to the nearest one, relocalisation to the most similar ones.

use crate::camera::rig::LEVELS;
use crate::frame::grey::Grey;
use crate::frame::preprocess::Frame;
use crate::tracking::reference::Reference;
use recordings::types::Pose;

/// Width and height of a thumbnail, pixels.
const THUMB: (usize, usize) = (20, 15);

/// A thumbnail of zero mean and unit length: a dot product of two is their correlation.
#[derive(Debug, Clone)]
pub struct Thumbnail(Vec<f32>);

impl Thumbnail {
    /// The thumbnail of the coarsest grey level.
    pub fn new(grey: &Grey) -> Self {
        let mut t = vec![0.0f32; THUMB.0 * THUMB.1];
        for (i, t) in t.iter_mut().enumerate() {
            let (x, y) = (i % THUMB.0, i / THUMB.0);
            let columns = x * grey.width / THUMB.0..((x + 1) * grey.width).div_ceil(THUMB.0);
            let rows = y * grey.height / THUMB.1..((y + 1) * grey.height).div_ceil(THUMB.1);
            let mut n = 0;
            for r in rows {
                for c in columns.clone() {
                    *t += grey.data[r * grey.width + c].max(0.0);
                    n += 1;
                }
            }
            *t /= n.max(1) as f32;
        }
        let mean = t.iter().sum::<f32>() / t.len() as f32;
        t.iter_mut().for_each(|t| *t -= mean);
        let length = t.iter().map(|t| t * t).sum::<f32>().sqrt().max(1e-3);
        t.iter_mut().for_each(|t| *t /= length);
        Self(t)
    }

    /// Correlation of two thumbnails, −1 … 1.
    pub fn correlation(&self, other: &Self) -> f32 {
        self.0.iter().zip(&other.0).map(|(a, b)| a * b).sum()
    }
}

/// A stored frame.
pub struct Anchor {
    pub reference: Reference,
    pub thumbnail: Thumbnail,
    /// Its coarsest grey level.
    pub grey: Grey,
}

/// The stored frames, at most `capacity`.
pub struct Anchors {
    list: Vec<Anchor>,
    capacity: usize,
    oldest: usize,
}

impl Anchors {
    /// No anchors.
    pub fn new(capacity: usize) -> Self {
        Self { list: Vec::new(), capacity, oldest: 0 }
    }

    /// The anchor with this number.
    pub fn get(&self, i: usize) -> Option<&Anchor> {
        self.list.get(i)
    }

    /// Stores an anchor, in place of the oldest if the store is full; returns its number.
    pub fn add(&mut self, reference: Reference, frame: &Frame) -> usize {
        let grey = frame.grey[LEVELS - 1].clone();
        let anchor = Anchor { reference, thumbnail: Thumbnail::new(&grey), grey };
        if self.list.len() < self.capacity {
            self.list.push(anchor);
            return self.list.len() - 1;
        }
        let at = self.oldest;
        self.oldest = (self.oldest + 1) % self.capacity;
        self.list[at] = anchor;
        at
    }

    /// The anchor nearest to a pose and its distance, in units of the limits: `distance` as a share of the anchor's median
    /// depth, `angle` in radians.
    pub fn nearest(&self, pose: &Pose, distance: f64, angle: f64) -> Option<(usize, f64)> {
        self.list
            .iter()
            .enumerate()
            .map(|(i, a)| {
                let r = &a.reference;
                let d = (r.world_from_camera.translation - pose.translation).length()
                    / (distance * f64::from(r.median_depth.max(0.3)));
                let turn = r.world_from_camera.rotation.angle_between(pose.rotation) / angle;
                (i, d.max(turn))
            })
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The numbers of the `n` anchors whose thumbnails correlate most with the frame, best first.
    pub fn most_similar(&self, frame: &Frame, n: usize) -> Vec<usize> {
        let thumbnail = Thumbnail::new(&frame.grey[LEVELS - 1]);
        let mut scores: Vec<(f32, usize)> =
            self.list.iter().enumerate().map(|(i, a)| (a.thumbnail.correlation(&thumbnail), i)).collect();
        scores.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        scores.into_iter().take(n).map(|s| s.1).collect()
    }
}
