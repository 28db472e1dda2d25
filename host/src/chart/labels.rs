//! Where the labels of points go, so that they cover neither each other nor the points.

/// A rectangle in pixels: left, top, right, bottom.
pub(super) type Rectangle = [f64; 4];

/// Height of a label's letters, pixels.
pub(super) const LETTERS: f64 = 12.0;

/// A text that belongs to the point at `anchor` (pixels).
pub(super) struct Label<'a> {
    pub(super) text: &'a str,
    pub(super) anchor: (f64, f64),
}

/// A label in its place.
#[derive(Debug, PartialEq)]
pub(super) struct Placed<'a> {
    pub(super) text: &'a str,
    pub(super) anchor: (f64, f64),
    pub(super) area: Rectangle,
    /// So far away that a line must lead to its point.
    pub(super) far: bool,
}

/// Width of a text without knowing the font: a sans-serif letter is a little more than half as wide as it is high.
pub(super) fn width_of(text: &str, letters: f64) -> f64 {
    0.57 * letters * text.chars().count() as f64
}

/// Finds a place within `bounds` for every label that is not empty: beside its point, or farther out where it is crowded.
/// `obstacles` are what a label had better not cover besides the points.
pub(super) fn place<'a>(labels: &[Label<'a>], obstacles: &[Rectangle], bounds: Rectangle) -> Vec<Placed<'a>> {
    let marks: Vec<Rectangle> =
        labels.iter().map(|l| around(l.anchor, 5.0)).chain(obstacles.iter().copied()).collect();
    let named: Vec<&Label> = labels.iter().filter(|label| !label.text.is_empty()).collect();
    let mut chosen: Vec<Option<(Rectangle, bool)>> = vec![None; named.len()];
    // A later label may take the room that an earlier one does not need: three rounds settle that.
    for _ in 0..3 {
        for i in 0..named.len() {
            let cost = |(area, penalty): (Rectangle, f64)| {
                let others = chosen.iter().enumerate().filter(|(j, _)| *j != i).filter_map(|(_, c)| *c);
                let covered: f64 = others.map(|(other, _)| overlap(area, other)).sum();
                let marked: f64 = marks.iter().map(|mark| overlap(area, *mark)).sum();
                let size = (area[2] - area[0]) * (area[3] - area[1]);
                let outside = size - overlap(area, bounds);
                penalty + covered + 2.0 * marked + 4.0 * outside
            };
            let best =
                candidates(named[i]).into_iter().min_by(|a, b| cost((a.0, a.1)).total_cmp(&cost((b.0, b.1))));
            chosen[i] = best.map(|(area, _, far)| (area, far));
        }
    }
    let place = |(label, chosen): (&Label<'a>, Option<(Rectangle, bool)>)| {
        chosen.map(|(area, far)| Placed { text: label.text, anchor: label.anchor, area, far })
    };
    named.into_iter().zip(chosen).filter_map(place).collect()
}

/// Areas for a label, what each is worse by than the best, and whether it is far from its point.
fn candidates(label: &Label) -> Vec<(Rectangle, f64, bool)> {
    let (width, height) = (width_of(label.text, LETTERS), LETTERS * 1.15);
    let mut found = Vec::new();
    for (ring, gap) in [7.0, 18.0, 32.0, 48.0].into_iter().enumerate() {
        for step in 0..16 {
            let (sin, cos) = (f64::from(step) * std::f64::consts::PI / 8.0).sin_cos();
            // The box touches the ring on the side that faces the point.
            let x = label.anchor.0 + gap * cos + width / 2.0 * (cos * 1.5).clamp(-1.0, 1.0);
            let y = label.anchor.1 - gap * sin - height / 2.0 * (sin * 1.5).clamp(-1.0, 1.0);
            let area = [x - width / 2.0, y - height / 2.0, x + width / 2.0, y + height / 2.0];
            // Right first, then left, then above and below.
            let turned = 4.0 * sin.abs() + if cos < 0.0 { 2.0 } else { 0.0 };
            found.push((area, turned + 30.0 * ring as f64, ring > 0));
        }
    }
    found
}

fn around(at: (f64, f64), radius: f64) -> Rectangle {
    [at.0 - radius, at.1 - radius, at.0 + radius, at.1 + radius]
}

/// The area that two rectangles share.
fn overlap(a: Rectangle, b: Rectangle) -> f64 {
    let width = a[2].min(b[2]) - a[0].max(b[0]);
    let height = a[3].min(b[3]) - a[1].max(b[1]);
    width.max(0.0) * height.max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Rectangle = [0.0, 0.0, 500.0, 300.0];

    #[test]
    fn labels_of_a_crowd_do_not_touch_each_other_or_leave_the_picture() {
        let crowd: Vec<Label> = (0..12)
            .map(|i| Label {
                text: "36 terms",
                anchor: (250.0 + 14.0 * f64::from(i % 4), 150.0 + 12.0 * f64::from(i / 4)),
            })
            .collect();
        let corner = Label { text: "in the corner", anchor: (498.0, 298.0) };
        let labels: Vec<Label> = crowd.into_iter().chain([corner]).collect();
        let placed = place(&labels, &[], BOUNDS);
        assert_eq!(placed.len(), 13);
        for (i, a) in placed.iter().enumerate() {
            let size = (a.area[2] - a.area[0]) * (a.area[3] - a.area[1]);
            assert!((overlap(a.area, BOUNDS) - size).abs() < 1e-9, "{a:?}");
            for b in &placed[..i] {
                assert_eq!(overlap(a.area, b.area), 0.0, "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn a_lonely_label_stands_to_the_right_of_its_point_and_an_empty_one_nowhere() {
        let labels =
            [Label { text: "", anchor: (10.0, 10.0) }, Label { text: "alone", anchor: (100.0, 100.0) }];
        let placed = place(&labels, &[], BOUNDS);
        assert_eq!(placed.len(), 1);
        assert!(
            placed[0].area[0] > 105.0
                && placed[0].area[1] < 100.0
                && placed[0].area[3] > 100.0
                && !placed[0].far
        );
    }
}
