//! Segments of like albedo as one material (§3.2, once light is known). Segmentation sees lit colours only, so that a crease or
//! another lighting divides what is one paint; albedos tell.

use crate::segmentation::labels::renumber;
use firmware_config::tuning::SegmentationTuning;
use glam::DVec3;

/// Passes in which every segment is put to the nearest material again.
const PASSES: usize = 3;

/// A segment as the factorisation sees it.
#[derive(Debug, Clone, Copy)]
pub struct Paint {
    /// Natural logarithm of the albedo per channel.
    pub log_albedo: DVec3,
    /// Seen vertices.
    pub seen: f64,
    /// It has gloss: what has gloss and what has none are two materials.
    pub glossy: bool,
}

/// The material of every segment, `[segment]`, numbered from 0 in order of their first segment. `None` is a segment whose
/// albedo is not known: it stays by itself.
#[must_use]
pub fn materials(segments: &[Option<Paint>], tuning: &SegmentationTuning) -> Vec<u32> {
    let mut order: Vec<usize> = (0..segments.len()).collect();
    order.sort_by(|&a, &b| seen(&segments[b]).total_cmp(&seen(&segments[a])).then(a.cmp(&b)));
    let mut assigned: Vec<Option<usize>> = vec![None; segments.len()];
    let mut groups: Vec<Paint> = Vec::new();
    // Large segments lead: what is like one of them is it.
    for &s in &order {
        let Some(paint) = segments[s] else { continue };
        let group = nearest(&groups, &paint, tuning).filter(|(_, far)| *far <= 1.0);
        match group {
            Some((g, _)) => {
                groups[g] = groups[g].joined(paint);
                assigned[s] = Some(g);
            }
            None => {
                assigned[s] = Some(groups.len());
                groups.push(paint);
            }
        }
    }
    for _ in 0..PASSES {
        let mut sums: Vec<Option<Paint>> = vec![None; groups.len()];
        for (s, paint) in segments.iter().enumerate() {
            let Some(paint) = *paint else { continue };
            let Some((g, _)) = nearest(&groups, &paint, tuning) else { continue };
            assigned[s] = Some(g);
            sums[g] = Some(sums[g].map_or(paint, |sum| sum.joined(paint)));
        }
        groups.iter_mut().zip(sums).for_each(|(g, sum)| *g = sum.unwrap_or(*g));
    }
    let alone = groups.len()..;
    let mut labels: Vec<u32> = assigned.iter().zip(alone).map(|(g, alone)| g.unwrap_or(alone) as u32).collect();
    renumber(&mut labels);
    labels
}

fn seen(paint: &Option<Paint>) -> f64 {
    paint.map_or(0.0, |p| p.seen)
}

impl Paint {
    /// `None` where nothing was seen, or a channel has no logarithm.
    #[must_use]
    pub fn known(albedo: [f64; 3], seen: f64, glossy: bool) -> Option<Self> {
        let log_albedo = DVec3::from_array(albedo.map(libm::log));
        (seen > 0.0 && log_albedo.is_finite()).then_some(Self { log_albedo, seen, glossy })
    }

    fn joined(self, other: Self) -> Self {
        let seen = self.seen + other.seen;
        let share = if seen > 0.0 { other.seen / seen } else { 0.5 };
        Self { log_albedo: self.log_albedo.lerp(other.log_albedo, share), seen, ..self }
    }
}

/// The nearest group and its distance, in units of the difference that light leaves unexplained. Light errs more in its
/// strength than in its colour.
fn nearest(groups: &[Paint], paint: &Paint, tuning: &SegmentationTuning) -> Option<(usize, f64)> {
    let distance = |g: &Paint| {
        let off = g.log_albedo - paint.log_albedo;
        let level = off.element_sum() / 3.0;
        let chroma = (off - level).length();
        libm::hypot(level / tuning.material_level, chroma / tuning.material_chroma)
    };
    let alike = groups.iter().enumerate().filter(|(_, g)| g.glossy == paint.glossy);
    alike.map(|(i, g)| (i, distance(g))).min_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paint(rgb: [f64; 3], seen: f64) -> Option<Paint> {
        Some(Paint { log_albedo: DVec3::from_array(rgb.map(libm::log)), seen, glossy: false })
    }

    #[test]
    fn gloss_divides_what_has_one_albedo() {
        let matte = paint([0.4; 3], 100.0);
        let glossy = matte.map(|p| Paint { glossy: true, ..p });
        assert_eq!(materials(&[matte, glossy, matte, glossy], &SegmentationTuning::default()), [0, 1, 0, 1]);
    }

    #[test]
    fn walls_of_one_paint_are_one_material_and_another_colour_is_not() {
        let segments = [
            paint([0.50, 0.50, 0.50], 900.0),
            paint([0.55, 0.55, 0.54], 500.0),
            None,
            paint([0.50, 0.42, 0.40], 300.0),
            paint([0.25, 0.25, 0.25], 300.0),
            paint([0.46, 0.47, 0.46], 10.0),
        ];
        assert_eq!(materials(&segments, &SegmentationTuning::default()), [0, 0, 1, 2, 3, 0]);
    }

    #[test]
    fn a_ramp_of_albedos_is_not_one_material() {
        let ramp: Vec<Option<Paint>> = (0..20).map(|i| paint([0.1 * libm::exp(0.1 * f64::from(i)); 3], 1.0)).collect();
        let materials = materials(&ramp, &SegmentationTuning::default());
        assert!(materials[0] != materials[19] && materials.iter().max().unwrap() >= &3, "{materials:?}");
    }
}
