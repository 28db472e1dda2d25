//! One axis: its range, its ticks and how their numbers are written.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

/// A linear or logarithmic axis with a little room at both ends.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scale {
    /// In the unit of the values, or its decimal logarithm.
    low: f64,
    high: f64,
    logarithmic: bool,
}

impl Scale {
    /// An axis for values that are finite, and positive where it is logarithmic.
    pub(super) fn over(values: impl Iterator<Item = f64>, logarithmic: bool) -> Self {
        let values = values.map(|value| if logarithmic { value.log10() } else { value });
        let (mut low, mut high) = values.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        // A linear axis starts at zero where the values come near it: lengths are then true.
        if !logarithmic && low > 0.0 && low < 0.4 * high {
            low = 0.0;
        }
        let room = match high - low {
            extent if extent > 0.0 => 0.06 * extent,
            _ if logarithmic => 0.5,
            _ => 0.5 * high.abs().max(1e-9),
        };
        let from_zero = !logarithmic && low == 0.0;
        low -= if from_zero { 0.0 } else { room };
        high += room;
        Self { low, high, logarithmic }
    }

    /// Where the axis has its numbers, at most about `most`.
    fn ticks(&self, most: usize) -> Vec<f64> {
        let most = most.clamp(2, 8) as f64;
        if !self.logarithmic {
            return multiples(self.low, self.high, most);
        }
        let decades = self.high - self.low;
        if decades < 0.7 {
            return multiples(10f64.powf(self.low), 10f64.powf(self.high), most);
        }
        let mantissas: &[f64] = match decades {
            ..2.2 => &[1.0, 2.0, 5.0],
            ..4.0 => &[1.0, 3.0],
            _ => &[1.0],
        };
        let step = (decades / most).ceil().max(1.0) as i32;
        let (first, last) = (self.low.floor() as i32, self.high.ceil() as i32);
        (first..=last)
            .filter(|decade| decade.rem_euclid(step) == 0)
            .flat_map(|decade| mantissas.iter().map(move |m| m * 10f64.powi(decade)))
            .filter(|tick| (self.low..=self.high).contains(&tick.log10()))
            .collect()
    }
}

/// Multiples of 1, 2, 2.5 or 5 times a power of ten.
fn multiples(low: f64, high: f64, most: f64) -> Vec<f64> {
    let rough = (high - low) / most;
    let power = 10f64.powf(rough.log10().floor());
    let step =
        [1.0, 2.0, 2.5, 5.0, 10.0].map(|m| m * power).into_iter().find(|&s| s >= rough).unwrap_or(rough);
    ((low / step).ceil() as i64..=(high / step).floor() as i64).map(|i| i as f64 * step).collect()
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let value = if self.logarithmic { value.log10() } else { *value };
        let fraction = (value - self.low) / (self.high - self.low);
        limit.0 + (fraction * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        self.ticks(hint.max_num_points())
    }

    fn range(&self) -> Range<f64> {
        if self.logarithmic { 10f64.powf(self.low)..10f64.powf(self.high) } else { self.low..self.high }
    }
}

impl ValueFormatter<f64> for Scale {
    fn format(value: &f64) -> String {
        // Nine digits: enough for every tick, too few for 0.30000000000000004.
        let rounded: f64 = format!("{value:.9e}").parse().unwrap_or(*value);
        let size = rounded.abs();
        if size != 0.0 && !(1e-4..1e6).contains(&size) {
            format!("{rounded:e}")
        } else {
            format!("{rounded}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_few_and_inside() {
        let ranges: [(f64, f64); 7] =
            [(0.3, 0.9), (1e-6, 3e4), (12.0, 13.0), (1.0, 40.0), (5.0, 5.0), (0.3, 1.0), (0.02, 90.0)];
        for (a, b) in ranges {
            for logarithmic in [false, true] {
                let scale = Scale::over([a, b].into_iter(), logarithmic);
                let ticks = scale.ticks(6);
                assert!((2..=9).contains(&ticks.len()), "{a} {b} {logarithmic}: {ticks:?}");
                assert!(ticks.iter().all(|tick| scale.range().contains(tick)), "{ticks:?}");
                assert!(ticks.windows(2).all(|pair| pair[0] < pair[1]));
                assert!(ticks.iter().all(|tick| Scale::format(tick).len() < 8), "{ticks:?}");
                assert!(scale.range().contains(&a) && scale.range().contains(&b));
            }
        }
    }

    #[test]
    fn equal_ratios_are_equally_far_on_a_logarithmic_axis() {
        let scale = Scale::over([0.1, 1000.0].into_iter(), true);
        let at = |value: f64| scale.map(&value, (0, 10_000));
        assert!((at(10.0) - at(1.0) - (at(100.0) - at(10.0))).abs() <= 1);
    }

    #[test]
    fn numbers_are_written_as_people_do() {
        let written = [0.1 + 0.2, 0.0, 1e-7, 2000.0, 5e7].map(|v| Scale::format(&v));
        assert_eq!(written, ["0.3", "0", "1e-7", "2000", "5e7"]);
    }
}
