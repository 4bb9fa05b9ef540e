//! What a result is made from: the scan, the settings in it, and the limits of the run.

use crate::cli::Effort;
use crate::failure::Failure;
use estimator::Reference;
use firmware_config::{Config, EstimatorConfig};
use recordings::result::Origin;
use recordings::scan::ScanIdentity;
use std::fmt::Write;
use std::path::Path;

/// What a result is made from.
pub struct Inputs {
    /// Settings of the estimator.
    pub config: EstimatorConfig,
    /// What the result will tell of them.
    pub origin: Origin,
}

impl Inputs {
    /// Reads them, without the pictures of the scan.
    ///
    /// # Errors
    /// The scan is unreadable, or its settings are those of another version.
    pub fn read(scan: &Path, effort: &Effort, reference: Option<Reference>) -> Result<Self, Failure> {
        let identity = ScanIdentity::read(scan)?;
        // Written by the program that made the scan, perhaps of another version: an unknown key is an input error.
        let mut config = Config::from_toml(&identity.config).map_err(|e| {
            Failure::Input(format!("{}: its settings: {e}; scan again with this version", scan.display()))
        })?;
        if let Some(point) = effort.quality {
            config.estimator.quality = point.setting();
        }
        let origin = Origin {
            scan: identity.digest,
            settings: recordings::sha256(settings(&config.estimator, effort, reference).as_bytes()),
            version: env!("CARGO_PKG_VERSION").into(),
        };
        Ok(Self { config: config.estimator, origin })
    }
}

/// Every setting that a result depends on, one a line. Threads change no result, and memory none that has fixed rounds.
fn settings(config: &EstimatorConfig, effort: &Effort, reference: Option<Reference>) -> String {
    let mut text = match effort.rounds {
        Some(rounds) => format!("rounds = {rounds}\n"),
        None => format!("budget_s = {}\n", effort.budget),
    };
    if let (None, Some(mb)) = (effort.rounds, effort.memory) {
        let _ = writeln!(text, "memory_mb = {mb}");
    }
    if let Some(reference) = reference {
        let _ = writeln!(text, "reference = {reference}");
    }
    for setting in config.settings().iter().chain(&config.tuning.settings()) {
        let _ = writeln!(text, "{} = {}", setting.key, setting.value);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_changes_a_result_changes_the_digest() {
        let scan = concat!(env!("CARGO_MANIFEST_DIR"), "/../recordings/data/tiny.lscan");
        let effort = |budget, rounds, quality, threads| Effort {
            budget,
            rounds,
            quality,
            threads,
            memory: threads.map(u32::from),
        };
        let origin = |effort: Effort| Inputs::read(scan.as_ref(), &effort, None).unwrap().origin;
        let draft = Some(crate::cli::QualityPoint::Draft);
        let first = origin(effort(120.0, Some(2), None, None));
        // With a fixed number of rounds no clock is read.
        assert_eq!(origin(effort(60.0, Some(2), None, Some(64))), first);
        for other in
            [effort(120.0, Some(3), None, None), effort(120.0, None, None, None), effort(120.0, Some(2), draft, None)]
        {
            let other = origin(other);
            assert!(other.settings != first.settings && other.scan == first.scan);
        }
        let white = "keyframe:0:5,5=0.9".parse().ok();
        let referred = Inputs::read(scan.as_ref(), &effort(120.0, Some(2), None, None), white).unwrap().origin;
        assert_ne!(referred.settings, first.settings);
        assert_ne!(origin(effort(120.0, None, None, None)), origin(effort(60.0, None, None, None)));
        assert_ne!(origin(effort(120.0, None, None, None)), origin(effort(120.0, None, None, Some(600))));
    }
}
