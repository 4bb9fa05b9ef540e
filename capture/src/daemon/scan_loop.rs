//! The daemon's main loop: wait for a Kinect, scan, publish, and again.

use crate::cli::{Capture, Effort};
use crate::device_folder::files::write_file;
use crate::device_folder::manifest::{self, CaptureEntry};
use crate::device_folder::retention;
use crate::device_folder::staging::{Staging, remove_abandoned};
use crate::device_folder::undated;
use crate::failure::Failure;
use crate::kinect::driver::{Kinect, Led};
use crate::kinect::frame_queue::Wanted;
use crate::kinect::live::{Live, Polled};
use crate::kinect::protocol::KinectError;
use crate::kinect::transport::{Bus, UsbError};
use crate::live_config::LiveConfig;
use crate::lock::lock;
use crate::memory;
use crate::orders::Orders;
use crate::pipeline::{self, Job};
use crate::publish::{self, Published};
use crate::report::Reporter;
use crate::serve::service::Service;
use crate::sources::motion::Motion;
use crate::sources::pairs::Pairs;
use crate::sources::sensor;
use crate::sources::streaming::{Conditions, Streaming};
use crate::status::{Board, State};
use crate::stop::Stop;
use firmware_config::Config;
use recordings::import::trajectory::format_trajectory;
use recordings::recording::Event;
use recordings::scan::Scan;
use std::cell::Cell;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time between two searches for a Kinect, or checks that it is still plugged in.
const DEVICE_POLL: Duration = Duration::from_secs(1);
/// Time between two checks for orders.
const ORDER_POLL: Duration = Duration::from_millis(50);

/// The daemon and what it works with.
pub struct Daemon<'a> {
    /// The command line.
    pub args: &'a Capture,
    /// Settings.
    pub config: &'a Config,
    /// Those of the next scan.
    pub live_config: &'a LiveConfig,
    /// Receives state and figures.
    pub board: &'a Arc<Board>,
    /// Requests of the user.
    pub orders: &'a Orders,
    /// Signals of the service manager.
    pub stop: &'a Stop,
    /// Shows the scan to whoever watches.
    pub page: Option<&'a Service>,
    /// Log.
    pub reporter: &'a Reporter,
    /// The last scan ended with an error, which the LED shows until the next one begins.
    pub last_scan_failed: Cell<bool>,
    /// No scan waits for its date.
    pub dates_are_right: Cell<bool>,
}

