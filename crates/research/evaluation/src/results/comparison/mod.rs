//! Comparison of two runs on the same queries, figure by figure, with confidence intervals.
//!
//! Queries are paired by name and seed, so a query that is difficult for both runs does not affect the difference.
//! The interval of a difference comes from a bootstrap (B. Efron, Bootstrap methods: another look at the jackknife,
//! 1979): queries are drawn with replacement, a query with all its seeds and in both runs at once, and the interval
//! holds the middle 95 % of the differences. Neighbouring frames of one trajectory are more alike than independent
//! queries, which the bootstrap ignores: its interval is rather too narrow.

mod run;

use std::collections::BTreeMap;
use std::fmt::Write as _;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::EvalError;
use crate::results::metrics::{PoseErrors, Threshold, finite, median, recall};
use crate::results::text_table::{TextTable, length};
use run::{Query, Row};

pub use run::Run;

/// Share of the samples in the interval.
const LEVEL: f64 = 0.95;

/// Options of a comparison.
#[derive(Debug, Clone, Default)]
pub struct ComparisonOptions {
    /// Row or scheme of the first run, and of the second. Default: all rows that both have; for the second, the row
    /// of the first.
    pub rows: [Option<String>; 2],
    /// Thresholds of recall; if empty, those that both documents have.
    pub thresholds: Vec<Threshold>,
    /// Samples of the bootstrap; 0 stands for 10 000.
    pub draws: usize,
    /// Seed of the bootstrap.
    pub seed: u64,
}

/// Comparison of two runs: the part of the document of `eval compare` without the files.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Comparison {
    /// Number of bootstrap samples.
    pub draws: usize,
    /// Seed of the bootstrap.
    pub seed: u64,
    /// Share of the samples within an interval.
    pub level: f64,
    /// One entry for each pair of rows.
    pub rows: Vec<RowComparison>,
}

/// A row of the first run compared with one of the second.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RowComparison {
    /// Row of the first run: scheme and configuration.
    pub a: String,
    /// Row of the second run.
    pub b: String,
    /// Number of queries in both, counted once per seed.
    pub queries: usize,
    /// Number of queries of the first that the second does not have; they are not counted in any figure.
    pub only_a: usize,
    /// Number of queries of the second that the first does not have.
    pub only_b: usize,
    /// Number of queries whose translation error is smaller in the second.
    pub better_in_b: usize,
    /// Number of queries whose translation error is larger in the second.
    pub worse_in_b: usize,
    /// One entry per figure.
    pub figures: Vec<ComparedFigure>,
}

/// One figure of both runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ComparedFigure {
    /// Name: `recall T/DEG`, `median translation`, `median rotation` or `median time` (all stages together).
    pub figure: String,
    /// Unit: `share`, `map units`, `deg` or `ms`.
    pub unit: &'static str,
    /// Value of the first run; null when more than half of its queries were not localized.
    pub a: Option<f64>,
    /// Value of the second run; null likewise.
    pub b: Option<f64>,
    /// Second minus first; null when it is infinite.
    pub difference: Option<f64>,
    /// Lower end of its interval; null when it is minus infinity.
    pub low: Option<f64>,
    /// Upper end; null when it is infinity.
    pub high: Option<f64>,
    /// Whether the interval excludes zero, and which run is better.
    pub result: ComparisonResult,
}

/// Result of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ComparisonResult {
    /// The second is better, with an interval that excludes zero.
    BBetter,
    /// The first is better, with an interval that excludes zero.
    ABetter,
    /// The interval includes zero.
    NotShown,
}

impl ComparisonResult {
    /// Text for tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::BBetter => "B is better",
            Self::ABetter => "A is better",
            Self::NotShown => "not shown",
        }
    }
}

/// A figure over many queries.
#[derive(Clone, Copy)]
enum Measure {
    Recall(Threshold),
    Translation,
    Rotation,
    Time,
}

impl Measure {
    fn name(self) -> (String, &'static str) {
        match self {
            Self::Recall(threshold) => (format!("recall {threshold}"), "share"),
            Self::Translation => ("median translation".to_owned(), "map units"),
            Self::Rotation => ("median rotation".to_owned(), "deg"),
            Self::Time => ("median time".to_owned(), "ms"),
        }
    }

    /// Whether larger values are better.
    const fn more_is_better(self) -> bool {
        matches!(self, Self::Recall(_))
    }

