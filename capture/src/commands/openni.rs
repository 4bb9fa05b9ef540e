//! `lumiscan record FILE --openni ADDRESS`: the frames of a PrimeSense sensor or an `.oni` file to a recording.

use crate::cli;
use crate::commands::output::print;
use crate::commands::output::print_json;
use crate::commands::settings::load;
use crate::device_folder::disk;
use crate::failure::Failure;
use crate::report::{Reporter, Step};
use crate::sources::openni::Device;
use crate::stop::Stop;
use recordings::recording::{Event, RecordingKind, RecordingWriter};
use serde_json::json;
use std::path::Path;

/// Bytes per second of frames, at most: RGB and depth at 640×480.
const FRAME_RATE: f64 = 46.0e6;
/// Length that must fit on the disk where `--seconds` is not given.
const OPEN_END_S: f64 = 60.0;

/// Runs the command.
pub fn run(address: &str, args: &cli::Record, as_json: bool, reporter: &Reporter) -> Result<(), Failure> {
    load(&args.settings)?;
    if args.raw || args.simulate.is_some() {
        return Err(Failure::Usage("--raw and --simulate are for a Kinect; omit them with --openni".into()));
    }
    let mut device = Device::open(address).map_err(|e| Failure::Input(e.to_string()))?;
    if !device.is_file() {
        let folder = args.output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        disk::require(folder, FRAME_RATE, args.seconds.unwrap_or(OPEN_END_S))?;
    }
    let internal = |e: recordings::error::Error| Failure::Internal(e.to_string());
    let mut writer = RecordingWriter::create(&args.output, RecordingKind::Frames, device.sensor()).map_err(internal)?;
    let stop = Stop::on_signals()?;
    let (mut depth, mut color, mut first) = (0u64, 0u64, None);
    while stop.check().is_ok()
        && let Some(event) = device.next_event().map_err(|e| Failure::Input(e.to_string()))?
    {
        let seconds = (event.timestamp_ns() - *first.get_or_insert(event.timestamp_ns())) as f64 * 1e-9;
        writer.write(&event).map_err(internal)?;
        *(if matches!(event, Event::Depth(_)) { &mut depth } else { &mut color }) += 1;
        reporter.step(&Step {
            stage: "record".into(),
            fraction: args.seconds.map(|s| (seconds / s).min(1.0)),
            detail: format!("{seconds:.1} s · {depth} depth frames"),
        });
        if args.seconds.is_some_and(|s| seconds >= s) {
            break;
        }
    }
    writer.finish().map_err(internal)?;
    reporter.clear();
    if as_json {
        return print_json(&json!({ "recording": args.output, "depth_frames": depth, "color_frames": color }));
    }
    print(&args.output.display().to_string())
}
