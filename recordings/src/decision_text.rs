//! Sentences for decisions, cuts and warnings: the one place where they are worded. Programs read the types.

use crate::decision::{
    BouncedLight, Cut, Decision, DecisionText, ExposureModel, Milestone, PositionEvidence, Reduction, ResponseTest,
    ScaleBasis, TransferNext, Warning,
};
use crate::local_light::LightModel;
use crate::types::Response;
use serde::Serialize;
use std::fmt;

/// Decisions, cuts and warnings as `inspect --json` and `manifest.json` show them: sentences, and the figures in them.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Findings {
    /// What was decided, and why.
    pub decisions: Vec<DecisionEntry>,
    /// What was cut for the budget.
    pub cuts: Vec<String>,
    /// The figures of the cuts.
    pub cut_values: Vec<Cut>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// The figures of the warnings.
    pub warning_values: Vec<Warning>,
}

/// A decision as text and figures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DecisionEntry {
    /// As text.
    #[serde(flatten)]
    pub text: DecisionText,
    /// The figures; `None` in results that were written before decisions were typed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub evidence_values: Option<Decision>,
}

impl Findings {
    /// Words decisions, cuts and warnings.
    #[must_use]
    pub fn new(decisions: &[Decision], cuts: &[Cut], warnings: &[Warning]) -> Self {
        let entry = |d: &Decision| DecisionEntry {
            text: d.text(),
            evidence_values: (!matches!(d, Decision::Text(_))).then(|| d.clone()),
        };
        Self {
            decisions: decisions.iter().map(entry).collect(),
            cuts: cuts.iter().map(ToString::to_string).collect(),
            cut_values: cuts.to_vec(),
            warnings: warnings.iter().map(ToString::to_string).collect(),
            warning_values: warnings.to_vec(),
        }
    }
}

impl Decision {
    /// The decision in sentences.
    #[must_use]
    pub fn text(&self) -> DecisionText {
        if let Self::Text(text) = self {
            return text.clone();
        }
        DecisionText {
            name: self.name().into(),
            choice: self.choice(),
            evidence: self.evidence(),
            cost: self.cost(),
            next_level: self.next_level(),
        }
    }