    fn of(self, queries: &[Query]) -> f64 {
        let median_of = |of: fn(&Query) -> f64| median(&queries.iter().map(of).collect::<Vec<_>>());
        match self {
            Self::Recall(threshold) => {
                let errors: Vec<PoseErrors> = queries.iter().map(|q| q.error).collect();
                recall(&errors, &threshold)
            }
            Self::Translation => median_of(|q| q.error.translation),
            Self::Rotation => median_of(|q| q.error.rotation_deg),
            Self::Time => median_of(|q| q.ms),
        }
    }
}

/// Zero if neither has a pose.
fn difference(a: f64, b: f64) -> f64 {
    if a == b { 0.0 } else { b - a }
}

/// Compares two runs.
///
/// # Errors
/// [`EvalError::NoRows`] and [`EvalError::NoQueries`].
pub fn compare(a: &Run, b: &Run, options: &ComparisonOptions) -> Result<Comparison, EvalError> {
    let draws = if options.draws == 0 { 10_000 } else { options.draws };
    let thresholds: Vec<Threshold> = if options.thresholds.is_empty() {
        a.thresholds.iter().filter(|t| b.thresholds.contains(t)).copied().collect()
    } else {
        options.thresholds.clone()
    };
    let rows = pairs(a, b, &options.rows)?
        .into_iter()
        .map(|(name_a, name_b)| {
            let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
            row((name_a, &a.rows[name_a]), (name_b, &b.rows[name_b]), &thresholds, draws, &mut rng)
        })
        .collect::<Result<_, _>>()?;
    Ok(Comparison { draws, seed: options.seed, level: LEVEL, rows })
}

/// Pairs of rows to compare.
fn pairs<'a>(
    a: &'a Run,
    b: &'a Run,
    requested: &[Option<String>; 2],
) -> Result<Vec<(&'a str, &'a str)>, EvalError> {
    let none = || {
        let list = |run: &Run| run.rows().collect::<Vec<_>>().join("; ");
        EvalError::NoRows { first: list(a), second: list(b) }
    };
    // By the whole name, or by the scheme at its beginning.
    fn named<'r>(run: &'r Run, name: &str) -> Vec<&'r str> {
        let exact: Vec<&str> = run.rows().filter(|row| *row == name).collect();
        if exact.is_empty() {
            run.rows().filter(|row| row.split(", ").next() == Some(name)).collect()
        } else {
            exact
        }
    }
    let [first, second] = requested;
    let of_a: Vec<&str> = first.as_ref().map_or_else(|| a.rows().collect(), |name| named(a, name));
    let found: Vec<(&str, &str)> = match second {
        Some(second) => {
            let of_b = named(b, second);
            match (&of_a[..], &of_b[..]) {
                ([one], [other]) => vec![(*one, *other)],
                _ => return Err(none()),
            }
        }
        None => of_a.iter().filter_map(|row| Some((*row, b.rows().find(|other| other == row)?))).collect(),
    };
    // If each run has one row, these are compared whatever their names.
    let only = || match (&of_a[..], &b.rows().collect::<Vec<_>>()[..]) {
        ([one], [other]) => Some(vec![(*one, *other)]),
        _ => None,
    };
    let found = if found.is_empty() { only().unwrap_or_default() } else { found };
    if found.is_empty() { Err(none()) } else { Ok(found) }
}

