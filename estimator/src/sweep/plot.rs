//! Error against seconds, both logarithmic: one panel a scene.

use crate::plots::{self, Drawn, log_range, log_ticks, short, text};
use crate::sweep::point::Point;
use plotters::coord::Shift;
use plotters::prelude::*;
use recordings::decision::TransferLevel;

/// Size of a panel in pixels.
const PANEL: (u32, u32) = (760, 540);
/// Colours of diffuse, shade and gi.
const LEVELS: [(TransferLevel, &str, RGBColor); 3] = [
    (TransferLevel::Diffuse, "diffuse", RGBColor(120, 130, 145)),
    (TransferLevel::Shade, "shade", RGBColor(60, 145, 200)),
    (TransferLevel::Gi, "gi", RGBColor(225, 140, 30)),
];
const AUTO: RGBColor = RGBColor(20, 140, 60);
const PAPER: RGBColor = RGBColor(200, 40, 80);
const FRONT: RGBColor = RGBColor(60, 60, 70);
/// Half width of the mark of a named setting, and the distance of its name from the middle, in pixels.
const MARK: i32 = 6;
const ASIDE: i32 = 9;

/// Draws the sweeps of several scenes as a PNG file.
///
/// # Errors
/// There is nothing to draw.
pub fn png(scenes: &[(String, Vec<Point>)]) -> Result<Vec<u8>, String> {
    plots::png(size(scenes)?, |area| draw(&area, scenes))
}

/// The same as an SVG file.
///
/// # Errors
/// There is nothing to draw.
pub fn svg(scenes: &[(String, Vec<Point>)]) -> Result<String, String> {
    plots::svg(size(scenes)?, |area| draw(&area, scenes))
}

fn size(scenes: &[(String, Vec<Point>)]) -> Result<(u32, u32), String> {
    if scenes.iter().all(|(_, points)| points.is_empty()) {
        return Err("there is nothing to plot".into());
    }
    Ok((PANEL.0 * scenes.len().min(2) as u32, PANEL.1 * scenes.len().div_ceil(2) as u32))
}

fn draw<B: DrawingBackend>(area: &DrawingArea<B, Shift>, scenes: &[(String, Vec<Point>)]) -> Drawn
where
    B::ErrorType: 'static,
{
    area.fill(&WHITE)?;
    let panels = area.split_evenly((scenes.len().div_ceil(2), scenes.len().min(2)));
    for (panel, (name, points)) in panels.iter().zip(scenes) {
        draw_scene(panel, name, points)?;
    }
    area.present()?;
    Ok(())
}

fn draw_scene<B: DrawingBackend>(panel: &DrawingArea<B, Shift>, name: &str, points: &[Point]) -> Drawn
where
    B::ErrorType: 'static,
{
    let at = |p: &Point| (p.seconds, p.error());
    let ranges = (log_range(points.iter().map(|p| at(p).0)), log_range(points.iter().map(|p| at(p).1)));
    let (Some(x), Some(y)) = ranges else { return Ok(()) };
    let (x_ticks, y_ticks) = (log_ticks(&x), log_ticks(&y));
    let (x_labels, y_labels) = (x_ticks.len(), y_ticks.len());
    let mut chart = ChartBuilder::on(panel)
        .caption(name, text(22))
        .margin(14)
        .x_label_area_size(52)
        .y_label_area_size(76)
        .build_cartesian_2d(x.log_scale().with_key_points(x_ticks), y.log_scale().with_key_points(y_ticks))?;
    chart
        .configure_mesh()
        .x_desc("processor time, s")
        .y_desc("median relative error, albedo + irradiance")
        .x_labels(x_labels)
        .y_labels(y_labels)
        .x_label_formatter(&|v| short(*v))
        .y_label_formatter(&|v| short(*v))
        .label_style(text(15))
        .axis_desc_style(text(16))
        .bold_line_style(RGBColor(222, 222, 228))
        .light_line_style(TRANSPARENT)
        .draw()?;

    let mut front: Vec<&Point> = points.iter().filter(|p| p.pareto).collect();
    front.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    chart
        .draw_series(LineSeries::new(front.iter().map(|p| at(p)), FRONT.stroke_width(2)))?
        .label("Pareto front")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], FRONT.stroke_width(2)));
    for (level, label, color) in LEVELS {
        let of_level = points.iter().filter(|p| p.transfer == level && !is_named(p));
        chart
            .draw_series(of_level.map(|p| Circle::new(at(p), if p.pareto { 5 } else { 4 }, color.filled())))?
            .label(label)
            .legend(move |(x, y)| Circle::new((x + 9, y), 4, color.filled()));
    }
    let named: Vec<&Point> = points.iter().filter(|p| is_named(p)).collect();
    let sizes: Vec<(u32, u32)> =
        named.iter().map(|p| panel.estimate_text_size(&p.name, &text(15))).collect::<Result<_, _>>()?;
    let centers: Vec<(i32, i32)> = named.iter().map(|p| chart.backend_coord(&at(p))).collect();
    let right = chart.plotting_area().get_x_axis_pixel_range().end;
    for (p, offset) in named.iter().zip(offsets(&centers, &sizes, right)) {
        let color = match p.name.as_str() {
            "auto" => AUTO,
            "paper" => PAPER,
            _ => LEVELS.iter().find(|l| l.0 == p.transfer).map_or(FRONT, |l| l.2),
        };
        let mark = EmptyElement::at(at(p))
            + Circle::new((0, 0), MARK, color.filled())
            + Text::new(p.name.clone(), offset, text(15).color(&color));
        chart.draw_series(std::iter::once(mark))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(RGBColor(200, 200, 206))
        .label_font(text(15))
        .draw()?;
    Ok(())
}

