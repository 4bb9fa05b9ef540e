//! The answers of a run within a budget: the newest one is a complete file beside the result, so that only a rename is left to do
//! when the time is over.

use crate::device_folder::files::{beside, sync};
use crate::device_folder::manifest::EstimatorEntry;
use crate::failure::Failure;
use crate::lock::lock;
use crate::report::Reporter;
use estimator::Progress;
use recordings::decision::{Cut, Warning};
use recordings::result::{Estimate, Origin};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Endings of what stands beside the result: the newest answer, the next one while it is written, and its unfinished file.
const NEWEST: &str = ".partial";
const NEXT: &str = ".next";
const UNFINISHED: &str = ".next.part";

/// What is reported of an answer.
pub struct Summary {
    /// Vertices and findings.
    pub entry: EstimatorEntry,
    /// What was cut.
    pub cuts: Vec<Cut>,
    /// What limits the trust in it.
    pub warnings: Vec<Warning>,
}

impl Summary {
    /// Of a result.
    #[must_use]
    pub fn of(estimate: &Estimate) -> Self {
        let mut entry = EstimatorEntry::default();
        entry.describe(estimate);
        Self { entry, cuts: estimate.cuts.clone(), warnings: estimate.warnings.clone() }
    }
}

/// The answers of one run.
pub struct Answers {
    result: PathBuf,
    origin: Origin,
    reporter: Reporter,
    started: Instant,
    budget: Duration,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    newest: Option<Summary>,
    /// When an answer took the place of the result, after the start.
    in_place: Option<Duration>,
    is_over: bool,
}

impl Answers {
    /// None so far.
    #[must_use]
    pub fn new(result: &Path, origin: Origin, reporter: &Reporter, started: Instant, budget: Duration) -> Self {
        let (result, reporter) = (result.to_path_buf(), reporter.clone());
        Self { result, origin, reporter, started, budget, state: Mutex::default() }
    }

    /// Writes an answer, which replaces the one before unless a stage of it had to be abandoned.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn stand(&self, estimate: &Estimate) -> Result<(), Failure> {
        {
            let state = lock(&self.state);
            // A stage that was given up half-way spoils more than the stages that an earlier answer lacks.
            if state.is_over || (state.newest.is_some() && estimate.cuts.iter().any(Cut::is_abandoned)) {
                return Ok(());
            }
        }
        let next = beside(&self.result, NEXT);
        let written = estimate.write_unsynced(&next, Some(&self.origin));
        let mut state = lock(&self.state);
        // What is in its place in time is not replaced too late.
        if state.is_over || (state.in_place.is_some() && self.started.elapsed() > self.budget) {
            let _ = std::fs::remove_file(&next);
            return Ok(());
        }
        written.map_err(|e| Failure::Internal(e.to_string()))?;
        // Only what takes the place of the result has to outlive a power cut: a disk that is slow must not halt the run.
        let place = if state.in_place.is_some() {
            sync(&next)?;
            self.result.clone()
        } else {
            beside(&self.result, NEWEST)
        };
        std::fs::rename(&next, &place).map_err(|e| Failure::writing(&place, e))?;
        state.newest = Some(Summary::of(estimate));
        Ok(())
    }

    /// Puts the newest answer in the place of the result; false if there is none yet.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn put_in_place(&self) -> Result<bool, Failure> {
        let mut state = lock(&self.state);
        if state.in_place.is_none() && state.newest.is_some() {
            let newest = beside(&self.result, NEWEST);
            sync(&newest)?;
            std::fs::rename(&newest, &self.result).map_err(|e| Failure::writing(&self.result, e))?;
            state.in_place = Some(self.started.elapsed());
            sync(self.result.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")))?;
        }
        Ok(state.in_place.is_some())
    }

    /// Ends the run: no answer comes after this. The one in place, and when an answer came there.
    #[must_use]
    pub fn end(&self) -> Option<(Summary, Duration)> {
        let mut state = lock(&self.state);
        state.is_over = true;
        clear(&self.result);
        state.newest.take().zip(state.in_place)
    }
}

impl Progress for Answers {
    fn stage(&self, name: &'static str, fraction: f64) {
        self.reporter.stage(name, fraction);
    }

