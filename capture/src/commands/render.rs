//! `lumiscan render`: things put into a result, taken out of it, or lit anew.

use crate::cli::Settings;
use crate::commands::frames::{Frame, Kind, Lights, Sink};
use crate::commands::output::print;
use crate::commands::settings::load;
use crate::commands::settings::use_threads;
use crate::failure::Failure;
use crate::report::{Reporter, Step};
use clap::{Args, ValueEnum};
use estimator::rays::RayScene;
use estimator::render::RealityError;
use estimator::render::change::{Changed, change};
use estimator::render::compose::{Viewpoint, compose, model};
use estimator::render::inpainting::geometry::cut;
use estimator::render::lighting::completion::infer;
use estimator::render::lighting::observed_background::{Backdrop, surroundings};
use estimator::render::objects::insert::{Insert, give_material, load as load_object};
use estimator::render::objects::object::Object;
use estimator::render::relight::{NewLight, Relight};
use estimator::render::removal::{Removal, select};
use estimator::render::view::{View, ViewChoice, sees, views};
use firmware_config::RealityConfig;
use glam::Vec3;
use recordings::result::Estimate;
use recordings::scan::Scan;
use recordings::types::{Mesh, RgbImage};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What a picture is put over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Over {
    /// The keyframe's own picture.
    Photo,
}

/// `lumiscan render`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Keyframe pictures come from the scan. Options combine freely; --insert and --remove may be given several times. With
--over photo, pixels that the change does not touch stay the photo's, bit for bit.

Examples:
  lumiscan render result.lres --view keyframe:4 --over photo --insert knot.glb@0.2,-0.1,0 -o out.png
  lumiscan render result.lres --view keyframe:4 --over photo --remove box:0.1,0,0.001,0.3,0.2,0.1 -o out.png
  lumiscan render result.lres --view keyframe:0 --light panoramas/ -o frames/
  lumiscan render result.lres --view orbit:90 --insert other.lres#segment=4 -o turn.mp4")]
pub struct Render {
    /// A result (.lres).
    pub result: PathBuf,
    /// OUT.png, OUT.exr (linear), OUT.mp4 (through ffmpeg), or a folder of 000.png …
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Its scan [default: scan.lscan or the .lscan of the same stem beside the result].
    #[arg(long, value_name = "FILE")]
    pub scan: Option<PathBuf>,
    /// keyframe:N, witness:N, all, orbit[:FRAMES] or cameras in the transforms.json convention.
    #[arg(long, value_name = "VIEW", default_value = "keyframe:0")]
    pub view: ViewChoice,
    /// Size of the pictures in pixels.
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub size: Option<(u32, u32)>,
    /// Brightness factor [default: the keyframe's; under another light, what shows it well].
    #[arg(long, value_name = "GAIN", value_parser = gain)]
    pub exposure: Option<f32>,
    /// Put the change over the keyframe's own picture.
    #[arg(long)]
    pub over: Option<Over>,
    /// OBJECT[@x,y,z[,yaw_deg[,scale]]]: glTF, PLY, or other.lres[#segment=4,7].
    #[arg(long, value_name = "OBJECT")]
    pub insert: Vec<Insert>,
    /// segment:N: what is inserted gets the material of this segment.
    #[arg(long, value_name = "MATERIAL", value_parser = segment)]
    pub material: Option<u32>,
    /// segment:N, box:x0,y0,z0,x1,y1,z1 or point:x,y: the thing that stands under a pixel of the first view.
    #[arg(long, value_name = "WHAT", value_parser = removal)]
    pub remove: Vec<Gone>,
    /// A panorama (.hdr, .exr, .png, .jpg), a folder of them, a video, result:OTHER.lres or sh:FILE.
    #[arg(long, value_name = "LIGHT")]
    pub light: Option<String>,
    /// Turns that light about +Z, counter-clockwise from above.
    #[arg(long, value_name = "DEG", default_value = "0", allow_negative_numbers = true, value_parser = finite)]
    pub light_yaw: f32,
    /// Worker threads [default: one a processor].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Settings.
    #[command(flatten)]
    pub settings: Settings,
}