/// Where the names of the marks at `centers` stand, from the center to the name's upper left corner: the first place beside it, from near to
/// far, where a name covers none of these marks and no name before it, and ends before `right`. All are in pixels.
fn offsets(centers: &[(i32, i32)], sizes: &[(u32, u32)], right: i32) -> Vec<(i32, i32)> {
    let mut taken: Vec<[i32; 4]> = centers.iter().map(|(x, y)| [x - MARK, y - MARK, x + MARK, y + MARK]).collect();
    let place = |(&(x, y), &(width, height)): (&(i32, i32), &(u32, u32))| {
        let (width, height) = (width as i32, height as i32);
        let rows = [-height - 1, 4, -2 * height - 2, height + 5, -3 * height - 3, 2 * height + 6];
        let mut places = rows.iter().flat_map(|dy| [ASIDE, -ASIDE - width].map(|dx| (dx, *dy)));
        let area = |(dx, dy): (i32, i32)| [x + dx, y + dy, x + dx + width, y + dy + height];
        let is_free = |offset: &(i32, i32)| {
            let [left, top, end, bottom] = area(*offset);
            let apart = |b: &[i32; 4]| end <= b[0] || b[2] <= left || bottom <= b[1] || b[3] <= top;
            end <= right && taken.iter().all(apart)
        };
        let offset = places.find(is_free).unwrap_or((ASIDE, rows[0]));
        taken.push(area(offset));
        offset
    };
    centers.iter().zip(sizes).map(place).collect()
}

/// Settings that have a name of their own.
fn is_named(point: &Point) -> bool {
    point.name != "grid"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> Vec<Point> {
        let point = |name: &str, i: usize, transfer| Point {
            name: name.into(),
            bands: 3,
            transfer,
            rays: 64,
            vertices: 1000,
            keyframes: 4,
            seconds: 2.0 + i as f64,
            albedo_error: 0.05 / (1.0 + 0.02 * i as f64),
            irradiance_error: 0.01,
            pareto: i.is_multiple_of(2),
        };
        let levels = [TransferLevel::Diffuse, TransferLevel::Shade, TransferLevel::Gi];
        let mut points: Vec<Point> = (0..12).map(|i| point("grid", i, levels[i % 3])).collect();
        points.extend([point("auto", 5, TransferLevel::Gi), point("paper", 11, TransferLevel::Shade)]);
        points
    }

    #[test]
    fn axes_have_units_and_ticks_and_points_have_names() {
        let text = svg(&[("desk".into(), points())]).unwrap();
        for part in ["processor time, s", "median relative error", "Pareto front", "auto", "paper", "desk", "gi"] {
            assert!(text.contains(part), "{part}");
        }
        // Errors of 0.05 to 0.06 have ticks although no power of ten lies among them.
        let ticks = ["0.05", "0.052", "0.055", "0.06"].iter().filter(|t| text.contains(&format!("\n{t}\n"))).count();
        assert!(ticks >= 2, "{text}");
    }

    #[test]
    fn names_cover_neither_marks_nor_each_other() {
        // Three marks within a few pixels of each other, and one at the right border.
        let (centers, sizes) = ([(100, 100), (104, 103), (112, 98), (390, 50)], [(60, 15); 4]);
        let areas: Vec<[i32; 4]> = offsets(&centers, &sizes, 400)
            .iter()
            .zip(centers)
            .map(|((dx, dy), (x, y))| [x + dx, y + dy, x + dx + 60, y + dy + 15])
            .collect();
        let marks = centers.map(|(x, y)| [x - 6, y - 6, x + 6, y + 6]);
        let apart = |a: &[i32; 4], b: &[i32; 4]| a[2] <= b[0] || b[2] <= a[0] || a[3] <= b[1] || b[3] <= a[1];
        for (i, area) in areas.iter().enumerate() {
            assert!(area[2] <= 400 && marks.iter().chain(&areas[..i]).all(|b| apart(area, b)), "{areas:?}");
        }
    }

    #[test]
    fn a_png_file_is_drawn_without_fonts_of_the_system() {
        let png = png(&[("desk".into(), points()), ("room".into(), points())]).unwrap();
        assert!(png.starts_with(b"\x89PNG") && png.len() > 10_000);
        assert!(super::png(&[]).is_err());
    }
}
