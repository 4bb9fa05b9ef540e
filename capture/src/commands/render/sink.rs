//! Where `lumiscan render` writes its frames: a picture, a folder of pictures, or a video through ffmpeg.

use crate::commands::files::{StagingFolder, check_fresh, has_extension};
use crate::commands::output::check_parent;
use crate::commands::render::ffmpeg::find_ffmpeg;
use crate::device_folder::files::beside;
use crate::failure::Failure;
use estimator::export::picture::{write_exr, write_png};
use estimator::render::compose::Picture;
use glam::Vec3;
use recordings::types::{Response, RgbImage};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Frames per second of a video.
const FRAME_RATE: &str = "30";

/// A picture ready to be written.
pub struct Frame {
    size: (usize, usize),
    linear: Vec<Vec3>,
    bytes: Vec<u8>,
}

impl Frame {
    /// Encodes a picture; what it does not touch keeps the photo's bytes.
    pub fn new(size: (usize, usize), picture: Picture, photo: Option<RgbImage>, response: Response) -> Self {
        let mut bytes = photo.map_or_else(|| vec![0; 3 * size.0 * size.1], |p| p.data);
        let fresh = bytes.iter().all(|b| *b == 0);
        for ((out, p), touched) in bytes.chunks_exact_mut(3).zip(&picture.linear).zip(&picture.touched) {
            if *touched || fresh {
                out.copy_from_slice(&[response.encode(p.x), response.encode(p.y), response.encode(p.z)]);
            }
        }
        Self { size, linear: picture.linear, bytes }
    }
}

/// Form of the output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// One 8-bit picture.
    Png,
    /// One linear picture.
    Exr,
    /// 000.png …
    Folder,
    /// Through ffmpeg.
    Video,
}

/// Where frames go. Nothing appears under the output's name before all of it is there.
pub struct Sink {
    path: PathBuf,
    kind: Kind,
    frames: usize,
    staging: Option<StagingFolder>,
    video: Option<(Child, PathBuf)>,
}

impl Sink {
    /// Checks the output and makes ready for it.
    pub fn open(path: &Path) -> Result<Self, Failure> {
        let kind = if has_extension(path, &["png"]) {
            Kind::Png
        } else if has_extension(path, &["exr"]) {
            Kind::Exr
        } else if has_extension(path, &["mp4"]) {
            Kind::Video
        } else if path.extension().is_none() || path.is_dir() {
            Kind::Folder
        } else {
            let shown = path.display();
            return Err(Failure::Usage(format!("{shown}: the output must be .png, .exr, .mp4 or a folder")));
        };
        let mut staging = None;
        if kind == Kind::Folder {
            let mut name = check_fresh(path)?.to_os_string();
            name.push(format!(".{}.part", std::process::id()));
            staging = Some(StagingFolder::create(path.with_file_name(name))?);
        } else {
            check_parent(path)?;
        }
        if kind == Kind::Video {
            find_ffmpeg("to write an .mp4 file; name a folder instead to get the frames as pictures")?;
        }
        Ok(Self { path: path.to_path_buf(), kind, frames: 0, staging, video: None })
    }

    /// Form of the output.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Takes one frame.
    pub fn frame(&mut self, frame: &Frame) -> Result<(), Failure> {
        let (w, h) = frame.size;
        let written = |e: std::io::Error| Failure::writing(&self.path, e);
        match self.kind {
            Kind::Png => write_png(&self.path, w as u32, h as u32, &frame.bytes).map_err(written)?,
            Kind::Exr => write_exr(&self.path, w, h, &frame.linear).map_err(written)?,
            Kind::Folder => {
                if let Some(staging) = &self.staging {
                    let path = staging.path().join(format!("{:03}.png", self.frames));
                    write_png(&path, w as u32, h as u32, &frame.bytes).map_err(written)?;
                }
            }
            Kind::Video => {
                if self.video.is_none() {
                    self.video = Some(start_video(&self.path, frame.size)?);
                }
                let pipe = self.video.as_mut().and_then(|(child, _)| child.stdin.as_mut());
                pipe.map_or(Ok(()), |p| p.write_all(&frame.bytes)).map_err(written)?;
            }
        }
        self.frames += 1;
        Ok(())
    }

    /// Puts the output in its place.
    pub fn finish(mut self) -> Result<(), Failure> {
        if let Some(staging) = &self.staging {
            std::fs::rename(staging.path(), &self.path).map_err(|e| Failure::writing(&self.path, e))?;
        }
        if let Some((mut child, part)) = self.video.take() {
            drop(child.stdin.take());
            let ok = child.wait().is_ok_and(|s| s.success());
            if !ok {
                let _ = std::fs::remove_file(&part);
                return Err(Failure::Internal("ffmpeg could not write the video; see its message above".into()));
            }
            std::fs::rename(&part, &self.path).map_err(|e| Failure::writing(&self.path, e))?;
        }
        Ok(())
    }
}

impl Drop for Sink {
    fn drop(&mut self) {
        if let Some((mut child, part)) = self.video.take() {
            let _ = child.kill();
            let _ = child.wait();
            let _ = std::fs::remove_file(part);
        }
    }
}

fn start_video(path: &Path, (w, h): (usize, usize)) -> Result<(Child, PathBuf), Failure> {
    let part = beside(path, ".part");
    let child = Command::new("ffmpeg")
        .args(["-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", &format!("{w}x{h}")])
        .args(["-r", FRAME_RATE, "-i", "-", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])
        .args(["-fflags", "+bitexact", "-flags", "+bitexact", "-f", "mp4"])
        .arg(&part)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .map_err(|e| Failure::Internal(format!("ffmpeg: {e}")))?;
    Ok((child, part))
}