    /// What was decided.
    fn name(&self) -> &'static str {
        match self {
            Self::Text(_) => "",
            Self::Response { .. } => "response",
            Self::Exposure { .. } => "exposure",
            Self::Pose { .. } => "pose",
            Self::Bands { .. } => "bands",
            Self::RaysWithoutGloss { .. } => "rays without gloss",
            Self::Specular { .. } => "specular",
            Self::BandsWithoutGloss { .. } => "bands without gloss",
            Self::DistantLight { .. } => "distant light",
            Self::Witnesses { .. } => "witnesses",
            Self::Transfer { .. } => "transfer",
            Self::LightModel { .. } => "light model",
            Self::AlbedoScale { .. } => "albedo scale",
            Self::Texture { .. } => "texture",
            Self::Veil { .. } => "veiling glare",
            Self::Materials { .. } => "materials",
            Self::NearLight { .. } => "near light",
            Self::LightChroma { .. } => "colour of the light",
            Self::Background(_) => "background",
            Self::Division { .. } => "segments",
            Self::Haze { .. } => "glare",
            Self::Vignetting { .. } => "vignetting",
            Self::Shoulder { .. } => "highlights",
        }
    }

    fn choice(&self) -> String {
        match self {
            Self::Text(text) => text.choice.clone(),
            Self::Response { stated, .. } => stated.to_string(),
            Self::Exposure { chosen, .. } => match chosen {
                ExposureModel::None => "none".into(),
                ExposureModel::Scalar => "scalar".into(),
                ExposureModel::Rgb => "rgb".into(),
            },
            Self::Pose { refined, .. } => if *refined { "refined" } else { "off" }.into(),
            Self::Bands { chosen, .. }
            | Self::RaysWithoutGloss { chosen, .. }
            | Self::BandsWithoutGloss { chosen, .. } => chosen.to_string(),
            Self::Specular { cleaned: true, .. } => "lit colours cleaned of gloss and factorised once more".into(),
            Self::Specular { cleaned: false, .. } => "none".into(),
            Self::DistantLight { holds, .. } => if *holds { "holds" } else { "contradicted" }.into(),
            Self::Witnesses { refined: true, .. } => "from the pose that each tells".into(),
            Self::Witnesses { refined: false, .. } => "as tracked".into(),
            Self::Transfer { chosen, .. } => chosen.to_string(),
            Self::LightModel { chosen, .. } => rung(*chosen).into(),
            Self::AlbedoScale { chosen: ScaleBasis::Likely, brightest, quantile, .. } => format!(
                "light and surfaces neutral on the whole, albedo luminance {brightest:.2} at the {:.0} % quantile",
                100.0 * quantile
            ),
            Self::AlbedoScale { chosen: ScaleBasis::SecondaryLight, .. } => {
                "by the secondary light as it was observed, light and surfaces neutral on the whole".into()
            }
            Self::AlbedoScale { chosen: ScaleBasis::Reference { albedo }, .. } => {
                format!("by the reference, whose albedo is {}", list(albedo, 3))
            }
            Self::Texture { atlas: Some(atlas), .. } => format!("{:.2} mm a texel", 1e3 * atlas.texel_m),
            Self::Texture { atlas: None, .. } => "none".into(),
            Self::Veil { share, .. } => format!("{:.1} %", 100.0 * share),
            Self::Materials { materials, .. } => materials.to_string(),
            Self::LightChroma { weight: 0.0, .. } => "each channel for itself".into(),
            Self::LightChroma { weight, .. } => format!("drawn together by {}", brief(*weight)),
            Self::Background(b) => {
                let used = if b.weight > 0.0 {
                    format!("light drawn to it by {}", brief(b.weight))
                } else {
                    "not used".into()
                };
                b.correlation
                    .map_or(used.clone(), |c| format!("{used}, which correlates {c:.2} with what was left out"))
            }
            Self::Division { parts, .. } => format!("divided into {parts}"),
            Self::Haze { glare } => {
                let keyframes: Vec<String> = glare.iter().map(|(k, _)| k.to_string()).collect();
                format!("left out: keyframes {}", keyframes.join(", "))
            }
            Self::Vignetting { strength, .. } => {
                format!("corners {:.0} % darker", 100.0 * (1.0 - libm::exp(-strength)))
            }
            Self::Shoulder { strength, .. } => format!("white stands for {:.2} × as much light", 1.0 + strength),
            Self::NearLight { accepted, .. } => if *accepted { "in place of distant light" } else { "refused" }.into(),
        }
    }

    fn evidence(&self) -> String {
        match self {
            Self::Text(text) => text.evidence.clone(),
            Self::Response { values, min_exposure_ratio: ratio, test: Some(test), stated, .. } => {
                let ResponseTest { alternative, stated_change, alternative_change } = test;
                format!(
                    "{values} values seen at exposures {ratio} × apart or more: the factor between them changes by {:.1} % \
                     from dark to bright with {stated}, by {:.1} % with {}",
                    100.0 * stated_change,
                    100.0 * alternative_change,
                    family(*alternative),
                )
            }
            Self::Response { min_exposure_ratio: ratio, min_shared, test: None, .. } => {
                format!("not verified: no two keyframes share {min_shared} points at exposures {ratio} × apart")
            }
            Self::Exposure { none, scalar, rgb, .. } => {
                format!("disagreement of held-out patches (0 to 1): none {none:.4}, scalar {scalar:.4}, rgb {rgb:.4}")
            }
            Self::Pose { steps_px, first_residual, last_residual, .. } => format!(
                "RMS step per round in pixels: {}; residual of edge pixels {first_residual:.4} at first, \
                 {last_residual:.4} at last",
                list(steps_px, 2),
            ),
            Self::Bands { held_out, condition, .. } => {
                let tried: Vec<String> = held_out.iter().map(|(n, e)| format!("{n}: {e:.4}")).collect();
                format!(
                    "mean relative error on vertices left out, by bands: {}; condition {condition:.1e}",
                    tried.join(", ")
                )
            }
            Self::RaysWithoutGloss { chosen, before, held_out, error_before, error, .. } => format!(
                "mean relative error on vertices left out: {held_out:.4} without gloss; relative standard error of the \
                 transfer: {error_before:.4} with {before} rays, {error:.4} with {chosen}"
            ),
            Self::Specular { segments, glossy, exposure_change, without_gloss, with_gloss, .. } => {
                let exposed = exposure_change.map_or(String::new(), |moved| {
                    format!("; exposures by matte segments alone differ by {moved:.4} (RMS of logs)")
                });
                match without_gloss {
                    None => format!("no weight stands out of its error in {segments} segments{exposed}"),
                    Some(without) => format!(
                        "{glossy} of {segments} segments; mean relative error against the keyframes: {without:.4} without \
                         gloss, {} with it{exposed}",
                        list(with_gloss, 4),
                    ),
                }
            }
            Self::BandsWithoutGloss { before, tried, error_before, errors, .. } => format!(
                "mean relative error against the keyframes: {error_before:.4} with {before} bands, {} with {tried}",
                list(errors, 4),
            ),
            Self::DistantLight { position, .. } => position.to_string(),
            Self::Witnesses {
                frames,
                lit_psnr_db: lit,
                model_psnr_db: model,
                moved_px,
                tracked_lit_psnr_db: tracked_lit,
                tracked_model_psnr_db: tracked_model,
                ..
            } => format!(
                "{frames} frames that no step used: {lit:.1} dB from the lit colours, {model:.1} dB from the model; from \
                 the poses they were tracked at, {moved_px:.1} px off, {tracked_lit:.1} and {tracked_model:.1} dB"
            ),
            Self::Transfer { rays, blocked, relative_error, bounced, .. } => {
                let bounced = bounced.map_or(String::new(), |BouncedLight { bounces, share, last_share }| {
                    let (share, last) = (100.0 * share, 100.0 * last_share);
                    format!("; {bounces} bounces bring {share:.1} % of the light, the last {last:.2} %")
                });
                format!(
                    "{:.1} % of the rays are blocked{bounced}; {rays} rays a vertex, relative standard error \
                     {relative_error:.3}",
                    100.0 * blocked
                )
            }
            Self::LightModel { ladder, .. } => {
                let tried: Vec<String> =
                    ladder.iter().map(|r| format!("{} {:.4}", rung(r.model), r.held_out)).collect();
                format!("mean relative error on held-out blocks of surface: {}", tried.join(", "))
            }
            Self::AlbedoScale { irradiance_color, albedo_color, near_white, quantile, brightest, .. } => format!(
                "colour of the median irradiance {}, of the mean albedo {}; {:.0} % of the seen surface is near white; the \
                 {:.0} % quantile of the albedo's luminance is {brightest:.2}",
                list(irradiance_color, 2),
                list(albedo_color, 2),
                100.0 * near_white,
                100.0 * quantile,
            ),
            Self::Texture { footprint_m, atlas: Some(atlas), prediction } => {
                let predicted = prediction.map_or(String::new(), |p| {
                    format!(
                        "; validation frames: {:.1} dB and {:.0} % of their upper octave's energy, {:.1} dB and {:.0} % \
                         without it",
                        p.psnr_db,
                        100.0 * p.sharpness,
                        p.vertices_psnr_db,
                        100.0 * p.vertices_sharpness
                    )
                });
                format!(
                    "a pixel covers {:.2} mm where the surface is seen from near; keyframes show {:.0} % of the texels{predicted}",
                    1e3 * footprint_m,
                    100.0 * atlas.seen
                )
            }
            Self::Texture { atlas: None, .. } => "no keyframe shows the mesh, or its charts fit no page".into(),
            Self::Veil { most, held_out, .. } => {
                let tried: Vec<String> = held_out.iter().map(|(s, e)| format!("{:.1} %: {e:.4}", 100.0 * s)).collect();
                format!(
                    "mean relative error on vertices left out, by the share of the light that is scattered: {}; the \
                     darkest colours hold {:.1} % at most",
                    tried.join(", "),
                    100.0 * most
                )
            }
            Self::NearLight { distant, near, most, .. } => format!(
                "mean relative error on means of held-out patches: distant {distant:.4}, the best near model {near:.4}; at \
                 most {most:.2} of the former is asked for, since gloss can look like a lamp"
            ),
            Self::LightChroma { held_out, .. } => format!(
                "RMS relative change of the irradiance of vertices left out, by the weight of a radiance that the channels have in common: {}",
                by_weight(held_out)
            ),
            Self::Background(b) => {
                let tried = if b.held_out.is_empty() {
                    String::new()
                } else {
                    format!(
                        "RMS relative change of the irradiance of vertices left out, by the weight of what was seen: {}; ",
                        by_weight(&b.held_out)
                    )
                };
                format!(
                    "{tried}{} keyframes that were left out show {} directions beyond the scan",
                    b.keyframes, b.directions
                )
            }
            Self::Division { segments, held_out_segments, held_out, .. } => format!(
                "mean relative error on held-out blocks of surface: {held_out_segments:.4} with an albedo for \
                 each of {segments} segments, {held_out:.4} with one for each of their parts that face one way and differ"
            ),
            Self::Haze { glare } => {
                let shares: Vec<String> = glare.iter().map(|(_, share)| format!("{share:.2}")).collect();
                format!("share of glare in the light over the surface that they show: {}", shares.join(", "))
            }
            Self::Vignetting { without, with, .. } => format!(
                "disagreement of held-out patches (0 to 1): {without:.4} with even pictures, {with:.4} with the vignetting \
                 that the others tell"
            ),
            Self::Shoulder { without, with, .. } => format!(
                "disagreement of held-out patches (0 to 1): {without:.4} as in sRGB, {with:.4} with highlights compressed as the \
                 others tell"
            ),
            Self::Materials { segments, held_out_segments, held_out, .. } => format!(
                "mean relative error on vertices left out: {held_out_segments:.4} with an albedo for each of {segments} \
                 segments, {held_out:.4} with one for those of like albedo"
            ),
        }
    }

    fn cost(&self) -> String {
        match self {
            Self::Text(text) => text.cost.clone(),
            Self::Response { values, .. } => format!("{values} values compared"),
            Self::Exposure { patches, .. } => format!("{patches} patches"),
            Self::Pose { steps_px, .. } => format!("{} rounds", steps_px.len()),
            Self::Bands { chosen, .. } => format!("{} unknowns a channel", chosen * chosen),
            Self::RaysWithoutGloss { chosen: rays, vertices, .. } | Self::Transfer { rays, vertices, .. } => {
                format!("{:.1} million rays", f64::from(*vertices) * f64::from(*rays) / 1e6)
            }
            Self::Specular { segments, with_gloss, .. } => {
                format!("{segments} segments fitted, {} factorisations", with_gloss.len())
            }
            Self::BandsWithoutGloss { errors, .. } => format!("{} factorisations", errors.len()),
            Self::DistantLight { vertices, .. } => format!("{vertices} vertices"),
            Self::Witnesses { frames, .. } => format!("{frames} frames rendered"),
            Self::LightModel { samples, ladder, .. } => format!("{} models, {samples} vertices each", ladder.len()),
            Self::AlbedoScale { vertices, .. } => format!("{vertices} vertices"),
            Self::Texture { atlas: Some(atlas), .. } => {
                format!("{} texels of {} × {} in {} charts", atlas.texels, atlas.width, atlas.height, atlas.charts)
            }
            Self::Texture { atlas: None, .. } => String::new(),
            Self::Veil { held_out, .. } => format!("{} shares tried", held_out.len()),
            Self::Materials { .. } => "2 factorisations".into(),
            Self::NearLight { .. } | Self::Division { .. } => "2 models compared".into(),
            Self::Haze { glare } => format!("{} pictures", glare.len()),
            Self::Vignetting { patches, .. } | Self::Shoulder { patches, .. } => format!("{patches} patches"),
            Self::LightChroma { held_out, .. } => format!("{} solutions of the light", held_out.len()),
            Self::Background(b) => format!("{} pictures", b.keyframes),
        }
    }

    fn next_level(&self) -> String {
        match self {
            Self::Text(text) => text.next_level.clone(),
            Self::Response { .. } => "a response that is measured with a grey card".into(),
            Self::Exposure { chosen, scalar, rgb, .. } => match chosen {
                ExposureModel::None => format!("one gain a keyframe: {scalar:.4}"),
                ExposureModel::Scalar => format!("rgb gains: {rgb:.4}"),
                ExposureModel::Rgb => String::new(),
            },
            Self::Pose { steps_px, .. } => {
                steps_px.last().map_or(String::new(), |s| format!("another round: a step of less than {s:.2} px"))
            }
            Self::Bands { next, .. } => next.map_or(String::new(), |n| {
                format!("{} bands: held-out error lower by {:.5} ± {:.5}", n.bands, n.gain, n.standard_error)
            }),
            Self::RaysWithoutGloss { before, .. } => format!("{before} rays were chosen before gloss was known"),
            Self::Specular { cleaned: false, without_gloss: Some(without), with_gloss, .. } => with_gloss
                .first()
                .map_or(String::new(), |with| format!("without gloss: {with:.4} instead of {without:.4}")),
            Self::Specular { with_gloss, .. } => match with_gloss[..] {
                [.., best, last] if last > best => format!("once more: {last:.4}"),
                _ => String::new(),
            },
            Self::BandsWithoutGloss { first, .. } => format!("{first} bands were chosen before gloss was known"),
            Self::DistantLight { .. } => "light that depends on position is not modelled".into(),
            Self::Witnesses { own_psnr_db: own, .. } => {
                format!("their own colours on this mesh: {own:.1} dB, more takes smaller triangles or truer ones")
            }
            Self::Transfer { next, .. } => match next {
                TransferNext::Visibility => "visibility: less than the colours err".into(),
                TransferNext::GreyBounce { share } => {
                    format!("one bounce between mid-grey surfaces: {:.2} % of the light", 100.0 * share)
                }
                TransferNext::TwiceRays { relative_error } => {
                    format!("twice the rays: relative standard error about {relative_error:.3}")
                }
            },
            Self::LightModel { .. } | Self::AlbedoScale { chosen: ScaleBasis::Reference { .. }, .. } => String::new(),
            Self::AlbedoScale { .. } => {
                "a surface of known albedo, stated with `estimate --reference keyframe:N:X,Y=ALBEDO`".into()
            }
            Self::Texture { footprint_m, atlas: Some(atlas), .. } if atlas.texel_m > *footprint_m => {
                "finer texels: a larger texture.max_side".into()
            }
            Self::Texture { .. } => "finer texels show nothing that the pictures show".into(),
            Self::Veil { .. }
            | Self::Materials { .. }
            | Self::NearLight { .. }
            | Self::Division { .. }
            | Self::Vignetting { .. }
            | Self::Shoulder { .. }
            | Self::LightChroma { .. }
            | Self::Background(_) => String::new(),
            Self::Haze { .. } => "keep lamps and windows out of the picture".into(),
        }
    }
}

