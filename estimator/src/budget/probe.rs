//! Measures the speed of the machine.

use crate::budget::machine::Machine;
use crate::numerics::{random, sh};
use firmware_config::tuning::BudgetTuning;
use rayon::prelude::*;

/// Reference seconds of one slice of the probe.
const SLICE_SECONDS: f64 = 0.9e-3;
/// SH evaluations of one slice, and parallel tasks that share them.
const EVALUATIONS: u32 = 16_000;
const TASKS: u32 = 16;
/// Minimum number of slices.
const MIN_SLICES: u32 = 4;
/// A stall is recurrent if another slice took this share of the longest.
const RECURRENT: f64 = 0.2;

/// Result of the probe.
pub(super) struct Probe {
    /// Reference seconds per second.
    pub speed: f64,
    /// When it ended, seconds.
    pub end: f64,
}

/// Runs slices of work until the speed is known. `needed` are the reference seconds of the whole run, `budget` seconds of the
/// clock, `measured` those of work that was done before and tells of the machine, too. The longest slice is ignored, as a machine
/// may stall once; recurrent stalls are part of its speed.
pub(super) fn probe(machine: &dyn Machine, needed: f64, budget: f64, measured: f64, tuning: &BudgetTuning) -> Probe {
    let (mut slices, mut spent, mut longest, mut second) = (0, 0.0, 0.0f64, 0.0f64);
    let mut before = machine.now();
    loop {
        let evaluated: f32 = (0..TASKS).into_par_iter().map(slice).collect::<Vec<f32>>().iter().sum();
        std::hint::black_box(evaluated);
        machine.worked(SLICE_SECONDS);
        slices += 1;
        let now = machine.now();
        let slice = now - before;
        spent += slice;
        second = second.max(slice.min(longest));
        longest = longest.max(slice);
        before = now;
        if slices < MIN_SLICES {
            continue;
        }
        let ignored = if second < RECURRENT * longest { longest } else { 0.0 };
        let steady = (spent - ignored).max(1e-9);
        let speed = f64::from(slices - 1) * SLICE_SECONDS / steady;
        let enough = needed < tuning.clearly_enough_share * speed * (budget - now);
        if enough || measured + steady >= tuning.probe_share * budget {
            return Probe { speed, end: now };
        }
    }
}

fn slice(task: u32) -> f32 {
    let mut values = [0.0f32; sh::MAX_COEFFICIENTS];
    let mut sum = 0.0;
    for i in 0..EVALUATIONS / TASKS {
        let draw = |k| random::unit(random::hash(task * EVALUATIONS + i, k)) - 0.5;
        sh::eval_f32(glam::Vec3::new(draw(1), draw(2), draw(3)).normalize_or(glam::Vec3::Z), &mut values);
        sum += values[7];
    }
    sum
}
