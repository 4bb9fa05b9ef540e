//! Budgets under load: `LUMISCAN_SHARED=… cargo run --release -p tests --example budgets -- [--scene NAME] [--vertices N,…]
//! [--budgets S,…] [--loads LOAD,…] [--memory MB]`.
//!
//! Every mesh of a scene with known truth, subdivided to so many vertices, with every budget and under every load of `tests/load.sh`:
//! three meshes, three budgets and four loads without arguments, 36 runs. Prints one row a run: when the result stood, when the process
//! ended, its processor time as a share of that, its exit code, vertices and error of the albedo against the truth, and what was cut;
//! then the number of runs that were late.

use recordings::import::photos::import_photos;
use recordings::ply::write::write_ply;
use recordings::result::Estimate;
use recordings::types::Mesh;
use std::collections::HashMap;
use std::error::Error;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::Command;
use tests::matching::Vertices;
use tests::metrics::{self, AlbedoError};
use tests::truth::Truth;

type Outcome<T> = Result<T, Box<dyn Error>>;

/// What a result may be late by, in seconds.
const TOLERATED_S: f64 = 1.0;

struct Arguments {
    scene: String,
    vertices: Vec<usize>,
    budgets: Vec<f64>,
    loads: Vec<String>,
    memory_mb: Option<u32>,
}

impl Arguments {
    fn parse() -> Outcome<Self> {
        let mut own = Self {
            scene: "fruits".into(),
            vertices: vec![70_910, 229_000, 900_000],
            budgets: vec![15.0, 30.0, 120.0],
            loads: ["even:0.5", "stretches:0.25", "stretches:0.1", "busy"].map(String::from).to_vec(),
            memory_mb: None,
        };
        let mut arguments = std::env::args().skip(1);
        while let Some(name) = arguments.next() {
            let value = arguments.next().ok_or_else(|| format!("{name} takes a value"))?;
            match name.as_str() {
                "--scene" => own.scene = value,
                "--vertices" => own.vertices = value.split(',').map(str::parse).collect::<Result<_, _>>()?,
                "--budgets" => own.budgets = value.split(',').map(str::parse).collect::<Result<_, _>>()?,
                "--loads" => own.loads = value.split(',').map(String::from).collect(),
                "--memory" => own.memory_mb = Some(value.parse()?),
                _ => return Err(format!("no option {name}").into()),
            }
        }
        Ok(own)
    }
}

fn main() -> Outcome<()> {
    let arguments = Arguments::parse()?;
    let truth = Truth::read(&tests::shared(), &arguments.scene);
    let folder = tempfile::tempdir()?;
    println!(
        "| vertices | budget | load | result | process | of a core | code | peak | of the result | albedo, median / p90 | cuts |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let (mut runs, mut late) = (0, 0);
    for vertices in &arguments.vertices {
        let scan = scan(&truth, *vertices, folder.path())?;
        for budget in &arguments.budgets {
            for load in &arguments.loads {
                runs += 1;
                late += u32::from(!run(&truth, &scan, *vertices, *budget, load, arguments.memory_mb)?);
            }
        }
    }
    println!("\n{runs} runs, {late} late");
    Ok(())
}

/// The scene as a scan with about so many vertices.
fn scan(truth: &Truth, vertices: usize, folder: &Path) -> Outcome<PathBuf> {
    let mut mesh = truth.mesh.clone();
    while mesh.positions.len() < vertices {
        mesh = refined(&mesh, vertices);
    }
    let ply = folder.join("mesh.ply");
    write_ply(&mut BufWriter::new(File::create(&ply)?), "subdivided", &mesh, &[])?;
    let mut scan = import_photos(&truth.folder, Some(&ply))?;
    scan.config = firmware_config::Config::default().to_toml();
    let path = folder.join(format!("{vertices}.lscan"));
    scan.write(&path)?;
    Ok(path)
}

/// The mesh with its longest edges halved, up to `vertices` vertices; those of the mesh keep their numbers.
fn refined(mesh: &Mesh, vertices: usize) -> Mesh {
    let sides = |t: &[u32; 3]| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])].map(|(a, b)| (a.min(b), a.max(b)));
    let mut edges: Vec<(u32, u32)> = mesh.triangles.iter().flat_map(sides).collect();
    edges.sort_unstable();
    edges.dedup();
    let length = |(a, b): &(u32, u32)| mesh.positions[*a as usize].distance_squared(mesh.positions[*b as usize]);
    edges.sort_by(|a, b| length(b).total_cmp(&length(a)));
    edges.truncate(vertices - mesh.positions.len());
    let mut fine = Mesh { triangles: Vec::new(), ..mesh.clone() };
    let mut middle = HashMap::new();
    for (a, b) in edges {
        middle.insert((a, b), fine.positions.len() as u32);
        let [a, b] = [a, b].map(|i| i as usize);
        fine.positions.push((mesh.positions[a] + mesh.positions[b]) / 2.0);
        fine.normals.push((mesh.normals[a] + mesh.normals[b]).normalize_or(mesh.normals[a]));
    }
    for t in &mesh.triangles {
        let corners = *t;
        let split = sides(t).map(|side| middle.get(&side).copied());
        // The outline with the new points on it, from a corner that follows a halved side, as a fan; all three halved is a case of its own.
        if let [Some(x), Some(y), Some(z)] = split {
            let [a, b, c] = corners;
            fine.triangles.extend([[a, x, z], [x, b, y], [z, y, c], [x, y, z]]);
            continue;
        }
        let start = (0..3).find(|&i| split[i].is_none() && split[(i + 2) % 3].is_some()).unwrap_or(0);
        // With one or two sides halved, a fan around the middle of the side before `start` covers the triangle.
        let outline: Vec<u32> =
            (0..3).flat_map(|i| [Some(corners[(start + i) % 3]), split[(start + i) % 3]]).flatten().collect();
        let (last, rest) = (outline[outline.len() - 1], &outline[..outline.len() - 1]);
        fine.triangles.extend(rest.windows(2).map(|w| [last, w[0], w[1]]));
    }
    fine
}

