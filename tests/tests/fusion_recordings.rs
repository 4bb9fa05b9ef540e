//! Fusion on recordings of real and rendered Kinects: accuracy, coverage, loss and recovery, speed.

#![allow(clippy::unwrap_used, reason = "these are tests")]

use estimator::sweep::alignment::rigid_alignment;
use firmware_config::FusionConfig;
use fusion::Fusion;
use fusion::FusionOutput;
use fusion::Tracking;
use glam::{DVec3, Vec3};
use recordings::import::trajectory::read_trajectory;
use recordings::import::tum::TumReader;
use recordings::recording::{Event, RecordingReader};
use recordings::types::{ColorFrame, DepthFrame, Mesh, RgbdFrame, Sensor, TimestampNs};
use std::collections::HashMap;
use std::ops::Range;
use std::path::Path;
use tests::shared;

type Pair = (DepthFrame, ColorFrame);

/// All depth frames and all colour frames that `next` gives.
fn streams(mut next: impl FnMut() -> Option<Event>) -> (Vec<DepthFrame>, Vec<ColorFrame>) {
    let (mut depths, mut colors) = (Vec::new(), Vec::new());
    while let Some(event) = next() {
        match event {
            Event::Depth(d) => depths.push(d),
            Event::Color(c) => colors.push(c),
            _ => {}
        }
    }
    (depths, colors)
}

/// Each colour frame with the depth frame nearest in time.
fn pairs(dir: &Path) -> (Sensor, Vec<Pair>) {
    let mut reader = TumReader::open(dir).unwrap();
    let (depths, colors) = streams(|| reader.next_event().unwrap());
    let gap = |c: &ColorFrame, d: &DepthFrame| (d.timestamp_ns - c.timestamp_ns).abs();
    let near = |c: ColorFrame| {
        let depth = depths.iter().min_by_key(|d| gap(&c, d)).filter(|d| gap(&c, d) <= 20_000_000)?;
        Some((depth.clone(), c))
    };
    (reader.sensor().clone(), colors.into_iter().filter_map(near).collect())
}

fn decoded((depth, color): &Pair) -> RgbdFrame {
    RgbdFrame { depth: depth.clone(), color: color.clone(), rgb: color.decode().unwrap() }
}

/// The pairs of the bundled recording, which begins at rest.
fn bundled() -> (Sensor, Vec<Pair>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/data/tabletop.lrec");
    let mut reader = RecordingReader::open(&path).unwrap();
    let (depths, colors) = streams(|| reader.next_event().unwrap());
    (reader.sensor().clone(), depths.into_iter().zip(colors).collect())
}

/// Fuses pairs, paused for some of them; what comes of it, and the blocks in use when the pause begins and when it ends.
fn fuse_with_a_pause((sensor, pairs): &(Sensor, Vec<Pair>), pause: Range<usize>) -> (FusionOutput, [u64; 2]) {
    // Coarse, for time.
    let config = FusionConfig { voxel_size_m: 0.01, fine_blocks: 0, ..FusionConfig::default() };
    let mut fusion = Fusion::new(sensor, &config).unwrap();
    let mut blocks = [0; 2];
    for (i, pair) in pairs.iter().enumerate() {
        fusion.set_paused(pause.contains(&i));
        let report = fusion.push(&decoded(pair)).unwrap();
        if i + 1 == pause.start {
            blocks = [report.blocks_used; 2];
        }
        if i + 1 == pause.end {
            blocks[1] = report.blocks_used;
        }
    }
    (fusion.finish(), blocks)
}

/// True camera centres by time in seconds.
fn truth(dir: &Path) -> Vec<(f64, DVec3)> {
    let path = read_trajectory(&dir.join("groundtruth.txt")).unwrap();
    path.iter().map(|(t, pose)| (*t as f64 * 1e-9, pose.translation)).collect()
}

fn at(truth: &[(f64, DVec3)], stamp: TimestampNs) -> DVec3 {
    let t = stamp as f64 * 1e-9;
    let i = truth.partition_point(|p| p.0 < t).clamp(1, truth.len() - 1);
    let (a, b) = (truth[i - 1], truth[i]);
    a.1.lerp(b.1, ((t - a.0) / (b.0 - a.0)).clamp(0.0, 1.0))
}

