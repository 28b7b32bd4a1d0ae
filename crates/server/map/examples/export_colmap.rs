//! Writes a map as a COLMAP text model, for other programs to read: `export_colmap place.vmap DIR`.

use std::path::Path;
use std::process::ExitCode;

use veiloc_map::{MapError, MapFile, colmap};

#[expect(clippy::print_stderr, reason = "an example talks to the person who runs it")]
fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, dir] = arguments.as_slice() else {
        eprintln!("usage: export_colmap MAP DIR");
        return ExitCode::from(2);
    };
    match export(Path::new(map), Path::new(dir)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn export(map: &Path, dir: &Path) -> Result<(), MapError> {
    colmap::write_text(&colmap::export(&MapFile::open(map)?.to_model())?, dir)
}
