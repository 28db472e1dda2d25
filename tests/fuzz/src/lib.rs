//! What must be true of whatever comes from a line or a disk. The fuzz targets try it with what libFuzzer makes up, the test
//! `regressions` with what it once found.

use std::path::Path;

use rigel::session::{Journal, Manifest};
use rigel_firmware_core::isotrak::{Driver, Layout, List, Parser, Rejected, TrackerOutput};
use rigel_protocol::{Answer, Decoder, LARGEST_FRAME, LARGEST_PAYLOAD, Request, encode, frame};
use rigel_protocol::{Format, Orientation, Output, Record, Tracking};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// The frame decoder, on a stream of any bytes (first byte even) or on a good frame around any message (odd).
pub fn frame(bytes: &[u8]) {
    let Some((kind, bytes)) = bytes.split_first() else { return };
    if kind % 2 == 0 {
        assert_eq!(heard(bytes), expected(bytes), "the decoder accepts what has its CRC, and nothing else");
    } else {
        let payload = &bytes[..bytes.len().min(LARGEST_PAYLOAD)];
        let mut plain = payload.to_vec();
        plain.extend(crc32(payload).to_le_bytes());
        let mut stream = vec![0];
        stream.extend(stuffed(&plain));
        stream.push(0);
        assert_eq!(heard(&stream), [payload], "a good frame is heard whatever is in it");
        round_trip::<Request>(payload);
        round_trip::<Answer>(payload);
        frame::identity(payload);
    }
}

fn heard(stream: &[u8]) -> Vec<Vec<u8>> {
    let mut decoder = Decoder::new();
    let found = |&byte| decoder.push(byte).and_then(|frame| frame.ok().map(<[u8]>::to_vec));
    stream.iter().filter_map(found).collect()
}

/// A message that was understood is understood again when it is said again.
fn round_trip<M: Serialize + DeserializeOwned + PartialEq + std::fmt::Debug>(payload: &[u8]) {
    let Ok(message) = frame::decode::<M>(payload) else { return };
    let mut buffer = [0; LARGEST_FRAME];
    let stream = encode(&message, &mut buffer).expect("what fitted into a frame fits again");
    let again: Vec<M> =
        heard(stream).iter().map(|payload| frame::decode(payload).expect("said well")).collect();
    assert_eq!(again, [message]);
}

/// What a stream holds, found in another way: cut at the zeros, unstuffed, divided by the polynomial bit by bit.
fn expected(stream: &[u8]) -> Vec<Vec<u8>> {
    let Some(last) = stream.iter().rposition(|&byte| byte == 0) else { return vec![] };
    let frames = stream[..last].split(|&byte| byte == 0).filter(|frame| frame.len() <= LARGEST_FRAME);
    frames
        .filter_map(|frame| {
            let plain = unstuffed(frame)?;
            let (payload, crc) = plain.split_last_chunk::<4>()?;
            (crc32(payload) == u32::from_le_bytes(*crc)).then(|| payload.to_vec())
        })
        .collect()
}

/// COBS (Cheshire and Baker 1999), from its description.
fn unstuffed(mut frame: &[u8]) -> Option<Vec<u8>> {
    let mut plain = vec![];
    while let Some((&code, rest)) = frame.split_first() {
        let (run, rest) = rest.split_at_checked(usize::from(code) - 1)?;
        plain.extend(run);
        if code < 255 && !rest.is_empty() {
            plain.push(0);
        }
        frame = rest;
    }
    Some(plain)
}

fn stuffed(plain: &[u8]) -> Vec<u8> {
    // No run here is as long as 254.
    plain.split(|&byte| byte == 0).flat_map(|run| [&[run.len() as u8 + 1], run].concat()).collect()
}

/// CRC-32 as of Ethernet, bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 })
    })
}

/// A session's journal: what is accepted is accepted with every cut of it, and survives being written again.
pub fn journal(bytes: &[u8]) {
    let path = Path::new("journal.jsonl");
    let Ok((events, whole)) = Journal::parse(bytes, path) else { return };
    assert!(whole <= bytes.len() && !bytes[whole..].contains(&b'\n'));
    assert_eq!(events.len(), bytes.iter().filter(|&&byte| byte == b'\n').count());
    for cut in 0..bytes.len() {
        let (fewer, whole) = Journal::parse(&bytes[..cut], path).expect("a cut leaves whole lines");
        assert!(whole <= cut && fewer == events[..fewer.len()]);
    }
    let written: String = events.iter().map(Journal::line).collect();
    let (again, whole) = Journal::parse(written.as_bytes(), path).expect("what was written is read");
    assert!(whole == written.len() && again == events);
}

/// A session's manifest: what is accepted survives being written again, and can be asked for everything.
pub fn manifest(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let path = Path::new("session.toml");
    let Ok(manifest) = Manifest::parse(text, path) else { return };
    for (index, view) in manifest.views.iter().enumerate() {
        assert!(!view.name.contains(['/', '\\']) && !view.name.is_empty());
        let _ = manifest.lens(index);
    }
    let _ = manifest.surface();
    let written = toml::to_string(&manifest).expect("a manifest is plain data");
    assert_eq!(Manifest::parse(&written, path).expect("what was written is read"), manifest);
}

