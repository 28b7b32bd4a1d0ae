//! Published figures from the paper; they are shown only beside figures of the same images.

/// A method on one data set.
pub(super) struct PublishedRow {
    /// Data set, as in the command's name.
    pub(super) data_set: &'static str,
    /// Name of the method in the paper.
    pub(super) method: &'static str,
    /// One cell per scene of [`scenes`]; empty if the paper has no value.
    pub(super) cells: &'static [&'static str],
}

/// Table of the paper, and the meaning of its cells.
pub(super) fn source(data_set: &str) -> Option<&'static str> {
    match data_set {
        "7scenes" => Some(
            "the paper, Table 4: median position error (cm) / median rotation error (°) / recall at 5 cm, 5° (%)",
        ),
        "cambridge" => Some("the paper, Table 2: median position error (cm) / median rotation error (°)"),
        "aachen" => Some("the paper, Table 3: recall (%) at 0.25 m, 2° / 0.5 m, 5° / 5 m, 10°"),
        _ => None,
    }
}

/// Scenes (and conditions) of a data set in the order of the paper's columns.
pub(super) fn scenes(data_set: &str) -> &'static [&'static str] {
    match data_set {
        "7scenes" => &["chess", "fire", "heads", "office", "pumpkin", "redkitchen", "stairs"],
        "cambridge" => &["KingsCollege", "OldHospital", "ShopFacade", "StMarysChurch"],
        "aachen" => &["day", "night"],
        _ => &[],
    }
}

/// A line of the paper's table.
const fn row(data_set: &'static str, method: &'static str, cells: &'static [&'static str]) -> PublishedRow {
    PublishedRow { data_set, method, cells }
}

/// The paper's tables 2 to 4.
pub(super) const METHODS: &[PublishedRow] = &[
    row(
        "7scenes",
        "HLoc (SP+SG)",
        &[
            "0.3/0.10/100",
            "0.6/0.25/100",
            "0.4/0.27/100",
            "0.7/0.20/100",
            "0.6/0.13/100",
            "0.5/0.14/97",
            "2.1/0.66/73",
        ],
    ),
    row(
        "7scenes",
        "HLoc (SP+NN)",
        &[
            "0.3/0.11/100",
            "0.6/0.25/100",
            "0.5/0.27/97",
            "0.8/0.21/99",
            "0.7/0.15/98",
            "0.5/0.14/95",
            "2.6/0.74/66",
        ],
    ),
    row(
        "7scenes",
        "DSAC*",
        &[
            "0.5/0.17/100",
            "0.8/0.28/99",
            "0.5/0.34/100",
            "1.2/0.34/98",
            "1.2/0.28/99",
            "0.7/0.21/97",
            "2.7/0.78/92",
        ],
    ),
    row(
        "7scenes",
        "ACE",
        &["0.5/0.18/-", "0.8/0.33/-", "0.5/0.33/-", "1.0/0.29/-", "1.0/0.22/-", "0.8/0.2/-", "2.9/0.81/-"],
    ),
    row(
        "7scenes",
        "GoMatch",
        &["4/1.65/-", "13/3.86/-", "9/5.17/-", "11/2.48/-", "16/3.32/-", "13/2.84/-", "89/21.12/-"],
    ),
    row(
        "7scenes",
        "DGC-GNN",
        &["3/1.41/-", "5/1.81/-", "4/3.13/-", "7/1.66/-", "8/2.03/-", "8/2.14/-", "83/21.53/-"],
    ),
    row(
        "7scenes",
        "GSFF Privacy",
        &[
            "0.8/0.28/96",
            "0.8/0.33/94",
            "1.0/0.67/90",
            "1.5/0.51/90",
            "2.0/0.50/78",
            "1.2/0.33/85",
            "28.2/0.98/29",
        ],
    ),
    row(
        "7scenes",
        "Random Lines, the paper's",
        &[
            "0.5/0.15/100",
            "0.9/0.35/99",
            "0.7/0.40/96",
            "1.0/0.29/98",
            "1.0/0.22/96",
            "0.7/0.20/94",
            "3.7/1.06/58",
        ],
    ),
    row(
        "7scenes",
        "DCL, the paper's",
        &[
            "1.0/0.36/97",
            "2.0/0.76/81",
            "1.3/0.77/83",
            "2.0/0.61/83",
            "2.1/0.48/80",
            "1.4/0.42/84",
            "26.3/6.59/13",
        ],
    ),
    row("cambridge", "HLoc (SP+SG)", &["12/0.2", "15/0.3", "4/0.2", "7/0.2"]),
    row("cambridge", "HLoc (SP+NN)", &["12/0.2", "15/0.3", "4/0.2", "8/0.2"]),
    row("cambridge", "DSAC*", &["18/0.3", "21/0.4", "5/0.3", "15/0.6"]),
    row("cambridge", "ACE", &["28/0.4", "31/0.6", "5/0.3", "18/0.6"]),
    row("cambridge", "GLACE", &["19/0.3", "17/0.4", "4/0.2", "9/0.3"]),
    row("cambridge", "GoMatch", &["25/0.64", "283/8.14", "48/4.77", "335/9.94"]),
    row("cambridge", "DGC-GNN", &["18/0.47", "75/2.83", "15/1.57", "106/4.03"]),
    row("cambridge", "SegLoc", &["24/0.26", "36/0.52", "11/0.34", "17/0.46"]),
    row("cambridge", "GSFF Privacy", &["24/0.39", "26/0.49", "5/0.27", "13/0.48"]),
    row("cambridge", "Random Lines, the paper's", &["11/0.2", "16/0.3", "4/0.2", "7/0.2"]),
    row("cambridge", "DCL, the paper's", &["25/0.4", "38/0.7", "10/0.4", "16/0.5"]),
    row("aachen", "HLoc (SP+NN)", &["86.5/93.7/96.8", "70.4/86.7/94.9"]),
    row("aachen", "ACE x 50", &["6.9/17.2/50.0", "0.0/1.0/5.1"]),
    row("aachen", "GLACE", &["8.6/20.8/64.0", "1.0/1.0/17.3"]),
    row("aachen", "Random Lines, the paper's", &["79.9/87.1/94.2", "54.1/63.3/85.7"]),
    row("aachen", "DCL, the paper's", &["41.0/57.9/72.7", "13.3/21.4/38.8"]),
];