/// What is to be removed, as it is said on the command line.
#[derive(Debug, Clone, PartialEq)]
pub enum Gone {
    /// Known without a view.
    Known(Removal),
    /// A pixel of the first view.
    Point(f32, f32),
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let wrong = || "must be WxH, each 1 to 8192".to_string();
    let (w, h) = text.split_once('x').ok_or_else(wrong)?;
    match (w.parse(), h.parse()) {
        (Ok(w @ 1..=8192), Ok(h @ 1..=8192)) => Ok((w, h)),
        _ => Err(wrong()),
    }
}

fn finite(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|x: &f32| x.is_finite()).ok_or_else(|| format!("`{text}` is not a number"))
}

fn gain(text: &str) -> Result<f32, String> {
    finite(text)?.gt(&0.0).then_some(finite(text)?).ok_or_else(|| "must be more than 0".into())
}

fn segment(text: &str) -> Result<u32, String> {
    text.strip_prefix("segment:").and_then(|n| n.parse().ok()).ok_or_else(|| "must be segment:N".into())
}

fn removal(text: &str) -> Result<Gone, String> {
    let wrong = || "must be segment:N, box:x0,y0,z0,x1,y1,z1 or point:x,y".to_string();
    let (kind, rest) = text.split_once(':').ok_or_else(wrong)?;
    if kind == "segment" {
        return rest.parse().map(|n| Gone::Known(Removal::Segment(n))).map_err(|_| wrong());
    }
    let n: Vec<f32> = rest.split(',').map(|x| finite(x.trim())).collect::<Result<_, _>>()?;
    match (kind, n.as_slice()) {
        ("box", [a, b, c, d, e, f]) => {
            let (p, q) = (Vec3::new(*a, *b, *c), Vec3::new(*d, *e, *f));
            Ok(Gone::Known(Removal::Box(p.min(q), p.max(q))))
        }
        ("point", [x, y]) => Ok(Gone::Point(*x, *y)),
        _ => Err(wrong()),
    }
}

impl From<RealityError> for Failure {
    fn from(e: RealityError) -> Self {
        match e {
            RealityError::Request(_) => Self::Usage(e.to_string()),
            RealityError::Result(_) | RealityError::File { .. } => Self::Input(e.to_string()),
        }
    }
}

/// Runs the command.
pub fn run(args: &Render, reporter: &Reporter) -> Result<(), Failure> {
    let config = load(&args.settings)?.reality;
    use_threads(args.threads)?;
    let mut sink = Sink::open(&args.output)?;
    let estimate = Estimate::read(&args.result)?;
    let scan = read_scan(args)?;
    let mut lights = args.light.as_deref().map(|l| Lights::open(l, args.light_yaw)).transpose()?;
    let views = views(&args.view, &estimate, scan.as_ref(), args.size)?;
    let light_frames = lights.as_ref().map_or(Some(1), Lights::count);
    check_frames(&sink, views.len(), light_frames)?;

    let scene = RayScene::new(&estimate.mesh);
    if views.iter().all(|v| !sees(&v.viewpoint, &scene)) {
        return Err(Failure::Usage("the view looks away from the scan: nothing of it would be in the picture".into()));
    }
    let first = &views[0].viewpoint;
    let gone = gone(args, &estimate, &scene, first)?;
    let cut = cut(&estimate.mesh, &gone);
    let objects = objects(args, &estimate, &cut.kept, first)?;
    reporter.step(&step("light", 0.0, String::new()));
    let pictures: Vec<Option<RgbImage>> =
        estimate.keyframes.iter().map(|k| picture_of(scan.as_ref(), &k.name)).collect();
    let known = surroundings(&estimate, &scene, &pictures);
    let around = (infer(&estimate.light, &known), Backdrop::new(&estimate, pictures, &known));
    let changed = change(&estimate, around, cut, &objects, &config);

    let started = Instant::now();
    let progress = |done: usize, total: Option<usize>| {
        let left =
            total.filter(|_| done > 0).map(|t| started.elapsed().as_secs_f64() / done as f64 * (t - done) as f64);
        let text = match (total, left) {
            (Some(t), Some(left)) => format!("frame {done} of {t} · {left:.0} s left"),
            (Some(t), None) => format!("frame {done} of {t}"),
            (None, _) => format!("frame {done}"),
        };
        reporter.step(&step("render", total.map_or(0.0, |t| done as f64 / t.max(1) as f64), text));
    };
    match &mut lights {
        None => {
            for (n, view) in views.iter().enumerate() {
                progress(n, Some(views.len()));
                sink.frame(&as_scanned(args, &changed, view, &estimate, &config)?)?;
            }
        }
        Some(lights) => {
            let relight = Relight::new(&changed, &config, &|f| reporter.step(&step("transfer", f, String::new())));
            relit(args, &changed, &relight, lights, &views, &estimate, &config, &mut sink, &progress)?;
        }
    }
    sink.finish()?;
    reporter.clear();
    print(&args.output.display().to_string())
}

