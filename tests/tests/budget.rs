//! The promise of the budget, on machines that exist on paper only: time passes there as work is reported.

#![allow(clippy::expect_used, reason = "these are tests")]

use estimator::budget::{Done, Machine, Plan};
use estimator::estimate_on;
use estimator::stages::Run;
use estimator::{Options, Progress};
use firmware_config::EstimatorConfig;
use glam::Vec3;
use recordings::decision::{Cut, Milestone, Reduction};
use recordings::result::Estimate;
use recordings::scan::Scan;
use std::sync::Mutex;
use std::time::Duration;
use tests::scans::{globe, joined, scan, shaded, sheet};

/// A machine of a given speed that stalls at given times.
struct Simulated {
    /// Reference seconds a second.
    speed: f64,
    /// When it stalls, and for how long.
    stalls: Vec<(f64, f64)>,
    now: Mutex<f64>,
}

impl Simulated {
    fn new(speed: f64, stalls: &[(f64, f64)]) -> Self {
        Self { speed, stalls: stalls.to_vec(), now: Mutex::new(0.0) }
    }
}

impl Machine for Simulated {
    fn now(&self) -> f64 {
        *self.now.lock().expect("nobody panicked")
    }

    fn worked(&self, reference_seconds: f64) {
        let mut now = self.now.lock().expect("nobody panicked");
        let before = *now;
        *now += reference_seconds / self.speed;
        for (at, seconds) in &self.stalls {
            if (before..*now).contains(at) {
                *now += seconds;
            }
        }
    }
}

fn run(scan: &Scan, machine: &Simulated, budget: f64) -> Estimate {
    let options = Options { budget: Duration::from_secs_f64(budget), rounds: None, reference: None, memory_mb: None };
    let e = estimate_on(machine, scan, &EstimatorConfig::default(), &options, &()).expect("a result");
    assert!(e.albedo.iter().all(|a| a.is_finite()), "a valid result");
    assert!(e.confidence.iter().any(|c| *c > 0.1), "some albedos are known");
    e
}

/// Three walls that meet: 7500 vertices that see one another, so that light bounces.
fn corner() -> Scan {
    let at = Vec3::splat(-0.5);
    let walls = [sheet(49, at, Vec3::X, Vec3::Y), sheet(49, at, Vec3::Y, Vec3::Z), sheet(49, at, Vec3::Z, Vec3::X)];
    scan(joined(&walls), 3, 2.0, shaded)
}

#[test]
fn a_fast_machine_cuts_nothing() {
    let machine = Simulated::new(1.0, &[]);
    let e = run(&corner(), &machine, 120.0);
    assert!(e.cuts.is_empty(), "{:?}", e.cuts);
    assert!(machine.now() < 120.0);
}

#[test]
fn slower_machines_cut_in_order_and_keep_the_budget() {
    let scan = corner();
    let mut last = 0;
    for (speed, budget) in [(0.05, 60.0), (0.01, 120.0), (0.01, 60.0)] {
        let machine = Simulated::new(speed, &[]);
        let e = run(&scan, &machine, budget);
        let now = machine.now();
        println!("{speed} of the reference, {budget} s: {now:.1} s, cuts {:?}", e.cuts);
        assert!(now <= budget, "{now} s of {budget}");
        let cut = |is: fn(&Cut) -> bool| e.cuts.iter().any(is);
        let vertices = cut(|c| matches!(c, Cut::Planned { what: Reduction::Vertices { .. }, .. }));
        let bounces = cut(|c| matches!(c, Cut::Planned { what: Reduction::Bounces { .. }, .. }));
        let rays = cut(|c| {
            matches!(
                c,
                Cut::Planned { what: Reduction::Rays { .. }, .. } | Cut::FewerRays { .. } | Cut::LateRays { .. }
            )
        });
        assert!(!vertices || rays, "rays before vertices: {:?}", e.cuts);
        assert!(!rays || bounces, "bounces before rays: {:?}", e.cuts);
        assert!(!e.cuts.iter().any(Cut::is_abandoned), "planned, not abandoned: {:?}", e.cuts);
        assert!(e.cuts.len() >= last, "a slower machine cuts no less");
        last = e.cuts.len();
    }
    assert!(last > 0, "the slowest machine had to cut");
}

