//! Live pictures: reduced and coded as JPEG once for all clients, in a thread of their own. A client gets the newest one.

use crate::lock::lock;
use crossbeam_channel::{Receiver, Sender, bounded};
use jpeg_encoder::{ColorType, Encoder};
use recordings::types::{Pose, RgbImage};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Pictures of kept frames that are remembered, for the way back after a loss.
const REMEMBERED: usize = 256;
/// Niceness of the thread that codes.
const NICE: i32 = 5;

/// A picture with the pose it was taken from.
#[derive(Debug)]
pub struct Picture {
    /// Number of the picture; a later one has a larger number.
    pub number: u64,
    /// Time on the sensor's clock, seconds from the first frame.
    pub seconds: f64,
    /// `world_from_camera`; `None` when lost.
    pub pose: Option<Pose>,
    /// Width and height, pixels.
    pub size: (u16, u16),
    /// The JPEG file.
    pub jpeg: Arc<[u8]>,
}

/// A reduced picture that is to be coded.
struct Raw {
    pixels: Vec<u8>,
    picture: Picture,
    /// True for the picture of a kept frame.
    kept: bool,
}

#[derive(Default)]
struct Coded {
    newest: Option<Arc<Picture>>,
    kept: VecDeque<Arc<Picture>>,
}

/// The pictures of a scan.
pub struct Pictures {
    coded: Arc<(Mutex<Coded>, Condvar)>,
    to_coder: Sender<Raw>,
    width: usize,
}

impl Pictures {
    /// Starts the thread that codes.
    #[must_use]
    pub fn start(width: usize, quality: u8) -> Self {
        let coded: Arc<(Mutex<Coded>, Condvar)> = Arc::default();
        let (to_coder, raws) = bounded(2);
        let out = Arc::clone(&coded);
        // Without the thread there are no pictures, which is all.
        if let Err(e) = std::thread::Builder::new().name("pictures".into()).spawn(move || code(&raws, &out, quality)) {
            tracing::warn!("the web page shows no pictures: {e}");
        }
        Self { coded, to_coder, width }
    }

    /// Reduces a picture and hands it to the thread that codes; drops it if that is busy.
    pub fn offer(&self, number: u64, seconds: f64, pose: Option<Pose>, image: &RgbImage, kept: bool) {
        if self.to_coder.is_full() {
            return;
        }
        let (size, pixels) = reduced(image, self.width);
        let picture = Picture { number, seconds, pose, size, jpeg: Arc::from([]) };
        let _ = self.to_coder.try_send(Raw { pixels, picture, kept });
    }

    /// The newest picture with a number above `after`; waits for it at most so long.
    #[must_use]
    pub fn newer(&self, after: u64, wait: Duration) -> Option<Arc<Picture>> {
        let is_old = |c: &mut Coded| c.newest.as_ref().is_none_or(|p| p.number <= after);
        let (coded, _) =
            self.coded.1.wait_timeout_while(lock(&self.coded.0), wait, is_old).unwrap_or_else(PoisonError::into_inner);
        coded.newest.clone().filter(|p| p.number > after)
    }

    /// The picture of the kept frame that was taken nearest to a pose.
    #[must_use]
    pub fn nearest(&self, pose: &Pose) -> Option<Arc<Picture>> {
        let distance = |p: &Picture| {
            p.pose.map_or(f64::INFINITY, |q| {
                (q.translation - pose.translation).length() + 0.5 * q.rotation.angle_between(pose.rotation)
            })
        };
        lock(&self.coded.0).kept.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).cloned()
    }

    /// At most `most` pictures of kept frames, spread over the scan, the newest among them.
    #[must_use]
    pub fn spread(&self, most: usize) -> Vec<Arc<Picture>> {
        let coded = lock(&self.coded.0);
        let (n, most) = (coded.kept.len(), most.max(1));
        let wanted = (1..=most.min(n)).map(|i| i * n / most.min(n) - 1);
        wanted.filter_map(|i| coded.kept.get(i).cloned()).collect()
    }

    /// The picture of a kept frame by its number.
    #[must_use]
    pub fn kept(&self, number: u64) -> Option<Arc<Picture>> {
        lock(&self.coded.0).kept.iter().find(|p| p.number == number).cloned()
    }

    /// Forgets the pictures of the last scan.
    pub fn clear(&self) {
        *lock(&self.coded.0) = Coded::default();
    }
}