fn step(stage: &str, fraction: f64, detail: String) -> Step {
    Step { stage: stage.into(), fraction: Some(fraction), detail }
}

/// One view, one light or the other way round; a single picture takes one frame.
fn check_frames(sink: &Sink, views: usize, lights: Option<usize>) -> Result<(), Failure> {
    let many_lights = lights != Some(1);
    if views > 1 && many_lights {
        return Err(Failure::Usage("several views and several lights: give one view, or one light".into()));
    }
    if sink.kind() != Kind::Folder && sink.kind() != Kind::Video && (views > 1 || many_lights) {
        return Err(Failure::Usage("several frames need a folder or an .mp4 file as output".into()));
    }
    Ok(())
}

/// The scan that was named, or that stands beside a result.
pub fn find_scan(named: Option<&Path>, result: &Path) -> Option<PathBuf> {
    let beside = [result.with_file_name("scan.lscan"), result.with_extension("lscan")];
    named.map(Path::to_path_buf).or_else(|| beside.into_iter().find(|p| p.is_file()))
}

/// The scan, if it is there or was named.
fn read_scan(args: &Render) -> Result<Option<Scan>, Failure> {
    let Some(path) = find_scan(args.scan.as_deref(), &args.result) else {
        if args.over.is_some() {
            return Err(Failure::Usage("--over photo needs the scan with its pictures: --scan FILE".into()));
        }
        return Ok(None);
    };
    Ok(Some(Scan::read(&path)?))
}

fn picture_of(scan: Option<&Scan>, name: &str) -> Option<RgbImage> {
    scan?.keyframes.iter().find(|k| k.name == name)?.color.decode().ok()
}

/// What is inserted, in its place on `mesh`: what stays of the scan.
fn objects(args: &Render, estimate: &Estimate, mesh: &Mesh, view: &Viewpoint) -> Result<Vec<Object>, Failure> {
    let mut objects = Vec::new();
    if args.insert.is_empty() {
        return Ok(objects);
    }
    let scene = RayScene::new(mesh);
    for insert in &args.insert {
        let (mut object, odd) = load_object(insert, view, mesh, &scene)?;
        for o in odd {
            tracing::warn!("{o}");
        }
        if let Some(segment) = args.material {
            give_material(&mut object, estimate, segment)?;
        }
        objects.push(object);
    }
    Ok(objects)
}

fn gone(args: &Render, estimate: &Estimate, scene: &RayScene, view: &Viewpoint) -> Result<Vec<bool>, Failure> {
    let removals: Vec<Removal> = args
        .remove
        .iter()
        .map(|g| match g {
            Gone::Known(removal) => removal.clone(),
            Gone::Point(x, y) => {
                Removal::Ray { origin: view.world_from_camera.translation.as_vec3(), direction: view.ray(*x, *y) }
            }
        })
        .collect();
    Ok(select(&estimate.mesh, &estimate.segment, scene, &removals)?)
}

/// The keyframe's picture as bytes and as linear light, if it is wanted.
fn photo(args: &Render, view: &View, estimate: &Estimate) -> Result<Option<(RgbImage, Vec<Vec3>)>, Failure> {
    if args.over.is_none() {
        return Ok(None);
    }
    let photo = view
        .photo
        .as_ref()
        .ok_or_else(|| Failure::Usage("--over photo needs a keyframe's or a witness' view at its own size".into()))?;
    let image = photo.decode().map_err(|e| Failure::Input(format!("the keyframe's picture: {e}")))?;
    let table = estimate.response.linear_table();
    let linear =
        image.data.chunks_exact(3).map(|p| Vec3::from([p[0], p[1], p[2]].map(|v| table[v as usize]))).collect();
    Ok(Some((image, linear)))
}

