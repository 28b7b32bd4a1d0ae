//! `cargo xtask rooms`: how large each room is, whom it leans on, and the circles among its files.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;

use crate::arrows;
use crate::file_arrows::{self, FileArrows};
use crate::rust_text;
use crate::workspace::Workspace;

/// Lines of a room, tests left out, above which it is to be split.
const MOST_LINES: usize = 5000;
/// Lines of a file, tests included, above which it is to be split.
pub(crate) const MOST_LINES_OF_A_FILE: usize = 500;

/// Rooms above the bound, each with its reason.
const LARGE_ROOMS: &[(&str, &str)] = &[];

/// Long files, each with its reason.
const LONG_FILES: &[(&str, &str)] = &[];

/// Circles of files that stay, each with its reason: room, files relative to `src/`, reason.
/// A circle within these files is allowed; a row without any circle is a fault.
const CIRCLES: &[(&str, &[&str], &str)] = &[];

/// One room as read from its files.
pub(crate) struct Room {
    name: String,
    leans_on: BTreeSet<String>,
    files: Vec<(String, String)>,
    arrows: FileArrows,
    /// Those that need a reason.
    circles: Vec<Vec<String>>,
    /// How many modules lean on their own parts and these on them.
    modules_in_parts: usize,
}

/// Reads all rooms.
pub(crate) fn read(workspace: &Workspace) -> Result<Vec<Room>, String> {
    let mut direct = arrows::direct_dependencies(workspace);
    let mut rooms = Vec::new();
    for package in workspace.ours() {
        let Some(name) = package.room() else { continue };
        let folder = Path::new(package.text("manifest_path")).with_file_name("src");
        let mut files = Vec::new();
        sources(&folder, "", &mut files).map_err(|e| format!("{}: {e}", folder.display()))?;
        let leans_on = direct.remove(name).unwrap_or_default();
        rooms.push(Room::new(name, leans_on, files));
    }
    rooms.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(rooms)
}

/// Checks sizes and circles.
pub(crate) fn check(rooms: &[Room], faults: &mut Vec<String>) {
    judge(rooms, &Reasons { large_rooms: LARGE_ROOMS, long_files: LONG_FILES, circles: CIRCLES }, faults);
}

/// What breaks a rule for a reason.
#[derive(Default)]
struct Reasons<'a> {
    large_rooms: &'a [(&'a str, &'a str)],
    long_files: &'a [(&'a str, &'a str)],
    circles: &'a [(&'a str, &'a [&'a str], &'a str)],
}

fn judge(rooms: &[Room], reasons: &Reasons, faults: &mut Vec<String>) {
    let (long_files, allowed) = (reasons.long_files, reasons.circles);
    let mut large = BTreeSet::new();
    let mut long = BTreeSet::new();
    let mut met = vec![false; allowed.len()];
    for room in rooms {
        let lines = room.lines();
        let is_listed = reasons.large_rooms.iter().any(|(name, _)| *name == room.name);
        if lines > MOST_LINES {
            large.insert(room.name.as_str());
        }
        if lines > MOST_LINES && !is_listed {
            faults.push(format!("room {}: {lines} lines without tests, at most {MOST_LINES}", room.name));
        }
        for (file, text) in &room.files {
            let (file, lines) = (format!("crates/{}/src/{file}", room.name), text.lines().count());
            if lines > MOST_LINES_OF_A_FILE && !long_files.iter().any(|(name, _)| *name == file) {
                faults.push(format!("{file}: {lines} lines, at most {MOST_LINES_OF_A_FILE}"));
            }
            if lines > MOST_LINES_OF_A_FILE {
                long.insert(file);
            }
        }
        for circle in &room.circles {
            let row = allowed.iter().position(|(name, files, _)| {
                *name == room.name && circle.iter().all(|file| files.contains(&file.as_str()))
            });
            match row {
                Some(row) => met[row] = true,
                None => faults.push(format!("room {}: a circle of files: {}", room.name, circle.join(", "))),
            }
        }
    }
    for (room, _) in reasons.large_rooms.iter().filter(|(room, _)| !large.contains(room)) {
        faults.push(format!("room {room} is listed as a large room (xtask/src/rooms.rs) and is none"));
    }
    for (file, _) in long_files.iter().filter(|(file, _)| !long.contains(*file)) {
        faults.push(format!("{file} is listed as a long file (xtask/src/rooms.rs) and is none"));
    }
    for ((room, files, _), _) in allowed.iter().zip(met).filter(|(_, met)| !met) {
        let files = files.join(", ");
        faults.push(format!("room {room}: {files} are listed as a circle (xtask/src/rooms.rs) and are none"));
    }
}

