//! When and on which machine a run was, in words and as a name.

use crate::rt::{now, unix_origin};
use crate::time::SpanNs;

/// The day and the time in UTC, and the machine: name, processor, cores, kernel. What cannot be read is left out.
pub(super) fn when_and_where() -> [(String, String); 2] {
    let read = |path: &str| std::fs::read_to_string(path).ok().map(|text| text.trim().to_owned());
    let cpu = read("/proc/cpuinfo").and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("model name"))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    });
    let cores = std::thread::available_parallelism().ok().map(|cores| format!("{cores} cores"));
    let kernel = read("/proc/sys/kernel/osrelease").map(|release| format!("Linux {release}"));
    let parts = [read("/proc/sys/kernel/hostname"), cpu, cores, kernel];
    let machine = parts.into_iter().flatten().collect::<Vec<_>>().join(", ");
    let unix_s = (now() + unix_origin()).0.div_euclid(SpanNs::MILLISECOND.0 * 1000);
    [("made".into(), utc(unix_s)), ("machine".into(), machine)]
}

/// Seconds since 1970 as a name that sorts by time: `2026-11-29T120000Z`.
pub(super) fn utc_name(unix_s: i64) -> String {
    utc(unix_s).replace(" UTC", "Z").replace(' ', "T").replace(':', "")
}

/// Seconds since 1970 as a date and a time. The numbers are those of the Gregorian calendar, counted from March of the year 0.
fn utc(unix_s: i64) -> String {
    let (days, s) = (unix_s.div_euclid(86_400), unix_s.rem_euclid(86_400));
    let since_march = days + 719_468;
    let (era, of_era) = (since_march.div_euclid(146_097), since_march.rem_euclid(146_097));
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year + 400 * era + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02}:{:02} UTC", s / 3600, s / 60 % 60, s % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against `date -u -d @...`.
    #[test]
    fn dates_are_those_of_the_calendar() {
        for (unix_s, told) in [
            (0, "1970-01-01 00:00:00 UTC"),
            (951_782_399, "2000-02-28 23:59:59 UTC"),
            (951_782_400, "2000-02-29 00:00:00 UTC"),
            (1_735_689_599, "2024-12-31 23:59:59 UTC"),
            (4_107_542_400, "2100-03-01 00:00:00 UTC"),
        ] {
            assert_eq!(utc(unix_s), told);
        }
        assert_eq!(utc_name(951_782_400), "2000-02-29T000000Z");
        let [made, machine] = when_and_where();
        assert!(made.1.starts_with("20") && machine.1.contains("cores"), "{made:?} {machine:?}");
    }
}
