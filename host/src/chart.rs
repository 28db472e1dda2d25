//! Measurements as pictures: SVG that a browser shows on light and dark pages, prints, and needs no font for.

mod canvas;
mod field;
mod labels;
mod scale;

use crate::{Error, Result};
pub use field::{Arrow, field};

use canvas::{Mark, chart};
use labels::{Label, place};
use scale::Scale;

/// One measurement in a comparison of methods.
#[derive(Debug, Clone, PartialEq)]
pub struct ChartPoint {
    /// The method that was measured; it chooses colour and shape.
    pub method: String,
    /// Position along x.
    pub x: f64,
    /// Position along y.
    pub y: f64,
    /// A few words beside the point, such as the setting; may be empty.
    pub label: String,
}

/// What an axis means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Axis<'a> {
    /// Quantity and unit.
    pub label: &'a str,
    /// Whether its steps are powers of ten.
    pub logarithmic: bool,
}

/// Values that belong together in a plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// The values, in the order in which a line connects them.
    pub points: Vec<(f64, f64)>,
    /// How they are drawn.
    pub drawn: Drawn,
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drawn {
    /// A mark per value: what was measured.
    Marks,
    /// One line: what was fitted.
    Line,
    /// A line in the page's ink: what the others are held against.
    Limit,
}

/// A comparison of methods in which less is better on both axes, such as time against error. The points that no other
/// point beats on both (the Pareto front) are filled and joined by a line; the others are hollow.
///
/// # Errors
/// [`Error::Request`] when there is no point, or one cannot be drawn: it is not finite, or not positive on a
/// logarithmic axis.
pub fn scatter(points: &[ChartPoint], axes: (Axis, Axis)) -> Result<String> {
    let all: Vec<(f64, f64)> = points.iter().map(|p| (p.x, p.y)).collect();
    let describe = |i: usize| format!("{} {}", points[i].method, points[i].label);
    check(&all, axes, describe)?;
    let mut methods: Vec<&str> = Vec::new();
    for point in points {
        if !methods.contains(&point.method.as_str()) {
            methods.push(&point.method);
        }
    }
    let front = pareto_front(&all);
    let mut legend: Vec<(&str, Mark)> =
        methods.iter().enumerate().map(|(i, name)| (*name, Mark::Filled(i))).collect();
    legend.push(("no other is better in both", Mark::Front));

    let mut steps = Vec::new();
    for pair in front.windows(2) {
        steps.extend([all[pair[0]], (all[pair[1]].0, all[pair[0]].1), all[pair[1]]]);
    }
    chart(scales(&all, axes), axes, &legend, |canvas| {
        canvas.line(&steps, Mark::Front)?;
        let mut labels = Vec::new();
        for (i, point) in points.iter().enumerate() {
            let method = methods.iter().position(|name| *name == point.method).unwrap_or_default();
            let mark = if front.contains(&i) { Mark::Filled(method) } else { Mark::Hollow(method) };
            canvas.mark(all[i], mark)?;
            labels.push(Label { text: &point.label, anchor: canvas.pixel(all[i]) });
        }
        let stairs: Vec<_> = steps.windows(2).map(|ends| canvas.around(ends[0], ends[1])).collect();
        place(&labels, &stairs, canvas.plot_area()).iter().try_for_each(|placed| canvas.label(placed))
    })
}

/// Several series over the same axes: marks for what was measured, lines for what was fitted. Marks and a line of one name belong
/// together: they share a colour and a place in the legend.
///
/// # Errors
/// [`Error::Request`] when there is no value, or one cannot be drawn: it is not finite, or not positive on a
/// logarithmic axis.
pub fn lines(series: &[Series], axes: (Axis, Axis)) -> Result<String> {
    let owners: Vec<&str> = series.iter().flat_map(|s| s.points.iter().map(|_| s.name.as_str())).collect();
    let all: Vec<(f64, f64)> = series.iter().flat_map(|s| s.points.iter().copied()).collect();
    check(&all, axes, |i| owners[i].to_owned())?;
    let mut names: Vec<&str> = vec![];
    for series in series {
        if !names.contains(&series.name.as_str()) {
            names.push(&series.name);
        }
    }
    let mark = |i: usize| {
        let name = names.iter().position(|name| *name == series[i].name).unwrap_or_default();
        match series[i].drawn {
            Drawn::Marks => Mark::Filled(name),
            Drawn::Line => Mark::Line(name),
            Drawn::Limit => Mark::Front,
        }
    };
    let drawn = |name: &str, drawn| series.iter().position(|s| s.name == name && s.drawn == drawn);
    let shown =
        |name: &str| drawn(name, Drawn::Marks).or_else(|| drawn(name, Drawn::Line)).map_or(Mark::Front, mark);
    let legend: Vec<(&str, Mark)> = names.iter().map(|name| (*name, shown(name))).collect();
    chart(scales(&all, axes), axes, &legend, |canvas| {
        // Lines first: a mark must not hide behind the curve that was fitted to it.
        for (i, s) in series.iter().enumerate().filter(|(_, s)| s.drawn != Drawn::Marks) {
            canvas.line(&s.points, mark(i))?;
        }
        for (i, s) in series.iter().enumerate().filter(|(_, s)| s.drawn == Drawn::Marks) {
            s.points.iter().try_for_each(|&point| canvas.mark(point, mark(i)))?;
        }
        Ok(())
    })
}