/// The tracker's parser and driver, on any bytes: every byte is accounted for, every whole record gets one verdict, and what
/// is accepted stands on the line as it is given out.
pub fn tracker(bytes: &[u8]) {
    let Some((&kind, stream)) = bytes.split_first() else { return };
    let layout = Layout {
        format: if kind & 1 == 0 { Format::Ascii } else { Format::Binary },
        output: if kind & 2 == 0 { Output::Quaternion } else { Output::Euler },
        list: [List::Once, List::Twice, List::Cosines][usize::from(kind >> 2) % 3],
    };
    // The cosines come in characters only.
    let format = if layout.list == List::Cosines { Format::Ascii } else { layout.format };
    let layout = Layout { format, ..layout };
    let stations = 1 + (kind >> 7);
    // A byte takes 87 microseconds, and records begin about sixty times per second.
    let mut at_us = 0;
    let stamps: Vec<u64> = stream
        .iter()
        .enumerate()
        .map(|(i, byte)| {
            let begins = match layout.format {
                Format::Ascii => i > 0 && stream[i - 1] == b'\n',
                Format::Binary => byte & 0x80 != 0,
            };
            at_us += if begins { 12_000 } else { 87 };
            at_us
        })
        .collect();
    let mut parser = Parser::new(layout, stations);
    let mut verdicts = vec![];
    for (&byte, &at_us) in stream.iter().zip(&stamps) {
        verdicts.extend(parser.push(byte, at_us));
    }
    verdicts.extend(parser.advance(at_us + 1_000_000));
    verdicts.extend(parser.finish());
    let broken = verdicts.iter().filter(|verdict| {
        use Rejected::{Column, Copies, Header, Norm, Range};
        matches!(verdict, Err(Header | Column | Copies | Range | Norm))
    });
    let whole = parser.whole_records() as usize;
    let ended = whole + broken.count();
    assert_eq!(verdicts.len(), ended, "every record of the right length gets one verdict");
    assert_eq!(stream.len(), parser.skipped_bytes() as usize + ended * layout.length());
    for record in verdicts.into_iter().flatten() {
        let start = stamps.binary_search(&record.at_us).expect("the stamp of a byte");
        stands(&stream[start..start + layout.length()], layout, stations, &record);
    }
    drive(bytes, stations, layout);
}

/// Whether these bytes are that record; characters are read by other means than the parser's.
fn stands(wire: &[u8], layout: Layout, stations: u8, record: &Record) {
    assert!((1..=stations).contains(&record.station) && record.count == 0);
    assert!(record.position_um.iter().all(|p| p.abs() <= 1_663_200));
    let norm = match record.orientation {
        Orientation::Quaternion(q) => q.iter().map(|&q| (f64::from(q) * 1e-6).powi(2)).sum::<f64>(),
        Orientation::Euler([azimuth, elevation, roll]) => {
            assert!(azimuth.abs() <= 180_000 && elevation.abs() <= 90_000 && roll.abs() <= 180_000);
            1.0
        }
    };
    assert!((norm - 1.0).abs() < 1e-3, "{norm}");
    if layout.format == Format::Ascii {
        let text = std::str::from_utf8(&wire[3..]).expect("columns are characters");
        let column = |i: usize| text[7 * i..7 * i + 7].trim().parse::<f64>().expect("a column is a number");
        assert_eq!((wire[0], wire[1], wire[2]), (b'0', b'0' + record.station, record.status));
        assert!((0..3).all(|i| (column(i) * 1e4).round() as i32 == record.position_um[i]));
    }
}

/// The driver, with whatever comes whenever.
fn drive(bytes: &[u8], stations: u8, layout: Layout) {
    let mut driver = Driver::new();
    let tracking = Tracking { stations, format: layout.format, output: layout.output };
    driver.track(tracking, 7, 0).expect("one station or two");
    let (mut now_us, mut records, mut rest) = (0, 0, bytes);
    while let Some((&step, after)) = rest.split_first() {
        let (heard, after) = after.split_at(after.len().min(usize::from(step & 0x3f)));
        driver.bytes(heard, now_us);
        rest = after;
        // From nothing to four seconds.
        now_us += 87 * heard.len() as u64 + [0, 16_000, 300_000, 4_000_000][usize::from(step >> 6)];
        for turn in 0.. {
            assert!(turn < 100, "it comes to an end");
            match driver.advance(now_us) {
                None => break,
                Some(TrackerOutput::Record(record)) => {
                    assert_eq!((record.count, driver.sequence()), (records, 7));
                    records += 1;
                }
                Some(_) => {}
            }
        }
        assert_eq!(driver.status().forwarded, records);
    }
}
