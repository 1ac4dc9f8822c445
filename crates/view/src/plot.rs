//! Line plots (losses over updates) and the trade-off of error against time.
//!
//! Values that cannot be drawn are an error, never left out silently: NaN and
//! infinities anywhere, and times that are not positive on their logarithmic
//! axis. One exception is stated in the legend: a loss of zero on a
//! logarithmic axis is a gap in its line.

use std::ops::Range;

use plotters::chart::{ChartBuilder, SeriesLabelPosition};
use plotters::coord::combinators::IntoLogRange;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::element::{Circle, PathElement, Text};
use plotters::prelude::Cartesian2d;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, RGBColor, ShapeStyle};

use crate::error::ViewError;
use crate::picture::{Picture, text_style};

const PAPER: [u8; 3] = [255; 3];
const INK: [u8; 3] = [40, 40, 44];
/// Colours of series that can also be told apart in common colour blindness
/// (Okabe and Ito), but for the yellow, which is too light on white.
const COLOURS: [[u8; 3]; 7] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [86, 180, 233],
    [230, 159, 0],
    [90, 90, 90],
];

/// A named line.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Points, x ascending.
    pub points: Vec<(f64, f64)>,
}

/// What a line plot says.
#[derive(Clone, Debug, PartialEq)]
pub struct LinePlot<'a> {
    /// Heading.
    pub title: &'a str,
    /// Text at the x axis.
    pub x_label: &'a str,
    /// Text at the y axis.
    pub y_label: &'a str,
    /// Logarithmic y axis.
    pub log_y: bool,
    /// Lines.
    pub series: &'a [Series],
    /// Places on the x axis with a name, such as the beginning of a phase.
    pub marks: &'a [(f64, &'a str)],
}

/// Points of one colour in the trade-off of error against time.
#[derive(Clone, Debug, PartialEq)]
pub struct Family {
    /// Settings of one method are joined by a line; independent methods are not.
    pub joined: bool,
    /// The points.
    pub costs: Vec<Cost>,
}

/// What one method's accuracy costs.
#[derive(Clone, Debug, PartialEq)]
pub struct Cost {
    /// Name beside the point.
    pub label: String,
    /// Time for one frame.
    pub milliseconds: f64,
    /// Error, in the unit of the y axis.
    pub error: f64,
}

/// Draws lines.
///
/// # Errors
/// No points at all; a point that is not finite.
pub fn line_plot(plot: &LinePlot, width: usize, height: usize) -> Result<Picture, ViewError> {
    let points = || plot.series.iter().flat_map(|series| &series.points);
    if points().next().is_none() {
        return Err(ViewError::Empty {
            what: "line plot",
            item: "point",
        });
    }
    for series in plot.series {
        if let Some(index) = series
            .points
            .iter()
            .position(|(x, y)| !(x.is_finite() && y.is_finite()))
        {
            let (x, y) = series.points[index];
            let (plot, series) = (plot.title.to_string(), series.name.clone());
            return Err(ViewError::NotFinite {
                plot,
                series,
                index,
                x,
                y,
            });
        }
    }
    let x_range = padded(
        points().map(|p| p.0).chain(plot.marks.iter().map(|m| m.0)),
        0.01,
    );
    let mut picture = Picture::new(width, height, PAPER);
    if plot.log_y {
        let positive = points().map(|p| p.1).filter(|&y| y > 0.0);
        let y_range = decades(positive, 1.3);
        draw_lines(&mut picture, plot, x_range, y_range.log_scale())?;
    } else {
        let y_range = padded(points().map(|p| p.1), 0.05);
        draw_lines(&mut picture, plot, x_range, y_range)?;
    }
    Ok(picture)
}

