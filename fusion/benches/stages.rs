//! Cost of fusion on a made-up 640 × 480 scan of a desk: CPU and wall time per frame, voxels per second, peak memory, for
//! the instruction set in use. `cargo bench -p fusion`; `LUMISCAN_ISA=portable cargo bench -p fusion` for the plain path.

#![allow(clippy::unwrap_used)]

#[path = "../tests/world/mod.rs"]
mod world;

use firmware_config::FusionConfig;
use fusion::Fusion;
use glam::DVec3;
use std::time::Instant;

const FRAMES: usize = 60;

fn main() {
    let sensor = world::sensor(640, 480);
    let desk = world::desk();
    let frames: Vec<_> = (0..FRAMES)
        .map(|i| {
            let a = i as f64 * 0.02;
            let from = DVec3::new(1.1 * libm::sin(a), -1.1 * libm::cos(a), 0.7);
            desk.look(&sensor, &world::look_at(from, DVec3::new(0.0, 0.0, 0.1)), i)
        })
        .collect();
    let isa = std::env::var("LUMISCAN_ISA").unwrap_or_else(|_| "best".into());
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut fusion = Fusion::new(&sensor, &FusionConfig::default()).unwrap();
            let (mut cpu, mut wall, mut blocks) = (Vec::new(), Vec::new(), 0);
            for frame in &frames {
                let (c, w) = (cpu_ms(), Instant::now());
                blocks = fusion.push(frame).unwrap().blocks_used;
                cpu.push(cpu_ms() - c);
                wall.push(w.elapsed().as_secs_f64() * 1e3);
            }
            let (c, w) = (cpu_ms(), Instant::now());
            let output = fusion.finish();
            let finish = (cpu_ms() - c, w.elapsed().as_secs_f64() * 1e3);
            println!(
                "isa {isa}, threads {threads}: push CPU {:.1} ms, wall {:.1} ms ({:.0} fps); {blocks} blocks = {:.2} M voxels held; \
                 finish CPU {:.0} ms, wall {:.0} ms, {} vertices; peak {} MiB",
                median(&mut cpu),
                median(&mut wall),
                1e3 / median(&mut wall),
                blocks as f64 * 512e-6,
                finish.0,
                finish.1,
                output.mesh.positions.len(),
                peak_mib()
            );
        });
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// CPU time of this process's threads so far, in milliseconds (Linux; 0 elsewhere).
fn cpu_ms() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return 0.0 };
    tasks
        .filter_map(|t| std::fs::read_to_string(t.ok()?.path().join("schedstat")).ok())
        .filter_map(|s| s.split_whitespace().next()?.parse::<f64>().ok())
        .sum::<f64>()
        * 1e-6
}

/// Peak resident memory in MiB (Linux; 0 elsewhere).
fn peak_mib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    line.and_then(|l| l.split_whitespace().next()?.parse::<u64>().ok()).unwrap_or(0) / 1024
}
