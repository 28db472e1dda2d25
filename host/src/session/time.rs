//! The time of day as journals write it: RFC 3339 in UTC, to the microsecond, such as `2026-11-22T18:45:29.123456Z`.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Deserializer, Serializer};

use crate::calendar::{civil, days};

const DAY_S: u64 = 86_400;

/// Now, as exactly as it is written.
pub(super) fn now() -> SystemTime {
    whole_microseconds(SystemTime::now())
}

/// Without what is lost in writing; before 1970 becomes 1970.
pub(super) fn whole_microseconds(at: SystemTime) -> SystemTime {
    let since = at.duration_since(UNIX_EPOCH).unwrap_or_default();
    UNIX_EPOCH + Duration::new(since.as_secs(), since.subsec_micros() * 1000)
}

fn format(at: SystemTime) -> String {
    let since = at.duration_since(UNIX_EPOCH).unwrap_or_default();
    let (year, month, day) = civil((since.as_secs() / DAY_S) as i64);
    let second = since.as_secs() % DAY_S;
    let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
    let micros = since.subsec_micros();
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{micros:06}Z")
}

/// The time that [`format`] writes so; nothing else is understood.
fn parse(text: &str) -> Option<SystemTime> {
    // By its bytes: a text in other letters has no such places.
    let number = |from: usize, to: usize| -> Option<u64> {
        let digits = text.as_bytes().get(from..to)?;
        digits.iter().try_fold(0, |sum, d| d.is_ascii_digit().then(|| sum * 10 + u64::from(d - b'0')))
    };
    let (year, month, day) = (number(0, 4)?, number(5, 7)?, number(8, 10)?);
    let (hour, minute, second, micros) = (number(11, 13)?, number(14, 16)?, number(17, 19)?, number(20, 26)?);
    if year < 1970 || !(1..=12).contains(&month) || !(1..=31).contains(&day) {
        return None;
    }
    let days = days(year as i64, month as i64, day as i64) as u64;
    let seconds = days * DAY_S + hour * 3600 + minute * 60 + second;
    let at = UNIX_EPOCH + Duration::new(seconds, micros as u32 * 1000);
    // Whatever was not as it is written (30 February, 25 o'clock, a missing Z) is written otherwise.
    (format(at) == text).then_some(at)
}

pub(super) fn serialize<S: Serializer>(at: &SystemTime, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&format(*at))
}

pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<SystemTime, D::Error> {
    let text = String::deserialize(deserializer)?;
    parse(&text).ok_or_else(|| {
        serde::de::Error::custom(format!("'{text}' is no time like 2026-11-22T18:45:29.123456Z"))
    })
}

/// The same where a time may be absent.
pub(super) mod optional {
    use super::*;

    pub(in super::super) fn serialize<S: Serializer>(
        at: &Option<SystemTime>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        match at {
            Some(at) => super::serialize(at, serializer),
            None => serializer.serialize_none(),
        }
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<SystemTime>, D::Error> {
        super::deserialize(deserializer).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: u64, micros: u32) -> SystemTime {
        UNIX_EPOCH + Duration::new(seconds, micros * 1000)
    }

    #[test]
    fn known_times_are_written_as_everybody_writes_them() {
        // `date -u -d @SECONDS +%FT%TZ`
        for (seconds, text) in [
            (0, "1970-01-01T00:00:00"),
            (951_782_399, "2000-02-28T23:59:59"),
            (951_782_400, "2000-02-29T00:00:00"),
            (951_868_800, "2000-03-01T00:00:00"),
            (1_795_373_129, "2026-11-22T18:45:29"),
            (4_107_542_400, "2100-03-01T00:00:00"),
            (253_402_300_799, "9999-12-31T23:59:59"),
        ] {
            assert_eq!(format(at(seconds, 120)), format!("{text}.000120Z"));
        }
    }

    #[test]
    fn every_day_survives_writing_and_they_are_in_order() {
        let days: Vec<SystemTime> = (0..60_000).map(|day| at(day * DAY_S + day * 7 % DAY_S, 5)).collect();
        assert!(days.iter().all(|&day| parse(&format(day)) == Some(day)));
        assert!(days.windows(2).all(|pair| format(pair[0]) < format(pair[1])));
    }

    #[test]
    fn what_is_no_time_is_refused() {
        for text in [
            "",
            "2026-11-22",
            "2026-11-22T18:45:29Z",
            "2026-11-22T18:45:29.123456",
            "2026-02-30T18:45:29.123456Z",
            "2026-11-22T24:00:00.000000Z",
            "2026-13-22T18:45:29.123456Z",
            "1969-12-31T23:59:59.999999Z",
            "2026-11-22T18:45:29.123456Z ",
            "２０２６-11-22T18:45:29.123456Z",
            "2026-00-00T00:00:00.000000Z",
        ] {
            assert_eq!(parse(text), None, "{text}");
        }
    }
}
