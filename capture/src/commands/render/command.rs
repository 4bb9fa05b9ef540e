//! `lumiscan render`: inserts objects into a result, removes objects, renders it under another light.

use crate::child_process::end_with_parent;
use crate::cli::{RemovalTarget, Render};
use crate::commands::files::find_scan;
use crate::commands::output::print;
use crate::commands::render::lights::Lights;
use crate::commands::render::sink::{Frame, Kind, Sink};
use crate::commands::settings::load;
use crate::commands::settings::use_threads;
use crate::failure::Failure;
use crate::memory;
use crate::report::{Reporter, Step};
use estimator::rays::RayScene;
use estimator::render::change::{Changed, change};
use estimator::render::compose::{Viewpoint, compose, model};
use estimator::render::error::RenderError;
use estimator::render::inpainting::geometry::cut;
use estimator::render::lighting::completion::complete;
use estimator::render::lighting::lamp_change::changed_light;
use estimator::render::lighting::observed_background::{ObservedBackground, pictures, surroundings};
use estimator::render::objects::insert::{give_material, load as load_object};
use estimator::render::objects::object::Object;
use estimator::render::relight::{NewLight, Relight};
use estimator::render::removal::select::{Removal, select};
use estimator::render::view::{View, sees, views};
use firmware_config::RealityConfig;
use firmware_config::tuning::RemovalTuning;
use glam::Vec3;
use recordings::result::Estimate;
use recordings::scan::Scan;
use recordings::types::{Mesh, RgbImage};
use std::time::Instant;

impl From<RenderError> for Failure {
    fn from(e: RenderError) -> Self {
        match e {
            RenderError::Request(_) => Self::Usage(e.to_string()),
            RenderError::Result(_) | RenderError::File { .. } => Self::Input(e.to_string()),
        }
    }
}

/// Runs the command.
pub fn run(args: &Render, reporter: &Reporter) -> Result<(), Failure> {
    end_with_parent(args.parent)?;
    memory::limit(args.memory)?;
    let config = load(&args.settings)?.reality;
    use_threads(args.threads)?;
    let mut sink = Sink::open(&args.output)?;
    let estimate = Estimate::read(&args.result)?;
    let scan = read_scan(args)?;
    let mut lights = args.light.as_deref().map(|l| Lights::open(l, args.light_yaw)).transpose()?;
    let views = views(&args.view, &estimate, scan.as_ref(), args.size)?;
    let near = changed_light(&estimate.local_light, &args.lamp, &args.emitter, lights.is_some())?;
    let light_frames = lights.as_ref().map_or(Some(1), Lights::count);
    check_frames(&sink, views.len(), light_frames)?;

    let scene = RayScene::new(&estimate.mesh);
    if views.iter().all(|v| !sees(&v.viewpoint, &scene)) {
        return Err(Failure::Usage("the view looks away from the scan: nothing of it would be in the picture".into()));
    }
    let first = &views[0].viewpoint;
    let gone = gone(args, &estimate, &scene, first, &config.tuning.removal)?;
    let cut = cut(&estimate.mesh, &gone, &config.tuning.inpainting);
    let objects = objects(args, &estimate, &cut.kept, first, &config)?;
    reporter.step(&step("light", 0.0, String::new()));
    let pictures = pictures(&estimate, scan.as_ref());
    let beyond = &config.tuning.surroundings;
    let known = surroundings(&estimate, &scene, &pictures, beyond);
    let environment = complete(&estimate.light, &known, beyond);
    if near != estimate.local_light && lights.is_none() {
        lights = Some(Lights::scanned(&estimate.light, environment.clone()));
    }
    let around = (environment, ObservedBackground::new(&estimate, pictures, &known, beyond));
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
            let relight =
                Relight::new(&changed, &near, &config, &|f| reporter.step(&step("transfer", f, String::new())));
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

/// What is inserted, in its place on `mesh`: what stays of the scan.
fn objects(
    args: &Render,
    estimate: &Estimate,
    mesh: &Mesh,
    view: &Viewpoint,
    config: &RealityConfig,
) -> Result<Vec<Object>, Failure> {
    let mut objects = Vec::new();
    if args.insert.is_empty() {
        return Ok(objects);
    }
    let scene = RayScene::new(mesh);
    for insert in &args.insert {
        let (mut object, odd) = load_object(insert, view, mesh, &scene, config)?;
        for o in odd {
            tracing::warn!("{o}");
        }
        if let Some(segment) = args.material {
            give_material(&mut object, estimate, segment, config)?;
        }
        objects.push(object);
    }
    Ok(objects)
}

fn gone(
    args: &Render,
    estimate: &Estimate,
    scene: &RayScene,
    view: &Viewpoint,
    tuning: &RemovalTuning,
) -> Result<Vec<bool>, Failure> {
    let removals: Vec<Removal> = args
        .remove
        .iter()
        .map(|g| match g {
            RemovalTarget::Known(removal) => removal.clone(),
            RemovalTarget::Point(x, y) => {
                Removal::Ray { origin: view.world_from_camera.translation.as_vec3(), direction: view.ray(*x, *y) }
            }
        })
        .collect();
    Ok(select(&estimate.mesh, &estimate.segment, scene, &removals, tuning)?)
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
            let good = || good_gain(&relight.picture(kept, light, Vec3::ONE, None).linear);
            viewpoint.gain = match (light.scanned, args.exposure) {
                // A lamp that is dimmed is seen to be dimmed.
                (true, exposure) => viewpoint.gain * exposure.unwrap_or(1.0),
                (false, None) if sink.kind() == Kind::Exr => Vec3::ONE,
                (false, _) => Vec3::splat(*gain.get_or_insert_with(good)),
            };
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