    fn answer(&self, estimate: &Estimate) {
        if let Err(e) = self.stand(estimate) {
            tracing::warn!("an answer before the last was lost: {e}");
        }
    }
}

/// Removes what a run left beside its result.
pub fn clear(result: &Path) {
    for ending in [UNFINISHED, NEXT, NEWEST] {
        let _ = std::fs::remove_file(beside(result, ending));
    }
}

/// Makes the newest answer of a run that died the result, where there is none yet; false otherwise. It does not tell what it was made
/// from, so that it is made again.
pub fn recover(result: &Path) -> bool {
    let recovered = !result.exists()
        && Estimate::read(&beside(result, NEWEST)).is_ok_and(|estimate| estimate.write(result).is_ok());
    clear(result);
    recovered
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Estimate {
        Estimate::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../recordings/data/samples/v1-findings.lres").as_ref())
            .unwrap()
    }

    fn named(name: &str) -> Estimate {
        Estimate { name: name.into(), cuts: Vec::new(), ..sample() }
    }

    fn answers(result: &Path, budget: Duration) -> Answers {
        let origin = Origin { scan: String::new(), settings: String::new(), version: String::new() };
        Answers::new(result, origin, &Reporter::silent(), Instant::now(), budget)
    }

    fn files(folder: &Path) -> Vec<String> {
        let names = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned());
        let mut names: Vec<String> = names.collect();
        names.sort();
        names
    }

    #[test]
    fn the_newest_answer_takes_its_place_and_nothing_stays_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let result = folder.path().join("a.lres");
        named("of an earlier run").write(&result).unwrap();
        let answers = answers(&result, Duration::from_secs(600));
        let name = || Estimate::read(&result).unwrap().name;
        assert!(!answers.put_in_place().unwrap(), "there is none");
        answers.stand(&named("first")).unwrap();
        assert_eq!(name(), "of an earlier run", "until the end nears");
        assert!(answers.put_in_place().unwrap());
        assert_eq!(name(), "first");
        answers.stand(&named("better")).unwrap();
        assert_eq!(name(), "better");
        assert!(answers.end().is_some());
        answers.stand(&named("too late")).unwrap();
        assert_eq!((name(), files(folder.path())), ("better".into(), vec!["a.lres".into()]));
        assert!(Origin::read(&result).unwrap().is_some());
    }

    #[test]
    fn an_answer_with_an_abandoned_stage_replaces_none() {
        let folder = tempfile::tempdir().unwrap();
        let result = folder.path().join("a.lres");
        let cuts = vec![Cut::AbandonedTransfer { rays: 8 }];
        let answers = answers(&result, Duration::from_secs(600));
        answers.stand(&Estimate { cuts: cuts.clone(), ..named("abandoned") }).unwrap();
        answers.stand(&named("first")).unwrap();
        answers.stand(&Estimate { cuts, ..named("abandoned again") }).unwrap();
        assert!(answers.put_in_place().unwrap());
        assert_eq!(Estimate::read(&result).unwrap().name, "first");
    }

    #[test]
    fn what_is_in_time_is_not_replaced_too_late() {
        let folder = tempfile::tempdir().unwrap();
        let result = folder.path().join("a.lres");
        let answers = answers(&result, Duration::ZERO);
        answers.stand(&named("first")).unwrap();
        assert!(answers.put_in_place().unwrap());
        answers.stand(&named("too late")).unwrap();
        assert_eq!(Estimate::read(&result).unwrap().name, "first");
    }

    #[test]
    fn a_run_that_died_leaves_its_newest_answer_where_there_is_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let result = folder.path().join("a.lres");
        assert!(!recover(&result));
        answers(&result, Duration::from_secs(600)).stand(&named("first")).unwrap();
        assert!(recover(&result));
        assert_eq!(Estimate::read(&result).unwrap().name, "first");
        assert_eq!(Origin::read(&result).unwrap(), None, "it is made again");
        answers(&result, Duration::from_secs(600)).stand(&named("second")).unwrap();
        assert!(!recover(&result));
        assert_eq!(Estimate::read(&result).unwrap().name, "first");
        assert_eq!(files(folder.path()), ["a.lres"]);
    }
}
