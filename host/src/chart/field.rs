//! What happens where in a photograph: arrows, and cells that are shaded by a value.

use std::fmt::Write;

use super::labels::width_of;

/// An arrow in a photograph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrow {
    /// Where it begins, pixels.
    pub at: (f64, f64),
    /// How long it is, pixels.
    pub by: (f64, f64),
    /// Whether it is drawn in full colour; the others are red.
    pub strong: bool,
}

/// Width of the drawing, pixels of a browser; height of a line of text below it.
const WIDTH: f64 = 640.0;
const LINE: f64 = 22.0;
/// About how long the arrow of the legend is, and how dark the largest value is.
const KEY: f64 = 60.0;
const DARKEST: f64 = 0.75;
const STRONG: &str = "#0072b2";
const WEAK: &str = "#d55e00";

/// Draws arrows (`magnified` times as long as they are, from a dot where they begin) and shaded cells (values in pixels, row by row,
/// columns and rows; the largest value is darkest, what is not finite is black) over the frame of a photograph of `size`
/// pixels, as SVG; below it a legend with the length of an arrow and the values of some shades, and the caption.
pub fn field(
    size: (u32, u32),
    arrows: &[Arrow],
    magnified: f64,
    (values, cells): (&[f64], (usize, usize)),
    caption: &str,
) -> String {
    let scale = WIDTH / f64::from(size.0.max(1));
    let height = scale * f64::from(size.1);
    let mut svg = format!(
        "<svg class=\"chart\" width=\"{WIDTH}\" height=\"{:.0}\" xmlns=\"http://www.w3.org/2000/svg\">\n\
         <style>.chart{{color:#222;font-family:sans-serif;max-width:100%;height:auto}}\
         @media(prefers-color-scheme:dark){{.chart{{color:#ddd}}}}@media print{{.chart{{color:#222}}}}</style>\n",
        height + 2.0 * LINE + 6.0
    );
    let most = values.iter().copied().filter(|value| value.is_finite()).fold(0.0, f64::max).max(1e-300);
    let (wide, tall) = (WIDTH / cells.0.max(1) as f64, height / cells.1.max(1) as f64);
    for (i, value) in values.iter().enumerate() {
        let shade = if value.is_finite() { DARKEST * value / most } else { 1.0 };
        let (x, y) = ((i % cells.0.max(1)) as f64 * wide, (i / cells.0.max(1)) as f64 * tall);
        // Writing to a string cannot fail.
        let _ = writeln!(
            svg,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{wide:.1}\" height=\"{tall:.1}\" fill=\"currentColor\" fill-opacity=\"{shade:.3}\"/>"
        );
    }
    // An inner picture cuts off what points beyond the photograph.
    let _ = writeln!(svg, "<svg width=\"{WIDTH}\" height=\"{height:.1}\">");
    for arrow in arrows {
        // A pixel's centre is an integer.
        let (x, y) = (scale * (arrow.at.0 + 0.5), scale * (arrow.at.1 + 0.5));
        let (dx, dy) = (scale * magnified * arrow.by.0, scale * magnified * arrow.by.1);
        let colour = if arrow.strong { STRONG } else { WEAK };
        let _ = writeln!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"1.2\" fill=\"{colour}\"/>\
             <path d=\"M{x:.1} {y:.1}l{dx:.1} {dy:.1}\" stroke=\"{colour}\"/>"
        );
    }
    let _ = writeln!(
        svg,
        "</svg>\n<rect x=\"0.5\" y=\"0.5\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" stroke=\"currentColor\"/>",
        WIDTH - 1.0,
        height - 1.0
    );
    let mut legend = Legend { svg: &mut svg, x: 4.0, y: height + LINE - 8.0 };
    let longest = arrows.iter().map(|arrow| arrow.by.0.hypot(arrow.by.1)).fold(0.0, f64::max);
    if longest > 0.0 && magnified > 0.0 {
        legend.arrow(round(KEY / (scale * magnified)), scale * magnified);
        if arrows.iter().any(|arrow| !arrow.strong && arrow.by != (0.0, 0.0)) {
            legend.dot(STRONG, "used");
            legend.dot(WEAK, "left out");
        }
    }
    if values.iter().any(|value| value.is_finite()) {
        for part in [0.25, 0.5, 1.0] {
            legend.shade(part * DARKEST, &number(part * most));
        }
    }
    let _ = writeln!(
        svg,
        "<text x=\"4\" y=\"{:.1}\" font-size=\"12\" fill=\"currentColor\">{}</text>\n</svg>",
        height + 2.0 * LINE - 4.0,
        escaped(caption)
    );
    svg
}

