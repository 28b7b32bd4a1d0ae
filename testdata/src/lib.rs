//! Internal: `#[real_data_test]`, a test that needs the real images.
//!
//! Without `VEILOC_DATA` such a test is shown as ignored; with it, it runs, and a file that is missing from the
//! folder is a failure. The variable is read when the tests are built (`build.rs`), because the test harness fixes
//! ignored tests at build time; changing the variable rebuilds the tests.
//!
//! This is a separate crate, so that published crates need no build script for their tests.

use proc_macro::{Delimiter, Group, TokenStream, TokenTree};

/// The folder that `VEILOC_DATA` named at build time, absolute.
const FOLDER: Option<&str> = option_env!("VEILOC_DATA_FOLDER");

/// Attribute of `fn name(data: &Path) { … }`: makes it a test that gets the folder of the real images.
///
/// Without the folder the test is ignored, and fails if it is run anyway (`--include-ignored`).
#[proc_macro_attribute]
pub fn real_data_test(arguments: TokenStream, function: TokenStream) -> TokenStream {
    let Some(name) = name_of(&function).filter(|_| arguments.is_empty()) else {
        return tokens("compile_error!(\"#[real_data_test] must precede `fn name(data: &Path) { … }`\");");
    };
    let (ignore, call) = match FOLDER {
        Some(folder) => ("", format!("{name}(::std::path::Path::new({folder:?}))")),
        None => (
            "#[ignore = \"needs the real images: set VEILOC_DATA\"]",
            "panic!(\"VEILOC_DATA was not set when this test was built\")".to_owned(),
        ),
    };
    // The function is nested in the generated test token by token, so that a failure has its original line.
    let unused = tokens("#[allow(dead_code, reason = \"ignored without VEILOC_DATA\")]");
    let body: TokenStream = [unused, function, tokens(&call)].into_iter().collect();
    let mut test = tokens(&format!("#[test] {ignore} fn {name}()"));
    test.extend([TokenTree::Group(Group::new(Delimiter::Brace, body))]);
    test
}

/// The name of a function with arguments: `fn`, the name, non-empty parentheses.
fn name_of(function: &TokenStream) -> Option<String> {
    let tokens: Vec<TokenTree> = function.clone().into_iter().collect();
    tokens.windows(3).find_map(|three| match three {
        [TokenTree::Ident(keyword), TokenTree::Ident(name), TokenTree::Group(taken)]
            if keyword.to_string() == "fn"
                && taken.delimiter() == Delimiter::Parenthesis
                && !taken.stream().is_empty() =>
        {
            Some(name.to_string())
        }
        _ => None,
    })
}

fn tokens(source: &str) -> TokenStream {
    source.parse().expect("Rust")
}