/// RMS distance of two paths, in metres, after the best rigid alignment (Umeyama).
fn ate(path: &[(DVec3, DVec3)]) -> f64 {
    let (rotation, translation) = rigid_alignment(path).unwrap();
    let error = |(a, b): &(DVec3, DVec3)| (rotation * *a + translation - *b).length_squared();
    (path.iter().map(error).sum::<f64>() / path.len() as f64).sqrt()
}

/// Fuses pairs; what comes of it, the path beside the true one, and the number of pairs.
fn fuse(dir: &Path, choose: impl Fn(Vec<Pair>) -> Vec<Pair>) -> (FusionOutput, f64, usize) {
    let (sensor, all) = pairs(dir);
    let truth = truth(dir);
    let chosen = choose(all);
    let mut fusion = Fusion::new(&sensor, &FusionConfig::default()).unwrap();
    for pair in &chosen {
        fusion.push(&decoded(pair)).unwrap();
    }
    let output = fusion.finish();
    let path: Vec<_> = output.trajectory.iter().map(|(t, p)| (p.translation, at(&truth, *t))).collect();
    let error = ate(&path);
    println!("{}: {} of {} frames, ATE {:.2} cm", dir.display(), path.len(), chosen.len(), 100.0 * error);
    (output, error, chosen.len())
}

/// Share of the vertices with another sheet of the surface, turned the same way, 1 to 4 cm before or behind them.
fn doubled(positions: &[Vec3], normals: &[Vec3]) -> f64 {
    const CELL: f32 = 0.01;
    let cell = |p: Vec3| (p / CELL).floor().as_ivec3().to_array();
    let mut cells: HashMap<[i32; 3], Vec<usize>> = HashMap::new();
    for (i, p) in positions.iter().enumerate() {
        cells.entry(cell(*p)).or_default().push(i);
    }
    let has_double = |i: usize| {
        let (p, n) = (positions[i], normals[i]);
        let beside = |q: usize| {
            let d = positions[q] - p;
            let along = d.dot(n);
            (0.01..0.04).contains(&along.abs()) && (d - n * along).length() < 0.004 && normals[q].dot(n) > 0.8
        };
        [-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0f32].iter().any(|k| {
            let c = cell(p + n * (k * CELL));
            (0..27).any(|j| {
                let key = [c[0] + j % 3 - 1, c[1] + j / 3 % 3 - 1, c[2] + j / 9 - 1];
                cells.get(&key).is_some_and(|list| list.iter().any(|q| beside(*q)))
            })
        })
    };
    let judged: Vec<usize> = (0..positions.len()).step_by(positions.len().div_ceil(20_000).max(1)).collect();
    judged.iter().filter(|i| has_double(**i)).count() as f64 / judged.len().max(1) as f64
}

/// The same with a second wall 2 cm before every tenth of the surface: what the measure must notice.
fn doubled_on_purpose(mesh: &Mesh) -> f64 {
    let more = mesh.positions.iter().zip(&mesh.normals).filter(|(p, _)| (p.x * 10.0).floor() as i32 % 10 == 0);
    let (p, n): (Vec<Vec3>, Vec<Vec3>) = more.map(|(p, n)| (*p + *n * 0.02, *n)).unzip();
    doubled(&[&mesh.positions[..], &p].concat(), &[&mesh.normals[..], &n].concat())
}

#[test]
fn a_pause_adds_nothing_and_does_not_tear_the_surface() {
    let table = bundled();
    let frames = table.1.len();
    let (whole, _) = fuse_with_a_pause(&table, 0..0);
    let (paused, blocks) = fuse_with_a_pause(&table, 20..40);
    assert_eq!(blocks[0], blocks[1], "blocks in use before and after the pause");
    assert_eq!(paused.trajectory.len(), frames, "tracked all the while");
    let last = |o: &FusionOutput| o.trajectory.last().unwrap().1.translation;
    let apart = last(&whole).distance(last(&paused));
    let share = |o: &FusionOutput| doubled(&o.mesh.positions, &o.mesh.normals);
    println!("{:.1} mm apart at the end; doubled: {:.4} and {:.4}", 1e3 * apart, share(&whole), share(&paused));
    assert!(apart < 0.01, "{apart} m");
    assert!(share(&paused) < share(&whole) + 0.01, "the surface is torn: {} against {}", share(&paused), share(&whole));
}