/// A picture in the light that was there.
fn as_scanned(
    args: &Render,
    changed: &Changed,
    view: &View,
    estimate: &Estimate,
    config: &RealityConfig,
) -> Result<Frame, Failure> {
    let mut viewpoint = view.viewpoint.clone();
    let photo = photo(args, view, estimate)?;
    let exposure = args.exposure.unwrap_or(1.0);
    if photo.is_none() {
        viewpoint.gain *= exposure;
    }
    let base = match &photo {
        Some((_, linear)) => linear.clone(),
        None => model(changed, &viewpoint, config),
    };
    let mut picture = compose(changed, &viewpoint, &base, config);
    if photo.is_some() && args.exposure.is_some() {
        picture.linear.iter_mut().for_each(|p| *p *= exposure);
        picture.touched.fill(true);
    }
    Ok(Frame::new(viewpoint.size(), picture, photo.map(|p| p.0), estimate.response))
}

/// Pictures in other light.
#[allow(clippy::too_many_arguments)]
fn relit(
    args: &Render,
    changed: &Changed,
    relight: &Relight,
    lights: &mut Lights,
    views: &[View],
    estimate: &Estimate,
    config: &RealityConfig,
    sink: &mut Sink,
    progress: &dyn Fn(usize, Option<usize>),
) -> Result<(), Failure> {
    let mut gain: Option<f32> = args.exposure;
    let mut done = 0;
    let mut frame = |light: &NewLight, view: &View, kept: &_| -> Result<(), Failure> {
        let photo = photo(args, view, estimate)?;
        let over = photo.as_ref().map(|p| p.1.as_slice());
        let mut viewpoint = view.viewpoint.clone();
        if over.is_none() {
            // One gain for all frames, so that a light that fades is seen to fade.
            let g = *gain.get_or_insert_with(|| good_gain(&relight.picture(kept, light, Vec3::ONE, None).linear));
            viewpoint.gain = Vec3::splat(if sink.kind() == Kind::Exr && args.exposure.is_none() { 1.0 } else { g });
        }
        let picture = relight.picture(kept, light, viewpoint.gain, over);
        sink.frame(&Frame::new(viewpoint.size(), picture, None, estimate.response))
    };
    if views.len() == 1 {
        let kept = relight.view(changed, &views[0].viewpoint, config);
        let total = lights.count();
        while let Some(light) = lights.next()? {
            progress(done, total);
            frame(&light, &views[0], &kept)?;
            done += 1;
        }
        if done == 0 {
            return Err(Failure::Input("the light has no frames".into()));
        }
    } else if let Some(light) = lights.next()? {
        for view in views {
            progress(done, Some(views.len()));
            frame(&light, view, &relight.view(changed, &view.viewpoint, config))?;
            done += 1;
        }
    }
    Ok(())
}

/// The gain under which nearly everything fits a screen's range.
fn good_gain(linear: &[Vec3]) -> f32 {
    let mut values: Vec<f32> = linear.iter().map(|p| p.max_element()).filter(|x| *x > 0.0).collect();
    values.sort_by(f32::total_cmp);
    values.get(values.len() * 98 / 100).map_or(1.0, |x| 0.8 / x)
}

/// True if two paths name the same kind of file.
pub fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().and_then(|e| e.to_str()).is_some_and(|e| extensions.contains(&e.to_ascii_lowercase().as_str()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_read() {
        assert_eq!(size("640x480"), Ok((640, 480)));
        assert!(size("0x4").is_err() && size("640").is_err() && size("9999x9").is_err());
        assert_eq!(removal("segment:3"), Ok(Gone::Known(Removal::Segment(3))));
        assert_eq!(removal("box:1,1,1,0,0,0"), Ok(Gone::Known(Removal::Box(Vec3::ZERO, Vec3::ONE))));
        assert_eq!(removal("point:3,4.5"), Ok(Gone::Point(3.0, 4.5)));
        assert!(removal("box:1,2").is_err() && removal("point:nan,0").is_err() && removal("all").is_err());
        assert!(gain("0").is_err() && gain("-1").is_err() && gain("2").is_ok());
    }
}
