//! What the parser believes and what it does not.

use rigel_protocol::{Format, Orientation, Output, Record};

use super::{Layout, List, Parser, Rejected};

const PERIOD_US: u64 = 16_667;
const BYTE_US: u64 = 87;
const ONCE: Layout = Layout { format: Format::Ascii, output: Output::Euler, list: List::Once };
const TWICE: Layout = Layout { list: List::Twice, ..ONCE };
const BINARY: Layout = Layout { format: Format::Binary, ..ONCE };

/// Small noise that never repeats soon.
fn noise(n: u64) -> i32 {
    (n.wrapping_mul(2_654_435_761) >> 13 & 3) as i32 - 1
}

/// A record of station 1: x in hundredths of a centimetre; everything else stands almost still.
fn line(n: u64, x: i32, status: char, layout: Layout) -> Vec<u8> {
    let numbers = [x, 1000 + noise(n), -500 + noise(n + 7), 1234 + noise(n + 3), -567 + noise(n + 5), 89];
    if layout.format == Format::Binary {
        let mut plain = vec![b'0', b'1', status as u8];
        plain.extend(numbers.iter().flat_map(|&number| (number as i16).to_le_bytes()));
        let mut wire: Vec<u8> = plain
            .chunks(7)
            .flat_map(|group| {
                let high = group.iter().enumerate().fold(0, |high, (i, byte)| high | (byte >> 7) << i);
                group.iter().map(|byte| byte & 0x7f).chain([high]).collect::<Vec<_>>()
            })
            .collect();
        wire[0] |= 0x80;
        return wire;
    }
    let copy: String = numbers.iter().map(|&number| format!("{:7.2}", f64::from(number) / 100.0)).collect();
    format!("01{status}{copy}{}\r\n", if layout == TWICE { &copy } else { "" }).into_bytes()
}

/// Pushes bytes that follow each other from `at_us` on.
fn push(parser: &mut Parser, bytes: &[u8], at_us: u64) -> Vec<Result<Record, Rejected>> {
    let times = (0..).map(|i| at_us + i * BYTE_US);
    bytes.iter().zip(times).flat_map(|(&byte, at_us)| parser.push(byte, at_us)).collect()
}

/// A parser that has believed a hundred records with x = 40 cm; the next one is due at the time that is returned.
fn settled(layout: Layout) -> (Parser, u64) {
    let mut parser = Parser::new(layout, 1);
    let good: usize = (0..100)
        .map(|n| push(&mut parser, &line(n, 4000 + noise(n), ' ', layout), n * PERIOD_US))
        .map(|verdicts| verdicts.iter().filter(|v| v.is_ok()).count())
        .sum();
    let good = good + parser.advance(100 * PERIOD_US).filter(Result::is_ok).count();
    assert_eq!((good, parser.skipped_bytes()), (100, 0));
    (parser, 100 * PERIOD_US)
}

/// What becomes of records with these x and status characters after the settled ones.
fn follow(layout: Layout, records: &[(i32, char)]) -> Vec<Result<i32, Rejected>> {
    let (mut parser, start_us) = settled(layout);
    let mut verdicts = Vec::new();
    for (n, &(x, status)) in (0..).zip(records) {
        verdicts.extend(push(&mut parser, &line(n, x, status, layout), start_us + n * PERIOD_US));
    }
    verdicts.into_iter().map(|verdict| verdict.map(|record| record.position_um[0] / 100)).collect()
}

#[test]
fn a_record_carries_the_time_of_its_first_byte_and_every_status() {
    for status in ['*', '@', 'F', '\u{1}'] {
        let (mut parser, at_us) = settled(TWICE);
        assert_eq!(push(&mut parser, &line(1, 4000, status, TWICE), at_us), []);
        let both = push(&mut parser, &line(2, 4001, status, TWICE), at_us + PERIOD_US);
        let stamps: Vec<_> = both.iter().map(|r| r.map(|r| (r.at_us, r.status))).collect();
        assert_eq!(stamps, [Ok((at_us, status as u8)), Ok((at_us + PERIOD_US, status as u8))]);
    }
}

#[test]
fn a_status_that_nothing_bears_out_is_refused() {
    let verdicts = follow(TWICE, &[(4000, ' '), (4001, '@'), (4002, ' ')]);
    assert_eq!(verdicts, [Ok(4000), Err(Rejected::Status), Ok(4002)]);
}

#[test]
fn a_leap_is_believed_once_four_records_agree_and_not_before() {
    for layout in [ONCE, TWICE] {
        let away = follow(layout, &[(4001, ' '), (-4000, ' '), (4000, ' '), (4001, ' ')]);
        assert_eq!(away, [Ok(4001), Err(Rejected::Continuity), Ok(4000), Ok(4001)]);
        let leap = [-4000, -4001, -4000, -4002, -4001].map(|x| (x, ' '));
        let rejected = Err(Rejected::Continuity);
        assert_eq!(follow(layout, &leap), [rejected, rejected, Ok(-4000), Ok(-4002), Ok(-4001)]);
        // Leaps to and fro never agree.
        let wild: Vec<_> = (0..40).map(|n| (if n % 2 == 0 { -9000 } else { 9000 }, ' ')).collect();
        assert!(follow(layout, &wild).iter().all(|verdict| *verdict == rejected));
    }
}

