//! The command line: commands with their arguments and options. `render`'s are in [`render`].

mod render;
mod settings;

use crate::orders::Request;
use clap::{Args, Parser, Subcommand, ValueEnum};
use estimator::Reference;
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;

pub use render::{RemovalTarget, Render};
pub use settings::Settings;

/// Light and materials from a casual scan with a Kinect.
#[derive(Debug, Parser)]
#[command(
    name = "lumiscan",
    version = concat!(env!("CARGO_PKG_VERSION"), " (", env!("LUMISCAN_COMMIT"), ", ", env!("LUMISCAN_TARGET"), ")"),
    propagate_version = true,
    arg_required_else_help = true,
    after_long_help = "\
Examples:
  lumiscan replay recordings/data/tabletop.lrec       fuse, estimate and publish into ./lumiscan-device/scans/
  lumiscan inspect lumiscan-device/scans/*/result.lres
  lumiscan export lumiscan-device/scans/<id>/result.lres --to folder -o /tmp/result

Results go to stdout, progress and log lines to stderr.

Exit codes:
  0  success (also with planned cuts, which the result records)
  1  internal error
  2  usage or configuration
  3  no device, or unreadable input
  4  the scan is unusable: tracking never held
  5  a stage had to be abandoned for the budget, or the result was more than a second late; it was written
  6  too little memory

After 3 and 4 the same input fails again, everywhere; after 5 and 6 it may succeed with more time or memory."
)]
pub struct Cli {
    /// The command.
    #[command(subcommand)]
    pub command: Command,
    /// Print more log lines.
    #[arg(short, long, global = true)]
    pub verbose: bool,
    /// Print JSON: progress and log lines on stderr, results on stdout.
    #[arg(long, global = true)]
    pub json: bool,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Replay a recording: fuse it, estimate light and materials, publish the scan in the device folder.
    Replay(Replay),
    /// Estimate light and materials from a scan file.
    Estimate(Estimate),
    /// Convert a TUM RGB-D folder to a recording, or a mesh with posed photos to a scan.
    Import(Import),
    /// Write a result, or a recording, in a form that other programs read.
    Export(Export),
    /// Insert objects into a result, remove objects, or relight it; write pictures.
    Render(Box<Render>),
    /// Print every setting with unit, range and default, as a configuration file.
    Config(Config),
    /// Run the daemon: wait for a Kinect, scan on request or on motion, publish.
    Capture(Capture),
    /// Start or stop a scan of the daemon, or print its status.
    Scan(Scan),
    /// Copy finished scans to another machine, and fetch results that were made there.
    Handoff(Handoff),
    /// Test this machine: sensor, USB, disk, memory, speed; name remedies.
    Check(Check),
    /// List the sensors that are plugged in.
    List(List),
    /// Record the frames or USB packets of a Kinect.
    Record(Record),
    /// Print the contents of a recording, a scan or a result.
    Inspect(Inspect),
    /// Measure speed against accuracy on scenes with known truth.
    Trade(Trade),
    /// Write manual pages and shell completions, for packages.
    #[command(hide = true)]
    Manual(Manual),
}

/// Arguments of `manual`.
#[derive(Debug, Args)]
pub struct Manual {
    /// Folder that receives them.
    pub folder: PathBuf,
}

/// Named points of the trade of speed against accuracy (`lumiscan trade` measures them).
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum QualityPoint {
    /// A quick look: few rays, bands and bounces, two rounds of pose refinement.
    Draft,
    /// What the scene requires.
    Standard,
    /// Everything that still improves the result measurably.
    Best,
}

impl QualityPoint {
    /// As settings name it.
    #[must_use]
    pub fn setting(self) -> firmware_config::Quality {
        match self {
            Self::Draft => firmware_config::Quality::Draft,
            Self::Standard => firmware_config::Quality::Standard,
            Self::Best => firmware_config::Quality::Best,
        }
    }

    /// As the command line does.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Standard => "standard",
            Self::Best => "best",
        }
    }
}

/// Limits of a run of the estimator.
#[derive(Debug, Args)]
pub struct Effort {
    /// Seconds from the estimator's start to the result on disk.
    #[arg(long, value_name = "S", default_value = "120", value_parser = seconds)]
    pub budget: f64,
    /// Fixed number of ray rounds instead of the budget; the result is then the same, byte for byte, on every run.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub rounds: Option<u32>,
    /// Trade-off of speed and accuracy for settings that are `auto` [default: standard].
    #[arg(long, value_name = "POINT")]
    pub quality: Option<QualityPoint>,
    /// Worker threads [default: one per processor].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Memory of the estimator in MB: it plans to fit, with fewer vertices if need be, and ends when it needs more. With --rounds, a
    /// limit alone.
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u32).range(16..))]
    pub memory: Option<u32>,
}

/// `lumiscan replay`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Publishes <device>/scans/<utc>-<name>/ with scan.lscan, result.lres, manifest.json, preview.png, viewer.html and trajectory.txt. The
folder appears when the result is complete, preview and viewer follow within seconds; then its path is the last line on stdout.

Examples:
  lumiscan replay recordings/data/tabletop.lrec
  lumiscan replay ~/rgbd_dataset_freiburg1_xyz --device /var/lib/lumiscan --budget 60
  lumiscan replay recordings/data/tabletop.lrec --watch         in a browser; prints the address
  lumiscan replay scan.lrec --no-estimate --set fusion.voxel_size_m=0.01")]
pub struct Replay {
    /// A recording (.lrec) or a TUM RGB-D folder.
    pub source: PathBuf,
    /// Device folder, created if missing.
    #[arg(long, value_name = "DIR", env = "LUMISCAN_DEVICE", default_value = "lumiscan-device")]
    pub device: PathBuf,
    /// Publish without result, preview and viewer.
    #[arg(long)]
    pub no_estimate: bool,
    /// Limits of the estimator.
    #[command(flatten)]
    pub effort: Effort,
    /// Show the scan in a browser while it is played at its own speed [address without a value: this machine, any free port].
    #[arg(long, value_name = "ADDR:PORT", num_args = 0..=1, require_equals = true, default_missing_value = "127.0.0.1:0",
          value_parser = address)]
    pub watch: Option<SocketAddr>,
    /// With --watch: go on serving when the scan is published, until Ctrl-C.
    #[arg(long, requires = "watch")]
    pub keep: bool,
    /// Play the source N times, alternately forward and backward, with continuous time stamps.
    #[arg(long = "loop", value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..))]
    pub loops: u32,
    /// Settings.
    #[command(flatten)]
    pub settings: Settings,
}

/// `lumiscan estimate`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Uses the settings stored in the scan. The last line on stdout is the result's path; with --json it is one line that tells how the
estimate ended (docs/studio.md).

Examples:
  lumiscan estimate ball.lscan
  lumiscan --json estimate ball.lscan --if-changed --quality best
  lumiscan estimate ball.lscan -o draft.lres --budget 10
  lumiscan estimate ball.lscan --rounds 4 --threads 1
  lumiscan estimate ball.lscan --reference keyframe:2:320,200=0.9")]
pub struct Estimate {
    /// A scan (.lscan).
    pub scan: PathBuf,
    /// The result [default: beside the scan; result.lres for scan.lscan, otherwise of the same stem].
    #[arg(short, long, value_name = "RESULT")]
    pub output: Option<PathBuf>,
    /// Do nothing if the result was made from the same scan, with the same settings, by the same version. Waits while another process
    /// makes it.
    #[arg(long)]
    pub if_changed: bool,
    /// Write the preview sheet, too (`replay` publishes it as preview.png).
    #[arg(long, value_name = "FILE")]
    pub preview: Option<PathBuf>,
    /// Write the viewer page, too (`replay` publishes it as viewer.html).
    #[arg(long, value_name = "FILE")]
    pub viewer: Option<PathBuf>,
    /// A thing of known albedo in a picture, such as white paper, fixes the scale of the albedo: pixel X,Y of keyframe N
    /// shows diffuse albedo A (linear), one number or R,G,B. The viewer page tells this line for a click.
    #[arg(long, value_name = "keyframe:N:X,Y=A")]
    pub reference: Option<Reference>,
    /// End when the process with this id, the parent, ends.
    #[arg(long, value_name = "ID", hide = true)]
    pub parent: Option<u32>,
    /// Limits.
    #[command(flatten)]
    pub effort: Effort,
}

/// Input formats of `lumiscan import`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ImportFrom {
    /// A TUM RGB-D folder (rgb.txt, depth.txt, camera.txt), to a recording.
    Tum,
    /// A mesh and posed photos (mesh.ply, transforms.json), to a scan.
    Photos,
}

/// `lumiscan import`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  lumiscan import tum ~/rgbd_dataset_freiburg1_xyz -o desk.lrec
  lumiscan import photos ~/ball -o ball.lscan
  lumiscan import photos ~/ball --mesh ~/ball/fine.ply -o ball.lscan")]
pub struct Import {
    /// Format of the data.
    pub from: ImportFrom,
    /// Folder of the data.
    pub dir: PathBuf,
    /// The recording (.lrec) or scan (.lscan) to write.
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Mesh for the photos [default: DIR/mesh.ply].
    #[arg(long, value_name = "M")]
    pub mesh: Option<PathBuf>,
}

/// What `lumiscan export` writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportTo {
    /// Of a result: lighting_sh.json, vertices.ply, exposures.json, poses.json and materials.json in a fresh folder.
    Folder,
    /// Of a result: the mesh with lit colour, albedo and segment of every vertex.
    Ply,
    /// Of a result: distant light as a Radiance panorama, with what the pictures of its scan show beyond the surface.
    Hdr,
    /// The same as an OpenEXR panorama.
    Exr,
    /// Of a result: a glTF scene with materials, cameras, and light as in the panorama.
    Glb,
    /// Of a result: a folder with the mesh as Wavefront OBJ, its materials and its texture.
    Obj,
    /// Of a result and its scan: cameras and pictures as COLMAP's text model.
    Colmap,
    /// Of a result and its scan: cameras and pictures with a transforms.json.
    Nerf,
    /// Of a result and its scan: a page that any browser opens, to view and relight it and to try settings.
    Html,
    /// Of a result and its scan: the preview sheet, a PNG picture.
    Preview,
    /// Of a recording: a TUM RGB-D folder, frame for frame.
    Tum,
}

/// `lumiscan export`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  lumiscan export result.lres --to folder -o /tmp/result
  lumiscan export result.lres --to hdr -o light.hdr
  lumiscan export tabletop.lrec --to tum -o /tmp/tabletop")]
pub struct Export {
    /// A result (.lres), or for `--to tum` a recording (.lrec).
    pub file: PathBuf,
    /// Form to write.
    #[arg(long, value_name = "FORM")]
    pub to: ExportTo,
    /// Its scan, for pictures [default: scan.lscan or the .lscan of the same stem beside the result].
    #[arg(long, value_name = "FILE")]
    pub scan: Option<PathBuf>,
    /// File or folder to write; a folder must be new or empty.
    #[arg(short, long, value_name = "PATH")]
    pub output: PathBuf,
    /// End when the process with this id, the parent, ends.
    #[arg(long, value_name = "ID", hide = true)]
    pub parent: Option<u32>,
}

/// `lumiscan config`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  lumiscan config > lumiscan.toml                     a settings file to edit
  lumiscan config --set estimator.transfer=shade      with a value changed
  lumiscan --json config                              for programs")]
pub struct Config {
    /// Settings to print instead of the defaults.
    #[command(flatten)]
    pub settings: Settings,
}

/// `lumiscan inspect`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  lumiscan inspect tabletop.lrec
  lumiscan inspect result.lres --json")]
pub struct Inspect {
    /// A recording, a scan or a result, recognised by its contents.
    pub file: PathBuf,
}

/// `lumiscan trade`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Prints a table a scene, how `auto` fares against its rule, and the paths of the table (CSV) and the plot (PNG, SVG). A scene is a
folder of posed photos with mesh.ply and truth/{albedo,lit_color}.npy, or a recording X.lrec with X_truth/ beside it.

Examples:
  lumiscan trade -o trade.csv                         the bundled tabletop
  lumiscan trade ~/truth/ball ~/truth/bunny -o trade.csv")]
pub struct Trade {
    /// Scenes [default: recordings/data/tabletop.lrec].
    pub scenes: Vec<PathBuf>,
    /// The table; the plot gets the same name with .png and .svg.
    #[arg(short, long, value_name = "FILE", default_value = "trade.csv")]
    pub output: PathBuf,
    /// Seconds a scene may take; settings that are left then are not measured.
    #[arg(long, value_name = "S", default_value = "600", value_parser = seconds)]
    pub limit: f64,
    /// Worker threads [default: one per processor].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// `lumiscan capture`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Signals: SIGUSR1 starts a scan, SIGUSR2 ends it; SIGTERM ends the daemon, which finishes an open scan at its next start.

Examples:
  lumiscan capture --device /var/lib/lumiscan --auto
  lumiscan capture --serve 0.0.0.0:8080               with the web page; prints its address
  lumiscan capture --simulate desk.lrec               with a simulated Kinect; then: lumiscan scan start")]
pub struct Capture {
    /// Device folder, created if missing.
    #[arg(long, value_name = "DIR", env = "LUMISCAN_DEVICE", default_value = "lumiscan-device")]
    pub device: PathBuf,
    /// Control socket [default: control in the device folder].
    #[arg(long, value_name = "PATH", env = "LUMISCAN_SOCKET")]
    pub socket: Option<PathBuf>,
    /// Start a scan when the sensor moves after stillness, and end it when the sensor is still again.
    #[arg(long)]
    pub auto: bool,
    /// Publish scans without results.
    #[arg(long)]
    pub no_estimate: bool,
    /// Exit after N scans.
    #[arg(long, value_name = "N")]
    pub scans: Option<u64>,
    /// Worker threads [default: one per processor].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Serve the web page [address without a value: serve.address, or else every network, port 8080].
    #[arg(long, value_name = "ADDR:PORT", num_args = 0..=1, value_parser = address)]
    pub serve: Option<Option<SocketAddr>>,
    /// Use a simulated Kinect: `pattern` or a recording, then `,fault=value` (see capture/README.md).
    #[arg(long, value_name = "PLAN")]
    pub simulate: Option<String>,
    /// Settings.
    #[command(flatten)]
    pub settings: Settings,
}

/// `lumiscan scan`.
#[derive(Debug, Args)]
pub struct Scan {
    /// The request.
    pub order: Request,
    /// Device folder of the daemon.
    #[arg(long, value_name = "DIR", env = "LUMISCAN_DEVICE", default_value = "lumiscan-device")]
    pub device: PathBuf,
    /// Its control socket [default: /run/lumiscan/control where the service runs, otherwise in the device folder].
    #[arg(long, value_name = "PATH", env = "LUMISCAN_SOCKET")]
    pub socket: Option<PathBuf>,
}

/// `lumiscan handoff`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Copies every finished scan to `handoff.destination`/scans by rsync, has it compared there byte for byte, and only then counts it as handed
off. Fetches results of its scans from `handoff.destination`/results and puts them in place. The service lumiscan-handoff runs it
(docs/studio.md).

Examples:
  lumiscan handoff --device /var/lib/lumiscan --config /etc/lumiscan/default.toml
  lumiscan handoff --set handoff.destination=studio@museum:boxes/7")]
pub struct Handoff {
    /// Device folder.
    #[arg(long, value_name = "DIR", env = "LUMISCAN_DEVICE", default_value = "lumiscan-device")]
    pub device: PathBuf,
    /// Settings.
    #[command(flatten)]
    pub settings: Settings,
}

/// `lumiscan check`.
#[derive(Debug, Args)]
pub struct Check {
    /// Device folder.
    #[arg(long, value_name = "DIR", env = "LUMISCAN_DEVICE", default_value = "lumiscan-device")]
    pub device: PathBuf,
    /// Use a simulated Kinect (see capture/README.md).
    #[arg(long, value_name = "PLAN")]
    pub simulate: Option<String>,
    /// Settings.
    #[command(flatten)]
    pub settings: Settings,
}

/// `lumiscan list`.
#[derive(Debug, Args)]
pub struct List {
    /// Use a simulated Kinect (see capture/README.md).
    #[arg(long, value_name = "PLAN")]
    pub simulate: Option<String>,
}

/// `lumiscan record`.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Ends after --seconds of the device's clock, or with Ctrl-C; the file is complete either way.

Examples:
  lumiscan record desk.lrec                           until Ctrl-C
  lumiscan record desk.lrec --seconds 20
  lumiscan record desk.lrec --raw                     USB packets unchanged, 22 MB/s; replay decodes them
  lumiscan record x.lrec --seconds 2 --simulate pattern,loss=0.01")]
pub struct Record {
    /// The recording to write (.lrec).
    #[arg(value_name = "FILE")]
    pub output: PathBuf,
    /// Length of the recording on the device's clock.
    #[arg(long, value_name = "N", value_parser = seconds)]
    pub seconds: Option<f64>,
    /// Record USB packets instead of frames.
    #[arg(long)]
    pub raw: bool,
    /// Use a simulated Kinect: `pattern` or a recording, then `,fault=value` (see capture/README.md).
    #[arg(long, value_name = "PLAN")]
    pub simulate: Option<String>,
    /// Use a PrimeSense sensor by its OpenNI2 address (empty for the first), or an .oni file.
    #[cfg(feature = "openni")]
    #[arg(long, value_name = "ADDRESS")]
    pub openni: Option<String>,
    /// Settings.
    #[command(flatten)]
    pub settings: Settings,
}

/// An address with a port, `0.0.0.0:8080` or `localhost:0`.
pub fn address(text: &str) -> Result<SocketAddr, String> {
    let found = text.to_socket_addrs().ok().and_then(|mut all| all.next());
    found.ok_or_else(|| "an address with a port, such as 0.0.0.0:8080".into())
}

/// A positive, finite number of seconds.
fn seconds(text: &str) -> Result<f64, String> {
    let s: f64 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if s > 0.0 && s <= 1e6 { Ok(s) } else { Err("must be more than 0 and at most 1000000 seconds".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn definitions_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn budgets_are_positive_and_finite() {
        for bad in ["0", "-1", "nan", "inf", "1e9", "soon", ""] {
            assert!(seconds(bad).is_err(), "{bad}");
        }
        assert_eq!(seconds("0.5"), Ok(0.5));
    }
}
