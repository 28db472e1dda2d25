//! The sheet that charts are drawn on: axes, legend, marks and lines, in the page's ink and a palette for all eyes.

use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::Axis;
use super::labels::{LETTERS, Placed, Rectangle, width_of};
use super::scale::Scale;
use crate::{Error, Result};

/// Size of a chart, pixels of a browser.
const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 420.0;
/// The backend only knows whole units: curves are smooth when a pixel has several.
const UNITS: f64 = 8.0;
/// Stands for the ink of the page until the picture is finished.
const INK: RGBColor = RGBColor(1, 2, 3);
/// Okabe and Ito's colours, which people with any kind of colour vision tell apart; yellow is too pale for lines.
const PALETTE: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];
/// Corners of the marks, of radius 1; the empty one is a circle. Five shapes and six colours make thirty marks.
const SHAPES: [&[(f64, f64)]; 5] = [
    &[],
    &[(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)],
    &[(0.0, -1.2), (1.1, 0.8), (-1.1, 0.8)],
    &[(0.0, -1.3), (1.3, 0.0), (0.0, 1.3), (-1.3, 0.0)],
    &[(0.0, 1.2), (1.1, -0.8), (-1.1, -0.8)],
];

/// How something is drawn; the number is that of its series.
#[derive(Debug, Clone, Copy)]
pub(super) enum Mark {
    Filled(usize),
    Hollow(usize),
    Line(usize),
    /// The line along the Pareto front, in ink.
    Front,
}

impl Mark {
    fn colour(self) -> RGBAColor {
        match self {
            Mark::Filled(i) | Mark::Hollow(i) | Mark::Line(i) => PALETTE[i % PALETTE.len()].to_rgba(),
            Mark::Front => INK.mix(0.45),
        }
    }
}

/// A sheet with axes and legend.
pub(super) struct Canvas<'a> {
    sheet: DrawingArea<SVGBackend<'a>, Shift>,
    plot: DrawingArea<SVGBackend<'a>, Cartesian2d<Scale, Scale>>,
}