#[test]
fn stalls_are_survived_wherever_they_come() {
    let scan = corner();
    for at in [0.01, 1.0, 3.0, 6.0, 9.0, 12.0] {
        let machine = Simulated::new(0.1, &[(at, 10.0)]);
        let e = run(&scan, &machine, 40.0);
        let now = machine.now();
        println!("10 s lost at {at} s: {now:.1} s, cuts {:?}", e.cuts);
        assert!(now <= 40.0, "10 s lost at {at} s: {now} s");
    }
}

#[test]
fn a_stall_while_the_machine_is_measured_makes_it_no_slow_machine() {
    let machine = Simulated::new(1.0, &[(0.003, 10.0)]);
    let e = run(&corner(), &machine, 120.0);
    assert!(machine.now() > 10.0, "it stalled");
    assert!(e.cuts.is_empty(), "{:?}", e.cuts);
}

#[test]
fn a_machine_that_is_halted_again_and_again_is_slow() {
    let stalls: Vec<(f64, f64)> = (0..40).map(|second| (f64::from(second) + 0.25, 0.75)).collect();
    let machine = Simulated::new(0.2, &stalls);
    let e = run(&corner(), &machine, 30.0);
    let now = machine.now();
    println!("a quarter of 0.2 of the reference: {now:.1} s, cuts {:?}", e.cuts);
    assert!(now <= 30.0, "{now} s");
    assert!(!e.cuts.iter().any(Cut::is_abandoned), "planned, not abandoned: {:?}", e.cuts);
}

#[test]
fn what_was_cut_is_taken_back_when_there_turns_out_to_be_time() {
    let (scan, config) = (corner(), EstimatorConfig::default());
    let size = Run::size(&scan, &config);
    let options = |milliseconds| Options {
        budget: Duration::from_millis(milliseconds),
        rounds: None,
        reference: None,
        memory_mb: None,
    };
    let has_gloss = |milliseconds| {
        Plan::new(&Simulated::new(0.2, &[]), &options(milliseconds), &config, size, Done::default()).workload().specular
    };
    // The most time that gloss is not planned for; then no round of pose refinement is asked for, which was planned.
    let (mut cut, mut kept) = (1_000, 60_000);
    while kept - cut > 100 {
        let middle = (cut + kept) / 2;
        *(if has_gloss(middle) { &mut kept } else { &mut cut }) = middle;
    }
    let machine = Simulated::new(0.2, &[]);
    let options = options(cut);
    let mut plan = Plan::new(&machine, &options, &config, size, Done::default());
    let is_cut = |plan: &Plan| plan.cuts().iter().any(|c| matches!(c, Cut::Planned { what: Reduction::Specular, .. }));
    assert!(is_cut(&plan), "{:?}", plan.cuts());
    plan.mesh_done(scan.mesh.positions.len());
    plan.association_done();
    plan.segmentation_done();
    assert!(plan.workload().specular && !is_cut(&plan), "{cut} ms: {:?}", plan.cuts());
}

#[test]
fn bounces_that_were_cut_are_made_up_for_when_there_turns_out_to_be_time() {
    let (scan, config) = (corner(), EstimatorConfig::default());
    let mut size = Run::size(&scan, &config);
    size.vertices = 200_000.0;
    let machine = Simulated::new(1.0, &[]);
    let options = Options { budget: Duration::from_secs(100), rounds: None, reference: None, memory_mb: None };
    let mut plan = Plan::new(&machine, &options, &config, size, Done::default());
    *machine.now.lock().expect("nobody panicked") += 30.0;
    let is_cut =
        |plan: &Plan| plan.cuts().iter().any(|c| matches!(c, Cut::Planned { what: Reduction::Bounces { .. }, .. }));
    let (bounces, _) = plan.light(0.4);
    assert!(bounces == 1 && is_cut(&plan), "30 s were lost: {:?}", plan.cuts());
    let rays = plan.more_rays(64, 64, 0.4, 5, 1);
    assert!(rays == 64 && plan.workload().bounces == 1 && is_cut(&plan), "no time yet: {:?}", plan.cuts());
    plan.worked(15.0);
    assert!(plan.has_spare(), "{:?}", plan.cuts());
    let rays = plan.more_rays(64, 64, 0.4, 5, 1);
    assert!(rays == 64 && plan.workload().bounces == config.bounces && !is_cut(&plan), "{:?}", plan.cuts());
    plan.bounces_stay(1);
    assert!(is_cut(&plan), "they were not made: {:?}", plan.cuts());
}

