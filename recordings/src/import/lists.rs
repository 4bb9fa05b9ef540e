//! Lists of stamped file names in a TUM RGB-D folder, and decimal time stamps.

use crate::error::{Error, Result};
use crate::types::TimestampNs;
use std::io::Read;
use std::path::{Component, Path};

/// Bytes of the longest list file that is read (some ten million frames).
const MAX_TEXT_BYTES: u64 = 1 << 28;

/// Reads a text file of bounded size.
pub(crate) fn read_text(path: &Path) -> Result<String> {
    let file = std::fs::File::open(path).map_err(|e| Error::io(path, e))?;
    let mut text = String::new();
    file.take(MAX_TEXT_BYTES + 1).read_to_string(&mut text).map_err(|e| Error::io(path, e))?;
    if text.len() as u64 > MAX_TEXT_BYTES {
        return Err(Error::invalid(path, "file too long", "this is no list of frames"));
    }
    Ok(text)
}

/// Seconds as decimal text ("1305031102.175304", also "1.3e9") to nanoseconds, exactly (rounded half up below 1 ns).
#[must_use]
pub fn parse_seconds(text: &str) -> Option<TimestampNs> {
    let (mantissa, exponent) = match text.split_once(['e', 'E']) {
        Some((m, e)) => (m, e.parse::<i32>().ok().filter(|e| e.abs() < 32)?),
        None => (text, 0),
    };
    let (negative, digits) = match mantissa.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, mantissa.strip_prefix('+').unwrap_or(mantissa)),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    if (whole.is_empty() && fraction.is_empty()) || !whole.bytes().chain(fraction.bytes()).all(|b| b.is_ascii_digit()) {
        return None;
    }
    // The value is the digits read as a whole number, times 10^shift nanoseconds.
    let shift = 9 + exponent - i32::try_from(fraction.len()).ok()?;
    let digits: Vec<u8> = whole.bytes().chain(fraction.bytes()).map(|b| b - b'0').collect();
    let kept = usize::try_from(digits.len() as i64 + i64::from(shift.min(0))).unwrap_or(0);
    let mut ns: i64 = 0;
    for d in digits[..kept].iter().copied().chain(std::iter::repeat_n(0, shift.max(0) as usize)) {
        ns = ns.checked_mul(10)?.checked_add(i64::from(d))?;
    }
    // Half up: the first digit that is cut off decides, provided it stands right behind the kept ones.
    let leading_gap = shift.min(0).unsigned_abs() as usize > digits.len();
    if !leading_gap && digits.get(kept).is_some_and(|d| *d >= 5) {
        ns = ns.checked_add(1)?;
    }
    Some(if negative { -ns } else { ns })
}

/// Nanoseconds as decimal seconds with six decimals, or nine where six would round; [`parse_seconds`] reads it back.
#[must_use]
pub fn format_seconds(ns: TimestampNs) -> String {
    let (sign, magnitude) = (if ns < 0 { "-" } else { "" }, ns.unsigned_abs());
    let (whole, fraction) = (magnitude / 1_000_000_000, magnitude % 1_000_000_000);
    if fraction.is_multiple_of(1000) {
        format!("{sign}{whole}.{:06}", fraction / 1000)
    } else {
        format!("{sign}{whole}.{fraction:09}")
    }
}

/// Reads a list of `timestamp filename` lines, sorted by time stamp (stable).
pub(crate) fn read_list(path: &Path) -> Result<Vec<(TimestampNs, String)>> {
    let text = read_text(path)?;
    let mut entries = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let bad = |what: &str| {
            Error::invalid(
                path,
                format!("line {}: {what}: `{}`", number + 1, line.chars().take(80).collect::<String>()),
                "a line is `timestamp filename`, comments begin with #",
            )
        };
        let (stamp, name) = line.split_once([' ', '\t']).ok_or_else(|| bad("no file name"))?;
        let stamp = parse_seconds(stamp).ok_or_else(|| bad("not a time stamp in seconds"))?;
        let name = name.trim();
        if !Path::new(name).components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir)) {
            return Err(bad("the file lies outside the folder"));
        }
        entries.push((stamp, name.to_owned()));
    }
    if entries.is_empty() {
        return Err(Error::invalid(path, "the list is empty", "list at least one `timestamp filename`"));
    }
    entries.sort_by_key(|(stamp, _)| *stamp);
    Ok(entries)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::text_file;
    use proptest::prelude::*;

    #[test]
    fn seconds_are_read_exactly() {
        for (text, ns) in [
            ("1305031102.175304", 1_305_031_102_175_304_000),
            ("0", 0),
            ("0.000000", 0),
            (".5", 500_000_000),
            ("12.", 12_000_000_000),
            ("-1.25", -1_250_000_000),
            ("0.0333333333333", 33_333_333),
            ("0.0333333335", 33_333_334),
            ("0.0000000004", 0),
            ("0.0000000005", 1),
            ("0.00000000005", 0),
            ("1.305031102175304e+09", 1_305_031_102_175_304_000),
            ("3.5e-1", 350_000_000),
            ("9e-11", 0),
        ] {
            assert_eq!(parse_seconds(text), Some(ns), "{text}");
        }
        for text in ["", "nan", "NaN", "inf", "-", ".", "1.2.3", "0x10", "1e", "1e99", "99999999999999999999", "1,5"] {
            assert_eq!(parse_seconds(text), None, "{text}");
        }
    }

    #[test]
    fn lists_may_be_commented_windows_made_and_unsorted() {
        let (_dir, path) = text_file("# colour\r\n\r\n2.5 rgb/b name.png\r\n1.5\trgb/a.png\r\n  \n2.5   rgb/c.png");
        let list = read_list(&path).unwrap();
        let expected = [(1_500_000_000, "rgb/a.png"), (2_500_000_000, "rgb/b name.png"), (2_500_000_000, "rgb/c.png")];
        assert_eq!(list.iter().map(|(t, n)| (*t, n.as_str())).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn bad_lists_name_file_line_and_remedy() {
        for (text, part) in [
            ("", "the list is empty"),
            ("# only comments", "the list is empty"),
            ("1.0 a.png\nnan b.png", "line 2: not a time stamp"),
            ("1.0", "no file name"),
            ("1.0 ../../etc/passwd", "outside the folder"),
            ("1.0 /etc/passwd", "outside the folder"),
        ] {
            let (_dir, path) = text_file(text);
            let message = read_list(&path).unwrap_err().to_string();
            assert!(message.contains(part) && message.contains("file.txt"), "{message}");
        }
    }

    proptest! {
        #[test]
        fn stamps_come_back(ns in any::<i64>()) {
            prop_assume!(ns != i64::MIN);
            prop_assert_eq!(parse_seconds(&format_seconds(ns)), Some(ns));
        }

        #[test]
        fn any_text_is_read_or_refused(text in "[0-9eE.+#= \\-k1p2\n/a]{0,60}") {
            let _ = parse_seconds(&text);
            let (_dir, path) = text_file(&text);
            let _ = read_list(&path);
        }
    }
}
