//! The class names of a detector, from its file: `{0: 'person', 1: 'bicycle', …}`, a Python dictionary.

/// The names by index; `None` when the text is not such a list of all indices from 0 on.
pub(crate) fn parse(text: &str) -> Option<Vec<String>> {
    let mut rest = text.trim().strip_prefix('{')?.strip_suffix('}')?.trim();
    let mut names = Vec::new();
    while !rest.is_empty() {
        let (number, after) = rest.split_once(':')?;
        if number.trim().parse() != Ok(names.len()) {
            return None;
        }
        let after = after.trim_start();
        let quote = after.chars().next().filter(|c| "'\"".contains(*c))?;
        let (name, after) = after[1..].split_once(quote)?;
        names.push(name.to_owned());
        let after = after.trim_start();
        rest = if after.is_empty() { after } else { after.strip_prefix(',')?.trim_start() };
    }
    (!names.is_empty()).then_some(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn class_names_are_parsed() {
        let names = parse("{0: 'person', 1: \"driver's seat\", 2: 'a, b: c'}").expect("three names");
        assert_eq!(names, ["person", "driver's seat", "a, b: c"]);
        assert_eq!(parse("{0:'x',}").expect("one name"), ["x"]);
        for text in
            ["", "{}", "person", "{1: 'x'}", "{0: 'x', 2: 'y'}", "{0: x}", "{0: 'x}", "{0: 'x' 1: 'y'}"]
        {
            assert_eq!(parse(text), None, "{text}");
        }
    }
}
