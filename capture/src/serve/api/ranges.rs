//! Parts of a long answer (RFC 9110, section 14): one range, or all of it.

/// What a `Range` header asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// Everything.
    All,
    /// From here, so many bytes.
    Part(u64, u64),
    /// Nothing that is there.
    Outside,
}

/// Reads a `Range` header for a body of `total` bytes. What is malformed, or asks for several ranges, asks for everything.
#[must_use]
pub fn wanted(header: Option<&str>, total: u64) -> Wanted {
    let Some((first, last)) = header.and_then(|h| h.strip_prefix("bytes=")).and_then(|r| r.split_once('-')) else {
        return Wanted::All;
    };
    let number = |text: &str| text.trim().parse::<u64>().ok();
    match (number(first), number(last), first.trim().is_empty(), last.trim().is_empty()) {
        (Some(first), Some(last), ..) if first <= last && first < total => {
            Wanted::Part(first, last.min(total - 1) - first + 1)
        }
        (Some(first), Some(last), ..) if first <= last => Wanted::Outside,
        (Some(first), None, _, true) if first < total => Wanted::Part(first, total - first),
        (Some(_), None, _, true) => Wanted::Outside,
        (None, Some(0), true, _) => Wanted::Outside,
        (None, Some(n), true, _) if total > 0 => Wanted::Part(total - n.min(total), n.min(total)),
        _ => Wanted::All,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_as_the_standard_has_them() {
        let of = |text: &str| wanted(Some(text), 100);
        assert_eq!(
            [of("bytes=0-9"), of("bytes=90-"), of("bytes=-10")],
            [Wanted::Part(0, 10), Wanted::Part(90, 10), Wanted::Part(90, 10)]
        );
        assert_eq!([of("bytes=50-1000"), of("bytes=-1000")], [Wanted::Part(50, 50), Wanted::Part(0, 100)]);
        assert_eq!([of("bytes=100-"), of("bytes=100-200"), of("bytes=-0")], [Wanted::Outside; 3]);
        assert_eq!(
            [of("bytes=9-1"), of("bytes=0-1,5-6"), of("lines=1-2"), of("bytes=-"), of("bytes=a-b")],
            [Wanted::All; 5]
        );
        assert_eq!(wanted(None, 100), Wanted::All);
        assert_eq!(wanted(Some("bytes=18446744073709551615-"), 100), Wanted::Outside);
    }
}