#[test]
fn a_small_error_is_refused_and_a_sudden_motion_is_not() {
    // One digit: a tenth of a centimetre, ten times the noise.
    let verdicts = follow(ONCE, &[(4001, ' '), (4020, ' '), (4000, ' '), (4001, ' ')]);
    assert_eq!(verdicts, [Ok(4001), Err(Rejected::Continuity), Ok(4000), Ok(4001)]);
    // From standing still to one metre per second within a record, and back.
    let moving: Vec<i32> =
        (0..30).map(|n| 4000 + 166 * n).chain((0..30).map(|n| 4000 + 166 * 29 + n % 2)).collect();
    for layout in [ONCE, TWICE] {
        let records: Vec<_> = moving.iter().map(|&x| (x, ' ')).collect();
        let verdicts = follow(layout, &records);
        assert!(verdicts.iter().all(Result::is_ok), "{verdicts:?}");
        assert_eq!(verdicts.len(), moving.len());
    }
}

#[test]
fn halves_of_two_records_are_never_one() {
    for layout in [ONCE, TWICE, BINARY] {
        for cut in 1..layout.length() {
            let (mut parser, at_us) = settled(layout);
            let whole = parser.whole_records();
            let first = line(1, 4000, ' ', layout);
            let second = line(2, 4001, ' ', layout);
            assert_eq!(push(&mut parser, &first[..cut], at_us), []);
            let rest_us = at_us + PERIOD_US + BYTE_US * cut as u64;
            assert_eq!(push(&mut parser, &second[cut..], rest_us), []);
            assert_eq!((parser.next_us(), parser.whole_records()), (None, whole), "{cut}");
            assert_eq!(parser.finish().count(), 0);
            assert_eq!(parser.skipped_bytes() as usize, layout.length());
        }
    }
}

#[test]
fn a_binary_record_ends_with_the_next_or_with_silence_and_with_nothing_else() {
    let (mut parser, at_us) = settled(BINARY);
    let wire = line(1, 4000, ' ', BINARY);
    let last_us = at_us + BYTE_US * (wire.len() as u64 - 1);
    assert_eq!(push(&mut parser, &wire, at_us), []);
    assert_eq!(parser.next_us(), Some(last_us + 4_000));
    assert_eq!(parser.advance(last_us + 3_999).count(), 0);
    let ended: Vec<_> = parser.advance(last_us + 4_000).collect();
    assert_eq!(ended.len(), 1);
    assert_eq!(ended[0].unwrap().at_us, at_us);
    // A byte too many, before the silence.
    assert_eq!(push(&mut parser, &[&wire[..], &[5]].concat(), at_us + PERIOD_US), []);
    assert_eq!(parser.next_us(), None);
    assert_eq!(push(&mut parser, &wire, at_us + 2 * PERIOD_US), []);
    assert_eq!(parser.skipped_bytes(), 19);
}

#[test]
fn what_follows_a_broken_line_is_doubtful_where_numbers_stand_once() {
    for layout in [ONCE, TWICE, BINARY] {
        let (mut parser, at_us) = settled(layout);
        push(&mut parser, &line(0, 4000, ' ', layout)[3..], at_us);
        let mut verdicts = Vec::new();
        for n in 1..=40 {
            verdicts.extend(push(&mut parser, &line(n, 4000 + noise(n), ' ', layout), at_us + n * PERIOD_US));
        }
        verdicts.extend(parser.advance(u64::MAX));
        let doubtful = verdicts.iter().filter(|v| **v == Err(Rejected::Doubtful)).count();
        let good = verdicts.iter().filter(|v| v.is_ok()).count();
        assert_eq!((doubtful, good), if layout == TWICE { (0, 40) } else { (32, 8) }, "{layout:?}");
    }
}

#[test]
fn babble_without_an_end_costs_nothing_but_itself() {
    let (mut parser, at_us) = settled(TWICE);
    assert_eq!(push(&mut parser, &[b'x'; 10_000], at_us), []);
    let after_us = at_us + 10_000 * BYTE_US + PERIOD_US;
    assert!(push(&mut parser, &line(1, 4000, ' ', TWICE), after_us)[0].is_ok());
    assert_eq!(parser.skipped_bytes(), 10_000);
}

#[test]
fn any_bytes_at_any_time_are_survived() {
    for layout in [ONCE, TWICE, BINARY, Layout { output: Output::Quaternion, ..BINARY }] {
        let mut parser = Parser::new(layout, 2);
        let (mut state, mut at_us) = (1u64, 0u64);
        let alphabet = b"0123456789 -+.\r\n01 \x80\xb0\xff";
        for _ in 0..200_000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let byte = alphabet.get((state >> 33) as usize % 40).copied().unwrap_or((state >> 40) as u8);
            at_us = if state >> 50 == 0 { u64::MAX - 3 } else { at_us.wrapping_add(state >> 57) };
            for record in parser.push(byte, at_us).flatten() {
                let Orientation::Euler([_, elevation, _]) = record.orientation else { continue };
                assert!(elevation.abs() <= 90_000);
            }
        }
        let _ = parser.finish();
    }
}