/// What a model of light is called in the ladder.
fn rung(model: LightModel) -> &'static str {
    match model {
        LightModel::Secondary => "distant with observed secondary light",
        other => other.name(),
    }
}

impl fmt::Display for Cut {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Text(text) => f.write_str(text),
            Self::Planned { what, speed } => {
                write!(f, "{what} (planned for a machine {speed:.2} times as fast as the reference)")
            }
            Self::FewerRays { rays, instead_of } => write!(f, "rays: {rays} per vertex instead of {instead_of}"),
            Self::LateRays { rays, instead_of } => {
                write!(f, "rays: {rays} per vertex, since {instead_of} were not there in time")
            }
            Self::Specular => f.write_str("specular: not looked for"),
            Self::Texture => f.write_str("texture: not made"),
            Self::Materials => f.write_str("veiling glare, materials of like albedo: not looked for"),
            Self::LocalLight => f.write_str("light: lamps and emitting surfaces were not looked for"),
            Self::Witnesses { predicted, of } => write!(f, "witnesses: {predicted} of {of} predicted"),
            Self::AbandonedTransfer { rays } => write!(f, "abandoned: transfer with {rays} rays per vertex"),
            Self::FirstAnswer { vertices, keyframes } => {
                write!(f, "end of the budget: the first answer, from {vertices} vertices and {keyframes} keyframes")
            }
            Self::EndOfBudget { after: Milestone::Albedo } => f.write_str(
                "end of the budget: without what follows light and albedo (glare, materials, gloss, texture)",
            ),
            Self::EndOfBudget { after: Milestone::Gloss } => {
                f.write_str("end of the budget: without what follows gloss (texture, prediction of validation frames)")
            }
            Self::Memory { what, limit_mb } => write!(f, "{what} (for {limit_mb} MB of memory)"),
        }
    }
}