/// Indices of the points that no other point beats (smaller on one axis and not larger on the other), by rising x.
/// Of equal points the first one counts.
pub fn pareto_front(points: &[(f64, f64)]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| {
        points[a].0.total_cmp(&points[b].0).then(points[a].1.total_cmp(&points[b].1)).then(a.cmp(&b))
    });
    let mut best = f64::INFINITY;
    order.retain(|&i| {
        let better = points[i].1 < best;
        best = best.min(points[i].1);
        better
    });
    order
}

fn check(points: &[(f64, f64)], axes: (Axis, Axis), describe: impl Fn(usize) -> String) -> Result<()> {
    if points.is_empty() {
        return Err(Error::request(
            "a chart without points cannot be drawn",
            "give at least one measurement",
        ));
    }
    let drawable = |value: f64, axis: Axis| value.is_finite() && (value > 0.0 || !axis.logarithmic);
    match points.iter().position(|&(x, y)| !drawable(x, axes.0) || !drawable(y, axes.1)) {
        None => Ok(()),
        Some(i) => Err(Error::request(
            format!(
                "({}, {}) of \"{}\" cannot be drawn on these axes",
                points[i].0,
                points[i].1,
                describe(i).trim()
            ),
            "leave the value out, or use a linear axis",
        )),
    }
}

fn scales(points: &[(f64, f64)], axes: (Axis, Axis)) -> (Scale, Scale) {
    (
        Scale::over(points.iter().map(|p| p.0), axes.0.logarithmic),
        Scale::over(points.iter().map(|p| p.1), axes.1.logarithmic),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(method: &str, x: f64, y: f64, label: &str) -> ChartPoint {
        ChartPoint { method: method.into(), x, y, label: label.into() }
    }

    const TIME: Axis = Axis { label: "time per texel / µs", logarithmic: true };
    const ERROR: Axis = Axis { label: "relative error <5%", logarithmic: false };

    #[test]
    fn the_front_is_what_nothing_beats() {
        let points = [(1.0, 9.0), (2.0, 9.0), (3.0, 4.0), (3.0, 5.0), (5.0, 4.0), (6.0, 1.0), (6.0, 1.0)];
        assert_eq!(pareto_front(&points), [0, 2, 5]);
        for (i, p) in points.iter().enumerate() {
            let beaten = points.iter().any(|q| q.0 <= p.0 && q.1 <= p.1 && q != p);
            let twin = points[..i].contains(p);
            assert_eq!(pareto_front(&points).contains(&i), !beaten && !twin);
        }
    }

    #[test]
    fn a_chart_is_well_formed_and_holds_every_name() {
        let points = [
            point("Phong & co", 1.0, 0.3, "m < 3"),
            point("SH", 20.0, 0.1, "16"),
            point("SH", 25.0, 0.2, "25"),
        ];
        let svg = scatter(&points, (TIME, ERROR)).unwrap();
        for text in
            ["Phong &amp; co", "m &lt; 3", "16", "25", "SH", "time per texel / µs", "relative error &lt;5%"]
        {
            assert!(svg.contains(text), "{text} is missing in {svg}");
        }
        assert!(svg.starts_with("<svg ") && svg.trim_end().ends_with("</svg>"));
        assert!(svg.contains("currentColor"), "follows the page's light or dark ink");
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }

    #[test]
    fn what_cannot_be_drawn_is_named() {
        let error = scatter(&[point("SH", 0.0, 0.3, "16")], (TIME, ERROR)).unwrap_err().to_string();
        assert!(error.contains("SH 16") && error.contains("linear"), "{error}");
        assert!(scatter(&[], (TIME, ERROR)).is_err());
        let series = Series { name: "red".into(), points: vec![(1.0, f64::NAN)], drawn: Drawn::Line };
        assert!(lines(&[series], (TIME, ERROR)).unwrap_err().to_string().contains("red"));
    }

    #[test]
    fn marks_and_line_of_one_name_are_one_entry_and_one_colour() {
        let series =
            |name: &str, drawn| Series { name: name.into(), points: vec![(1.0, 2.0), (2.0, 3.0)], drawn };
        let all = [series("a", Drawn::Marks), series("a", Drawn::Line), series("b", Drawn::Marks)];
        let svg = lines(&all, (TIME, ERROR)).unwrap();
        assert_eq!(svg.matches("#0072B2").count(), 4, "two marks, a line, a mark in the legend: {svg}");
        assert!(!svg.contains("#009E73"), "a third colour");
    }

    #[test]
    fn one_point_or_a_flat_line_still_make_a_chart() {
        for logarithmic in [false, true] {
            let axis = Axis { label: "x", logarithmic };
            let flat =
                Series { name: "flat".into(), points: vec![(3.0, 2.0), (3.0, 2.0)], drawn: Drawn::Line };
            let svg = lines(&[flat], (axis, axis)).unwrap();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }
}
