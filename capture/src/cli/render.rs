//! Arguments of `lumiscan render`.

use crate::cli::settings::Settings;
use clap::{Args, ValueEnum};
use estimator::render::lighting::lamp_change::LampChange;
use estimator::render::objects::insert::Insert;
use estimator::render::removal::select::Removal;
use estimator::render::view::ViewChoice;
use glam::Vec3;
use std::path::PathBuf;

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
  lumiscan render result.lres --view keyframe:4 --over photo --insert knot.glb@pixel:470,300 -o out.png
  lumiscan render result.lres --view keyframe:4 --over photo --remove box:0.1,0,0.001,0.3,0.2,0.1 -o out.png
  lumiscan render result.lres --view keyframe:0 --light panoramas/ -o frames/
  lumiscan render result.lres --view keyframe:0 --over photo --lamp 0=@0.2,0.1,0.5 --lamp 1=off -o moved.png
  lumiscan render result.lres --view orbit:90 --insert other.lres#segment=4 -o turn.mp4")]
#[allow(rustdoc::broken_intra_doc_links, reason = "brackets in the text of --help are no links")]
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
    /// OBJECT[@x,y,z[,yaw_deg[,scale]]] or OBJECT@pixel:X,Y[,yaw_deg[,scale]]: glTF, PLY, or other.lres[#segment=4,7].
    ///
    /// With a pixel of the first view, and without a place (the middle of the view), it stands on the surface that shows there.
    #[arg(long, value_name = "OBJECT")]
    pub insert: Vec<Insert>,
    /// segment:N: what is inserted gets the material of this segment.
    #[arg(long, value_name = "MATERIAL", value_parser = segment)]
    pub material: Option<u32>,
    /// segment:N, box:x0,y0,z0,x1,y1,z1 or point:x,y: the object under a pixel of the first view.
    #[arg(long, value_name = "WHAT", value_parser = removal)]
    pub remove: Vec<RemovalTarget>,
    /// A panorama (.hdr, .exr, .png, .jpg), a folder of them, a video, result:OTHER.lres or sh:FILE.
    #[arg(long, value_name = "LIGHT")]
    pub light: Option<String>,
    /// Turns that light about +Z, counter-clockwise from above.
    #[arg(long, value_name = "DEG", default_value = "0", allow_negative_numbers = true, value_parser = finite)]
    pub light_yaw: f32,
    /// N=off, N=on, N=*FACTOR, N=*R,G,B or N=@x,y,z (metres): switches, dims, colours, moves a lamp that `inspect` lists.
    ///
    /// Several for one lamp are joined by commas: 0=*0.5,@0.1,0.2,0.6. Under --light, lamps are off unless named here.
    #[arg(long, value_name = "LAMP")]
    pub lamp: Vec<LampChange>,
    /// The same for an emitting surface, which cannot be moved.
    #[arg(long, value_name = "EMITTER")]
    pub emitter: Vec<LampChange>,
    /// Worker threads [default: one a processor].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Memory in MB; the command ends when it needs more.
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u32).range(16..))]
    pub memory: Option<u32>,
    /// End when the process with this id, the parent, ends.
    #[arg(long, value_name = "ID", hide = true)]
    pub parent: Option<u32>,
    /// Settings.
    #[command(flatten)]
    pub settings: Settings,
}

/// What is removed, as given on the command line.
#[derive(Debug, Clone, PartialEq)]
pub enum RemovalTarget {
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

fn removal(text: &str) -> Result<RemovalTarget, String> {
    let wrong = || "must be segment:N, box:x0,y0,z0,x1,y1,z1 or point:x,y".to_string();
    let (kind, rest) = text.split_once(':').ok_or_else(wrong)?;
    if kind == "segment" {
        return rest.parse().map(|n| RemovalTarget::Known(Removal::Segment(n))).map_err(|_| wrong());
    }
    let n: Vec<f32> = rest.split(',').map(|x| finite(x.trim())).collect::<Result<_, _>>()?;
    match (kind, n.as_slice()) {
        ("box", [a, b, c, d, e, f]) => {
            let (p, q) = (Vec3::new(*a, *b, *c), Vec3::new(*d, *e, *f));
            Ok(RemovalTarget::Known(Removal::Box(p.min(q), p.max(q))))
        }
        ("point", [x, y]) => Ok(RemovalTarget::Point(*x, *y)),
        _ => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_read() {
        assert_eq!(size("640x480"), Ok((640, 480)));
        assert!(size("0x4").is_err() && size("640").is_err() && size("9999x9").is_err());
        assert_eq!(removal("segment:3"), Ok(RemovalTarget::Known(Removal::Segment(3))));
        assert_eq!(removal("box:1,1,1,0,0,0"), Ok(RemovalTarget::Known(Removal::Box(Vec3::ZERO, Vec3::ONE))));
        assert_eq!(removal("point:3,4.5"), Ok(RemovalTarget::Point(3.0, 4.5)));
        assert!(removal("box:1,2").is_err() && removal("point:nan,0").is_err() && removal("all").is_err());
        assert!(gain("0").is_err() && gain("-1").is_err() && gain("2").is_ok());
    }
}
