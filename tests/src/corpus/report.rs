//! Tables of many scenes' figures.

use crate::metrics::percentile;
use serde_json::{Map, Value};
use std::fmt::Write;

/// A scene's figures, as [`judge`](super::judge::judge) returns them.
pub type Row = Map<String, Value>;

/// A figure of the report.
pub struct Figure {
    /// Its name, with its unit.
    pub title: &'static str,
    /// Its value for a scene.
    pub value: fn(&Row) -> Option<f64>,
}

/// A number of a scene.
#[must_use]
pub fn number(row: &Row, key: &str) -> Option<f64> {
    row.get(key)?.as_f64()
}

fn difference(row: &Row, a: &str, b: &str) -> Option<f64> {
    Some(number(row, a)? - number(row, b)?)
}

/// All figures.
pub const FIGURES: [Figure; 17] = [
    Figure { title: "albedo, median", value: |r| number(r, "albedo_median") },
    Figure { title: "albedo, p90", value: |r| number(r, "albedo_p90") },
    Figure { title: "albedo, naive median", value: |r| number(r, "naive_albedo_median") },
    Figure { title: "albedo, log dev. within", value: |r| number(r, "albedo_within") },
    Figure { title: "albedo, angle deg", value: |r| number(r, "albedo_angle_deg") },
    Figure { title: "albedo, luminance factor", value: |r| number(r, "albedo_luminance_factor") },
    Figure { title: "irradiance, median", value: |r| number(r, "irradiance_median") },
    Figure { title: "light, relative error", value: |r| number(r, "light_error") },
    Figure { title: "ARI", value: |r| number(r, "ari") },
    Figure { title: "gloss AUC", value: |r| number(r, "gloss_auc") },
    Figure { title: "exposure, log RMS", value: |r| number(r, "exposure") },
    Figure { title: "pose, mm", value: |r| number(r, "pose_mm") },
    Figure { title: "pose, px", value: |r| number(r, "pose_px") },
    Figure { title: "relit, dB", value: |r| number(r, "relit_psnr") },
    Figure { title: "relit - ceiling, dB", value: |r| difference(r, "relit_psnr", "ceiling_psnr") },
    Figure { title: "relit - naive, dB", value: |r| difference(r, "relit_psnr", "naive_psnr") },
    Figure { title: "time, s", value: |r| number(r, "seconds") },
];

/// Quantiles shown.
const QUANTILES: [f64; 5] = [0.1, 0.25, 0.5, 0.75, 0.9];

/// A text of a scene.
#[must_use]
pub fn text<'a>(row: &'a Row, key: &str) -> &'a str {
    row.get(key).and_then(Value::as_str).unwrap_or("")
}

/// True for scenes that rules and thresholds are judged by.
#[must_use]
pub fn is_even(row: &Row) -> bool {
    number(row, "seed").is_some_and(|s| (s as u64).is_multiple_of(2))
}

/// One line a scene.
#[must_use]
pub fn scenes(rows: &[Row]) -> String {
    let mut out = String::from(
        "seed light   support road   | albedo  p90    naive | irrad  light  ARI   AUC   expos | pose mm  px   | relit  ceil   naive  orig  | s\n",
    );
    for row in rows {
        let n = |key: &str, width: usize, digits: usize| match number(row, key) {
            Some(x) => format!("{x:width$.digits$}"),
            None => format!("{:>width$}", "-"),
        };
        let _ = writeln!(
            out,
            "{:>4} {:<7} {:<7} {:<6} | {} {} {} | {} {} {} {} {} | {} {} | {} {} {} {} | {}",
            n("seed", 4, 0),
            text(row, "light"),
            text(row, "support"),
            text(row, "road"),
            n("albedo_median", 6, 3),
            n("albedo_p90", 6, 3),
            n("naive_albedo_median", 6, 3),
            n("irradiance_median", 6, 3),
            n("light_error", 5, 2),
            n("ari", 6, 2),
            n("gloss_auc", 5, 2),
            n("exposure", 6, 3),
            n("pose_mm", 6, 2),
            n("pose_px", 5, 2),
            n("relit_psnr", 6, 2),
            n("ceiling_psnr", 6, 2),
            n("naive_psnr", 6, 2),
            n("original_psnr", 6, 2),
            n("seconds", 5, 1),
        );
    }
    out
}

/// Quantiles over the scenes, even and odd seeds in two columns, by kind of light and road.
#[must_use]
pub fn quantiles(rows: &[Row]) -> String {
    let mut out = String::new();
    for (light, road) in [
        ("distant", "photos"),
        ("lamps", "photos"),
        ("room", "photos"),
        ("distant", "fused"),
        ("lamps", "fused"),
        ("room", "fused"),
    ] {
        let of = |even: bool| -> Vec<&Row> {
            rows.iter().filter(|r| is_even(r) == even && text(r, "light") == light && text(r, "road") == road).collect()
        };
        let sides = [of(true), of(false)];
        if sides.iter().all(Vec::is_empty) {
            continue;
        }
        let _ = writeln!(out, "\n{light}, {road}: {} even, {} odd seeds", sides[0].len(), sides[1].len());
        let _ =
            writeln!(out, "{:<26}{:^45} | {:^45}", "", "even: p10 p25 median p75 p90", "odd: p10 p25 median p75 p90");
        for figure in &FIGURES {
            let _ = write!(out, "{:<26}", figure.title);
            for (k, side) in sides.iter().enumerate() {
                let values: Vec<f64> = side.iter().filter_map(|r| (figure.value)(r)).collect();
                let cells: String = QUANTILES.iter().map(|q| format!("{:9.3}", percentile(&values, *q))).collect();
                let _ = write!(out, "{cells}{}", if k == 0 { " | " } else { "\n" });
            }
        }
        for (k, side) in sides.iter().enumerate() {
            let worse = side.iter().filter(|r| worse_than_naive(r)).filter_map(|r| number(r, "seed"));
            let seeds: Vec<String> = worse.map(|s| format!("{s:.0}")).collect();
            let _ = writeln!(out, "worse than naive, {}: [{}]", ["even", "odd"][k], seeds.join(", "));
        }
    }
    out
}

/// True if lit colours taken as albedo have a better albedo median or relit PSNR.
#[must_use]
pub fn worse_than_naive(row: &Row) -> bool {
    difference(row, "albedo_median", "naive_albedo_median").is_some_and(|d| d > 0.0)
        || difference(row, "relit_psnr", "naive_psnr").is_some_and(|d| d < 0.0)
}

/// What was decided, and how often, even and odd seeds apart.
#[must_use]
pub fn decisions(rows: &[Row]) -> String {
    let mut counts: std::collections::BTreeMap<(String, String), [usize; 2]> = std::collections::BTreeMap::new();
    for row in rows {
        for (name, choice) in row.get("decisions").and_then(Value::as_object).into_iter().flatten() {
            let choice: String = choice.as_str().unwrap_or("").chars().take(60).collect();
            counts.entry((name.clone(), choice)).or_default()[usize::from(!is_even(row))] += 1;
        }
    }
    let mut out = String::from("\ndecisions: even, odd\n");
    for ((name, choice), [even, odd]) in counts {
        let _ = writeln!(out, "{even:>4} {odd:>4}  {name}: {choice}");
    }
    out
}