/// The table for people, in Markdown.
pub(crate) fn table(rooms: &[Room]) -> String {
    let mut out = String::from(
        "| room | files | lines without tests | of these code | longest file | leans on |\n|---|---|---|---|---|---|\n",
    );
    let mut sums = [0; 3];
    for room in rooms {
        let (lines, code) = (room.lines(), room.code_lines());
        let longest = room.files.iter().map(|(_, text)| text.lines().count()).max().unwrap_or(0);
        let leans_on: Vec<&str> = room.leans_on.iter().map(String::as_str).collect();
        let files = room.files.len();
        sums = [sums[0] + files, sums[1] + lines, sums[2] + code];
        let _ = writeln!(
            out,
            "| {} | {files} | {lines} | {code} | {longest} | {} |",
            room.name,
            leans_on.join(", ")
        );
    }
    let _ = writeln!(out, "| all | {} | {} | {} | | |\n", sums[0], sums[1], sums[2]);
    let count = rooms.iter().map(|room| room.circles.len()).sum::<usize>();
    let modules = rooms.iter().map(|room| room.modules_in_parts).sum::<usize>();
    let _ = writeln!(
        out,
        "Circles of files: {count}. Beside them {modules} modules whose parts use what the module itself defines."
    );
    for room in rooms {
        for circle in &room.circles {
            let reason = CIRCLES.iter().find(|(name, files, _)| {
                *name == room.name && circle.iter().all(|file| files.contains(&file.as_str()))
            });
            let reason = reason.map_or("no reason is given", |(_, _, reason)| reason);
            let _ = writeln!(out, "- {}: {reason}", room.name);
            for file in circle {
                let to: Vec<&str> =
                    room.arrows[file].iter().filter(|to| circle.contains(to)).map(String::as_str).collect();
                let _ = writeln!(out, "  - {file} -> {}", to.join(", "));
            }
        }
    }
    out
}

impl Room {
    fn new(name: &str, leans_on: BTreeSet<String>, files: Vec<(String, String)>) -> Self {
        let arrows = file_arrows::of_crate(&files);
        // What a module's parts take from the module itself makes no circle: they are one module in several files.
        let mut across = arrows.clone();
        for (file, to) in &mut across {
            to.retain(|other| !is_part_of(file, other));
        }
        let circles = circles(&across);
        let within = |all: &Vec<String>| !circles.iter().any(|c| c.iter().all(|file| all.contains(file)));
        let modules_in_parts = self::circles(&arrows).iter().filter(|all| within(all)).count();
        Self { name: name.to_owned(), leans_on, files, arrows, circles, modules_in_parts }
    }

    fn without_tests(&self) -> impl Iterator<Item = &str> {
        let files = self.files.iter().filter(|(file, _)| !rust_text::is_tests(file));
        files.map(|(_, text)| rust_text::without_tests(text))
    }

    fn lines(&self) -> usize {
        self.without_tests().map(|text| text.lines().count()).sum()
    }

    /// Lines that hold more than a comment.
    fn code_lines(&self) -> usize {
        let of_file = |text| rust_text::code(text).lines().filter(|line| !line.trim().is_empty()).count();
        self.without_tests().map(of_file).sum()
    }
}

/// All Rust files below a folder, with names relative to it.
fn sources(folder: &Path, prefix: &str, files: &mut Vec<(String, String)>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        if entry.file_type()?.is_dir() {
            sources(&entry.path(), &format!("{name}/"), files)?;
        } else if entry.path().extension().is_some_and(|e| e == "rs") {
            files.push((name, std::fs::read_to_string(entry.path())?));
        }
    }
    files.sort();
    Ok(())
}

/// Whether a file is below a module's folder: `a/b.rs` is part of `a.rs`, or of `a/mod.rs`. The root's parts are the crate.
fn is_part_of(file: &str, module: &str) -> bool {
    let folder = module.strip_suffix("mod.rs").map(str::to_owned);
    let folder = folder.or_else(|| module.strip_suffix(".rs").map(|stem| format!("{stem}/")));
    folder.is_some_and(|folder| !folder.is_empty() && file != module && file.starts_with(&folder))
}

/// Sets of files in which each reaches each other (strongly connected components of more than one file).
fn circles(arrows: &FileArrows) -> Vec<Vec<String>> {
    let reached: BTreeMap<&str, BTreeSet<&str>> =
        arrows.keys().map(|file| (file.as_str(), reach(file, arrows))).collect();
    let mut circles = BTreeSet::new();
    for (file, from_it) in &reached {
        let circle: Vec<String> = (from_it.iter())
            .filter(|other| reached.get(**other).is_some_and(|back| back.contains(file)))
            .map(|other| (*other).to_owned())
            .collect();
        if circle.len() > 1 {
            circles.insert(circle);
        }
    }
    circles.into_iter().collect()
}

