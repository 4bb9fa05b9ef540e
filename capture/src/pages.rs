//! The preview and the viewer page of a result, made beside it: each by a process of its own, this executable again with `export`, both at
//! once.

use crate::child_process::{relay, wait};
use crate::failure::Failure;
use crate::report::Reporter;
use crate::stop::Stop;
use std::io::BufReader;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// What `export` calls them, and their files.
const PAGES: [(&str, &str); 2] = [("preview", "preview.png"), ("html", "viewer.html")];
/// A page that takes longer is given up.
const LIMIT: Duration = Duration::from_secs(300);

/// Writes both into a folder with a scan and its result; each appears whole. Returns the seconds that each took.
///
/// # Errors
/// A process could not be started or failed, or a signal came.
pub fn write(
    folder: &Path,
    threads: Option<u16>,
    stop: &Stop,
    reporter: &Reporter,
) -> Result<Vec<(String, f64)>, Failure> {
    let cannot = |e: std::io::Error| Failure::Internal(format!("the preview could not be started: {e}"));
    let program = std::env::current_exe().map_err(cannot)?;
    let start = |(form, file): (&str, &str)| {
        let mut command = Command::new(&program);
        command.args(["--json", "export"]).arg(folder.join("result.lres")).args(["--to", form]);
        command.arg("-o").arg(folder.join(file)).args(["--parent", &std::process::id().to_string()]);
        if let Some(n) = threads {
            command.env("RAYON_NUM_THREADS", n.to_string());
        }
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn()
    };
    let mut children = Vec::new();
    for page in PAGES {
        children.push((page.1, start(page).map_err(cannot)?));
    }
    let ended: Vec<Result<(String, f64), Failure>> = std::thread::scope(|scope| {
        let ends: Vec<_> =
            children.iter_mut().map(|(file, child)| scope.spawn(|| finish(file, child, stop, reporter))).collect();
        let lost = || Err(Failure::Internal("a thread panicked".into()));
        ends.into_iter().map(|end| end.join().unwrap_or_else(|_| lost())).collect()
    });
    ended.into_iter().collect()
}

/// Waits for the process that writes `file`.
fn finish(file: &str, child: &mut Child, stop: &Stop, reporter: &Reporter) -> Result<(String, f64), Failure> {
    let began = Instant::now();
    let stderr = child.stderr.take();
    let (waited, said) = std::thread::scope(|scope| {
        let said = scope.spawn(|| stderr.map(|e| relay(BufReader::new(e), file, reporter)).unwrap_or_default());
        let waited = wait(child, stop, Some(LIMIT));
        (waited, said.join().unwrap_or_default())
    });
    let status = waited?.status;
    if status.success() {
        let stem = file.split('.').next().unwrap_or(file);
        return Ok((stem.to_owned(), began.elapsed().as_secs_f64()));
    }
    let said = said.iter().map(String::as_str).collect::<Vec<_>>().join(" · ");
    Err(Failure::Internal(format!("{file} could not be made ({status}) {said}; the result is complete")))
}
