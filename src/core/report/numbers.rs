//! Numbers as people read them: with the digits that they are worth.

/// With so many digits that mean something.
#[must_use]
pub fn significant(value: f64, digits: usize) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0".into() } else { "unknown".into() };
    }
    let digits = digits.clamp(1, 12) as i32;
    let power = value.abs().log10().floor() as i32;
    if !(-5..9).contains(&power) {
        return format!("{value:.*e}", digits as usize - 1);
    }
    // What is rounded up to the next power of ten has a digit more before the point.
    let unit = 10f64.powi(power - digits + 1);
    let rounded = (value / unit).round() * unit;
    let power = rounded.abs().log10().floor() as i32;
    let decimals = (digits - 1 - power).max(0) as usize;
    format!("{rounded:.decimals$}")
}

/// "1 frame", "2 frames".
#[must_use]
pub fn counted(count: u64, what: &str) -> String {
    if count == 1 { format!("1 {what}") } else { format!("{count} {what}s") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_digits_as_asked_for() {
        let told = [
            (0.043_21, 2),
            (163.73, 3),
            (163.73, 2),
            (0.999_6, 3),
            (9.99, 1),
            (-1234.5, 3),
            (0.0, 3),
            (2e-9, 2),
            (9.96e-5, 2),
        ];
        let texts = told.map(|(value, digits)| significant(value, digits));
        assert_eq!(texts, ["0.043", "164", "160", "1.00", "10", "-1230", "0", "2.0e-9", "0.00010"]);
        assert_eq!(significant(f64::NAN, 3), "unknown");
        assert_eq!((counted(1, "frame"), counted(0, "frame")), ("1 frame".to_owned(), "0 frames".to_owned()));
    }
}
