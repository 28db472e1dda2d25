//! The camera's response: which exposure (radiance times time) gives which level.

use std::path::Path;

use half::f16;
use nalgebra::DMatrix;

use super::rows::{KNOTS, knot_of};
use crate::picture::Picture;
use crate::{Error, Result, file};

/// Cameras that are said to follow a curve follow it to so much of its exponent, standard deviation.
const ASSUMED_EXPONENT: f64 = 0.1;

/// Exposure per level and channel; never decreasing, and 1 at the middle level, so that it fixes the session's unit of
/// radiance: what reaches the middle level in one second.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    exposure: [Vec<f32>; 3],
    /// Of ln exposure at the knots of the recovery, less its mean over what it was learnt from: that factor is nothing but the
    /// unit. `None` where the response was given.
    covariance: Option<[DMatrix<f64>; 3]>,
    /// Nobody has measured it: photographs that contradict each other may only contradict the guess.
    assumed: bool,
}

impl Response {
    /// A response from a table of exposures per channel, one entry per level from 0 to white; scaled to 1 at the middle.
    pub(super) fn from_tables(mut exposure: [Vec<f32>; 3]) -> Self {
        for table in &mut exposure {
            let middle = table[middle_level(table.len())];
            table.iter_mut().for_each(|x| *x /= middle);
        }
        Self { exposure, covariance: None, assumed: false }
    }

    /// The same, recovered with this doubt.
    pub(super) fn with_covariance(self, covariance: [DMatrix<f64>; 3]) -> Self {
        Self { covariance: Some(covariance), ..self }
    }

    /// The covariance of ln exposure at the knots; `None` where the response was given.
    pub(super) fn covariance(&self, channel: usize) -> Option<&DMatrix<f64>> {
        self.covariance.as_ref().map(|covariance| &covariance[channel])
    }

    /// Variance of a weighted mean of ln exposures, relative to what is common to all radiances; 0 where the response was
    /// given, but for one that nobody has measured. `parts`: exposures in the table's unit, each with its weight.
    pub(super) fn variance_of(&self, channel: usize, parts: &[(f32, f64)]) -> f64 {
        if self.assumed {
            let from_middle: f64 = parts.iter().map(|&(x, weight)| weight * f64::from(x).ln()).sum();
            return (ASSUMED_EXPONENT * from_middle).powi(2);
        }
        let Some(covariance) = self.covariance(channel) else { return 0.0 };
        let table = &self.exposure[channel];
        let mut shares: Vec<(usize, f64)> = Vec::with_capacity(2 * parts.len());
        for &(exposure, weight) in parts {
            let above = table.partition_point(|&x| x < exposure).clamp(1, table.len() - 1);
            let (knot, part) = knot_of(above, self.white());
            shares.extend([(knot, weight * (1.0 - part)), ((knot + 1).min(KNOTS - 1), weight * part)]);
        }
        let row = |i: usize, a: f64| shares.iter().map(|&(k, b)| a * b * covariance[(i, k)]).sum::<f64>();
        shares.iter().map(|&(i, a)| row(i, a)).sum::<f64>().max(0.0)
    }

    /// What cameras write that follow the standard (IEC 61966-2-1), for photographs without a bracket to learn from.
    /// `white` is the highest level, 255 or 65535.
    pub fn srgb(white: u16) -> Self {
        let curve = |v: f64| if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
        Self { assumed: true, ..Self::from_curve(white, curve) }
    }

    /// Whether nobody has measured it: sRGB, or 8 bits taken for linear.
    pub fn is_assumed(&self) -> bool {
        self.assumed
    }

    /// Levels proportional to exposure, for raw and floating-point pictures ([`Picture::FLOAT_WHITE`]).
    pub fn linear(white: u16) -> Self {
        if white == Picture::FLOAT_WHITE {
            // The numbers keep their unit: no scaling to a middle.
            let table: Vec<f32> = (0..=white).map(|bits| f16::from_bits(bits).to_f32()).collect();
            return Self {
                exposure: [table.clone(), table.clone(), table],
                covariance: None,
                assumed: false,
            };
        }
        Self { assumed: white == 255, ..Self::from_curve(white, |v| v) }
    }

    fn from_curve(white: u16, curve: impl Fn(f64) -> f64) -> Self {
        let table: Vec<f32> =
            (0..=white).map(|level| curve(f64::from(level) / f64::from(white)) as f32).collect();
        Self::from_tables([table.clone(), table.clone(), table])
    }

    /// The exposure of each level of a channel (0 red, 1 green, 2 blue), in the session's unit times seconds.
    pub fn exposure(&self, channel: usize) -> &[f32] {
        &self.exposure[channel]
    }

    /// The highest level it knows.
    pub fn white(&self) -> u16 {
        (self.exposure[0].len() - 1) as u16
    }