/// Draws error (linear, from 0) against milliseconds per frame (logarithmic).
///
/// # Errors
/// No points; a value that is not finite; a time that is not positive.
pub fn trade_off(
    title: &str,
    error_label: &str,
    families: &[Family],
    width: usize,
    height: usize,
) -> Result<Picture, ViewError> {
    let costs = || families.iter().flat_map(|family| &family.costs);
    if costs().next().is_none() {
        return Err(ViewError::Empty {
            what: "trade-off plot",
            item: "method",
        });
    }
    for (index, cost) in costs().enumerate() {
        let (x, y) = (cost.milliseconds, cost.error);
        if !(x.is_finite() && y.is_finite()) {
            let (plot, series) = (title.to_string(), cost.label.clone());
            return Err(ViewError::NotFinite {
                plot,
                series,
                index,
                x,
                y,
            });
        }
        if x <= 0.0 {
            let (plot, point) = (title.to_string(), cost.label.clone());
            let axis = "milliseconds per frame";
            return Err(ViewError::NotPositive {
                plot,
                point,
                axis,
                value: x,
            });
        }
    }
    let times = decades(costs().map(|cost| cost.milliseconds), 2.0);
    let highest = costs().map(|cost| cost.error).fold(0.0, f64::max);
    let lowest = costs().map(|cost| cost.error).fold(0.0, f64::min);
    let span = (highest - lowest).max(f64::MIN_POSITIVE);
    let errors = lowest..highest + 0.08 * span;
    let mut picture = Picture::new(width, height, PAPER);
    draw_costs(&mut picture, title, error_label, families, times, errors)?;
    Ok(picture)
}

fn draw_lines<Y>(
    picture: &mut Picture,
    plot: &LinePlot,
    x_range: Range<f64>,
    y_range: Y,
) -> Result<(), ViewError>
where
    Y: AsRangedCoord<Value = f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let failed = |error: &dyn std::fmt::Display| ViewError::drawing("line plot", error);
    let area = picture.drawing_area();
    let mut chart = ChartBuilder::on(&area)
        .caption(plot.title, text_style(20.0, INK))
        .margin(14)
        .x_label_area_size(44)
        .y_label_area_size(76)
        .build_cartesian_2d(x_range, y_range)
        .map_err(|e| failed(&e))?;
    chart
        .configure_mesh()
        .x_desc(plot.x_label)
        .y_desc(plot.y_label)
        .x_label_formatter(&|x| number(*x))
        .y_label_formatter(&|y| number(*y))
        .label_style(text_style(14.0, INK))
        .axis_desc_style(text_style(15.0, INK))
        .bold_line_style(RGBColor(222, 222, 226))
        .light_line_style(RGBColor(243, 243, 245))
        .draw()
        .map_err(|e| failed(&e))?;
    let (_, y_pixels) = area.get_pixel_range();
    let top = chart
        .plotting_area()
        .get_pixel_range()
        .1
        .start
        .max(y_pixels.start);
    for &(at, name) in plot.marks {
        let bounds = chart.plotting_area().get_y_range();
        let line = vec![(at, bounds.start), (at, bounds.end)];
        let style = RGBColor(120, 120, 124).stroke_width(1);
        chart
            .plotting_area()
            .draw(&PathElement::new(line, style))
            .map_err(|e| failed(&e))?;
        let (x, _) = chart.backend_coord(&(at, bounds.start));
        let style = text_style(13.0, [110, 110, 114]).pos(Pos::new(HPos::Left, VPos::Top));
        area.draw(&Text::new(name.to_string(), (x + 4, top + 4), style))
            .map_err(|e| failed(&e))?;
    }
    for (index, series) in plot.series.iter().enumerate() {
        let style = colour(index).stroke_width(2);
        let drawable = |p: &(f64, f64)| !plot.log_y || p.1 > 0.0;
        let zeros = series.points.iter().filter(|p| !drawable(p)).count();
        let name = match zeros {
            0 => series.name.clone(),
            _ => format!("{} ({zeros} values not above 0)", series.name),
        };
        let runs: Vec<_> = series
            .points
            .chunk_by(|a, b| drawable(a) == drawable(b))
            .filter(|run| drawable(&run[0]))
            .collect();
        // A run of one point would have no line: draw it as a dot.
        let dots = runs.iter().filter(|run| run.len() == 1);
        chart
            .draw_series(dots.map(|run| Circle::new(run[0], 2, style.filled())))
            .map_err(|e| failed(&e))?;
        let lines = runs.iter().map(|run| PathElement::new(run.to_vec(), style));
        chart
            .draw_series(lines)
            .map_err(|e| failed(&e))?
            .label(name)
            .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 18, y)], style));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .label_font(text_style(14.0, INK))
        .background_style(RGBColor(255, 255, 255).mix(0.85))
        .border_style(RGBColor(210, 210, 214))
        .margin(10)
        .draw()
        .map_err(|e| failed(&e))
}

