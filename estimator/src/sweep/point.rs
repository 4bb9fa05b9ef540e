//! Measured settings, how `auto` fares among them, and the table.

use recordings::decision::TransferLevel;
use std::fmt::Write;

/// A setting is near the best if its error is at most this many times as large.
const NEAR: f64 = 1.1;
/// `auto` may take at most this many times as long as the cheapest setting near the best.
const DEAR: f64 = 2.0;

/// A setting with its time and errors.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Its name: "grid", "auto", "draft", "best", "paper", "nonsegmented", "literal", "vertices 0.25" …
    pub name: String,
    /// SH bands.
    pub bands: usize,
    /// Transfer level.
    pub transfer: TransferLevel,
    /// Rays per vertex; 0 for diffuse.
    pub rays: u32,
    /// Vertices.
    pub vertices: usize,
    /// Keyframes used.
    pub keyframes: usize,
    /// Seconds of the clock from the estimator's start to the answer, stages that settings share included.
    pub seconds: f64,
    /// Median relative error of the albedo, after one factor per channel.
    pub albedo_error: f64,
    /// The same of the irradiance.
    pub irradiance_error: f64,
    /// No other setting is both faster and better.
    pub pareto: bool,
}

impl Point {
    /// What settings are ranked by.
    #[must_use]
    pub fn error(&self) -> f64 {
        self.albedo_error + self.irradiance_error
    }
}

/// How `auto` fares against the rule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margins {
    /// Its error over the best.
    pub error: f64,
    /// Its time over that of the cheapest setting that comes near the best.
    pub seconds: f64,
}

impl Margins {
    /// The rule holds.
    #[must_use]
    pub fn hold(&self) -> bool {
        self.error <= NEAR && self.seconds <= DEAR
    }
}

/// The margins of `auto` in a sweep; `None` if it is not in it.
#[must_use]
pub fn margins(points: &[Point]) -> Option<Margins> {
    let auto = points.iter().find(|p| p.name == "auto")?;
    let best = points.iter().map(Point::error).fold(f64::INFINITY, f64::min);
    let near = points.iter().filter(|p| p.error() <= NEAR * best);
    let cheapest = near.map(|p| p.seconds).fold(f64::INFINITY, f64::min);
    Some(Margins { error: auto.error() / best, seconds: auto.seconds / cheapest })
}

/// The sweep as a table for programs.
#[must_use]
pub fn to_csv(scene: &str, points: &[Point]) -> String {
    let mut text = String::new();
    for p in points {
        let _ = writeln!(
            text,
            "{scene},{},{},{},{},{},{},{:.3},{:.5},{:.5},{:.5},{}",
            p.name,
            p.bands,
            p.transfer,
            p.rays,
            p.vertices,
            p.keyframes,
            p.seconds,
            p.albedo_error,
            p.irradiance_error,
            p.error(),
            u8::from(p.pareto)
        );
    }
    text
}

/// Head of the table.
pub const CSV_HEAD: &str = "scene,setting,bands,transfer,rays,vertices,keyframes,seconds,albedo_error,irradiance_error,\
                            error,pareto\n";
