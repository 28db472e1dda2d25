//! What happens where in a photograph: arrows, and cells that are shaded by a value.

use std::fmt::Write;

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

/// Width of the drawing, pixels of a browser.
const WIDTH: f64 = 640.0;

/// Draws arrows (`magnified` times as long as they are) and shaded cells (values row by row, columns and rows; the largest
/// value is darkest, what is not finite is black) over the frame of a photograph of `size` pixels, as SVG.
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
        height + 26.0
    );
    let most = values.iter().copied().filter(|value| value.is_finite()).fold(0.0, f64::max).max(1e-300);
    let (wide, tall) = (WIDTH / cells.0.max(1) as f64, height / cells.1.max(1) as f64);
    for (i, value) in values.iter().enumerate() {
        let shade = if value.is_finite() { 0.75 * value / most } else { 1.0 };
        let (x, y) = ((i % cells.0.max(1)) as f64 * wide, (i / cells.0.max(1)) as f64 * tall);
        // Writing to a string cannot fail.
        let _ = writeln!(
            svg,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{wide:.1}\" height=\"{tall:.1}\" fill=\"currentColor\" fill-opacity=\"{shade:.3}\"/>"
        );
    }
    for arrow in arrows {
        // A pixel's centre is an integer.
        let (x, y) = (scale * (arrow.at.0 + 0.5), scale * (arrow.at.1 + 0.5));
        let (dx, dy) = (scale * magnified * arrow.by.0, scale * magnified * arrow.by.1);
        let colour = if arrow.strong { "#0072b2" } else { "#d55e00" };
        let _ = writeln!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"1.2\" fill=\"{colour}\"/>\
             <path d=\"M{x:.1} {y:.1}l{dx:.1} {dy:.1}\" stroke=\"{colour}\"/>"
        );
    }
    let _ = writeln!(
        svg,
        "<rect x=\"0.5\" y=\"0.5\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" stroke=\"currentColor\"/>\n\
         <text x=\"4\" y=\"{:.1}\" font-size=\"12\" fill=\"currentColor\">{}</text>\n</svg>",
        WIDTH - 1.0,
        height - 1.0,
        height + 18.0,
        caption.replace('&', "&amp;").replace('<', "&lt;")
    );
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrows_cells_and_caption_are_drawn_in_the_frame_of_the_photograph() {
        let arrows = [Arrow { at: (319.5, 239.5), by: (1.0, -0.5), strong: true }];
        let svg = field((640, 480), &arrows, 10.0, (&[1.0, f64::INFINITY], (2, 1)), "a < b");
        assert!(svg.contains("M320.0 240.0l10.0 -5.0"), "{svg}");
        assert!(svg.contains("height=\"506\"") && svg.contains("a &lt; b") && svg.contains("0.750"));
        assert!(!svg.contains("inf") && !svg.contains("NaN"));
        assert_eq!(svg.matches("<rect").count(), 3);
    }
}
