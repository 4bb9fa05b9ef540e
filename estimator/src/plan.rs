//! What a run may spend, and on what: the machine is measured, the rays are planned to fit, what is cut is written down.

use crate::Options;
use crate::scene::Scene;
use crate::transfer;
use firmware_config::EstimatorConfig;
use recordings::types::Mesh;
use std::time::{Duration, Instant};

/// Rays of one round.
pub const ROUND: u32 = 64;
/// Rays per vertex where the budget does not bind.
const DEFAULT_RAYS: u32 = 128;
/// Least rays a vertex gets.
const LEAST_RAYS: u32 = 8;
/// Share of the time left that rays may take.
const RAY_SHARE: f64 = 0.5;
/// Vertices that the speed probe traces.
const PROBE_VERTICES: usize = 512;
/// Rays that it traces from each.
const PROBE_RAYS: u32 = 16;

/// The clock and the budget of one run.
#[derive(Debug)]
pub struct Plan {
    start: Instant,
    budget: Duration,
    rounds: Option<u32>,
    /// What was cut, in words.
    pub cuts: Vec<String>,
}

impl Plan {
    /// Starts the clock.
    #[must_use]
    pub fn new(options: &Options) -> Self {
        Self { start: Instant::now(), budget: options.budget, rounds: options.rounds, cuts: Vec::new() }
    }

    fn left(&self) -> Duration {
        self.budget.saturating_sub(self.start.elapsed())
    }

    /// Rays per vertex: as set, or as rounds say, or as many as the machine traces in its share of the time left.
    pub fn rays(&mut self, mesh: &Mesh, scene: &Scene, config: &EstimatorConfig) -> u32 {
        if config.rays > 0 {
            return config.rays;
        }
        if let Some(rounds) = self.rounds {
            return ROUND * rounds.max(1);
        }
        let stride = mesh.positions.len().div_ceil(PROBE_VERTICES).max(1);
        let probe = Mesh {
            positions: mesh.positions.iter().copied().step_by(stride).collect(),
            normals: mesh.normals.iter().copied().step_by(stride).collect(),
            triangles: Vec::new(),
        };
        let before = Instant::now();
        transfer::probe(&probe, scene, PROBE_RAYS, config.seed);
        let seconds_per_ray = before.elapsed().as_secs_f64() / (probe.positions.len() as f64 * f64::from(PROBE_RAYS));
        let affordable = RAY_SHARE * self.left().as_secs_f64() / (seconds_per_ray * mesh.positions.len() as f64);
        let mut rays = DEFAULT_RAYS;
        while f64::from(rays) > affordable && rays > LEAST_RAYS {
            rays /= 2;
        }
        if rays < DEFAULT_RAYS {
            self.cuts.push(format!(
                "rays: {rays} per vertex instead of {DEFAULT_RAYS} ({:.0} rays a second here)",
                1.0 / seconds_per_ray
            ));
        }
        rays
    }
}
