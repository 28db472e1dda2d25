//! How a tracker writes a record.

use glam::{DMat3, DQuat, DVec3, EulerRot};
use rigel_firmware_core::isotrak::{Layout, List};
use rigel_protocol::{Format, Orientation, Output, Record};

/// Writes records in a layout.
#[derive(Debug, Clone)]
pub struct Teller {
    /// How.
    pub layout: Layout,
}

impl Teller {
    /// A writer of this layout.
    pub fn new(layout: Layout) -> Self {
        Self { layout }
    }

    /// Writes the record of a station at `at_m` (metres) with this orientation, both in the transmitter's axes. Returns
    /// what it says after rounding (count and time 0) and its bytes on the line.
    pub fn say(&self, station: u8, status: u8, at_m: DVec3, orientation: DQuat) -> (Record, Vec<u8>) {
        let angles = match self.layout.output {
            Output::Quaternion => [orientation.w, orientation.x, orientation.y, orientation.z],
            Output::Euler => {
                let (azimuth, elevation, roll) = orientation.to_euler(EulerRot::ZYX);
                [azimuth.to_degrees(), elevation.to_degrees(), roll.to_degrees(), 0.0]
            }
        };
        let (said, wire) = match self.layout.format {
            Format::Ascii => {
                let axes = DMat3::from_quat(orientation).to_cols_array();
                self.columns(station, status, at_m * 100.0, angles, axes)
            }
            Format::Binary => self.packed(station, status, at_m * 100.0, angles),
        };
        let [x, y, z, a, b, c, d] = said;
        let orientation = match self.layout.output {
            Output::Quaternion => Orientation::Quaternion([a, b, c, d]),
            Output::Euler => Orientation::Euler([a, b, c]),
        };
        (Record { count: 0, at_us: 0, station, status, position_um: [x, y, z], orientation }, wire)
    }

    fn count(&self) -> usize {
        if self.layout.output == Output::Quaternion { 7 } else { 6 }
    }

    fn columns(
        &self,
        station: u8,
        status: u8,
        at_cm: DVec3,
        angles: [f64; 4],
        axes: [f64; 9],
    ) -> ([i32; 7], Vec<u8>) {
        let mut said = [0; 7];
        let mut copy = Vec::with_capacity(49);
        let values = at_cm.to_array().into_iter().chain(angles);
        for (i, value) in values.enumerate().take(self.count()) {
            let (decimals, unit) = match (i, self.layout.output) {
                (0..3, _) => (2, 100),
                (_, Output::Quaternion) => (4, 100),
                (_, Output::Euler) => (2, 10),
            };
            let units = (value * f64::from(10i32.pow(decimals))).round() as i32;
            said[i] = units * unit;
            copy.extend(column(units, decimals as usize));
        }
        let mut wire = vec![b'0', b'0' + station, status];
        wire.extend_from_slice(&copy);
        match self.layout.list {
            List::Once => {}
            List::Twice => wire.extend_from_slice(&copy),
            List::Cosines => {
                wire.extend(axes.iter().flat_map(|cosine| column((cosine * 1e4).round() as i32, 4)));
            }
        }
        wire.extend_from_slice(b"\r\n");
        (said, wire)
    }

    fn packed(&self, station: u8, status: u8, at_cm: DVec3, angles: [f64; 4]) -> ([i32; 7], Vec<u8>) {
        let mut said = [0; 7];
        let mut copy = Vec::with_capacity(14);
        let values = at_cm.to_array().into_iter().chain(angles);
        for (i, value) in values.enumerate().take(self.count()) {
            // What a full scale is: in the tracker's unit, and in the record's.
            let (full, units) = match (i, self.layout.output) {
                (0..3, _) => (166.32, 1_663_200.0),
                (_, Output::Quaternion) => (1.0, 1_000_000.0),
                (_, Output::Euler) => (180.0, 180_000.0),
            };
            let number = (value / full * 32767.0).round() as i16;
            said[i] = (f64::from(number) / 32767.0 * units).round() as i32;
            copy.extend(number.to_le_bytes());
        }
        let mut plain = vec![b'0', b'0' + station, status];
        plain.extend_from_slice(&copy);
        if self.layout.list == List::Twice {
            plain.extend_from_slice(&copy);
        }
        let mut wire = Vec::with_capacity(40);
        for group in plain.chunks(7) {
            wire.extend(group.iter().map(|byte| byte & 0x7f));
            wire.push(group.iter().enumerate().fold(0, |high, (i, byte)| high | (byte >> 7) << i));
        }
        wire[0] |= 0x80;
        (said, wire)
    }
}

/// A number in seven characters, its sign next to its digits.
fn column(units: i32, decimals: usize) -> [u8; 7] {
    let mut out = *b"       ";
    let mut rest = units.unsigned_abs();
    let mut place = 6;
    for digit in 0.. {
        if digit == decimals {
            out[place] = b'.';
            place -= 1;
        }
        if digit > decimals && rest == 0 {
            break;
        }
        out[place] = b'0' + (rest % 10) as u8;
        rest /= 10;
        place -= 1;
    }
    if units < 0 {
        out[place] = b'-';
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_look_like_the_one_record_that_is_known() {
        let said: Vec<u8> =
            [89, 4, 182, -7055, 4183, -2348].iter().flat_map(|&units| column(units, 2)).collect();
        assert_eq!(said, b"   0.89   0.04   1.82 -70.55  41.83 -23.48");
        assert_eq!(&column(-16_632, 2), b"-166.32");
        assert_eq!(&column(-1, 4), b"-0.0001");
        assert_eq!(&column(10_000, 4), b" 1.0000");
    }

    #[test]
    fn records_have_the_documented_lengths() {
        let lengths = [
            (Format::Ascii, Output::Quaternion, 54),
            (Format::Ascii, Output::Euler, 47),
            (Format::Binary, Output::Quaternion, 20),
            (Format::Binary, Output::Euler, 18),
        ];
        for (format, output, length) in lengths {
            for (list, length) in [(List::Once, Some(length)), (List::Twice, None)] {
                let layout = Layout { format, output, list };
                let (_, wire) = Teller::new(layout).say(2, b' ', DVec3::new(-1.2, 0.3, 0.0), DQuat::IDENTITY);
                assert_eq!(wire.len(), layout.length());
                assert!(length.is_none_or(|length| length == wire.len()));
            }
        }
    }
}