#[test]
fn rays_that_do_not_come_in_time_are_given_up_and_said_to_be() {
    let (scan, config) = (corner(), EstimatorConfig::default());
    let machine = Simulated::new(1.0, &[]);
    let options = Options { budget: Duration::from_secs(40), rounds: None, reference: None, memory_mb: None };
    let mut plan = Plan::new(&machine, &options, &config, Run::size(&scan, &config), Done::default());
    let stall = |seconds: f64| *machine.now.lock().expect("nobody panicked") += seconds;
    let watch = plan.watch_rays(64);
    assert!(watch(0.1), "all is well");
    stall(20.0);
    assert!(!watch(0.15), "at this pace they would take minutes");
    drop(watch);
    assert_eq!(plan.fewer_rays(64, 0), Some(16));
    assert!(plan.cuts().contains(&Cut::LateRays { rays: 16, instead_of: 64 }), "{:?}", plan.cuts());
    stall(19.5);
    assert_eq!(plan.fewer_rays(256, 64), None, "a quarter of them is there already");
    assert!(plan.cuts().contains(&Cut::LateRays { rays: 64, instead_of: 256 }), "{:?}", plan.cuts());
    assert_eq!(plan.fewer_rays(16, 0), None, "no time for any");
    assert!(plan.cuts().iter().any(Cut::is_abandoned), "{:?}", plan.cuts());
}

/// When each answer stood, its vertices and what it lacks.
struct Answers<'a>(&'a Simulated, Mutex<Vec<(f64, Estimate)>>);

impl Progress for Answers<'_> {
    fn stage(&self, _: &'static str, _: f64) {}

    fn answer(&self, estimate: &Estimate) {
        self.1.lock().expect("nobody panicked").push((self.0.now(), estimate.clone()));
    }
}

#[test]
fn complete_answers_stand_before_the_last_one() {
    let (scan, machine, budget) = (corner(), Simulated::new(0.05, &[]), 60.0);
    let answers = Answers(&machine, Mutex::default());
    let options = Options { budget: Duration::from_secs_f64(budget), rounds: None, reference: None, memory_mb: None };
    let last = estimate_on(&machine, &scan, &EstimatorConfig::default(), &options, &answers).expect("a result");
    let answers = answers.1.into_inner().expect("nobody panicked");
    let lacks = |e: &Estimate| e.cuts.last().cloned();
    let after = |after| Some(Cut::EndOfBudget { after });
    let [(early, first), (_, light), (_, gloss)] = answers.as_slice() else { panic!("{} answers", answers.len()) };
    assert!(*early <= 0.15 * budget, "the first answer after {early} s of {budget}");
    assert!(matches!(lacks(first), Some(Cut::FirstAnswer { .. })), "{:?}", first.cuts);
    assert_eq!((lacks(light), lacks(gloss)), (after(Milestone::Albedo), after(Milestone::Gloss)));
    for (_, answer) in &answers {
        assert!(answer.confidence.iter().any(|c| *c > 0.1), "some albedos are known");
        answer.write(tempfile::NamedTempFile::new().expect("a file").path()).expect("a valid result");
    }
    assert!(first.mesh.positions.len() < last.mesh.positions.len(), "coarse");
    assert_eq!(light.mesh, last.mesh);
    assert!(!last.cuts.iter().any(|c| matches!(c, Cut::EndOfBudget { .. } | Cut::FirstAnswer { .. })));
}

/// Rounds replace the clock: whatever the machine does, the bytes are the same.
#[test]
fn rounds_replace_the_clock() {
    let scan = scan(globe(24, 0.5, 1.0), 3, 2.0, shaded);
    let options = Options { budget: Duration::from_millis(1), rounds: Some(1), reference: None, memory_mb: None };
    let run = |speed| {
        let machine = Simulated::new(speed, &[(0.0, 10.0)]);
        let answers = Answers(&machine, Mutex::default());
        let e = estimate_on(&machine, &scan, &EstimatorConfig::default(), &options, &answers).expect("a result");
        assert!(answers.1.into_inner().expect("nobody panicked").is_empty(), "there is one answer");
        assert_eq!(machine.now(), 0.0, "the clock is neither read nor advanced");
        e
    };
    let (fast, slow) = (run(1.0), run(1e-6));
    assert!(fast == slow && fast.cuts.is_empty());
}