fn code(raws: &Receiver<Raw>, out: &(Mutex<Coded>, Condvar), quality: u8) {
    let _ = rustix::process::setpriority_process(Some(rustix::thread::gettid()), NICE);
    for Raw { pixels, picture, kept } in raws {
        let mut jpeg = Vec::new();
        let (width, height) = picture.size;
        if Encoder::new(&mut jpeg, quality).encode(&pixels, width, height, ColorType::Rgb).is_err() {
            continue;
        }
        let picture = Arc::new(Picture { jpeg: jpeg.into(), ..picture });
        let mut coded = lock(&out.0);
        if kept {
            if coded.kept.len() == REMEMBERED {
                coded.kept.pop_front();
            }
            coded.kept.push_back(Arc::clone(&picture));
        }
        coded.newest = Some(picture);
        drop(coded);
        out.1.notify_all();
    }
}

/// Means over squares of pixels, so that the picture is at most `width` wide.
fn reduced(image: &RgbImage, width: usize) -> ((u16, u16), Vec<u8>) {
    let (w, h) = (image.width as usize, image.height as usize);
    let step = w.div_ceil(width).max(1);
    let (columns, rows) = (w / step, h / step);
    let area = (step * step) as u32;
    let mut sums = vec![0u32; 3 * columns];
    let mut pixels = Vec::with_capacity(3 * columns * rows);
    for y in 0..rows {
        sums.fill(0);
        for row in image.data[3 * w * step * y..].chunks_exact(3 * w).take(step) {
            for (sum, cell) in sums.chunks_exact_mut(3).zip(row.chunks_exact(3 * step)) {
                for p in cell.chunks_exact(3) {
                    for (s, p) in sum.iter_mut().zip(p) {
                        *s += u32::from(*p);
                    }
                }
            }
        }
        pixels.extend(sums.iter().map(|s| (s / area) as u8));
    }
    ((columns as u16, rows as u16), pixels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    #[test]
    fn pictures_are_means_and_the_newest_is_kept() {
        let image = RgbImage { width: 5, height: 4, data: (0..60).collect() };
        let (size, pixels) = reduced(&image, 2);
        assert_eq!((size, pixels.len()), ((1, 1), 3));
        assert_eq!(pixels[0], 18, "mean of the first three columns and rows");

        let pictures = Pictures::start(16, 70);
        let image = RgbImage { width: 16, height: 16, data: vec![100; 3 * 256] };
        let at = |x: f64| Pose::new(DQuat::IDENTITY, DVec3::new(x, 0.0, 0.0));
        for number in 1..=3 {
            pictures.offer(number, 0.0, Some(at(number as f64)), &image, number != 2);
            assert_eq!(pictures.newer(number - 1, Duration::from_secs(20)).unwrap().number, number);
        }
        assert!(pictures.newer(3, Duration::from_millis(1)).is_none());
        assert_eq!(pictures.nearest(&at(1.9)).unwrap().number, 1);
        assert_eq!(pictures.nearest(&at(9.0)).unwrap().number, 3);
        assert!(pictures.kept(2).is_none() && pictures.kept(3).is_some());
        assert_eq!(pictures.spread(9).iter().map(|p| p.number).collect::<Vec<_>>(), [1, 3]);
        assert_eq!(pictures.spread(1)[0].number, 3);
        pictures.clear();
        assert!(pictures.newer(0, Duration::ZERO).is_none() && pictures.nearest(&at(0.0)).is_none());
    }
}