fn reach<'a>(from: &'a str, arrows: &'a FileArrows) -> BTreeSet<&'a str> {
    let mut seen = BTreeSet::new();
    let mut open = vec![from];
    while let Some(file) = open.pop() {
        open.extend(
            arrows.get(file).into_iter().flatten().map(String::as_str).filter(|next| seen.insert(*next)),
        );
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room(files: &[(&str, &str)]) -> Room {
        let files: Vec<(String, String)> =
            files.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect();
        Room::new("a", BTreeSet::new(), files)
    }

    fn faults(room: Room, long_files: &[(&str, &str)], circles: &[(&str, &[&str], &str)]) -> Vec<String> {
        let mut faults = Vec::new();
        judge(&[room], &Reasons { large_rooms: &[], long_files, circles }, &mut faults);
        faults
    }

    #[test]
    fn a_circle_needs_a_reason_and_a_reason_a_circle() {
        let round = || {
            room(&[
                ("lib.rs", "mod b; mod c; mod d; use d::D;"),
                ("b.rs", "use crate::c::C;"),
                ("c.rs", "use crate::d::D;"),
                ("d.rs", "use crate::b::B;"),
            ])
        };
        assert_eq!(faults(round(), &[], &[]), ["room a: a circle of files: b.rs, c.rs, d.rs"]);
        let listed: &[(&str, &[&str], &str)] = &[("a", &["b.rs", "c.rs", "d.rs"], "they are one idea")];
        assert_eq!(faults(round(), &[], listed), [""; 0]);
        let other: &[(&str, &[&str], &str)] = &[("a", &["b.rs", "c.rs"], "not the whole circle")];
        assert_eq!(faults(round(), &[], other).len(), 2, "a circle without reason, a reason without circle");
        let straight = room(&[("lib.rs", "mod b; use b::B;"), ("b.rs", "")]);
        assert_eq!(faults(straight, &[], listed).len(), 1, "no circle any more");
    }

    #[test]
    fn a_module_and_its_parts_are_one() {
        let module = ("b/mod.rs", "mod c; mod d; use c::C; use d::D; pub struct B;");
        let parts = [("lib.rs", "mod b;"), module, ("b/c.rs", "use super::B;"), ("b/d.rs", "use super::B;")];
        let one = room(&parts);
        assert_eq!((one.circles.len(), one.modules_in_parts), (0, 1));
        let among_parts = [parts[0], module, ("b/c.rs", "use super::d::D;"), ("b/d.rs", "use super::c::C;")];
        let two = room(&among_parts);
        assert_eq!(two.circles, [["b/c.rs", "b/d.rs"]]);
        assert_eq!(two.modules_in_parts, 0);
    }

    #[test]
    fn long_files_and_rooms_are_named() {
        let long = || room(&[("lib.rs", &"fn f() {}\n".repeat(501))]);
        assert_eq!(faults(long(), &[], &[]), ["crates/a/src/lib.rs: 501 lines, at most 500"]);
        assert_eq!(faults(long(), &[("crates/a/src/lib.rs", "a table")], &[]), [""; 0]);
        let short = room(&[("lib.rs", &"fn f() {}\n".repeat(500))]);
        assert_eq!(faults(short, &[("crates/a/src/lib.rs", "a table")], &[]).len(), 1);
        let tests = format!("{}#[cfg(test)]\nmod tests {{\n{}}}\n", "//\n".repeat(9), "// t\n".repeat(200));
        assert_eq!(room(&[("lib.rs", &tests)]).lines(), 9);
        assert_eq!(room(&[("lib.rs", &tests)]).code_lines(), 0);
        let text = "fn f() {}\n".repeat(500);
        let names: Vec<String> = (0..11).map(|i| format!("f{i}.rs")).collect();
        let files: Vec<(&str, &str)> = names.iter().map(|name| (name.as_str(), text.as_str())).collect();
        assert_eq!(faults(room(&files), &[], &[]), ["room a: 5500 lines without tests, at most 5000"]);
        let listed = Reasons { large_rooms: &[("a", "for now")], ..Reasons::default() };
        let mut faults = Vec::new();
        judge(&[room(&files)], &listed, &mut faults);
        assert_eq!(faults, [""; 0]);
        judge(&[room(&files[1..2])], &listed, &mut faults);
        assert_eq!(faults.len(), 1, "no large room any more: {faults:?}");
    }
}
