//! Rust source as the structure checks read it: without comments, strings and tests.

/// The source without its tests: from the first `#[cfg(test)]` that stands before an inline module, everything goes
/// (tests are at the bottom, as a convention). A file that is all tests is left out by its name: [`is_tests`].
pub(crate) fn without_tests(source: &str) -> &str {
    let mut at = 0;
    while let Some(found) = source[at..].find("#[cfg(test)]") {
        let start = at + found;
        let after = source[start + "#[cfg(test)]".len()..].trim_start();
        let line = after.lines().next().unwrap_or_default();
        if line.contains("mod ") && line.contains('{') {
            return &source[..start];
        }
        at = start + 1;
    }
    source
}

/// Whether a file of `src/`, named relative to it, holds nothing but tests and what they need.
pub(crate) fn is_tests(file: &str) -> bool {
    file.split('/').any(|part| matches!(part, "tests" | "tests.rs" | "test_data.rs"))
}

/// The code alone: every comment and every string's content becomes spaces; line breaks stay.
pub(crate) fn code(source: &str) -> String {
    let bytes = source.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        let end = comment_end(source, at).or_else(|| string_end(source, at));
        if let Some(end) = end {
            out.extend(bytes[at..end].iter().map(|b| if *b == b'\n' { b'\n' } else { b' ' }));
            at = end;
        } else {
            out.push(bytes[at]);
            at += 1;
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

fn comment_end(source: &str, at: usize) -> Option<usize> {
    let rest = &source.as_bytes()[at..];
    if rest.starts_with(b"//") {
        return Some(at + rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len()));
    }
    if !rest.starts_with(b"/*") {
        return None;
    }
    let mut depth = 0;
    let mut i = 0;
    while i < rest.len() {
        match &rest[i..] {
            [b'/', b'*', ..] => (depth, i) = (depth + 1, i + 2),
            [b'*', b'/', ..] => (depth, i) = (depth - 1, i + 2),
            _ => i += 1,
        }
        if depth == 0 {
            break;
        }
    }
    Some(at + i)
}

/// A string, a raw string or a character; a lifetime is none.
fn string_end(source: &str, at: usize) -> Option<usize> {
    let bytes = source.as_bytes();
    let follows_a_name = at > 0 && (bytes[at - 1].is_ascii_alphanumeric() || bytes[at - 1] == b'_');
    match bytes[at] {
        b'"' => Some(quoted_end(bytes, at + 1, b'"')),
        b'r' if !follows_a_name || bytes[at - 1] == b'b' => {
            let hashes = bytes[at + 1..].iter().take_while(|b| **b == b'#').count();
            let open = at + 1 + hashes;
            (bytes.get(open) == Some(&b'"')).then(|| {
                let close = format!("\"{}", "#".repeat(hashes)).into_bytes();
                let end = bytes[open + 1..].windows(close.len()).position(|w| w == close);
                end.map_or(bytes.len(), |end| open + 1 + end + close.len())
            })
        }
        b'\'' => {
            let is_escape = bytes.get(at + 1) == Some(&b'\\');
            let next = source[at + 1..].chars().next()?;
            let closes = bytes.get(at + 1 + next.len_utf8()) == Some(&b'\'');
            (is_escape || closes)
                .then(|| if is_escape { quoted_end(bytes, at + 1, b'\'') } else { at + 2 + next.len_utf8() })
        }
        _ => None,
    }
}

fn quoted_end(bytes: &[u8], mut at: usize, quote: u8) -> usize {
    while at < bytes.len() && bytes[at] != quote {
        at += if bytes[at] == b'\\' { 2 } else { 1 };
    }
    (at + 1).min(bytes.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_code_is_left() {
        let source = "a // crate::b\n/* c /* d */ e */ f \"crate::g \\\" h\" r#\"i \" j\"# '\\'' 'k' <'l> b'm' br\"n\" o";
        let left: Vec<String> = code(source).split_whitespace().map(str::to_owned).collect();
        assert_eq!(left, ["a", "f", "<'l>", "b", "b", "o"]);
        assert_eq!(code("é \"é\n\" ü").lines().count(), 2);
    }

    #[test]
    fn tests_are_cut() {
        let source =
            "fn a() {}\n#[cfg(test)]\nmod test_data;\nfn b() {}\n#[cfg(test)]\nmod tests {\n fn c() {}\n}\n";
        assert_eq!(without_tests(source), "fn a() {}\n#[cfg(test)]\nmod test_data;\nfn b() {}\n");
        assert!(
            is_tests("tests.rs")
                && is_tests("tests/a.rs")
                && is_tests("a/tests.rs")
                && !is_tests("attests.rs")
        );
    }
}