/// A chart as SVG: axes, legend, and what `draw` adds.
pub(super) fn chart(
    scales: (Scale, Scale),
    axes: (Axis, Axis),
    legend: &[(&str, Mark)],
    draw: impl FnOnce(&Canvas) -> Result<()>,
) -> Result<String> {
    let mut svg = String::new();
    let size = (units(WIDTH) as u32, units(HEIGHT) as u32);
    {
        let sheet = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        let rows = draw_legend(&sheet, legend)?;
        let (_, below) = sheet.split_vertically(units(8.0 + 20.0 * rows as f64));
        let mut builder = ChartBuilder::on(&below);
        builder.margin_right(units(18.0)).margin_top(units(6.0)).margin_bottom(units(4.0));
        builder.x_label_area_size(units(46.0)).y_label_area_size(units(66.0));
        let mut context = drawn(builder.build_cartesian_2d(scales.0, scales.1))?;
        let mut mesh = context.configure_mesh();
        mesh.x_desc(axes.0.label).y_desc(axes.1.label).label_style(text(12.0)).axis_desc_style(text(13.0));
        mesh.bold_line_style(INK.mix(0.14).stroke_width(UNITS as u32)).light_line_style(TRANSPARENT);
        mesh.axis_style(INK.mix(0.6).stroke_width(UNITS as u32)).set_all_tick_mark_size(units(4.0));
        mesh.x_labels(8).y_labels(7);
        drawn(mesh.draw())?;
        draw(&Canvas { plot: context.plotting_area().clone(), sheet: sheet.clone() })?;
        drawn(sheet.present())?;
    }
    let header = format!(r#"<svg width="{}" height="{}""#, size.0, size.1);
    let page = format!(r#"<svg class="chart" width="{WIDTH}" height="{HEIGHT}""#);
    // In a file of its own the picture has no page to take its ink from.
    let ink = "<style>.chart{color:#222;font-family:sans-serif;max-width:100%;height:auto}\
               @media(prefers-color-scheme:dark){.chart{color:#ddd}}\
               @media print{.chart{color:#222}}</style>\n";
    let svg = svg.replacen(&header, &page, 1).replace("#010203", "currentColor");
    Ok(svg.replacen(">\n", &format!(">\n{ink}"), 1))
}

impl Canvas<'_> {
    /// Where a value is drawn, pixels.
    pub(super) fn pixel(&self, value: (f64, f64)) -> (f64, f64) {
        let at = self.plot.map_coordinate(&value);
        (f64::from(at.0) / UNITS, f64::from(at.1) / UNITS)
    }

    /// The area inside the axes, pixels.
    pub(super) fn plot_area(&self) -> Rectangle {
        let (x, y) = self.plot.get_pixel_range();
        [x.start, y.start, x.end, y.end].map(|edge| f64::from(edge) / UNITS)
    }

    /// The area of a level or upright line between two values, pixels.
    pub(super) fn around(&self, a: (f64, f64), b: (f64, f64)) -> Rectangle {
        let (a, b) = (self.pixel(a), self.pixel(b));
        [a.0.min(b.0) - 1.0, a.1.min(b.1) - 1.0, a.0.max(b.0) + 1.0, a.1.max(b.1) + 1.0]
    }

    /// A mark at a value.
    pub(super) fn mark(&self, value: (f64, f64), mark: Mark) -> Result<()> {
        draw_mark(&self.sheet, self.pixel(value), mark)
    }

    /// A line through values.
    pub(super) fn line(&self, values: &[(f64, f64)], mark: Mark) -> Result<()> {
        let path: Vec<(i32, i32)> = values.iter().map(|value| self.plot.map_coordinate(value)).collect();
        stroke(&self.sheet, path, mark.colour(), if matches!(mark, Mark::Front) { 1.2 } else { 2.0 })
    }

    /// A label in its place, with a line to its point where it is far.
    pub(super) fn label(&self, placed: &Placed) -> Result<()> {
        let [left, top, right, bottom] = placed.area;
        if placed.far {
            let nearest = (placed.anchor.0.clamp(left, right), placed.anchor.1.clamp(top, bottom));
            let path = vec![in_units(placed.anchor), in_units(nearest)];
            stroke(&self.sheet, path, INK.mix(0.35), 0.8)?;
        }
        let centre = ((left + right) / 2.0, (top + bottom) / 2.0);
        let style = text(LETTERS).pos(Pos::new(HPos::Center, VPos::Center));
        drawn(self.sheet.draw(&Text::new(placed.text.to_owned(), in_units(centre), style)))
    }
}

/// Draws the legend along the top and returns how many rows it took.
fn draw_legend(sheet: &DrawingArea<SVGBackend, Shift>, legend: &[(&str, Mark)]) -> Result<usize> {
    const LEFT: f64 = 66.0;
    let (mut x, mut row) = (LEFT, 0);
    for (name, mark) in legend {
        let width = 22.0 + width_of(name, 13.0) + 16.0;
        if x > LEFT && x + width > WIDTH {
            (x, row) = (LEFT, row + 1);
        }
        let y = 16.0 + 20.0 * row as f64;
        if let Mark::Line(_) | Mark::Front = mark {
            let path = vec![in_units((x - 2.0, y)), in_units((x + 14.0, y))];
            stroke(sheet, path, mark.colour(), 2.0)?;
        } else {
            draw_mark(sheet, (x + 6.0, y), *mark)?;
        }
        let style = text(13.0).pos(Pos::new(HPos::Left, VPos::Center));
        drawn(sheet.draw(&Text::new((*name).to_owned(), in_units((x + 20.0, y)), style)))?;
        x += width;
    }
    Ok(row + 1)
}

fn draw_mark(sheet: &DrawingArea<SVGBackend, Shift>, at: (f64, f64), mark: Mark) -> Result<()> {
    const RADIUS: f64 = 4.5;
    let (series, filled) = match mark {
        Mark::Filled(i) | Mark::Line(i) => (i, true),
        Mark::Hollow(i) => (i, false),
        Mark::Front => return Ok(()),
    };
    let corners = SHAPES[series % SHAPES.len()];
    let outline = mark.colour().stroke_width(units(1.6) as u32);
    if corners.is_empty() {
        let style = if filled { mark.colour().filled() } else { outline };
        return drawn(sheet.draw(&Circle::new(in_units(at), units(RADIUS), style)));
    }
    let corner = |&(x, y): &(f64, f64)| in_units((at.0 + RADIUS * x, at.1 + RADIUS * y));
    let mut path: Vec<(i32, i32)> = corners.iter().map(corner).collect();
    if filled {
        return drawn(sheet.draw(&Polygon::new(path, mark.colour().filled())));
    }
    path.extend_from_within(..2);
    drawn(sheet.draw(&PathElement::new(path, outline)))
}

fn stroke(
    sheet: &DrawingArea<SVGBackend, Shift>,
    path: Vec<(i32, i32)>,
    colour: RGBAColor,
    width: f64,
) -> Result<()> {
    drawn(sheet.draw(&PathElement::new(path, colour.stroke_width(units(width) as u32))))
}

fn text(letters: f64) -> TextStyle<'static> {
    // The backend divides sizes by 1.24.
    ("sans-serif", units(letters * 1.24)).into_font().color(&INK)
}

fn units(pixels: f64) -> i32 {
    (pixels * UNITS).round() as i32
}

fn in_units(pixels: (f64, f64)) -> (i32, i32) {
    (units(pixels.0), units(pixels.1))
}

fn drawn<T, E: std::error::Error>(result: std::result::Result<T, E>) -> Result<T> {
    result.map_err(|error| {
        Error::request(format!("the chart cannot be drawn ({error})"), "chart fewer or other values")
    })
}
