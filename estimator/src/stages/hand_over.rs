//! Answers that stand before the run ends.

use crate::factorisation::Factorised;
use crate::stages::gloss::Answer;
use crate::stages::prepare::Prepared;
use crate::stages::result::{FoundLight, light, result};
use crate::stages::run::Run;
use crate::stages::scale::fix_scale;
use crate::transfer::Transfer;
use recordings::decision::{Cut, Milestone};
use recordings::local_light::{LightModel, LocalLight};
use recordings::scan::Scan;
use std::sync::Arc;

/// Hands the answer that stands after a milestone over, if that costs little of the time left; its `light`, if that is known already.
/// Changes nothing else: what follows is the same with it and without it.
pub fn hand_over(
    scan: &Scan,
    prepared: &mut Prepared,
    answer: &mut Answer,
    local_light: &LocalLight,
    known: Option<&FoundLight>,
    after: Milestone,
    run: &mut Run,
) {
    if !run.plan.hand_over() {
        return;
    }
    let Answer { found, gloss } = answer;
    // Lent, not copied: it is the largest part.
    let transfer = Transfer { traced: Arc::clone(&found.transfer.traced), bounced: found.transfer.bounced.take() };
    let (solution, detail, irradiance) = (found.solution.clone(), found.detail.clone(), found.irradiance.clone());
    let mut own = Answer { found: Factorised { transfer, solution, detail, irradiance }, gloss: gloss.clone() };
    let decisions = prepared.decisions.len();
    if after == Milestone::Albedo && local_light.model == LightModel::Distant {
        fix_scale(prepared, &mut own, run.config);
    }
    let light = known.cloned().unwrap_or_else(|| light(prepared, &mut own, local_light.model, run.config));
    let (mut estimate, transfer) = result(scan, prepared, own, local_light.clone(), light, run);
    prepared.decisions.truncate(decisions);
    estimate.cuts.push(Cut::EndOfBudget { after });
    run.progress.answer(&estimate);
    found.transfer = transfer;
    prepared.mesh = estimate.mesh;
    prepared.segment = estimate.segment;
    prepared.fields.lit_color = estimate.lit_color;
}