fn draw_costs(
    picture: &mut Picture,
    title: &str,
    error_label: &str,
    families: &[Family],
    times: Range<f64>,
    errors: Range<f64>,
) -> Result<(), ViewError> {
    let failed = |error: &dyn std::fmt::Display| ViewError::drawing("trade-off plot", error);
    let area = picture.drawing_area();
    let mut chart = ChartBuilder::on(&area)
        .caption(title, text_style(20.0, INK))
        .margin(14)
        .x_label_area_size(44)
        .y_label_area_size(76)
        .build_cartesian_2d(times.log_scale(), errors)
        .map_err(|e| failed(&e))?;
    chart
        .configure_mesh()
        .x_desc("milliseconds per frame")
        .y_desc(error_label)
        .x_label_formatter(&|x| number(*x))
        .y_label_formatter(&|y| number(*y))
        .label_style(text_style(14.0, INK))
        .axis_desc_style(text_style(15.0, INK))
        .bold_line_style(RGBColor(222, 222, 226))
        .light_line_style(RGBColor(243, 243, 245))
        .draw()
        .map_err(|e| failed(&e))?;
    for (index, family) in families.iter().enumerate() {
        let style: ShapeStyle = colour(index).into();
        let mut points: Vec<(f64, f64)> = family
            .costs
            .iter()
            .map(|cost| (cost.milliseconds, cost.error))
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        if family.joined {
            let line = PathElement::new(points.clone(), colour(index).mix(0.45).stroke_width(2));
            chart.draw_series([line]).map_err(|e| failed(&e))?;
        }
        let dots = points
            .into_iter()
            .map(|at| Circle::new(at, 5, style.filled()));
        chart.draw_series(dots).map_err(|e| failed(&e))?;
    }
    label_costs(&chart, &area, families).map_err(|e| failed(&e))
}

type Pixels<'a> = plotters::backend::BitMapBackend<'a>;
type LogTime = plotters::coord::combinators::LogCoord<f64>;
type Errors = plotters::coord::types::RangedCoordf64;
type TimeChart<'a, 'b> =
    plotters::chart::ChartContext<'a, Pixels<'b>, Cartesian2d<LogTime, Errors>>;
type Area<'b> = plotters::drawing::DrawingArea<Pixels<'b>, plotters::coord::Shift>;

/// Writes each point's name beside it, moved up or down until it covers no
/// other name or point.
fn label_costs(chart: &TimeChart, area: &Area, families: &[Family]) -> Result<(), String> {
    let costs: Vec<(usize, &Cost)> = families
        .iter()
        .enumerate()
        .flat_map(|(index, family)| family.costs.iter().map(move |cost| (index, cost)))
        .collect();
    let places: Vec<(i32, i32)> = costs
        .iter()
        .map(|(_, cost)| chart.backend_coord(&(cost.milliseconds, cost.error)))
        .collect();
    let (x_pixels, y_pixels) = chart.plotting_area().get_pixel_range();
    // Occupied rectangles: left, top, right, bottom.
    let mut taken: Vec<[i32; 4]> = places
        .iter()
        .map(|&(x, y)| [x - 6, y - 6, x + 6, y + 6])
        .collect();
    for (&(family, cost), &(x, y)) in costs.iter().zip(&places) {
        let style = text_style(13.0, INK);
        let (w, h) = area
            .estimate_text_size(&cost.label, &style)
            .map_err(|error| error.to_string())?;
        let (w, h) = (w as i32, h as i32);
        let rectangle = |&(right, dy): &(bool, i32)| {
            let left = if right { x + 10 } else { x - 10 - w };
            [left, y + dy - h / 2, left + w, y + dy + h / 2]
        };
        let free = |r: &[i32; 4]| {
            r[0] >= x_pixels.start
                && r[2] <= x_pixels.end
                && r[1] >= y_pixels.start
                && r[3] <= y_pixels.end
                && !taken
                    .iter()
                    .any(|t| r[0] < t[2] && t[0] < r[2] && r[1] < t[3] && t[1] < r[3])
        };
        let offsets = (0..8).flat_map(|step| [step * 8, -step * 8]);
        let candidates: Vec<(bool, i32)> =
            offsets.flat_map(|dy| [(true, dy), (false, dy)]).collect();
        let place = candidates
            .iter()
            .map(rectangle)
            .find(free)
            .unwrap_or(rectangle(&(true, 0)));
        taken.push(place);
        let dark = COLOURS[family % COLOURS.len()].map(|c| (f32::from(c) * 0.7) as u8);
        let style = text_style(13.0, dark).pos(Pos::new(HPos::Left, VPos::Center));
        let at = (place[0], (place[1] + place[3]) / 2);
        area.draw(&Text::new(cost.label.clone(), at, style))
            .map_err(|error| error.to_string())?;
    }
    Ok(())
}

