//! Plots of many scenes' figures: the sorted values of even and odd seeds, a panel a figure.

use crate::corpus::report::{FIGURES, Figure, Row, is_even, number, text};
use estimator::plots::{self, Drawn, log_range, log_ticks, short};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;

/// Panels in a row, and the size of one in pixels.
const COLUMNS: usize = 3;
const PANEL: (u32, u32) = (440, 330);
/// Colours of even and odd seeds.
const SIDES: [(&str, RGBColor); 2] = [("even seeds", RGBColor(40, 110, 190)), ("odd seeds", RGBColor(220, 120, 20))];
/// Errors that span this factor stand on a logarithmic axis.
const DECADES: f64 = 8.0;

/// A figure's values of a road: seed and value, ascending, of even and of odd seeds.
struct Panel<'a> {
    title: String,
    figure: &'a Figure,
    sides: [Vec<(f64, f64)>; 2],
}

/// The plots as a PNG file.
///
/// # Errors
/// There are no figures.
pub fn png(rows: &[Row]) -> Result<Vec<u8>, String> {
    let panels = panels(rows);
    plots::png(size(&panels)?, |area| draw(&area, &panels))
}

/// The same as an SVG file.
///
/// # Errors
/// There are no figures.
pub fn svg(rows: &[Row]) -> Result<String, String> {
    let panels = panels(rows);
    plots::svg(size(&panels)?, |area| draw(&area, &panels))
}

fn size(panels: &[Panel]) -> Result<(u32, u32), String> {
    if panels.is_empty() {
        return Err("there are no figures to plot".into());
    }
    Ok((PANEL.0 * COLUMNS as u32, PANEL.1 * panels.len().div_ceil(COLUMNS) as u32))
}

fn panels(rows: &[Row]) -> Vec<Panel<'static>> {
    let of = |road: &'static str, figure: &'static Figure| {
        let side = |even: bool| {
            let chosen = rows.iter().filter(|r| is_even(r) == even && text(r, "road") == road);
            let mut values: Vec<(f64, f64)> = chosen
                .filter_map(|r| Some((number(r, "seed")?, (figure.value)(r)?)))
                .filter(|v| v.1.is_finite())
                .collect();
            values.sort_by(|a, b| a.1.total_cmp(&b.1));
            values
        };
        let sides = [side(true), side(false)];
        let any = sides.iter().any(|s| !s.is_empty());
        any.then(|| Panel { title: format!("{road}: {}", figure.title), figure, sides })
    };
    ["photos", "fused"].into_iter().flat_map(|road| FIGURES.iter().filter_map(move |f| of(road, f))).collect()
}

fn draw<B: DrawingBackend>(area: &DrawingArea<B, Shift>, panels: &[Panel]) -> Drawn
where
    B::ErrorType: 'static,
{
    area.fill(&WHITE)?;
    for (place, panel) in area.split_evenly((panels.len().div_ceil(COLUMNS), COLUMNS)).iter().zip(panels) {
        let values = || panel.sides.iter().flatten().map(|v| v.1);
        let (low, high) = values().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        match log_range(values()) {
            Some(range) if low > 0.0 && high > DECADES * low => {
                let ticks = log_ticks(&range);
                draw_panel(place, panel, range.log_scale().with_key_points(ticks))?;
            }
            _ => {
                let room = 0.06 * (high - low).max(1e-3 * high.abs()).max(1e-6);
                draw_panel(place, panel, low - room..high + room)?;
            }
        }
    }
    area.present()?;
    Ok(())
}

fn draw_panel<B: DrawingBackend, Y>(place: &DrawingArea<B, Shift>, panel: &Panel, y: Y) -> Drawn
where
    B::ErrorType: 'static,
    Y: AsRangedCoord<Value = f64>,
    Y::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    let mut chart = ChartBuilder::on(place)
        .caption(&panel.title, plots::text(17))
        .margin(10)
        .x_label_area_size(42)
        .y_label_area_size(66)
        .build_cartesian_2d(0.0..100.0, y)?;
    chart
        .configure_mesh()
        .x_desc("scenes, %")
        .y_desc(panel.figure.title)
        .x_labels(6)
        .y_labels(7)
        .y_label_formatter(&|v| short(*v))
        .label_style(plots::text(13))
        .axis_desc_style(plots::text(14))
        .bold_line_style(RGBColor(224, 224, 230))
        .light_line_style(TRANSPARENT)
        .draw()?;
    for (values, (label, color)) in panel.sides.iter().zip(SIDES) {
        let at = |i: usize| (100.0 * (i as f64 + 0.5) / values.len() as f64, values[i].1);
        chart.draw_series(LineSeries::new((0..values.len()).map(at), color.mix(0.5)))?;
        chart
            .draw_series((0..values.len()).map(|i| Circle::new(at(i), 3, color.filled())))?
            .label(label)
            .legend(move |(x, y)| Circle::new((x + 9, y), 3, color.filled()));
        // The scenes at both ends by their seeds.
        let ends: std::collections::BTreeSet<usize> = [0, values.len().saturating_sub(1)].into();
        chart.draw_series(ends.into_iter().filter(|i| *i < values.len()).map(|i| {
            let name = Text::new(format!("{:.0}", values[i].0), (5, -13), plots::text(12).color(&color));
            EmptyElement::at(at(i)) + name
        }))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.8))
        .label_font(plots::text(12))
        .draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_figure_has_its_panel_with_axes_and_seeds() {
        let row = |seed: u32| {
            let value =
                json!({ "seed": seed, "road": "photos", "albedo_median": 0.01 * f64::from(seed + 1), "ari": 0.9 });
            value.as_object().cloned().unwrap_or_default()
        };
        let rows: Vec<Row> = (0..14).map(row).collect();
        let text = svg(&rows).unwrap();
        for part in ["photos: albedo, median", "photos: ARI", "scenes, %", "even seeds", "odd seeds"] {
            assert!(text.contains(part), "{part}");
        }
        assert!(text.contains("\n13\n") && !text.contains("fused"), "the worst seed has its number");
        assert!(png(&rows).unwrap().starts_with(b"\x89PNG"));
        assert!(svg(&[]).is_err());
    }
}
