//! Options, progress and errors of the estimator.

use recordings::result::Estimate;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// Least albedo of a reference: darker things are too dark to measure by.
const LEAST_ALBEDO: f64 = 0.01;

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum EstimateError {
    /// The scan has no triangle, or no keyframe that shows any of it.
    #[error("{0}")]
    Unusable(String),
    /// The pixel of the reference shows no surface that was seen.
    #[error("reference: {0}")]
    NoReference(String),
}

/// A thing of known albedo in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    /// Number of the keyframe, from 0.
    pub keyframe: usize,
    /// Column and row of its picture; pixel centres at integers.
    pub pixel: [f64; 2],
    /// Diffuse albedo of what the pixel shows, linear RGB.
    pub albedo: [f64; 3],
}

impl FromStr for Reference {
    type Err = String;

    /// Reads `keyframe:N:X,Y=ALBEDO`; the albedo is one number or `R,G,B`.
    fn from_str(text: &str) -> Result<Self, String> {
        let form = "must be keyframe:N:X,Y=ALBEDO, where ALBEDO is one number or R,G,B, as in keyframe:2:320,200=0.9";
        let (place, albedo) = text.split_once('=').ok_or(form)?;
        let (keyframe, pixel) = place.strip_prefix("keyframe:").and_then(|p| p.split_once(':')).ok_or(form)?;
        let (x, y) = pixel.split_once(',').ok_or(form)?;
        let number = |s: &str| s.trim().parse().ok().filter(|n: &f64| n.is_finite()).ok_or(form);
        let values = albedo.split(',').map(number).collect::<Result<Vec<f64>, _>>()?;
        let albedo = match values[..] {
            [grey] => [grey; 3],
            [red, green, blue] => [red, green, blue],
            _ => return Err(form.into()),
        };
        if !albedo.iter().all(|a| *a >= LEAST_ALBEDO && *a <= 1.0) {
            return Err(format!("the albedo must be from {LEAST_ALBEDO} to 1"));
        }
        Ok(Self { keyframe: keyframe.parse().map_err(|_| form)?, pixel: [number(x)?, number(y)?], albedo })
    }
}

impl fmt::Display for Reference {
    /// As [`FromStr`] reads it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { keyframe, pixel: [x, y], albedo: [r, g, b] } = self;
        write!(f, "keyframe:{keyframe}:{x},{y}={r},{g},{b}")
    }
}

/// Effort of a run.
#[derive(Debug, Clone)]
pub struct Options {
    /// Time from start to result.
    pub budget: Duration,
    /// Fixed number of ray rounds in place of the clock: the result is byte-identical on every machine.
    pub rounds: Option<u32>,
    /// A surface whose albedo fixes the scale, if the user knows one.
    pub reference: Option<Reference>,
    /// Megabytes that a run within a budget is planned to fit; `None` plans for time alone.
    pub memory_mb: Option<u32>,
}

/// Gets the progress of every stage.
pub trait Progress: Sync {
    /// `fraction` of stage `name` is done (0 at its start, 1 at its end).
    fn stage(&self, name: &'static str, fraction: f64);
    /// A complete result that stands before the run ends, each better than the one before. Runs without a clock have none.
    fn answer(&self, _answer: &Estimate) {}
}

/// Reports nothing.
impl Progress for () {
    fn stage(&self, _: &'static str, _: f64) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_reference_is_a_pixel_and_one_or_three_values() {
        let grey = Reference { keyframe: 3, pixel: [120.0, 80.5], albedo: [0.9; 3] };
        assert_eq!("keyframe:3:120,80.5=0.9".parse(), Ok(grey));
        assert_eq!("keyframe:3:120,80.5=0.9,0.5,0.1".parse(), Ok(Reference { albedo: [0.9, 0.5, 0.1], ..grey }));
        for bad in [
            "",
            "keyframe:3:120,80.5",
            "keyframe:3:120=0.9",
            "witness:3:1,2=0.9",
            "keyframe:-1:1,2=0.9",
            "keyframe:1:1,2=",
            "keyframe:1:1,2=0.9,0.9",
            "keyframe:1:1,2=1.5",
            "keyframe:1:1,2=0",
            "keyframe:1:1,2=nan",
            "keyframe:1:inf,2=0.9",
        ] {
            assert!(bad.parse::<Reference>().is_err(), "{bad}");
        }
    }

    proptest! {
        #[test]
        fn no_text_makes_the_parser_panic(text in "(keyframe:)?[0-9:,=.e+-]{0,30}|.{0,30}") {
            if let Ok(reference) = text.parse::<Reference>() {
                prop_assert!(reference.albedo.iter().all(|a| (LEAST_ALBEDO..=1.0).contains(a)));
                prop_assert!(reference.pixel.iter().all(|x| x.is_finite()));
            }
        }

        #[test]
        fn what_is_written_is_read(keyframe in 0usize..1000, x in 0.0..2000.0, y in 0.0..2000.0, a in 0.01..1.0) {
            let reference = Reference { keyframe, pixel: [x, y], albedo: [a, 0.5, 1.0] };
            prop_assert_eq!(reference.to_string().parse(), Ok(reference));
        }
    }
}