impl Daemon<'_> {
    /// Runs until a signal comes, or the number of scans is reached.
    ///
    /// # Errors
    /// The device folder cannot be used. Any other error is shown, and the daemon continues with the next scan.
    pub fn run(&self, mut bus: Box<dyn Bus>) -> Result<(), Failure> {
        self.finish_interrupted()?;
        while self.stop.check().is_ok() && !self.has_finished() {
            let Some(kinect) = self.wait_for_kinect(bus.as_mut()) else { break };
            let waited = if self.orders.is_auto() {
                self.wait_for_motion(kinect)
            } else {
                self.wait_for_order(kinect, bus.as_mut())
            };
            let Some(live) = waited else { continue };
            self.last_scan_failed.set(false);
            if let Err(e) = self.scan(live)
                && self.stop.check().is_ok()
            {
                self.report_problem(&e.to_string());
                // An error that comes at once would repeat without end.
                self.sleep(DEVICE_POLL);
            }
        }
        Ok(())
    }

    fn has_finished(&self) -> bool {
        self.args.scans.is_some_and(|n| self.board.get().finished_scans >= n)
    }

    /// Opens the first Kinect that answers; `None` when the daemon is to end.
    fn wait_for_kinect(&self, bus: &mut dyn Bus) -> Option<Kinect> {
        self.board.enter(State::Waiting);
        self.board.set(|s| s.sensor = None);
        let (mut last, mut times): (Option<KinectError>, u32) = (None, 0);
        while self.stop.check().is_ok() {
            match Kinect::open(bus, &self.config.kinect.serial, &self.config.kinect) {
                Ok(mut kinect) => {
                    let found = kinect.found();
                    let name = format!("{} {}", found.model.name(), found.serial);
                    tracing::info!("{name} is ready");
                    self.page.inspect(|page| page.set_serial(&found.serial));
                    self.board.set(|s| s.sensor = Some(name));
                    kinect.set_led(if self.last_scan_failed.get() { Led::Error } else { Led::Ready });
                    self.orders.clear();
                    self.board.enter(State::Ready);
                    return Some(kinect);
                }
                Err(e) => {
                    times = if last.as_ref() == Some(&e) { times + 1 } else { 1 };
                    // The parts of a Kinect appear one after the other while it is plugged in.
                    let report_at = if e == KinectError::Usb(UsbError::NoPower) { 2 } else { 1 };
                    if e.is_gone() {
                        tracing::debug!("{e}");
                    } else if times == report_at {
                        self.board.error(&e.to_string());
                    }
                    last = Some(e);
                }
            }
            self.put_dates_right();
            self.sleep(DEVICE_POLL);
        }
        None
    }

    /// Waits for the order to start; `None` when the Kinect is unplugged, motion is to start scans, or the daemon is to end.
    fn wait_for_order(&self, kinect: Kinect, bus: &mut dyn Bus) -> Option<Live> {
        let mut looked = Instant::now();
        while self.stop.check().is_ok() && !self.orders.is_auto() {
            if self.orders.take_start() {
                return self.started(Live::start(kinect, Wanted::NewFrames, &self.config.kinect));
            }
            if looked.elapsed() >= DEVICE_POLL {
                looked = Instant::now();
                self.put_dates_right();
                if !bus.is_here(kinect.found()) {
                    tracing::info!("the Kinect was unplugged");
                    return None;
                }
            }
            std::thread::sleep(ORDER_POLL);
        }
        None
    }

    /// Streams until the sensor has been still and then moves; `None` when it is unplugged, motion no longer starts scans, or
    /// the daemon is to end.
    fn wait_for_motion(&self, kinect: Kinect) -> Option<Live> {
        let mut live = self.started(Live::start(kinect, Wanted::NewFrames, &self.config.kinect))?;
        let buffers = live.buffers().clone();
        let mut motion = Motion::new(&self.config.daemon);
        let (mut armed, mut looked) = (false, Instant::now());
        while self.stop.check().is_ok() && self.orders.is_auto() {
            let polled = live.poll(&mut |event| {
                match &event {
                    Event::Color(c) => motion.add_color(c),
                    Event::Depth(d) => motion.add_depth(d),
                    _ => None,
                };
                buffers.recycle(event);
            });
            match polled {
                Ok(Polled::Gone) => return None,
                Ok(_) => {}
                Err(e) => return self.started(Err(e)),
            }
            self.board.driver(&live.stats(), live.exposure_us());
            if looked.elapsed() >= DEVICE_POLL {
                looked = Instant::now();
                self.put_dates_right();
            }
            armed |= motion.still_s() >= self.config.daemon.start_still_s;
            if self.orders.take_start() || (armed && motion.is_moving()) {
                return Some(live);
            }
        }
        None
    }

    fn started(&self, live: Result<Live, KinectError>) -> Option<Live> {
        live.inspect_err(|e| self.board.error(&e.to_string())).ok()
    }

    /// One scan, from its first frame to the published folder.
    fn scan(&self, live: Live) -> Result<(), Failure> {
        let config = &self.live_config.get();
        let (device, daemon) = (&self.args.device, &config.daemon);
        retention::make_room(device, daemon, &config.handoff)?;
        let name = retention::next_name(device)?;
        let described = sensor::describe(live.kinect(), config);
        let mut staging = Staging::unattended(device, &name)?;
        self.board.begin_scan(&name);
        let streaming = Streaming::new(
            live,
            described,
            Conditions {
                orders: self.orders.clone(),
                stop: self.stop.clone(),
                board: Arc::clone(self.board),
                config: daemon.clone(),
                device: device.clone(),
            },
        );
        let ending = streaming.ending();
        let source = Path::new("kinect");
        let pairs = Pairs::live(streaming, &config.capture);
        let scan_path = staging.folder().join("scan.lscan");
        let job = Job {
            name: &name,
            source,
            scan: &scan_path,
            config,
            board: Some(self.board),
            orders: Some(self.orders),
            hub: self.page.map(Service::hub),
            paced: false,
        };
        // A signal ends the capture; what was captured is still fused and written.
        let captured = pipeline::run(pairs, &job, &self.stop.without_signals(), self.reporter);
        let ending = lock(&ending).take();
        if let Some(problem) = ending.and_then(|e| e.problem()) {
            self.report_problem(&problem);
        }
        if self.orders.is_discarded() {
            tracing::info!("{name} is discarded");
            return Ok(());
        }
        let captured = captured?;
        let given = self.orders.name();
        if let Some(given) = &given {
            staging.set_name(&retention::with_name(&name, given));
        }
        // From here on, everything can be repeated from the scan file.
        staging.keep();
        let text = format_trajectory(&captured.trajectory);
        write_file(&staging.folder().join("trajectory.txt"), text.as_bytes())?;
        self.publish(staging, given.unwrap_or(name), publish::capture_entry(source, captured))
    }

    fn publish(&self, staging: Staging, name: String, entry: CaptureEntry) -> Result<(), Failure> {
        self.board.enter(State::Estimating);
        memory::give_back();
        let daemon = &self.live_config.get().daemon;
        let effort = Effort {
            budget: daemon.budget_s,
            rounds: None,
            quality: None,
            threads: self.args.threads,
            memory: (daemon.estimator_limit_mb > 0).then_some(daemon.estimator_limit_mb),
        };
        let effort = (!self.args.no_estimate).then_some(&effort);
        let Published { folder, failure, .. } =
            publish::publish(staging, name, entry, effort, self.stop, self.reporter)?;
        tracing::info!("published {}", folder.display());
        if let Some(failure) = failure {
            self.report_problem(&failure.to_string());
        }
        self.board.set(|s| {
            s.finished_scans += 1;
            s.last_scan = Some(folder.display().to_string());
        });
        Ok(())
    }

    /// Finishes the scans of an interrupted run, or sets them aside.
    fn finish_interrupted(&self) -> Result<(), Failure> {
        let device = &self.args.device;
        remove_abandoned(&device.join("scans"));
        for folder in retention::unfinished(device) {
            if self.stop.check().is_err() {
                break;
            }
            // The rename that makes a scan file visible follows its last byte, so one that cannot be read is incomplete.
            let Ok(scan) = Scan::read(&folder.join("scan.lscan")) else {
                retention::set_aside(device, &folder, self.config.daemon.max_aside)?;
                continue;
            };
            tracing::info!("finishing {}", folder.display());
            let entry = CaptureEntry {
                source: "kinect".into(),
                vertices: scan.mesh.positions.len(),
                keyframes: scan.keyframes.len(),
                seconds: Vec::new(),
                memory_peak_bytes: memory::peak_bytes(),
                last_frame: None,
                stats: scan.stats.clone(),
            };
            let name = scan.name.clone();
            drop(scan);
            remove_results(&folder);
            if let Err(e) = Staging::resume(&folder).and_then(|staging| self.publish(staging, name, entry)) {
                self.board.error(&e.to_string());
            }
        }
        for folder in retention::finished(device).into_iter().filter(|f| manifest::is_incomplete(f)) {
            if self.stop.check().is_err() {
                break;
            }
            tracing::info!("finishing {}", folder.display());
            if let Err(e) = publish::complete(&folder, self.stop, self.reporter) {
                self.board.error(&e.to_string());
            }
        }
        Ok(())
    }

    /// Dates the scans that were made before the clock was set, once it is.
    fn put_dates_right(&self) {
        if self.dates_are_right.get() {
            return;
        }
        let is_busy = |id: &str| self.page.is_some_and(|page| page.works_on(id));
        let Some(changed) = undated::put_right(&self.args.device, is_busy) else { return };
        self.dates_are_right.set(true);
        for (old, new) in changed {
            let (old, new) = (old.display().to_string(), new.display().to_string());
            tracing::info!("the clock is set: {old} is now {new}");
            self.board.set(|s| {
                if s.last_scan.as_ref() == Some(&old) {
                    s.last_scan = Some(new);
                }
            });
        }
    }

    fn report_problem(&self, problem: &str) {
        self.last_scan_failed.set(true);
        self.board.error(problem);
    }

    fn sleep(&self, time: Duration) {
        let until = Instant::now() + time;
        while Instant::now() < until && self.stop.check().is_ok() {
            std::thread::sleep(ORDER_POLL);
        }
    }
}

/// Removes what an interrupted run derived from the scan file.
fn remove_results(folder: &Path) {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    for entry in entries.filter(|e| e.file_name() != "scan.lscan" && e.file_name() != "trajectory.txt") {
        let _ = std::fs::remove_file(entry.path());
    }
}
