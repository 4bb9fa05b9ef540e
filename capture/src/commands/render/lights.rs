//! New lights for `lumiscan render`: panoramas, videos, the light of another result, or coefficients.

use crate::commands::files::has_extension;
use crate::commands::render::ffmpeg::find_ffmpeg;
use crate::failure::Failure;
use estimator::render::lighting::environment::Environment;
use estimator::render::lighting::panorama::{Panorama, Projector, turned};
use estimator::render::relight::{BANDS, NewLight};
use glam::Vec3;
use recordings::result::{Estimate, Light};
use recordings::types::Response;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

/// New lights, one after the other.
pub struct Lights {
    source: Source,
    yaw_deg: f32,
    projector: Option<Projector>,
}

enum Source {
    Files(VecDeque<PathBuf>),
    Video { child: Child, frames: BufReader<ChildStdout>, path: PathBuf, read: usize },
    Ready(Option<NewLight>),
}

impl Drop for Source {
    fn drop(&mut self) {
        if let Self::Video { child, .. } = self {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

impl Lights {
    /// Finds out what is meant.
    pub fn open(text: &str, yaw_deg: f32) -> Result<Self, Failure> {
        let path = Path::new(text);
        let source = if let Some(other) = text.strip_prefix("result:") {
            let other = Estimate::read(Path::new(other))?;
            if !other.local_light.lamps.is_empty() || !other.local_light.emitters.is_empty() {
                tracing::warn!("{text}: its lamps stay where they are; only its light from far away is taken");
            }
            Source::Ready(Some(from_coefficients(other.light.coefficients, yaw_deg)))
        } else if let Some(file) = text.strip_prefix("sh:") {
            Source::Ready(Some(from_coefficients(read_coefficients(Path::new(file))?, yaw_deg)))
        } else if path.is_dir() {
            Source::Files(panoramas(path)?)
        } else if has_extension(path, &["hdr", "exr", "png", "jpg", "jpeg"]) {
            Source::Files([path.to_path_buf()].into())
        } else if path.is_file() {
            open_video(path)?
        } else {
            return Err(Failure::Input(format!(
                "{text}: no such file; a light is a panorama, a folder of panoramas, a video, result:OTHER.lres or sh:FILE"
            )));
        };
        Ok(Self { source, yaw_deg, projector: None })
    }

    /// The scan's own light from far away, with what keyframes saw beyond the scan.
    pub fn scanned(light: &Light, environment: Environment) -> Self {
        let own = from_coefficients(light.coefficients.clone(), 0.0);
        let own = NewLight { environment, scanned: true, ..own };
        Self { source: Source::Ready(Some(own)), yaw_deg: 0.0, projector: None }
    }

    /// How many there are, where that is known beforehand.
    pub fn count(&self) -> Option<usize> {
        match &self.source {
            Source::Files(files) => Some(files.len()),
            Source::Ready(_) => Some(1),
            Source::Video { .. } => None,
        }
    }

    /// The next light.
    pub fn next(&mut self) -> Result<Option<NewLight>, Failure> {
        let panorama = match &mut self.source {
            Source::Ready(light) => return Ok(light.take()),
            Source::Files(files) => match files.pop_front() {
                None => return Ok(None),
                Some(path) => Panorama::read(&path)?,
            },
            Source::Video { frames, path, read, .. } => match video_frame(frames, path)? {
                Some(panorama) => {
                    *read += 1;
                    panorama
                }
                None if *read == 0 => {
                    return Err(Failure::Input(format!("{}: a video without frames", path.display())));
                }
                None => return Ok(None),
            },
        };
        let projector = match self.projector.take().filter(|p| p.fits(&panorama)) {
            Some(p) => p,
            None => Projector::new(&panorama, BANDS),
        };
        let yaw = self.yaw_deg.to_radians();
        let coefficients = turned(&projector.project(&panorama), f64::from(yaw));
        self.projector = Some(projector);
        Ok(Some(NewLight { coefficients, environment: panorama.environment(yaw), scanned: false }))
    }
}

fn from_coefficients(mut coefficients: Vec<[f64; 3]>, yaw_deg: f32) -> NewLight {
    let bands = coefficients.len().isqrt().min(BANDS);
    coefficients.truncate(bands * bands);
    let coefficients = turned(&coefficients, f64::from(yaw_deg.to_radians()));
    let light = Light { coefficients, ..Light::default() };
    let environment = Environment::from_light(&light);
    let mut coefficients = light.coefficients;
    coefficients.resize(BANDS * BANDS, [0.0; 3]);
    NewLight { coefficients, environment, scanned: false }
}

fn read_coefficients(path: &Path) -> Result<Vec<[f64; 3]>, Failure> {
    let wrong = |e: &str| Failure::Input(format!("{}: {e}", path.display()));
    let text = std::fs::read(path).map_err(|e| wrong(&e.to_string()))?;
    let json: serde_json::Value = serde_json::from_slice(&text).map_err(|e| wrong(&format!("not JSON: {e}")))?;
    let list: Vec<[f64; 3]> = serde_json::from_value(json["coefficients"].clone())
        .map_err(|_| wrong("must hold \"coefficients\": [[r, g, b], …]"))?;
    let square = list.len().isqrt().pow(2) == list.len();
    if list.is_empty() || !square || list.iter().flatten().any(|x| !x.is_finite()) {
        return Err(wrong("coefficients must be finite and a square number of rows"));
    }
    Ok(list)
}

fn panoramas(folder: &Path) -> Result<VecDeque<PathBuf>, Failure> {
    let input = |e: &dyn std::fmt::Display| Failure::Input(format!("{}: {e}", folder.display()));
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(|e| input(&e))?
        .map(|entry| entry.map(|e| e.path()))
        .collect::<Result<_, _>>()
        .map_err(|e| input(&e))?;
    files.sort();
    // The same frame may stand there in two forms: the one with the whole range counts.
    for form in [&["exr"][..], &["hdr"], &["png", "jpg", "jpeg"]] {
        let found: VecDeque<PathBuf> = files.iter().filter(|f| has_extension(f, form)).cloned().collect();
        if !found.is_empty() {
            return Ok(found);
        }
    }
    Err(input(&"no panoramas (.exr, .hdr, .png, .jpg) in this folder"))
}

fn open_video(path: &Path) -> Result<Source, Failure> {
    find_ffmpeg("to read a video; give a folder of panoramas instead")?;
    let mut child = Command::new("ffmpeg")
        .args(["-v", "error", "-nostdin", "-i"])
        .arg(path)
        .args(["-an", "-f", "image2pipe", "-vcodec", "ppm", "-"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|e| Failure::Internal(format!("ffmpeg: {e}")))?;
    let out = child.stdout.take().ok_or_else(|| Failure::Internal("ffmpeg gives no output".into()))?;
    Ok(Source::Video { child, frames: BufReader::new(out), path: path.to_path_buf(), read: 0 })
}

/// One frame in PPM form.
fn video_frame(frames: &mut impl BufRead, path: &Path) -> Result<Option<Panorama>, Failure> {
    let wrong = |e: &dyn std::fmt::Display| Failure::Input(format!("{}: {e}", path.display()));
    let mut header = Vec::new();
    while header.iter().filter(|b| **b == b'\n').count() < 3 {
        let n = frames.take(64).read_until(b'\n', &mut header).map_err(|e| wrong(&e))?;
        if n == 0 && header.is_empty() {
            return Ok(None);
        }
        if n == 0 || header.len() > 64 {
            return Err(wrong(&"ends within a frame"));
        }
    }
    let text = String::from_utf8_lossy(&header).into_owned();
    let words: Vec<&str> = text.split_ascii_whitespace().collect();
    let (Some(&"P6"), Some(Ok(w)), Some(Ok(h))) =
        (words.first(), words.get(1).map(|w| w.parse::<usize>()), words.get(2).map(|h| h.parse::<usize>()))
    else {
        return Err(wrong(&"cannot be read as a video"));
    };
    if w != 2 * h || w > 16_384 {
        return Err(wrong(&format!(
            "is {w}x{h}: a panorama of all directions is twice as wide as high, at most 16384"
        )));
    }
    let mut bytes = vec![0u8; 3 * w * h];
    frames.read_exact(&mut bytes).map_err(|_| wrong(&"ends within a frame"))?;
    let table = Response::Srgb.linear_table();
    let pixels = bytes.chunks_exact(3).map(|p| Vec3::from([p[0], p[1], p[2]].map(|v| table[v as usize]))).collect();
    Panorama::new(w, pixels).map(Some).map_err(|e| wrong(&e))
}
