//! Cost of the stages of fusion on a synthetic 640 × 480 scan of a desk: CPU and wall time per frame, frames and voxels per
//! second, peak memory; for the best instruction set of the machine and for the portable one, each in its own process.
//! `cargo bench -p fusion`.

#![allow(clippy::unwrap_used)]

#[path = "../tests/synthetic/mod.rs"]
mod synthetic;
mod usage;

use firmware_config::FusionConfig;
use fusion::Fusion;
use glam::DVec3;
use std::process::Command;
use std::time::Instant;
use usage::{cpu_ms, peak_mib};

const FRAMES: usize = 60;
/// Set in the measuring processes; `LUMISCAN_ISA` sets their instruction set.
const MEASURE: &str = "LUMISCAN_BENCH_STAGES";

fn main() {
    if std::env::var_os(MEASURE).is_some() {
        measure();
        return;
    }
    let this = std::env::current_exe().unwrap();
    for isa in ["best", "portable"] {
        assert!(Command::new(&this).env(MEASURE, "1").env("LUMISCAN_ISA", isa).status().unwrap().success());
    }
}

fn measure() {
    let isa = std::env::var("LUMISCAN_ISA").unwrap_or_default();
    let sensor = synthetic::sensor(640, 480);
    let desk = synthetic::desk();
    let frames: Vec<_> = (0..FRAMES)
        .map(|i| {
            let a = i as f64 * 0.02;
            let from = DVec3::new(1.1 * libm::sin(a), -1.1 * libm::cos(a), 0.7);
            desk.look(&sensor, &synthetic::look_at(from, DVec3::new(0.0, 0.0, 0.1)), i)
        })
        .collect();
    tracing::subscriber::set_global_default(stages::Collector).unwrap();
    let before = peak_mib();
    // Both pools live to the end: the CPU time of an ended thread would leave the sum.
    let pools = [1, 2].map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap());
    for pool in &pools {
        let threads = pool.current_num_threads();
        pool.install(|| {
            let mut fusion = Fusion::new(&sensor, &FusionConfig::default()).unwrap();
            stages::reset();
            let (mut cpu, mut wall, mut blocks) = (Vec::new(), Vec::new(), 0);
            for frame in &frames {
                let (c, w) = (cpu_ms(), Instant::now());
                blocks = fusion.push(frame).unwrap().blocks_used;
                cpu.push(cpu_ms() - c);
                wall.push(w.elapsed().as_secs_f64() * 1e3);
            }
            let (cpu, wall) = (median(&mut cpu), median(&mut wall));
            println!(
                "isa {isa}, threads {threads}: push CPU {cpu:.1} ms, wall {wall:.1} ms ({:.0} fps); {blocks} blocks held",
                1e3 / wall
            );
            for (name, cpu, wall, voxels) in stages::totals() {
                let n = FRAMES as f64;
                print!("    {name:<12} CPU {:.2} ms, wall {:.2} ms", cpu / n, wall / n);
                if voxels > 0 {
                    print!(", {:.0} M voxels/s of CPU time", voxels as f64 / cpu.max(1e-9) * 1e-3);
                }
                println!();
            }
            let (c, w) = (cpu_ms(), Instant::now());
            let output = fusion.finish();
            println!(
                "    {:<12} CPU {:.0} ms, wall {:.0} ms, {} vertices; peak {} MiB, of which the input {before}",
                "finish",
                cpu_ms() - c,
                w.elapsed().as_secs_f64() * 1e3,
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

/// Time per tracing span (the stages of `Fusion::push`), and the voxels that integration updates.
mod stages {
    use std::cell::RefCell;
    use std::fmt::Debug;
    use std::sync::Mutex;
    use std::time::Instant;
    use tracing::field::{Field, Visit};
    use tracing::span::{Attributes, Id, Record};
    use tracing::{Event, Metadata, Subscriber};

    /// Name, CPU ms, wall ms, voxels.
    type Total = (&'static str, f64, f64, u64);

    static TOTALS: Mutex<Vec<Total>> = Mutex::new(Vec::new());
    thread_local!(static OPEN: RefCell<Vec<(f64, Instant)>> = const { RefCell::new(Vec::new()) });

    pub fn reset() {
        TOTALS.lock().unwrap().clear();
    }

    pub fn totals() -> Vec<Total> {
        TOTALS.lock().unwrap().clone()
    }

    pub struct Collector;

    impl Subscriber for Collector {
        fn enabled(&self, metadata: &Metadata<'_>) -> bool {
            metadata.is_span() || metadata.fields().field("blocks").is_some()
        }
        fn new_span(&self, span: &Attributes<'_>) -> Id {
            let name = span.metadata().name();
            let mut totals = TOTALS.lock().unwrap();
            let at = totals.iter().position(|t| t.0 == name).unwrap_or(totals.len());
            if at == totals.len() {
                totals.push((name, 0.0, 0.0, 0));
            }
            Id::from_u64(at as u64 + 1)
        }
        fn record(&self, _: &Id, _: &Record<'_>) {}
        fn record_follows_from(&self, _: &Id, _: &Id) {}
        fn event(&self, event: &Event<'_>) {
            struct Blocks(u64);
            impl Visit for Blocks {
                fn record_u64(&mut self, field: &Field, value: u64) {
                    if field.name() == "blocks" {
                        self.0 = value;
                    }
                }
                fn record_debug(&mut self, _: &Field, _: &dyn Debug) {}
            }
            let mut blocks = Blocks(0);
            event.record(&mut blocks);
            if let Some(t) = TOTALS.lock().unwrap().iter_mut().find(|t| t.0 == "integrate") {
                t.3 += 512 * blocks.0;
            }
        }
        fn enter(&self, _: &Id) {
            OPEN.with_borrow_mut(|o| o.push((super::cpu_ms(), Instant::now())));
        }
        fn exit(&self, id: &Id) {
            let Some((cpu, wall)) = OPEN.with_borrow_mut(Vec::pop) else { return };
            if let Some(t) = TOTALS.lock().unwrap().get_mut(id.into_u64() as usize - 1) {
                t.1 += super::cpu_ms() - cpu;
                t.2 += wall.elapsed().as_secs_f64() * 1e3;
            }
        }
    }
}
