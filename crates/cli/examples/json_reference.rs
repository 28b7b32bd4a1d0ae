//! Writes `docs/reference/json.md`; with `--check` only compares it. `cargo xtask json-reference` runs it.

use std::path::Path;
use std::process::ExitCode;

#[expect(clippy::print_stderr, reason = "a command line program")]
fn main() -> ExitCode {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/reference/json.md");
    let is_check = std::env::args().nth(1).as_deref() == Some("--check");
    let result = veiloc_cli::json_reference().and_then(|page| match is_check {
        true if std::fs::read_to_string(&path).is_ok_and(|text| text == page) => Ok(()),
        true => Err("docs/reference/json.md is stale: run `cargo xtask json-reference`".to_owned()),
        false => std::fs::write(&path, page).map_err(|error| format!("{}: {error}", path.display())),
    });
    if let Err(problem) = result {
        eprintln!("{problem}");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}
