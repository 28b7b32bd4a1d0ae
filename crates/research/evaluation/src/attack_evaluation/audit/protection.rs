//! What `dcl` protects and what it does not, on places whose maps are known: an audit of a few images without a map cannot
//! show it.

/// Two sentences and the unit, with the ranges over the places of `docs/results/privacy`.
pub const PROTECTION: &str = "Under dcl, private things that no map shows stay hidden from someone who has only the \
                              query (-0.11 to +0.33 bits on seven places); static things that images from nearby \
                              viewpoints show too do not (-0.57 to +2.99 bits). A server that has found the pose also \
                              sees where something hides its map (+0.19 to +1.45 bits). Bits are the gain over the best \
                              answer without content: one bit halves the error.";

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;

    /// Rows of a table of the results.
    fn rows(name: &str) -> Vec<Vec<String>> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/results/privacy");
        let text = fs::read_to_string(folder.join(name)).expect("a table");
        text.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
    }

    fn range(values: impl Iterator<Item = f64>) -> String {
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        format!("({low:+.2} to {high:+.2} bits")
    }

    #[test]
    fn ranges_are_those_of_the_results() {
        let places = rows("places.csv");
        // Seven cells as `69 / 60 (-0.06)`, and their mean.
        let bits = |knows: &str| {
            let row =
                places.iter().find(|row| row[0] == "dcl:paper" && row[1] == knows).expect("an adversary");
            let of_cell = |cell: &String| -> f64 {
                let bits = cell.rsplit_once('(').expect("bits").1.trim_end_matches(')');
                bits.parse().expect("a number")
            };
            range(row[2..row.len() - 1].iter().map(of_cell))
        };
        assert_eq!(places[0].len() - 3, 7, "places");
        let occlusion = rows("occlusion.csv");
        let of_occlusion =
            occlusion.iter().filter(|row| row[1] == "dcl:paper").map(|row| row[7].parse().expect("bits"));
        for (range, after) in [
            (bits("the query and a statistic of other places"), "only the query"),
            (bits("images from nearby viewpoints"), "nearby viewpoints"),
            (range(of_occlusion), "hides its map"),
        ] {
            let claim = PROTECTION.split(after).nth(1).expect(after);
            let first = claim.find('(').map(|at| &claim[at..]).expect("a range");
            assert!(first.starts_with(&range), "{after}: {range}, not {first}");
        }
    }
}
