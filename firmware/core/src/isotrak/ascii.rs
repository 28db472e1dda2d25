//! Records in columns of seven characters.

use super::Rejected;

/// Reads a number with `decimals` digits behind the point; the number is given in units of its last digit.
///
/// A column is blanks, at most one sign, digits, the point at its own place, digits. The first character is the sign's
/// own. Columns touch, so that blanks separate nothing.
pub(super) fn number(column: &[u8], decimals: usize) -> Result<i32, Rejected> {
    let point = column.len().checked_sub(decimals + 1).ok_or(Rejected::Column)?;
    if column.first().is_none_or(u8::is_ascii_digit) {
        return Err(Rejected::Column);
    }
    let mut value = 0;
    let (mut negative, mut signed, mut digits) = (false, false, 0);
    for (i, &character) in column.iter().enumerate() {
        match character {
            b'.' if i == point && digits > 0 => {}
            b'0'..=b'9' if i != point => {
                value = value * 10 + i32::from(character - b'0');
                digits += 1;
            }
            b' ' if i < point && !signed && digits == 0 => {}
            b'+' | b'-' if i < point && !signed && digits == 0 => {
                signed = true;
                negative = character == b'-';
            }
            _ => return Err(Rejected::Column),
        }
    }
    Ok(if negative { -value } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_read_with_their_signs_wherever_they_stand() {
        for (column, decimals, value) in [
            (b"   0.89", 2, 89),
            (b" -70.55", 2, -7055),
            (b"-170.55", 2, -17055),
            (b"-007.05", 2, -705),
            (b"+166.32", 2, 16632),
            (b" 0.7071", 4, 7071),
            (b"-1.0000", 4, -10000),
        ] {
            assert_eq!(number(column, decimals), Ok(value));
        }
    }

    #[test]
    fn what_is_no_column_is_refused() {
        for column in [
            b"1170.55", b"  70.5 ", b"  7 .55", b" - 7.55", b" --7.55", b"   .555", b"    .55", b" 70.555",
            b"7  0.55", b"  70,55", b"       ", b"  70..5", b" 7-0.55",
        ] {
            assert_eq!(number(column, 2), Err(Rejected::Column), "{}", String::from_utf8_lossy(column));
        }
        assert_eq!(number(b"", 2), Err(Rejected::Column));
    }
}
