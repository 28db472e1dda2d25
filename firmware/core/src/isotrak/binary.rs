//! Records of sixteen-bit numbers, packed seven bits to the byte.
//!
//! Seven bytes without their highest bits are followed by one byte that holds those bits, the first byte's lowest; the
//! last group may be short. The first byte of a record, and no other, has its own highest bit set on the line.

use super::Layout;

/// Unpacks a record of the right length into `plain`; returns how many bytes it holds.
pub(super) fn unpack(wire: &[u8], plain: &mut [u8; Layout::LONGEST]) -> usize {
    let mut length = 0;
    for group in wire.chunks(8) {
        let Some((high, low)) = group.split_last() else { continue };
        for (i, &byte) in low.iter().enumerate() {
            if let Some(place) = plain.get_mut(length) {
                *place = byte & 0x7f | (high >> i & 1) << 7;
                length += 1;
            }
        }
    }
    length
}

/// The little-endian number at `at`; 0 beyond the end.
pub(super) fn number(plain: &[u8], at: usize) -> i16 {
    match plain.get(at..at + 2) {
        Some(&[low, high]) => i16::from_le_bytes([low, high]),
        _ => 0,
    }
}

/// `number` thirty-two-thousand-seven-hundred-and-sixty-sevenths of `full_scale`, rounded.
pub(super) fn scaled(number: i16, full_scale: i64) -> i32 {
    let twice = 2 * i64::from(number) * full_scale;
    let rounded = (twice + if twice < 0 { -32_767 } else { 32_767 }) / 65_534;
    rounded as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn highest_bits_come_back() {
        // Ten bytes: a full group of seven, then a short one of three.
        let plain = [0x30, 0x81, 0x02, 0xff, 0x00, 0x80, 0x7f, 0xfe, 0x01, 0x90];
        let wire = [0xb0, 0x01, 0x02, 0x7f, 0x00, 0x00, 0x7f, 0b010_1010, 0x7e, 0x01, 0x10, 0b101];
        let mut out = [0; Layout::LONGEST];
        assert_eq!(unpack(&wire, &mut out), 10);
        assert_eq!(out[..10], plain);
    }

    #[test]
    fn numbers_are_scaled_and_rounded_alike_on_both_sides_of_zero() {
        assert_eq!(scaled(32_767, 1_663_200), 1_663_200);
        assert_eq!(scaled(1, 1_663_200), 51);
        assert!((-32_767..=32_767).all(|n| scaled(n, 1_000_000) == -scaled(-n, 1_000_000)));
        assert_eq!(number(&[0x34, 0x12], 0), 0x1234);
        assert_eq!(number(&[0x34], 0), 0);
    }
}
