//! Numbers, ages and names as text.

use std::time::Duration;

use blueprints::outside::printable;
use proto::wilson::SuccessRate;

/// Longest name shown, in characters.
const NAME_LEN: usize = 40;

/// Formats how long before `now` something happened. Both times count from the start of the watch.
pub(super) fn age(now: Duration, at: Duration) -> String {
    format!("{} ago", span(now.saturating_sub(at)))
}

/// Formats a duration in the largest unit of which it has at least two.
pub(super) fn span(time: Duration) -> String {
    match time.as_secs() {
        seconds @ 0..120 => format!("{seconds} s"),
        seconds @ 120..7200 => format!("{} min", seconds / 60),
        seconds => format!("{} h", seconds / 3600),
    }
}

/// Formats seconds in the largest unit of which there are at least two; any `f64` is accepted.
pub fn seconds(seconds: f64) -> String {
    Duration::try_from_secs_f64(seconds).map_or_else(|_| format!("{seconds:e} s"), span)
}

/// Formats an integer with a space before each group of three digits.
pub(super) fn count(n: u64) -> String {
    grouped(&n.to_string())
}

/// Formats a rate per second without a fraction; in scientific notation from 10¹² on.
pub(super) fn rate(per_s: f64) -> String {
    // The sum of no rates is −0.
    let per_s = per_s.round() + 0.0;
    if per_s.abs() < 1e12 { grouped(&format!("{per_s:.0}")) } else { format!("{per_s:.1e}") }
}

/// Formats a measurement with a few digits: plain where that is short, in scientific notation elsewhere.
pub(super) fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        0.001..1e5 => format!("{value:.3}"),
        _ => format!("{value:.1e}"),
    }
}

/// Formats a success rate in percent with its confidence interval, 22 characters; `-` without episodes.
pub(super) fn success(success: &SuccessRate) -> String {
    if success.n_episodes == 0 {
        return "-".to_owned();
    }
    let [rate, low, high] = [success.rate, success.wilson_low, success.wilson_high].map(|share| 100.0 * share);
    format!("{rate:5.1} ({low:5.1} to {high:5.1})")
}

/// Makes an untrusted name safe for a terminal, and limits its length.
pub(super) fn name(text: &str) -> String {
    printable(text).chars().take(NAME_LEN).collect()
}

fn grouped(digits: &str) -> String {
    let mut text = String::new();
    for (idx, digit) in digits.chars().enumerate() {
        let n_right = digits.len() - idx;
        if idx > 0 && n_right.is_multiple_of(3) && !text.ends_with('-') {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ages_are_in_their_largest_unit() {
        for (seconds, text) in [(0, "0 s ago"), (119, "119 s ago"), (120, "2 min ago"), (7200, "2 h ago")] {
            assert_eq!(age(Duration::from_secs(seconds + 5), Duration::from_secs(5)), text);
        }
        // Messages that arrived after the redraw began have age zero.
        assert_eq!(age(Duration::ZERO, Duration::from_secs(1)), "0 s ago");
        assert_eq!(super::seconds(-1.0), "-1e0 s");
        assert_eq!(super::seconds(f64::MAX), format!("{:e} s", f64::MAX));
    }

    #[test]
    fn digits_are_grouped() {
        for (n, text) in [(0, "0"), (999, "999"), (1000, "1 000"), (3_326_976, "3 326 976")] {
            assert_eq!(count(n), text);
        }
        for (per_s, text) in [(-123_456.4, "-123 456"), (1e12, "1.0e12"), (-0.4, "0")] {
            assert_eq!(rate(per_s), text);
        }
    }

    #[test]
    fn measures_are_short() {
        for (value, text) in [(0.0, "0"), (0.0041, "0.004"), (-1.5, "-1.500"), (0.000_3, "3.0e-4"), (1e300, "1.0e300")]
        {
            assert_eq!(number(value), text);
        }
    }

    #[test]
    fn names_cannot_move_the_cursor() {
        assert_eq!(name("train 2-6"), "train 2-6");
        assert_eq!(name("a\u{1b}[2Jb\r\n\u{202e}"), "a\\u001b[2Jb\\u000d\\n\\u202e");
        assert_eq!(name(&"x".repeat(1000)).len(), NAME_LEN);
    }
}