fn row(
    (name_a, a): (&str, &Row),
    (name_b, b): (&str, &Row),
    thresholds: &[Threshold],
    draws: usize,
    rng: &mut ChaCha8Rng,
) -> Result<RowComparison, EvalError> {
    // All seeds of a query are grouped.
    let mut paired: BTreeMap<&str, Vec<[Query; 2]>> = BTreeMap::new();
    for (key, query) in a {
        if let Some(other) = b.get(key) {
            paired.entry(&key.0).or_default().push([*query, *other]);
        }
    }
    let paired: Vec<Vec<[Query; 2]>> = paired.into_values().collect();
    let all: Vec<[Query; 2]> = paired.concat();
    if all.is_empty() {
        return Err(EvalError::NoQueries { row: name_a.to_owned() });
    }
    let measures: Vec<Measure> = thresholds
        .iter()
        .map(|t| Measure::Recall(*t))
        .chain([Measure::Translation, Measure::Rotation, Measure::Time])
        .collect();
    let side = |pairs: &[[Query; 2]], at: usize| pairs.iter().map(|pair| pair[at]).collect::<Vec<_>>();
    let differences = |pairs: &[[Query; 2]]| -> Vec<f64> {
        let (a, b) = (side(pairs, 0), side(pairs, 1));
        measures.iter().map(|measure| difference(measure.of(&a), measure.of(&b))).collect()
    };
    let mut drawn: Vec<Vec<f64>> = vec![Vec::with_capacity(draws); measures.len()];
    for _ in 0..draws {
        let sample: Vec<[Query; 2]> = (0..paired.len())
            .flat_map(|_| paired[rng.random_range(0..paired.len())].iter().copied())
            .collect();
        for (of, value) in drawn.iter_mut().zip(differences(&sample)) {
            of.push(value);
        }
    }
    let (of_a, of_b) = (side(&all, 0), side(&all, 1));
    let figures =
        measures.iter().zip(differences(&all)).zip(&mut drawn).map(|((measure, difference), drawn)| {
            drawn.sort_by(f64::total_cmp);
            let at = |share: f64| drawn[((share * drawn.len() as f64) as usize).min(drawn.len() - 1)];
            let (low, high) = (at((1.0 - LEVEL) / 2.0), at(f64::midpoint(1.0, LEVEL)));
            let result = match (low > 0.0, high < 0.0, measure.more_is_better()) {
                (true, _, true) | (_, true, false) => ComparisonResult::BBetter,
                (true, _, false) | (_, true, true) => ComparisonResult::ABetter,
                _ => ComparisonResult::NotShown,
            };
            let (figure, unit) = measure.name();
            let (a, b) = (finite(measure.of(&of_a)), finite(measure.of(&of_b)));
            ComparedFigure {
                figure,
                unit,
                a,
                b,
                difference: finite(difference),
                low: finite(low),
                high: finite(high),
                result,
            }
        });
    let nearer = |pair: &[Query; 2]| pair[1].error.translation < pair[0].error.translation;
    let farther = |pair: &[Query; 2]| pair[1].error.translation > pair[0].error.translation;
    Ok(RowComparison {
        a: name_a.to_owned(),
        b: name_b.to_owned(),
        queries: all.len(),
        only_a: a.len() - all.len(),
        only_b: b.len() - all.len(),
        better_in_b: all.iter().filter(|pair| nearer(pair)).count(),
        worse_in_b: all.iter().filter(|pair| farther(pair)).count(),
        figures: figures.collect(),
    })
}

impl Comparison {
    /// The comparison as a text table.
    pub fn table(&self) -> String {
        let mut text = String::new();
        for row in &self.rows {
            let name = if row.a == row.b { row.a.clone() } else { format!("A: {}; B: {}", row.a, row.b) };
            let _ = writeln!(
                text,
                "{name}: {} queries in both, B nearer in {}, farther in {}",
                row.queries, row.better_in_b, row.worse_in_b
            );
            if row.only_a + row.only_b > 0 {
                let _ = writeln!(text, "left out: {} of A alone, {} of B alone", row.only_a, row.only_b);
            }
            let interval = format!("{:.0} % of draws", 100.0 * self.level);
            let mut table = TextTable::new(["figure", "A", "B", "B - A", &interval, ""], 1);
            for figure in &row.figures {
                table.push(figure.cells());
            }
            text += &table.render();
            text.push('\n');
        }
        text
    }
}

impl ComparedFigure {
    fn cells(&self) -> Vec<String> {
        let number = |value: f64| match self.unit {
            "share" => format!("{:.1}", 100.0 * value),
            "ms" => format!("{value:.1}"),
            "deg" => format!("{value:.3}"),
            _ => length(value),
        };
        let plain = |value: Option<f64>| value.map_or_else(|| "—".to_owned(), number);
        let signed = |value: Option<f64>, beyond: &str| {
            value.map_or_else(
                || beyond.to_owned(),
                |v| format!("{}{}", if v < 0.0 { "-" } else { "+" }, number(v.abs())),
            )
        };
        let unit = if self.unit == "share" { "%" } else { self.unit };
        vec![
            format!("{}, {unit}", self.figure),
            plain(self.a),
            plain(self.b),
            signed(self.difference, "—"),
            format!("{} to {}", signed(self.low, "-∞"), signed(self.high, "+∞")),
            self.result.name().to_owned(),
        ]
    }
}

#[cfg(test)]
mod tests;