/// The paper's ablation of the distance between the anchors (Table 5, for Aachen the supplement): scheme, data set,
/// cell.
pub(super) const ANCHORS: &[(&str, &str, &str)] = &[
    ("dcl:paper", "7scenes", "5.14/1.41"),
    ("dcl:s=2", "7scenes", "5.14/1.42"),
    ("dcl:s=3", "7scenes", "6.66/1.37"),
    ("dcl:paper", "cambridge", "22.50/0.50"),
    ("dcl:s=2", "cambridge", "27.75/0.73"),
    ("dcl:s=3", "cambridge", "32.50/0.75"),
    ("dcl:paper", "aachen", "41.0/57.9/72.7 and 13.3/21.4/38.8"),
    ("dcl:s=2", "aachen", "34.1/53.2/71.5 and 14.3/20.4/37.8"),
    ("dcl:s=3", "aachen", "26.8/49.5/70.3 and 12.2/24.5/37.8"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_have_a_cell_for_every_scene() {
        for line in METHODS {
            assert_eq!(line.cells.len(), scenes(line.data_set).len(), "{} {}", line.data_set, line.method);
            assert!(source(line.data_set).is_some());
            let parts = line.cells[0].split('/').count();
            assert!(line.cells.iter().all(|cell| cell.split('/').count() == parts), "{}", line.method);
        }
        // The averages of Table 5 for the default equal those of the lines above.
        let mean = |data_set: &str, at: usize| {
            let line = METHODS.iter().find(|m| m.data_set == data_set && m.method == "DCL, the paper's");
            let cells = line.expect("there").cells;
            let number =
                |cell: &str| cell.split('/').nth(at).and_then(|x| x.parse::<f64>().ok()).expect("a number");
            cells.iter().map(|cell| number(cell)).sum::<f64>() / cells.len() as f64
        };
        assert!((mean("7scenes", 0) - 5.14).abs() < 0.05, "{}", mean("7scenes", 0));
        assert!((mean("cambridge", 0) - 22.50).abs() < 0.3 && (mean("cambridge", 1) - 0.50).abs() < 0.01);
    }
}