fn colour(index: usize) -> RGBColor {
    let [r, g, b] = COLOURS[index % COLOURS.len()];
    RGBColor(r, g, b)
}

/// Range of values with a share of its length added at both ends.
fn padded(values: impl Iterator<Item = f64>, share: f64) -> Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    let pad = if high > low {
        (high - low) * share
    } else {
        (low.abs() * 0.1).max(0.5)
    };
    low - pad..high + pad
}

/// Range of positive values, widened by a factor at both ends; 0.1 to 1 without values.
fn decades(values: impl Iterator<Item = f64>, factor: f64) -> Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), v| {
        (low.min(v), high.max(v))
    });
    if high == 0.0 {
        0.1..1.0
    } else {
        low / factor..high * factor
    }
}

/// A number in few characters.
fn number(x: f64) -> String {
    let size = x.abs();
    if x == 0.0 {
        "0".into()
    } else if !(1e-3..1e5).contains(&size) {
        format!("{x:.0e}")
    } else {
        let text = format!(
            "{x:.*}",
            (2 - size.log10().floor() as i32).clamp(0, 5) as usize
        );
        if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.').into()
        } else {
            text
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot<'a>(series: &'a [Series], log_y: bool) -> LinePlot<'a> {
        LinePlot {
            title: "loss",
            x_label: "update",
            y_label: "loss",
            log_y,
            series,
            marks: &[],
        }
    }

    fn series(points: &[(f64, f64)]) -> Vec<Series> {
        vec![Series {
            name: "position".into(),
            points: points.to_vec(),
        }]
    }

    #[test]
    fn what_cannot_be_drawn_is_an_error_that_names_the_point() {
        let nothing = line_plot(&plot(&series(&[]), true), 300, 200);
        assert!(matches!(nothing, Err(ViewError::Empty { .. })));
        let nan = line_plot(
            &plot(&series(&[(0.0, 1.0), (1.0, f64::NAN)]), false),
            300,
            200,
        );
        let message = nan.unwrap_err().to_string();
        assert!(
            message.contains("position") && message.contains("point 1"),
            "{message}"
        );
        let cost = |milliseconds, error| Family {
            joined: false,
            costs: vec![Cost {
                label: "hold".into(),
                milliseconds,
                error,
            }],
        };
        assert!(matches!(
            trade_off("t", "e", &[], 300, 200),
            Err(ViewError::Empty { .. })
        ));
        let zero = trade_off("t", "e", &[cost(0.0, 1.0)], 300, 200);
        assert!(zero.unwrap_err().to_string().contains("hold"));
        let infinite = trade_off("t", "e", &[cost(1.0, f64::INFINITY)], 300, 200);
        assert!(matches!(infinite, Err(ViewError::NotFinite { .. })));
    }

    #[test]
    fn degenerate_but_finite_values_are_drawn() {
        for points in [
            vec![(0.0, 0.0)],
            vec![(5.0, 2.0), (5.0, 2.0)],
            vec![(0.0, 0.0), (1.0, 1e-30), (2.0, 1e30)],
            vec![(0.0, -1.0), (1.0, -2.0)],
        ] {
            for log_y in [false, true] {
                line_plot(&plot(&series(&points), log_y), 400, 300).unwrap();
            }
        }
        let same = Cost {
            label: "a".into(),
            milliseconds: 1e-9,
            error: 0.0,
        };
        let twice = Family {
            joined: true,
            costs: vec![same.clone(), same],
        };
        trade_off("t", "e", &[twice], 400, 300).unwrap();
    }

    #[test]
    fn numbers_are_short() {
        let texts = [0.0, 0.5, 1.0, 12.0, 0.001, 123.4, 1e-7, 2500.0, 1e6].map(number);
        assert_eq!(
            texts,
            ["0", "0.5", "1", "12", "0.001", "123", "1e-7", "2500", "1e6"]
        );
    }
}