/// One run; false if it was late.
fn run(truth: &Truth, scan: &Path, vertices: usize, budget: f64, load: &str, memory_mb: Option<u32>) -> Outcome<bool> {
    let result = scan.with_extension("lres");
    let log = scan.with_extension("log");
    let mut command = Command::new(Path::new(env!("CARGO_MANIFEST_DIR")).join("load.sh"));
    command.arg(scan).arg(budget.to_string()).arg(&result).arg(load).arg("--json");
    if let Some(mb) = memory_mb {
        command.arg("--memory").arg(mb.to_string());
    }
    let output = command.stderr(File::create(&log)?).output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let Some(line) = text.lines().find(|l| l.starts_with("result after")) else {
        println!("| {vertices} | {budget} s | {load} | none | | | | | | | |");
        return Ok(false);
    };
    let numbers: Vec<f64> = line.split_whitespace().filter_map(|w| w.parse().ok()).collect();
    let [after, _, ended, code] = numbers[..] else { return Err(format!("not understood: {line}").into()) };
    let line = text.lines().find_map(|l| serde_json::from_str::<serde_json::Value>(l).ok());
    let figure = |name: &str| line.as_ref().and_then(|l| l[name].as_f64()).unwrap_or(f64::NAN);
    let peak = figure("memory_peak_bytes") / f64::from(1 << 20);
    // What halts and other programs left of the time, where the run needed all that it could get.
    let share = figure("cpu_seconds") / ended;
    let found = Estimate::read(&result)?;
    let AlbedoError { median, p90, .. } = albedo_error(truth, &found);
    let cuts: Vec<String> = found.cuts.iter().map(ToString::to_string).collect();
    println!(
        "| {vertices} | {budget} s | {load} | {after:.1} s | {ended:.1} s | {:.0} % | {code} | {peak:.0} MiB | {} | {median:.3} / {p90:.2} | {} |",
        100.0 * share,
        found.mesh.positions.len(),
        cuts.join("; ")
    );
    Ok(after <= budget + TOLERATED_S && code == 0.0)
}

/// Error of the albedo at the vertices of the truth, each with the nearest vertex of the result whose normal agrees.
fn albedo_error(truth: &Truth, found: &Estimate) -> AlbedoError {
    let mesh = &found.mesh;
    let edges = mesh.triangles.iter().map(|t| {
        let [a, b] = [t[0], t[1]].map(|i| mesh.positions[i as usize]);
        f64::from(a.distance(b))
    });
    let cell = 2.0 * metrics::median(&edges.collect::<Vec<_>>()) as f32;
    let vertices = Vertices::new(mesh, cell);
    let nearest = |i: usize| vertices.nearest(truth.mesh.positions[i], truth.mesh.normals[i]);
    let seen = (0..truth.seen.len()).filter(|&i| truth.seen[i] >= 2);
    let pairs: Vec<(usize, usize)> = seen.filter_map(|i| Some((i, nearest(i)?))).collect();
    let albedo: Vec<[f64; 3]> = pairs.iter().map(|(_, k)| found.albedo[*k].to_array().map(f64::from)).collect();
    let true_albedo: Vec<[f64; 3]> = pairs.iter().map(|(i, _)| truth.albedo[*i]).collect();
    let material: Vec<u32> = pairs.iter().map(|(i, _)| truth.material[*i]).collect();
    metrics::albedo(&albedo, &true_albedo, &material, |_| true)
}
