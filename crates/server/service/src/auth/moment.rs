//! A second in UTC, and the calendar that goes with it.

use std::fmt;
use std::str::FromStr;
use std::time::{SystemTime, UNIX_EPOCH};

const DAY: i64 = 86_400;

/// A second, counted from the beginning of 1970 in UTC without leap seconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Moment(i64);

/// A text that is no moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a day (2027-01-31) or a second in UTC (2027-01-31T00:00:00Z) is expected")]
pub struct BadMoment;

impl Moment {
    /// So many seconds after the beginning of 1970.
    pub const fn of_unix(seconds: i64) -> Self {
        Self(seconds)
    }

    /// What a clock of the system shows.
    pub fn of(time: SystemTime) -> Self {
        Self(match time.duration_since(UNIX_EPOCH) {
            Ok(since) => since.as_secs().cast_signed(),
            Err(before) => -before.duration().as_secs().cast_signed(),
        })
    }

    /// From year, month (1 to 12), day (from 1), hour, minute, second; `None` where the calendar has no such day, or the day
    /// no such second. A leap second counts as the first of the next minute.
    pub fn of_calendar(date: [i64; 3], time: [i64; 3]) -> Option<Self> {
        let [year, month, day] = date;
        let [hour, minute, second] = time;
        let days = days(year, month, day);
        let exists = (1..=12).contains(&month) && (1..=31).contains(&day) && civil(days) == date;
        let in_day = (0..24).contains(&hour) && (0..60).contains(&minute) && (0..=60).contains(&second);
        (exists && in_day).then_some(Self(days * DAY + hour * 3600 + minute * 60 + second))
    }

    /// Seconds since the beginning of 1970.
    pub const fn unix(self) -> i64 {
        self.0
    }

    /// So many days later; `None` beyond the year 9999, which has no written form.
    pub fn days_later(self, days: u32) -> Option<Self> {
        let later = Self(self.0.checked_add(i64::from(days) * DAY)?);
        (civil(later.0.div_euclid(DAY))[0] <= 9999).then_some(later)
    }
}

impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [year, month, day] = civil(self.0.div_euclid(DAY));
        let second = self.0.rem_euclid(DAY);
        let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
        write!(f, "{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
    }
}

impl FromStr for Moment {
    type Err = BadMoment;

    fn from_str(text: &str) -> Result<Self, BadMoment> {
        let (date, time) = match text.split_once('T') {
            Some((date, time)) => (date, time.strip_suffix('Z').ok_or(BadMoment)?),
            None => (text, "00:00:00"),
        };
        let date = numbers(date, '-', [4, 2, 2]).ok_or(BadMoment)?;
        let time = numbers(time, ':', [2, 2, 2]).ok_or(BadMoment)?;
        Self::of_calendar(date, time).ok_or(BadMoment)
    }
}

/// Three numbers of so many digits.
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

/// Days from 1970-01-01 in the Gregorian calendar (H. Hinnant, `days_from_civil`).
fn days(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let of_era = year.rem_euclid(400);
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    year.div_euclid(400) * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468
}

/// Year, month and day of a day from 1970-01-01 (H. Hinnant, `civil_from_days`).
fn civil(days: i64) -> [i64; 3] {
    let days = days + 719_468;
    let of_era = days.rem_euclid(146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let shifted = (5 * of_year + 2) / 153;
    let day = of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    [year + days.div_euclid(146_097) * 400 + i64::from(month <= 2), month, day]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_calendar_is_right() {
        // `date -u -d DATE +%s`
        for (text, seconds) in [
            ("1970-01-01", 0),
            ("2000-02-29", 951_782_400),
            ("2026-11-22", 1_795_305_600),
            ("2027-01-31T23:59:59Z", 1_801_439_999),
            ("2100-03-01", 4_107_542_400),
            ("9999-12-31T23:59:59Z", 253_402_300_799),
        ] {
            let moment: Moment = text.parse().expect("a moment");
            assert_eq!(moment.unix(), seconds, "{text}");
            assert!(moment.to_string().starts_with(text), "{moment}");
        }
        for day in -800_000..3_000_000 {
            let [year, month, of_month] = civil(day);
            assert_eq!(days(year, month, of_month), day);
        }
        let last: Moment = "9999-12-31".parse().expect("a moment");
        assert!(last.days_later(0).is_some() && last.days_later(1).is_none());
    }

    #[test]
    fn what_is_no_moment_is_refused() {
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
            assert_eq!(bad.parse::<Moment>(), Err(BadMoment), "{bad}");
        }
    }
}