    /// How much exposure one level more means, at `level`.
    pub(crate) fn slope(&self, channel: usize, level: usize) -> f32 {
        let table = &self.exposure[channel];
        let (low, high) = (level.saturating_sub(1), (level + 1).min(table.len() - 1));
        (table[high] - table[low]) / (high - low) as f32
    }

    /// Writes a table with the columns `level,R,G,B`.
    ///
    /// # Errors
    /// [`Error::Io`] where the file cannot be written.
    pub fn write_csv(&self, path: &Path) -> Result<()> {
        let mut text = String::from("level,R,G,B\n");
        for level in 0..=usize::from(self.white()) {
            let [r, g, b] = [0, 1, 2].map(|c| self.exposure[c][level]);
            text.push_str(&format!("{level},{r:e},{g:e},{b:e}\n"));
        }
        file::write_bytes(path, text.as_bytes())
    }

    /// Reads what [`Response::write_csv`] wrote, or a table made by hand for the same purpose; the values are kept as
    /// they stand.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Input`] naming the line that breaks the order of levels or is negative, not finite or
    /// less than the line before.
    pub fn read_csv(path: &Path) -> Result<Self> {
        let remedy =
            "recover the response again, or give the columns level,R,G,B with a line per level from 0";
        let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let mut exposure = [const { Vec::new() }; 3];
        for (expected, row) in reader.deserialize::<(usize, f32, f32, f32)>().enumerate() {
            let line = expected + 2;
            let (level, r, g, b) =
                row.map_err(|e| Error::input(path, format!("line {line} is unreadable ({e})"), remedy))?;
            if level != expected {
                let what = format!("line {line} has level {level} where {expected} is due");
                return Err(Error::input(path, what, remedy));
            }
            for (table, value) in exposure.iter_mut().zip([r, g, b]) {
                if !value.is_finite() || value < table.last().copied().unwrap_or(0.0) {
                    let what = format!("the exposure {value} in line {line} is less than the one before");
                    return Err(Error::input(path, what, remedy));
                }
                table.push(value);
            }
        }
        let levels = exposure[0].len();
        let known =
            [255, u16::MAX, Picture::FLOAT_WHITE].iter().any(|&white| usize::from(white) + 1 == levels);
        if !known {
            return Err(Error::input(path, format!("it has {levels} levels, not 256 or 65536"), remedy));
        }
        if exposure.iter().any(|table| table[middle_level(levels)] <= 0.0) {
            return Err(Error::input(path, "its middle level stands for no exposure at all", remedy));
        }
        Ok(Self { exposure, covariance: None, assumed: false })
    }
}

fn middle_level(levels: usize) -> usize {
    levels / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_response_reads_back_exactly() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("response.csv");
        for response in [Response::srgb(255), Response::linear(255), Response::linear(Picture::FLOAT_WHITE)] {
            response.write_csv(&path).unwrap();
            assert_eq!(Response::read_csv(&path).unwrap().exposure, response.exposure);
        }
    }

    #[test]
    fn a_broken_table_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("response.csv");
        Response::srgb(255).write_csv(&path).unwrap();
        let good = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = good.lines().collect();
        let broken = [
            lines[..200].join("\n"),
            good.replace("\n100,", "\n101,"),
            good.replacen("e0", "x", 1),
            [&lines[..100], &["99,0,0,0"], &lines[101..]].concat().join("\n"),
            good.replace("\n90,", "\n90,NaN,"),
            (0..256).fold(String::from("level,R,G,B\n"), |text, level| text + &format!("{level},0,0,0\n")),
        ];
        for text in broken {
            std::fs::write(&path, text).unwrap();
            let message = Response::read_csv(&path).unwrap_err().to_string();
            assert!(
                message.contains("response.csv") && message.contains("recover the response"),
                "{message}"
            );
        }
    }

    #[test]
    fn a_response_that_nobody_measured_is_in_doubt() {
        let doubt = |response: &Response, x: f32| response.variance_of(1, &[(x, 1.0)]).sqrt();
        // Three stops from the middle.
        for guess in [Response::srgb(255), Response::linear(255)] {
            assert!((0.1..0.4).contains(&doubt(&guess, 0.125)) && doubt(&guess, 1.0) < 1e-6);
        }
        assert_eq!(doubt(&Response::linear(Picture::FLOAT_WHITE), 0.125), 0.0);
    }

    #[test]
    fn every_standard_response_grows_and_is_one_in_the_middle() {
        for response in [Response::srgb(255), Response::srgb(65535), Response::linear(255)] {
            for channel in 0..3 {
                let table = response.exposure(channel);
                assert!(table.windows(2).all(|pair| pair[0] < pair[1]));
                assert_eq!(table[table.len() / 2], 1.0);
            }
        }
        let float = Response::linear(Picture::FLOAT_WHITE);
        assert_eq!(float.exposure(1)[usize::from(f16::from_f32(0.25).to_bits())], 0.25);
    }
}
