//! What one record can be asked by itself: is its header right, are its numbers possible, is its quaternion a rotation?

use rigel_protocol::{Format, Orientation, Output, Record};

use super::{Layout, List, Rejected, ascii, binary, cosines, turn};

/// The largest coordinate that the tracker can say: the full scale of its binary records, 166.32 cm.
const RANGE_UM: i32 = 1_663_200;
const FULL_TURN_MDEG: i32 = 180_000;
const ONE: i32 = 1_000_000;

/// Reads a whole record of the right length; its first byte came at `at_us`.
///
/// # Errors
/// The first check that fails, in the order header, columns, copies, range, norm.
pub(super) fn read(wire: &[u8], layout: Layout, stations: u8, at_us: u64) -> Result<Record, Rejected> {
    let mut plain = [0; Layout::LONGEST];
    let head = match layout.format {
        Format::Ascii => wire,
        Format::Binary => {
            let length = binary::unpack(wire, &mut plain);
            plain.get(..length).unwrap_or_default()
        }
    };
    let Some((&[header, station, status], fields)) = head.split_first_chunk::<3>() else {
        return Err(Rejected::Header);
    };
    let station = station.wrapping_sub(b'0');
    if header != b'0' || !(1..=stations).contains(&station) {
        return Err(Rejected::Header);
    }
    let once = layout.numbers_once();
    let (mut numbers, mut columns) = ([[0; 7]; 2], [0; 9]);
    for i in 0..layout.numbers() {
        let (copy, place) = (i / once, i % once);
        if layout.list == List::Cosines && i >= once {
            let column = fields.get(7 * i..7 * i + 7).unwrap_or_default();
            if let Some(cosine) = columns.get_mut(i - once) {
                *cosine = i64::from(ascii::number(column, 4)?) * 100;
            }
            continue;
        }
        let number = match layout.format {
            Format::Ascii => ascii_number(fields.get(7 * i..7 * i + 7).unwrap_or_default(), layout, place)?,
            Format::Binary => binary_number(binary::number(fields, 2 * i), layout, place)?,
        };
        if let Some(n) = numbers.get_mut(copy).and_then(|copy| copy.get_mut(place)) {
            *n = number;
        }
    }
    if layout.format == Format::Ascii && !wire.ends_with(b"\r\n") {
        return Err(Rejected::Column);
    }
    let [[x, y, z, a, b, c, d], second] = numbers;
    if layout.list == List::Twice && second != [x, y, z, a, b, c, d] {
        return Err(Rejected::Copies);
    }
    let orientation = match layout.output {
        Output::Quaternion => Orientation::Quaternion([a, b, c, d]),
        Output::Euler => Orientation::Euler([a, b, c]),
    };
    let record = Record { count: 0, at_us, station, status, position_um: [x, y, z], orientation };
    possible(&record, layout.format)?;
    let (q, error) = match record.orientation {
        Orientation::Quaternion(q) => (q.map(i64::from), cosines::QUATERNION_ERROR),
        Orientation::Euler(angles) => (turn::quaternion(angles), cosines::EULER_ERROR),
    };
    if layout.list == List::Cosines && !cosines::agree(q, error, &columns) {
        return Err(Rejected::Copies);
    }
    Ok(record)
}

/// A column in the units of a [`Record`]: centimetres and degrees with two decimals, components with four.
fn ascii_number(column: &[u8], layout: Layout, place: usize) -> Result<i32, Rejected> {
    Ok(match (place, layout.output) {
        (0..3, _) => ascii::number(column, 2)? * 100,
        (_, Output::Quaternion) => ascii::number(column, 4)? * 100,
        (_, Output::Euler) => ascii::number(column, 2)? * 10,
    })
}

/// A packed number in the units of a [`Record`]. That angles fill the scale with half a turn is a guess: no source
/// says how the tracker scales them.
fn binary_number(number: i16, layout: Layout, place: usize) -> Result<i32, Rejected> {
    if number == i16::MIN {
        return Err(Rejected::Range);
    }
    Ok(match (place, layout.output) {
        (0..3, _) => binary::scaled(number, RANGE_UM.into()),
        (_, Output::Quaternion) => binary::scaled(number, ONE.into()),
        (_, Output::Euler) => binary::scaled(number, FULL_TURN_MDEG.into()),
    })
}

/// Range and norm.
fn possible(record: &Record, format: Format) -> Result<(), Rejected> {
    let within = |value: i32, limit: i32| (-limit..=limit).contains(&value);
    let in_range = record.position_um.iter().all(|&p| within(p, RANGE_UM))
        && match record.orientation {
            Orientation::Quaternion(q) => q.iter().all(|&q| within(q, ONE)),
            Orientation::Euler([azimuth, elevation, roll]) => {
                within(azimuth, FULL_TURN_MDEG)
                    && within(elevation, FULL_TURN_MDEG / 2)
                    && within(roll, FULL_TURN_MDEG)
            }
        };
    if !in_range {
        return Err(Rejected::Range);
    }
    match record.orientation {
        Orientation::Quaternion(q) if !is_unit(q, format) => Err(Rejected::Norm),
        _ => Ok(()),
    }
}