#[test]
fn a_scan_that_is_paused_at_once_begins_when_it_goes_on() {
    let table = bundled();
    let frames = table.1.len();
    let (output, _) = fuse_with_a_pause(&table, 0..10);
    assert!(output.trajectory.len() + 10 >= frames, "{} of {frames} frames tracked", output.trajectory.len());
    assert!(output.mesh.positions.len() > 1000, "{} vertices", output.mesh.positions.len());
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the recordings of data/ and truth_rgbd/")]
fn a_desk_is_followed_covered_and_has_no_double_walls() {
    let shared = shared();
    let (output, error, frames) = fuse(&shared.join("data/tum_fr1_xyz_400"), |all| all);
    assert!(error <= 0.015, "{error} m");
    assert!(output.trajectory.len() * 100 >= frames * 97);
    assert!(output.stats.keyframe_coverage >= 0.98, "{}", output.stats.keyframe_coverage);
    let (share, control) = (doubled(&output.mesh.positions, &output.mesh.normals), doubled_on_purpose(&output.mesh));
    println!("doubled: {:.2} %, with a second wall added: {:.2} %", 100.0 * share, 100.0 * control);
    assert!(share < 0.025, "{share} of the surface is double");
    assert!(control > share + 0.05, "the measure is blind: {control}");
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the recordings of data/ and truth_rgbd/")]
fn a_rendered_table_is_followed_to_millimetres() {
    let shared = shared();
    let (output, error, frames) = fuse(&shared.join("truth_rgbd/fruits"), |all| all);
    assert!(error <= 0.003, "{error} m");
    assert_eq!(output.trajectory.len(), frames);
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the recordings of data/ and truth_rgbd/")]
fn twice_the_speed_and_backwards_do_not_lose_it() {
    let shared = shared();
    let every_second = |all: Vec<Pair>| all.into_iter().step_by(2).collect();
    for (name, limit) in [("data/tum_fr1_xyz_400", 0.02), ("truth_rgbd/bunny", 0.004)] {
        let (output, error, frames) = fuse(&shared.join(name), every_second);
        assert_eq!(output.trajectory.len(), frames, "{name}: lost");
        assert!(error <= limit, "{name}: {error} m");
    }
    let backwards = |all: Vec<Pair>| {
        let (first, last) = (all[0].1.timestamp_ns, all[all.len() - 1].1.timestamp_ns);
        let turned = |(mut d, mut c): Pair| {
            // Truth is looked up by the colour stamp, so time is mirrored and the path with it below.
            (d.timestamp_ns, c.timestamp_ns) = (first + last - d.timestamp_ns, first + last - c.timestamp_ns);
            (d, c)
        };
        all.into_iter().rev().map(turned).collect()
    };
    let (output, _, frames) = fuse(&shared.join("truth_rgbd/bunny"), backwards);
    assert_eq!(output.trajectory.len(), frames, "bunny backwards: lost");
}

/// What fusion reports of a frame: tracked, blocks in use, camera centre.
struct Reported {
    tracked: bool,
    blocks: u64,
    centre: Option<DVec3>,
}

fn play(sensor: &Sensor, frames: impl Iterator<Item = RgbdFrame>) -> (Vec<Reported>, FusionOutput) {
    let mut fusion = Fusion::new(sensor, &FusionConfig::default()).unwrap();
    let report_of = |frame: RgbdFrame| {
        let report = fusion.push(&frame).unwrap();
        Reported {
            tracked: report.tracking == Tracking::Tracked,
            blocks: report.blocks_used,
            centre: report.world_from_camera.map(|p| p.translation),
        }
    };
    let reports = frames.map(report_of).collect();
    (reports, fusion.finish())
}

/// Asserts that the camera is lost within two frames of `begin`, that nothing is fused while it is, and that it is found
/// within ten frames of `end`.
fn assert_lost_and_found(reports: &[Reported], begin: usize, end: usize) {
    let lost = (begin..end).find(|i| !reports[*i].tracked).unwrap_or(end);
    assert!(lost < begin + 2, "frame {begin}: not lost within two frames");
    let found = (end..reports.len()).find(|i| reports[*i].tracked).unwrap_or(reports.len());
    println!("lost at {lost} (cut at {begin}), found {} frames after it was back", found - end + 1);
    assert!(found < end + 10, "frame {end}: not found within ten frames");
    for i in lost..found {
        assert!(reports[i].tracked || reports[i].blocks == reports[i - 1].blocks, "frame {i}: fused while lost");
    }
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the recordings of data/ and truth_rgbd/")]
fn black_frames_and_a_covered_lens_lose_a_desk_and_it_is_found_again() {
    let shared = shared();
    let (sensor, all) = pairs(&shared.join("data/tum_fr1_xyz_400"));
    let frames = all.iter().take(130).enumerate().map(|(i, pair)| {
        let mut frame = decoded(pair);
        if (40..55).contains(&i) {
            frame.rgb.data.fill(0);
            frame.depth.depth.fill(0);
        } else if (80..95).contains(&i) {
            // A hand on the lenses: too near for depth, dim skin with the sensor's noise for a picture.
            frame.depth.depth.fill(0);
            frame.rgb.data.iter_mut().enumerate().for_each(|(k, g)| *g = 38 + (k * 7919 % 11) as u8);
        } else if (110..115).contains(&i) {
            // The colour lens alone.
            frame.rgb.data.fill(0);
        }
        frame
    });
    let (reports, output) = play(&sensor, frames);
    for (begin, end) in [(40, 55), (80, 95), (110, 115)] {
        assert_lost_and_found(&reports, begin, end);
    }
    let s = &output.stats;
    assert_eq!((s.losses, s.relocalisations), (3, 3));
    assert_eq!(s.lost_pairs as usize, reports.iter().filter(|t| !t.tracked).count());
    assert_eq!(output.trajectory.len(), reports.iter().filter(|t| t.tracked).count());
}

/// A cut: the camera stands far away from one frame to the next, for ten frames, and then where it was.
#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the recordings of data/ and truth_rgbd/")]
fn a_cut_is_noticed_and_made_good() {
    let shared = shared();
    for name in ["data/tum_fr1_xyz_400", "data/redkitchen_300"] {
        let dir = shared.join(name);
        let ((sensor, all), truth) = (pairs(&dir), truth(&dir));
        let centre = |i: usize| at(&truth, all[i].1.timestamp_ns);
        let begin = 80;
        let distance = |i: usize| centre(i).distance(centre(begin - 1));
        let away = (0..all.len() - 10).max_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap();
        assert!(distance(away) > 0.3, "{name}: no such jump in it");
        let order: Vec<usize> = (0..begin).chain(away..away + 10).chain((begin - 20..begin).rev()).collect();
        let frames = order.iter().enumerate().map(|(k, i)| {
            let mut frame = decoded(&all[*i]);
            let stamp = all[0].1.timestamp_ns + k as i64 * 33_333_333;
            frame.depth.timestamp_ns += stamp - frame.color.timestamp_ns;
            frame.color.timestamp_ns = stamp;
            frame
        });
        let (reports, output) = play(&sensor, frames);
        println!("{name}: away by {:.2} m", distance(away));
        assert_lost_and_found(&reports, begin, begin + 10);
        assert!(output.stats.losses >= 1);
        let home = reports[begin - 1].centre.unwrap();
        for (k, i) in order.iter().enumerate().skip(begin) {
            let Some(c) = reports[k].centre else { continue };
            let error = (c.distance(home) - distance(*i)).abs();
            assert!(error < 0.06, "{name}: fused frame {k} at a wrong place, off by {error} m");
        }
    }
}