impl fmt::Display for Reduction {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Bounces { to, from } => {
                let from = from.map_or("as many as matter".into(), |n| n.to_string());
                write!(f, "bounces: {to} instead of {from}, the rest in proportion")
            }
            Self::Rays { to, from } => write!(f, "rays: {to} per vertex instead of {from}"),
            Self::PoseRounds { to, from } => write!(f, "pose refinement: {to} rounds instead of {from}"),
            Self::Specular => f.write_str("specular: not looked for"),
            Self::Texture => f.write_str("texture: not made"),
            Self::Bands { to, from } => write!(f, "bands: at most {to} instead of {from}"),
            Self::Keyframes { stride, of } => write!(f, "keyframes: every {stride}nd of {of}"),
            Self::Vertices { to, from } => write!(f, "vertices: about {to} instead of {from}"),
        }
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Text(text) => f.write_str(text),
            Self::ResponseMismatch { stated, better } => write!(
                f,
                "the colour response {stated} does not fit the pictures; {} does: set camera.response",
                family(*better)
            ),
            Self::LightNotDistant(evidence) => write!(f, "light_not_distant: {evidence}"),
            Self::OneKeyframe => f.write_str("one keyframe: exposure, pose and gloss cannot be told"),
            Self::UnseenLight { directions } => write!(
                f,
                "light: {directions} of the 3 directions of its first band are not told by these surfaces; the rest of the \
                 light cannot be seen from here"
            ),
        }
    }
}

