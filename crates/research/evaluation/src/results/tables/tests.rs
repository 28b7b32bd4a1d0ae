//! Tables of a small hand-written document.

use super::*;
use crate::EvalError;
use crate::results::data_set::SceneQuery;
use crate::results::summary::tests::query;

fn result(name: &str, scheme: &str, error: Option<(f64, f64)>) -> QueryResult {
    QueryResult { name: name.to_owned(), scheme: scheme.to_owned(), ..query(0, error) }
}

fn document(official: bool) -> String {
    let mut queries = Vec::new();
    for (scene, errors) in [("chess", [0.01, 0.02, 0.03]), ("stairs", [0.01, 0.04, f64::INFINITY])] {
        for (scheme, worse) in [("points", 1.0), ("dcl:paper", 2.0), ("dcl:s=2", 4.0)] {
            for (k, error) in errors.iter().enumerate() {
                let found = error.is_finite().then_some((0.1 * worse, error * worse));
                let mut result = result(&format!("{k}.png"), scheme, found);
                if found.is_none() && scheme == "dcl:paper" {
                    result.sealed_bytes = Some(0);
                }
                queries.push(SceneQuery { scene: Some(scene.to_owned()), condition: None, result });
            }
        }
    }
    let scene = |name: &str| serde_json::json!({"name": name, "is_official": official && name == "chess", "queries": 3, "remarks": [], "map": null});
    serde_json::json!({
        "version": 1, "command": "eval 7scenes", "data": ["chess", "stairs"], "scenes": [scene("chess"), scene("stairs")],
        "queries": queries,
    })
    .to_string()
}

fn options(format: Format) -> TableOptions {
    TableOptions {
        format,
        cells: None,
        thresholds: Vec::new(),
        published: true,
        bootstrap_samples: 200,
        seed: 0,
    }
}

fn line<'a>(text: &'a str, begin: &str) -> &'a str {
    text.lines().find(|line| line.starts_with(begin)).unwrap_or_else(|| panic!("{begin}: {text}"))
}

#[test]
fn medians_and_recalls_are_in_their_cells() {
    let data = TableData::parse(&document(true)).expect("read");
    let text = tables(&data, &options(Format::Markdown));
    assert_eq!(line(&text, "| queries"), "| queries | 3 | 3 |");
    // 1, 2, 3 cm: median 2, all within 5 cm; on the stairs one query is lost.
    assert_eq!(line(&text, "| points |"), "| points | 2.00/0.100/100.0 | 4.00/0.100/66.7 |");
    assert_eq!(line(&text, "| dcl:paper |"), "| dcl:paper | 4.00/0.200/66.7 | 8.00/0.200/33.3 |");
    // Mean of the medians, and the number of queries that could not be sealed.
    assert!(text.contains("| dcl:paper | 6.00/0.200 | 1 | 6 |"), "{text}");
    assert!(text.contains("| dcl:s=2 | 12.00/0.400 | 0 | 6 |"), "{text}");
}

#[test]
fn published_figures_are_shown_for_the_same_data_only() {
    let data = TableData::parse(&document(true)).expect("read");
    let text = tables(&data, &options(Format::Markdown));
    assert_eq!(line(&text, "| DSAC*"), "| DSAC* | 0.5/0.17/100 |  |", "not of a cut of the stairs");
    assert!(text.contains("published figures are not shown: stairs"), "{text}");
    assert!(
        !tables(&data, &TableOptions { published: false, ..options(Format::Markdown) }).contains("DSAC*")
    );
    let data = TableData::parse(&document(false)).expect("read");
    assert!(!tables(&data, &options(Format::Markdown)).contains("DSAC*"));
}

#[test]
fn formats_have_equal_cells() {
    let data = TableData::parse(&document(true)).expect("read");
    let latex = tables(&data, &options(Format::Latex));
    assert!(latex.contains("points & 2.00/0.100/100.0 & 4.00/0.100/66.7 \\\\"), "{latex}");
    assert!(latex.contains("\\begin{tabular}{lcc}") && !latex.contains("5 cm, 5 %"));
    let csv = tables(&data, &options(Format::Csv));
    assert!(csv.contains("points,2.00/0.100/100.0,4.00/0.100/66.7\r\n"), "{csv}");
    assert!(csv.contains("\"Random Lines, the paper's\""), "{csv}");
}

#[test]
fn documents_of_other_commands_are_refused() {
    let refused = |json: &str| TableData::parse(json).expect_err("refused").to_string();
    assert!(refused("{").contains("not a document"));
    assert!(refused(&document(true).replace("eval 7scenes", "eval crb")).contains("eval crb"));
    assert!(refused(&document(true).replace("\"version\":1", "\"version\":2")).contains("version 2"));
    let mut value: serde_json::Value = serde_json::from_str(&document(true)).expect("JSON");
    for query in value["queries"].as_array_mut().expect("queries") {
        query["has_ground_truth"] = false.into();
    }
    assert!(matches!(TableData::parse(&value.to_string()), Err(EvalError::NoTruth)));
}