/// Whether the length is one within what the format's last digit can explain: each component may be wrong by one unit
/// of it (the tracker may round or cut off), which changes the square by no more than the sum of `2|q|h + h²`.
fn is_unit(q: [i32; 4], format: Format) -> bool {
    let h: i64 = match format {
        Format::Ascii => 100,
        // 1/32767 and our own rounding.
        Format::Binary => 31,
    };
    let q = q.map(i64::from);
    let square: i64 = q.iter().map(|q| q * q).sum();
    let tolerance: i64 = q.iter().map(|q| 2 * q.abs() * h + h * h).sum();
    (square - i64::from(ONE) * i64::from(ONE)).abs() <= tolerance
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAYOUT: Layout = Layout { format: Format::Ascii, output: Output::Quaternion, list: List::Once };
    const EULER: Layout = Layout { output: Output::Euler, ..LAYOUT };

    fn read_ascii(line: &str, layout: Layout) -> Result<Record, Rejected> {
        assert_eq!(line.len() + 2, layout.length());
        read(format!("{line}\r\n").as_bytes(), layout, 2, 7)
    }

    #[test]
    fn a_record_is_read_by_column() {
        let record = read_ascii("02@-123.45   0.04 166.32 0.7071-0.7071 0.0000 0.0001", LAYOUT);
        let expected = Record {
            count: 0,
            at_us: 7,
            station: 2,
            status: b'@',
            position_um: [-1_234_500, 400, 1_663_200],
            orientation: Orientation::Quaternion([707_100, -707_100, 0, 100]),
        };
        assert_eq!(record, Ok(expected));
        let euler = read_ascii("01F   0.89   0.04   1.82 -70.55  41.83 -23.48", EULER).unwrap();
        assert_eq!(euler.orientation, Orientation::Euler([-70_550, 41_830, -23_480]));
        assert_eq!(euler.status, b'F');
    }

    #[test]
    fn each_check_refuses_what_it_is_there_for() {
        let cases = [
            ("11    0.89   0.04   1.82 1.0000 0.0000 0.0000 0.0000", Rejected::Header),
            ("03    0.89   0.04   1.82 1.0000 0.0000 0.0000 0.0000", Rejected::Header),
            ("01    0.89   0.04  1.820 1.0000 0.0000 0.0000 0.0000", Rejected::Column),
            ("01  166.33   0.04   1.82 1.0000 0.0000 0.0000 0.0000", Rejected::Range),
            ("01    0.89   0.04   1.82 1.0001 0.0000 0.0000 0.0000", Rejected::Range),
            ("01    0.89   0.04   1.82 0.9900 0.1000 0.0000 0.0000", Rejected::Norm),
        ];
        for (line, rejected) in cases {
            assert_eq!(read_ascii(line, LAYOUT), Err(rejected), "{line}");
        }
        let steep = "01    0.89   0.04   1.82 -70.55  90.01 -23.48";
        assert_eq!(read_ascii(steep, EULER), Err(Rejected::Range));
    }

    #[test]
    fn copies_must_agree() {
        let twice = Layout { list: List::Twice, ..EULER };
        let (head, copy) = ("01 ", "   0.89   0.04   1.82 -70.55  41.83 -23.48");
        assert!(read_ascii(&format!("{head}{copy}{copy}"), twice).is_ok());
        let other = copy.replace("0.04", "0.05");
        assert_eq!(read_ascii(&format!("{head}{copy}{other}"), twice), Err(Rejected::Copies));
    }

    #[test]
    fn every_rotation_survives_rounding_and_cutting_off() {
        // A walk over the sphere of quaternions in steps that no digit divides.
        let mut worst = 0.0f64;
        for i in 0..40_000 {
            let [a, b, c] = [0.1234, 0.777, 1.913].map(|s| s * f64::from(i));
            let q = [a.cos() * b.cos(), a.cos() * b.sin(), a.sin() * c.cos(), a.sin() * c.sin()];
            for (format, units) in [(Format::Ascii, 1e4), (Format::Binary, 32767.0)] {
                for say in [f64::round, f64::trunc] {
                    let said = q.map(|q| (say(q * units) / units * 1e6).round() as i32);
                    assert!(is_unit(said, format), "{said:?}");
                }
                // A component that is wrong by five of its last digits shows unless it is next to nothing.
                let mut wrong = q.map(|q| (q * 1e6).round() as i32);
                wrong[0] += (5e6 / units) as i32 * wrong[0].signum();
                if q[0].abs() > 0.9 {
                    worst = worst.max(f64::from(u8::from(is_unit(wrong, format))));
                }
            }
        }
        assert_eq!(worst, 0.0);
    }
}