impl fmt::Display for PositionEvidence {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(
            f,
            "position explains {:.0} % of what light and albedo leave unexplained at equal normals, on vertices left out; \
             it changes the light by {:.0} %",
            100.0 * self.explained,
            100.0 * self.change
        )
    }
}

impl fmt::Display for Response {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Srgb => f.write_str("srgb"),
            Self::Linear => f.write_str("linear"),
            Self::Gamma(gamma) => write!(f, "gamma:{gamma}"),
            Self::Shoulder(strength) => write!(f, "srgb with a shoulder of {strength:.2}"),
        }
    }
}

/// The responses that pass the test of exposures where this one does: all powers do alike.
fn family(response: Response) -> &'static str {
    match response {
        Response::Srgb | Response::Shoulder(_) => "srgb",
        Response::Linear | Response::Gamma(_) => "linear or gamma:2.2",
    }
}

/// A weight in two significant digits.
fn brief(weight: f64) -> String {
    format!("{weight:.1e}").parse().unwrap_or(weight).to_string()
}

/// Errors by the weights that were tried.
fn by_weight(tried: &[(f64, f64)]) -> String {
    let tried: Vec<String> = tried.iter().map(|(weight, error)| format!("{}: {error:.4}", brief(*weight))).collect();
    tried.join(", ")
}