/// One line of explanations, from left to right.
struct Legend<'a> {
    svg: &'a mut String,
    x: f64,
    y: f64,
}

impl Legend<'_> {
    /// An arrow that stands for `length` pixels of the photograph.
    fn arrow(&mut self, length: f64, scale: f64) {
        let _ = write!(
            self.svg,
            "<circle cx=\"{:.1}\" cy=\"{y:.1}\" r=\"1.2\" fill=\"{STRONG}\"/><path d=\"M{:.1} {y:.1}h{:.1}\" stroke=\"{STRONG}\"/>",
            self.x + 2.0,
            self.x + 2.0,
            scale * length,
            y = self.y - 4.0
        );
        self.x += scale * length + 8.0;
        self.text(&format!("{} px", number(length)));
    }

    fn dot(&mut self, colour: &str, text: &str) {
        let _ = write!(
            self.svg,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\" fill=\"{colour}\"/>",
            self.x + 3.0,
            self.y - 4.0
        );
        self.x += 10.0;
        self.text(text);
    }

    fn shade(&mut self, opacity: f64, text: &str) {
        let _ = write!(
            self.svg,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"22\" height=\"12\" fill=\"currentColor\" fill-opacity=\"{opacity:.3}\"/>",
            self.x,
            self.y - 10.0
        );
        self.x += 27.0;
        self.text(&format!("{text} px"));
    }

    fn text(&mut self, text: &str) {
        let _ = writeln!(
            self.svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"12\" fill=\"currentColor\">{}</text>",
            self.x,
            self.y,
            escaped(text)
        );
        self.x += width_of(text, 12.0) + 16.0;
    }
}

/// The nearest of 1, 2 and 5 times a power of ten below a positive number.
fn round(number: f64) -> f64 {
    let power = 10f64.powf(number.log10().floor());
    [5.0, 2.0, 1.0]
        .map(|m| m * power)
        .into_iter()
        .find(|&round| round <= number * (1.0 + 1e-9))
        .unwrap_or(power)
}

/// Three digits of a number, without those that say nothing.
fn number(value: f64) -> String {
    let digits = (2.0 - value.abs().max(1e-9).log10().floor()).clamp(0.0, 9.0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrows_cells_and_caption_are_drawn_in_the_frame_of_the_photograph() {
        let arrows = [Arrow { at: (319.5, 239.5), by: (1.0, -0.5), strong: true }];
        let svg = field((640, 480), &arrows, 10.0, (&[1.0, f64::INFINITY], (2, 1)), "a < b");
        assert!(svg.contains("M320.0 240.0l10.0 -5.0"), "{svg}");
        assert!(svg.contains("height=\"530\"") && svg.contains("a &lt; b") && svg.contains("0.750"));
        assert!(!svg.contains("inf") && !svg.contains("NaN"));
        // Two cells, the frame, three shades of the legend.
        assert_eq!(svg.matches("<rect").count(), 6);
        assert!(svg.contains("0.25 px") && svg.contains("1 px"), "{svg}");
    }

    #[test]
    fn the_legend_s_arrow_is_as_long_as_it_says() {
        let arrow = |strong| Arrow { at: (10.0, 10.0), by: (0.3, 0.0), strong };
        let svg = field((1280, 960), &[arrow(true), arrow(false)], 100.0, (&[], (0, 0)), "");
        // A pixel is drawn 50 wide: the arrow of 1 px, h50.
        assert!(svg.contains("h50.0\"") && svg.contains(">1 px<"), "{svg}");
        assert!(svg.contains(">used<") && svg.contains(">left out<"));
        let even = field((1280, 960), &[arrow(true)], 100.0, (&[], (0, 0)), "");
        assert!(!even.contains("left out"));
        let dots = field((64, 48), &[Arrow { by: (0.0, 0.0), ..arrow(true) }], 1.0, (&[], (0, 0)), "");
        assert!(!dots.contains("px"), "{dots}");
    }
}
