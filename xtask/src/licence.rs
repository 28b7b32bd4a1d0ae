//! SPDX expressions: `(MIT OR Apache-2.0) AND Unicode-3.0`, and the old `MIT/Apache-2.0`.

/// Whether the expression holds when exactly the licences that `is_allowed` names may be used.
pub(crate) fn is_satisfied(expression: &str, is_allowed: &dyn Fn(&str) -> bool) -> Result<bool, String> {
    let tokens = tokens(expression);
    let mut reader = Reader { tokens: &tokens, is_allowed };
    let satisfied = reader.any_of()?;
    if reader.tokens.is_empty() {
        Ok(satisfied)
    } else {
        Err(format!("`{}` is not expected", reader.tokens[0]))
    }
}

/// The licences that an expression names, each with its exception (`WITH`).
pub(crate) fn terms(expression: &str) -> Vec<String> {
    tokens(expression).into_iter().filter(|t| !matches!(t.as_str(), "(" | ")" | "AND" | "OR")).collect()
}

/// Words, parentheses, and `X WITH Y` as one word.
fn tokens(expression: &str) -> Vec<String> {
    let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
    let mut tokens: Vec<String> = Vec::new();
    let mut words = spaced.split_whitespace();
    while let Some(word) = words.next() {
        match (word, tokens.last_mut()) {
            ("WITH", Some(licence)) => {
                *licence = format!("{licence} WITH {}", words.next().unwrap_or_default());
            }
            _ => tokens.push(word.to_owned()),
        }
    }
    tokens
}

struct Reader<'a> {
    tokens: &'a [String],
    is_allowed: &'a dyn Fn(&str) -> bool,
}

impl Reader<'_> {
    /// `a OR b …`; AND binds closer.
    fn any_of(&mut self) -> Result<bool, String> {
        let mut satisfied = self.all_of()?;
        while self.take("OR") {
            satisfied |= self.all_of()?;
        }
        Ok(satisfied)
    }

    fn all_of(&mut self) -> Result<bool, String> {
        let mut satisfied = self.term()?;
        while self.take("AND") {
            satisfied &= self.term()?;
        }
        Ok(satisfied)
    }

    fn term(&mut self) -> Result<bool, String> {
        if self.take("(") {
            let satisfied = self.any_of()?;
            return if self.take(")") { Ok(satisfied) } else { Err("`)` is missing".to_owned()) };
        }
        match self.tokens.split_first() {
            Some((licence, rest)) if !matches!(licence.as_str(), ")" | "AND" | "OR") => {
                self.tokens = rest;
                Ok((self.is_allowed)(licence))
            }
            _ => Err("a licence is missing".to_owned()),
        }
    }

    fn take(&mut self, token: &str) -> bool {
        let is_next = self.tokens.first().is_some_and(|t| t == token);
        if is_next {
            self.tokens = &self.tokens[1..];
        }
        is_next
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expressions_are_judged() {
        let allowed = |l: &str| ["MIT", "ISC", "Apache-2.0 WITH LLVM-exception"].contains(&l);
        let judge = |e: &str| is_satisfied(e, &allowed);
        for yes in
            ["MIT", "GPL-2.0 OR MIT", "MIT/GPL-2.0", "(GPL-2.0 OR MIT) AND ISC", "MIT OR GPL-2.0 AND X"]
        {
            assert_eq!(judge(yes), Ok(true), "{yes}");
        }
        assert_eq!(judge("Apache-2.0 WITH LLVM-exception OR X"), Ok(true));
        for no in
            ["GPL-2.0", "MIT AND GPL-2.0", "(MIT OR ISC) AND X", "Apache-2.0", "X OR Y AND MIT", "MIT WITH X"]
        {
            assert_eq!(judge(no), Ok(false), "{no}");
        }
        for broken in ["", "MIT OR", "AND MIT", "(MIT", "MIT)", "MIT ISC"] {
            assert!(judge(broken).is_err(), "{broken}");
        }
    }
}