fn list(values: &[f64], digits: usize) -> String {
    values.iter().map(|x| format!("{x:.digits$}")).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decision::{BackgroundLikeness, TransferLevel};
    use crate::testing::{cuts, decisions, warnings};

    fn line(d: &Decision) -> String {
        let DecisionText { name, choice, evidence, cost, next_level } = d.text();
        format!("{name} | {choice} | {evidence} | {cost} | {next_level}")
    }

    /// Programs read these strings from `inspect --json` and `manifest.json`: they stay.
    #[test]
    fn decisions_keep_their_wording() {
        let lines: Vec<String> = decisions().iter().map(line).collect();
        assert_eq!(
            lines,
            [
                "old |  |  |  | ",
                "response | srgb | 900 values seen at exposures 1.5 × apart or more: the factor between them changes by \
                 1.2 % from dark to bright with srgb, by 23.4 % with linear or gamma:2.2 | 900 values compared | a response \
                 that is measured with a grey card",
                "response | gamma:2.2 | not verified: no two keyframes share 200 points at exposures 1.5 × apart | 0 values \
                 compared | a response that is measured with a grey card",
                "exposure | scalar | disagreement of held-out patches (0 to 1): none 0.5000, scalar 0.2500, rgb 0.2400 | 70 \
                 patches | rgb gains: 0.2400",
                "pose | refined | RMS step per round in pixels: 0.52, 0.13; residual of edge pixels 0.0310 at first, 0.0220 \
                 at last | 2 rounds | another round: a step of less than 0.13 px",
                "bands | 3 | mean relative error on vertices left out, by bands: 3: 0.0100, 5: 0.0099; condition 1.2e2 | 9 \
                 unknowns a channel | 5 bands: held-out error lower by 0.00010 ± 0.00020",
                "rays without gloss | 256 | mean relative error on vertices left out: 0.0500 without gloss; relative \
                 standard error of the transfer: 0.0200 with 128 rays, 0.0140 with 256 | 2.6 million rays | 128 rays were \
                 chosen before gloss was known",
                "specular | none | no weight stands out of its error in 7 segments | 7 segments fitted, 0 factorisations | ",
                "specular | none | 2 of 7 segments; mean relative error against the keyframes: 0.1000 without gloss, 0.1200 \
                 with it | 7 segments fitted, 1 factorisations | without gloss: 0.1200 instead of 0.1000",
                "specular | lit colours cleaned of gloss and factorised once more | 2 of 7 segments; mean relative error \
                 against the keyframes: 0.1000 without gloss, 0.0900, 0.0950 with it; exposures by matte segments alone \
                 differ by 0.0040 (RMS of logs) | 7 segments fitted, 2 factorisations | once more: 0.0950",
                "bands without gloss | 5 | mean relative error against the keyframes: 0.0900 with 3 bands, 0.0800, 0.0810 \
                 with 5 | 2 factorisations | 3 bands were chosen before gloss was known",
                "distant light | contradicted | position explains 30 % of what light and albedo leave unexplained at equal \
                 normals, on vertices left out; it changes the light by 9 % | 5000 vertices | light that depends on \
                 position is not modelled",
                "witnesses | from the pose that each tells | 4 frames that no step used: 30.0 dB from the lit colours, 28.0 \
                 dB from the model; from the poses they were tracked at, 1.5 px off, 25.0 and 24.0 dB | 4 frames rendered | \
                 their own colours on this mesh: 35.0 dB, more takes smaller triangles or truer ones",
                "transfer | diffuse | 0.5 % of the rays are blocked; 0 rays a vertex, relative standard error 0.000 | 0.0 \
                 million rays | visibility: less than the colours err",
                "transfer | gi | 20.0 % of the rays are blocked; 8 bounces bring 10.0 % of the light, the last 0.05 %; 128 \
                 rays a vertex, relative standard error 0.020 | 1.3 million rays | twice the rays: relative standard error \
                 about 0.014",
                "light model | lamps | mean relative error on held-out blocks of surface: distant 0.4000, lamps 0.0500 | 2 \
                 models, 5000 vertices each | ",
                "albedo scale | light and surfaces neutral on the whole, albedo luminance 0.80 at the 98 % quantile | colour of \
                 the median irradiance 1.04, 1.00, 0.96, of the mean albedo 1.30, 1.00, 0.77; 12 % of the seen surface is \
                 near white; the 98 % quantile of the albedo's luminance is 0.80 | 9000 vertices | a surface of known \
                 albedo, stated with `estimate --reference keyframe:N:X,Y=ALBEDO`",
                "albedo scale | by the secondary light as it was observed, light and surfaces neutral on the whole | colour of \
                 the median irradiance 1.04, 1.00, 0.96, of the mean albedo 1.30, 1.00, 0.77; 12 % of the seen surface is \
                 near white; the 98 % quantile of the albedo's luminance is 0.80 | 9000 vertices | a surface of known \
                 albedo, stated with `estimate --reference keyframe:N:X,Y=ALBEDO`",
                "albedo scale | by the reference, whose albedo is 0.900, 0.900, 0.800 | colour of the median irradiance 1.04, \
                 1.00, 0.96, of the mean albedo 1.30, 1.00, 0.77; 12 % of the seen surface is near white; the 98 % quantile \
                 of the albedo's luminance is 0.80 | 9000 vertices | ",
            ]
        );
    }

    #[test]
    fn cuts_and_warnings_keep_their_wording() {
        let planned = |what: &str| format!("{what} (planned for a machine 0.50 times as fast as the reference)");
        let cuts: Vec<String> = cuts().iter().map(ToString::to_string).collect();
        assert_eq!(
            cuts,
            [
                planned("bounces: 2 instead of as many as matter, the rest in proportion"),
                planned("rays: 32 per vertex instead of 128"),
                planned("pose refinement: 0 rounds instead of 4"),
                planned("specular: not looked for"),
                planned("bands: at most 5 instead of 9"),
                planned("keyframes: every 2nd of 30"),
                planned("vertices: about 7000 instead of 10000"),
                "old".into(),
                "rays: 32 per vertex instead of 128".into(),
                "rays: 16 per vertex, since 64 were not there in time".into(),
                "specular: not looked for".into(),
                "witnesses: 1 of 2 predicted".into(),
                "abandoned: transfer with 8 rays per vertex".into(),
            ]
        );
        let warnings: Vec<String> = warnings().iter().map(ToString::to_string).collect();
        assert_eq!(
            warnings,
            [
                "old",
                "the colour response srgb does not fit the pictures; linear or gamma:2.2 does: set camera.response",
                "light_not_distant: position explains 30 % of what light and albedo leave unexplained at equal normals, on \
                 vertices left out; it changes the light by 9 %",
                "one keyframe: exposure, pose and gloss cannot be told",
                "light: 2 of the 3 directions of its first band are not told by these surfaces; the rest of the light \
                 cannot be seen from here",
            ]
        );
    }

    #[test]
    fn early_answers_and_small_ones_say_why() {
        let cuts = [
            Cut::FirstAnswer { vertices: 2200, keyframes: 8 },
            Cut::EndOfBudget { after: Milestone::Albedo },
            Cut::EndOfBudget { after: Milestone::Gloss },
            Cut::Memory { what: Reduction::Vertices { to: 7000, from: 10_000 }, limit_mb: 600 },
        ];
        assert_eq!(
            cuts.map(|c| c.to_string()),
            [
                "end of the budget: the first answer, from 2200 vertices and 8 keyframes",
                "end of the budget: without what follows light and albedo (glare, materials, gloss, texture)",
                "end of the budget: without what follows gloss (texture, prediction of validation frames)",
                "vertices: about 7000 instead of 10000 (for 600 MB of memory)",
            ]
        );
    }

    #[test]
    fn a_near_model_that_is_refused_says_why() {
        let refused = Decision::NearLight { accepted: false, distant: 0.04, near: 0.03, most: 0.65 };
        assert_eq!(
            line(&refused),
            "near light | refused | mean relative error on means of held-out patches: distant 0.0400, the best near model \
             0.0300; at most 0.65 of the former is asked for, since gloss can look like a lamp | 2 models compared | "
        );
    }

    #[test]
    fn hazed_keyframes_are_named() {
        let haze = Decision::Haze { glare: vec![(3, 0.914), (10, 0.6)] };
        assert_eq!(
            line(&haze),
            "glare | left out: keyframes 3, 10 | share of glare in the light over the surface that they show: 0.91, 0.60 | \
             2 pictures | keep lamps and windows out of the picture"
        );
    }

    #[test]
    fn vignetting_is_told_by_what_the_corners_lack() {
        let vignetting = Decision::Vignetting { strength: 0.2, without: 0.5712, with: 0.4305, patches: 928 };
        assert_eq!(
            line(&vignetting),
            "vignetting | corners 18 % darker | disagreement of held-out patches (0 to 1): 0.5712 with even pictures, 0.4305 \
             with the vignetting that the others tell | 928 patches | "
        );
    }

    #[test]
    fn a_shoulder_is_told_by_what_white_stands_for() {
        let shoulder = Decision::Shoulder { strength: 0.9, without: 0.6729, with: 0.6428, patches: 1431 };
        assert_eq!(
            line(&shoulder),
            "highlights | white stands for 1.90 × as much light | disagreement of held-out patches (0 to 1): 0.6729 as in \
             sRGB, 0.6428 with highlights compressed as the others tell | 1431 patches | "
        );
    }

    #[test]
    fn divided_segments_say_what_it_is_worth() {
        let divided = Decision::Division { segments: 52, parts: 69, held_out_segments: 0.1473, held_out: 0.1136 };
        assert_eq!(
            line(&divided),
            "segments | divided into 69 | mean relative error on held-out blocks of surface: 0.1473 with \
             an albedo for each of 52 segments, 0.1136 with one for each of their parts that face one way and differ | 2 models \
             compared | "
        );
    }

    #[test]
    fn the_color_of_the_light_says_what_it_costs() {
        let drawn = |weight| Decision::LightChroma { weight, held_out: vec![(0.1, 0.21), (0.0, 0.2)] };
        assert_eq!(
            line(&drawn(0.1)),
            "colour of the light | drawn together by 0.1 | RMS relative change of the irradiance of vertices left out, by the weight of a \
             radiance that the channels have in common: 0.1: 0.2100, 0: 0.2000 | 2 solutions of the light | "
        );
        assert!(line(&drawn(0.010_234_569)).contains("drawn together by 0.01 |"));
        assert!(line(&drawn(0.0)).contains("each channel for itself"));
    }

    #[test]
    fn the_background_says_what_it_is_worth() {
        let seen = |weight, directions, correlation| {
            let held_out = if weight > 0.0 { vec![(weight, 0.21), (0.0, 0.2)] } else { vec![] };
            line(&Decision::Background(BackgroundLikeness { weight, held_out, keyframes: 4, directions, correlation }))
        };
        assert_eq!(
            seen(0.1, 812, Some(0.614)),
            "background | light drawn to it by 0.1, which correlates 0.61 with what was left out | RMS relative change of the \
             irradiance of vertices left out, by the weight of what was seen: 0.1: 0.2100, 0: 0.2000; 4 keyframes that were left out show 812 \
             directions beyond the scan | 4 pictures | "
        );
        assert_eq!(
            seen(0.0, 9, None),
            "background | not used | 4 keyframes that were left out show 9 directions beyond the scan | 4 pictures | "
        );
    }

    #[test]
    fn programs_get_the_figures_beside_the_words() {
        let findings = Findings::new(&decisions(), &[Cut::Specular], &[Warning::UnseenLight { directions: 2 }]);
        let json = serde_json::to_value(&findings).unwrap();
        assert!(json["decisions"][0].get("evidence_values").is_none(), "an old file has words alone");
        assert_eq!(json["decisions"][3]["choice"], "scalar");
        assert_eq!(json["decisions"][3]["evidence_values"]["exposure"]["rgb"], 0.24);
        assert_eq!(json["cut_values"][0], "specular");
        assert_eq!(json["warning_values"][0]["unseen_light"]["directions"], 2);
    }

    #[test]
    fn transfer_levels_are_read_by_name() {
        for level in [TransferLevel::Diffuse, TransferLevel::Shade, TransferLevel::Gi] {
            assert_eq!(level.name().parse(), Ok(level));
        }
        assert!("GI".parse::<TransferLevel>().is_err());
    }
}
