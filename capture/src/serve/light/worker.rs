//! The thread that has the light estimated every few seconds while someone watches.

use crate::child_process::IDLE;
use crate::estimator_process;
use crate::serve::light::coarse_mesh::coarse_mesh;
use crate::serve::light::snapshot::scan_of;
use crate::serve::light::so_far::LightSoFar;
use crate::serve::live::hub::{Hub, Seen};
use crate::stop::Stop;
use firmware_config::Config;
use recordings::result::Estimate;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

/// Time between two looks at whether an estimate is due.
const POLL: Duration = Duration::from_millis(50);
/// Kept pictures and surfels from which there is anything to find.
const FEWEST_PICTURES: usize = 3;
const FEWEST_SURFELS: usize = 500;
/// The first estimates come sooner: not later than this share of the scan's time after the one before, and this time.
const SOONER_SHARE: f64 = 0.03;
const SOONER_S: f64 = 0.1;
/// Vertices of the mesh that is handed over, in those of the estimate: the estimator makes an even mesh of it.
const FINER: usize = 2;
/// Memory of the estimator's process, MB.
const MEMORY_MB: u32 = 512;

/// Starts the thread; it ends when the hub is gone.
pub fn start(hub: &Arc<Hub>, config: &Config, stop: &Stop) {
    let (hub, config, stop) = (Arc::downgrade(hub), config.clone(), stop.clone());
    let work = move || {
        let folder = std::env::temp_dir().join(format!("lumiscan-light-{}", std::process::id()));
        run(&hub, &config, &stop, &folder);
        let _ = std::fs::remove_dir_all(&folder);
    };
    // Without the thread the light is not shown, which is all.
    if let Err(e) = std::thread::Builder::new().name("light".into()).spawn(work) {
        tracing::warn!("the light so far is not shown: {e}");
    }
}

fn run(hub: &Weak<Hub>, config: &Config, stop: &Stop, folder: &Path) {
    let mut last: Option<(Instant, f64)> = None;
    loop {
        std::thread::sleep(POLL);
        let Some(hub) = hub.upgrade() else { return };
        let due = last.is_none_or(|(t, seconds)| {
            let wait = (SOONER_S + SOONER_SHARE * seconds).min(config.serve.light_interval_s);
            t.elapsed().as_secs_f64() >= wait
        });
        if stop.is_set() {
            return;
        }
        if due && hub.is_watched() && hub.is_scanning() {
            match estimate(&hub, config, stop, folder) {
                Ok(None) => {}
                Ok(Some(seconds)) => last = Some((Instant::now(), seconds)),
                Err(problem) => {
                    tracing::debug!("light so far: {problem}");
                    last = Some((Instant::now(), f64::INFINITY));
                }
            }
        }
    }
}

/// One estimate; the time of the scan that it is of, in seconds, or `None` if there is too little to find anything from.
fn estimate(hub: &Hub, config: &Config, stop: &Stop, folder: &Path) -> Result<Option<f64>, String> {
    let Some(seen) = hub.seen(config.serve.light_pictures as usize) else { return Ok(None) };
    let surfels: usize = seen.blocks.iter().map(|(_, s)| s.len()).sum();
    if seen.pictures.len() < FEWEST_PICTURES || surfels < FEWEST_SURFELS {
        return Ok(None);
    }
    let work = || {
        let _ = rustix::process::setpriority_process(Some(rustix::thread::gettid()), IDLE);
        found_in(&seen, config, stop, folder)
    };
    // What was seen is copied at the priority of the server, since fusion may wait for that; only then is there time.
    let (cpu_s, found) = std::thread::scope(|scope| scope.spawn(work).join()).map_err(|_| "the thread panicked")??;
    hub.set_light(
        |number| LightSoFar::new(number, seen.seconds, cpu_s, &found.light, &found.mesh, &found.confidence),
        seen.scan,
    );
    Ok(Some(seen.seconds))
}

/// The estimate and its processor time in seconds.
fn found_in(seen: &Seen, config: &Config, stop: &Stop, folder: &Path) -> Result<(f64, Estimate), String> {
    let text = |e: &dyn std::fmt::Display| e.to_string();
    let mesh = coarse_mesh(&seen.blocks, seen.voxel_m, FINER * config.serve.light_vertices as usize);
    std::fs::create_dir_all(folder).map_err(|e| text(&e))?;
    let (scan, result): (PathBuf, PathBuf) = (folder.join("scan.lscan"), folder.join("result.lres"));
    scan_of(&seen.sensor, config, mesh, &seen.pictures).write(&scan).map_err(|e| text(&e))?;
    let cpu_s = estimator_process::estimate_coarsely(&scan, &result, MEMORY_MB, stop).map_err(|e| text(&e))?;
    Ok((cpu_s, Estimate::read(&result).map_err(|e| text(&e))?))
}
