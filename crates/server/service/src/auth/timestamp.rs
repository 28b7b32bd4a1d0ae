//! A second in UTC, and its calendar form.

use std::fmt;
use std::str::FromStr;
use std::time::{SystemTime, UNIX_EPOCH};

use time::{Date, Duration, OffsetDateTime, Time};

/// A second, counted from the beginning of 1970 in UTC without leap seconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Timestamp(i64);

/// The text is not a valid time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected a day (2027-01-31) or a second in UTC (2027-01-31T00:00:00Z)")]
pub struct InvalidTimestamp;

impl Timestamp {
    /// From seconds since the beginning of 1970.
    pub const fn of_unix(seconds: i64) -> Self {
        Self(seconds)
    }

    /// From a time of the system clock.
    pub fn of(time: SystemTime) -> Self {
        Self(match time.duration_since(UNIX_EPOCH) {
            Ok(since) => since.as_secs().cast_signed(),
            Err(before) => -before.duration().as_secs().cast_signed(),
        })
    }

    /// From year, month (1 to 12), day (from 1), hour, minute, second; `None` if the calendar has no such day or the
    /// day no such second. A leap second counts as the first second of the next minute.
    pub fn of_calendar(date: [i64; 3], time: [i64; 3]) -> Option<Self> {
        let [year, month, day] = date;
        let [hour, minute, second] = time.map(|part| u8::try_from(part).ok());
        let month = u8::try_from(month).ok()?.try_into().ok()?;
        let date = Date::from_calendar_date(year.try_into().ok()?, month, day.try_into().ok()?).ok()?;
        let is_leap = second == Some(60);
        let time = Time::from_hms(hour?, minute?, second?.min(59)).ok().filter(|_| second <= Some(60))?;
        Some(Self(date.with_time(time).assume_utc().unix_timestamp() + i64::from(is_leap)))
    }

    /// Seconds since the beginning of 1970.
    pub const fn unix(self) -> i64 {
        self.0
    }

    /// This many days later; `None` beyond the year 9999, which has no written form.
    pub fn plus_days(self, days: u32) -> Option<Self> {
        let later = self.calendar()?.checked_add(Duration::days(days.into()))?;
        Some(Self(later.unix_timestamp()))
    }

    /// `None` beyond the years -9999 to 9999.
    fn calendar(self) -> Option<OffsetDateTime> {
        OffsetDateTime::from_unix_timestamp(self.0).ok()
    }
}

impl fmt::Display for Timestamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Beyond the calendar there is no form that could be parsed again.
        let Some(time) = self.calendar() else { return write!(f, "{} s after 1970", self.0) };
        let (year, month, day) = time.to_calendar_date();
        let (hour, minute, second) = time.to_hms();
        write!(f, "{year:04}-{:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z", u8::from(month))
    }
}

impl FromStr for Timestamp {
    type Err = InvalidTimestamp;

    fn from_str(text: &str) -> Result<Self, InvalidTimestamp> {
        let (date, time) = match text.split_once('T') {
            Some((date, time)) => (date, time.strip_suffix('Z').ok_or(InvalidTimestamp)?),
            None => (text, "00:00:00"),
        };
        let date = numbers(date, '-', [4, 2, 2]).ok_or(InvalidTimestamp)?;
        let time = numbers(time, ':', [2, 2, 2]).ok_or(InvalidTimestamp)?;
        Self::of_calendar(date, time).ok_or(InvalidTimestamp)
    }
}

/// Three numbers with the given numbers of digits.
fn numbers(text: &str, separator: char, digits: [usize; 3]) -> Option<[i64; 3]> {
    let mut parts = text.split(separator);
    let mut numbers = [0; 3];
    for (number, digits) in numbers.iter_mut().zip(digits) {
        let part = parts.next()?;
        if part.len() != digits || !part.bytes().all(|c| c.is_ascii_digit()) {
            return None;
        }
        *number = part.parse().ok()?;
    }
    parts.next().is_none().then_some(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calendar_dates_convert_to_unix_seconds() {
        // `date -u -d DATE +%s`
        for (text, seconds) in [
            ("1970-01-01", 0),
            ("2000-02-29", 951_782_400),
            ("2026-11-22", 1_795_305_600),
            ("2027-01-31T23:59:59Z", 1_801_439_999),
            ("2100-03-01", 4_107_542_400),
            ("9999-12-31T23:59:59Z", 253_402_300_799),
        ] {
            let timestamp: Timestamp = text.parse().expect("a timestamp");
            assert_eq!(timestamp.unix(), seconds, "{text}");
            assert!(timestamp.to_string().starts_with(text), "{timestamp}");
        }
        let leap: Timestamp = "2016-12-31T23:59:60Z".parse().expect("a timestamp");
        assert_eq!(leap.to_string(), "2017-01-01T00:00:00Z");
        let last: Timestamp = "9999-12-31".parse().expect("a timestamp");
        assert!(last.plus_days(0).is_some() && last.plus_days(1).is_none());
    }

    #[test]
    fn invalid_times_are_rejected() {
        for bad in [
            "",
            "2027",
            "2027-02-29",
            "2027-13-01",
            "2027-00-10",
            "2027-1-31",
            "2027-01-31T00:00:00",
            "2027-01-31T24:00:00Z",
            "2027-01-31T00:60:00Z",
            "2027-01-31T00:00Z",
            "2027-01-31T00:00:00+01:00",
            "2027-01-31T00:00:00.5Z",
            "+027-01-31",
            "31.01.2027",
            "2027-01-31-",
            "never",
        ] {
            assert_eq!(bad.parse::<Timestamp>(), Err(InvalidTimestamp), "{bad}");
        }
    }
}
