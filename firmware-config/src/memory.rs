//! The memory plan: upper bounds of the memory of the capture process, computed before it starts.

use crate::config::Config;
use crate::kinect_models::{BAYER_SXGA, BAYER_VGA, DEPTH_11};

/// One part of the plan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Planned {
    /// Name of the part.
    pub name: &'static str,
    /// Upper bound of its memory, bytes.
    pub bytes: u64,
}

/// Bytes of a voxel block: 8³ voxels of 4 bytes, and its entries in the tables.
const BLOCK: u64 = 512 * 4 + 64;
/// Vertices per block of a real surface (15 to 26 measured on average), and bytes per vertex during extraction: position,
/// normal, two triangles, two entries of the search for connected components.
const VERTICES_A_BLOCK: u64 = 32;
const BYTES_A_VERTEX: u64 = 64;
/// Program, libraries, thread stacks, freed heap that stays with the process.
const PROGRAM: u64 = 96 << 20;

/// Upper bounds of the memory of the capture process, part by part.
#[must_use]
pub fn memory_plan(config: &Config) -> Vec<Planned> {
    let color = if config.kinect.color_sxga { &BAYER_SXGA } else { &BAYER_VGA };
    let pixels = u64::from(color.width) * u64::from(color.height);
    // Depth in 16 bits, the mosaic, and the decoded image.
    let pair = u64::from(DEPTH_11.width * DEPTH_11.height) * 2 + pixels + 3 * pixels;
    let blocks = u64::from(config.fusion.pool_blocks);
    let plan = |name, bytes| Planned { name, bytes };
    vec![
        plan("USB transfers", 2 * 16 * 16 * 1920),
        // Eight of each kind wait, up to twelve are in work.
        plan("frames as they arrive", 20 * (DEPTH_11.frame_bytes() + color.frame_bytes()) as u64),
        plan("tables of depth decoding", 8 << 20),
        // Two frames of each kind wait for their partners, two pairs before each stage, one in each.
        plan("frames waiting and in work", 10 * pair),
        plan("frames waiting for the disk", 4 * pixels),
        plan("voxel pool", blocks * BLOCK),
        // Vertex, normal and colour images of three levels, of the frame and of the prediction.
        plan("tracking", 2 * 640 * 480 * 64 * 4 / 3),
        plan(
            "kept frames' depth for keyframes and relocalisation",
            u64::from(config.fusion.max_keyframes) * 4 * 320 * 240 * 4,
        ),
        // Blocks with surface are fewer than half of the pool; 20 surfels of 8 bytes each, kept pictures, connections.
        plan("web page", 24 << 20),
        plan("mesh", blocks * VERTICES_A_BLOCK * BYTES_A_VERTEX),
        plan("program", PROGRAM),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_within_their_own_limit_and_larger_pools_are_not() {
        let total = |c: &Config| memory_plan(c).iter().map(|p| p.bytes).sum::<u64>();
        let mut config = Config::default();
        assert!(total(&config) <= u64::from(config.daemon.memory_limit_mb) * 1_000_000, "{}", total(&config));
        config.fusion.pool_blocks = 1 << 20;
        assert!(total(&config) > u64::from(config.daemon.memory_limit_mb) * 1_000_000);
    }
}
