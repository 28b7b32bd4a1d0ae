//! Order of queries by error, worst first.

use std::collections::BTreeMap;

use super::data::Method;
use crate::scene::QueryOutcome;

/// Queries of a run, `(scene, name)`, worst first: first by the number of methods that did not localize them, then by
/// the largest position error, or by the largest ± if the truth is unknown.
pub fn worst_first(methods: &[Method], outcomes: &[QueryOutcome]) -> Vec<(usize, String)> {
    let mut queries: BTreeMap<(usize, &str), (usize, f64)> = BTreeMap::new();
    for outcome in outcomes {
        let Some(method) = methods.get(outcome.method) else { continue };
        let (lost, worst) = queries.entry((method.scene, &outcome.name)).or_insert((0, 0.0));
        if outcome.estimate.is_none() {
            *lost += 1;
        } else {
            let error = outcome.position_error.or(outcome.position_sd).unwrap_or(0.0);
            *worst = worst.max(if error.is_nan() { f64::INFINITY } else { error });
        }
    }
    let mut ranked: Vec<_> = queries.into_iter().collect();
    ranked.sort_by(|(_, a), (_, b)| b.0.cmp(&a.0).then(b.1.total_cmp(&a.1)));
    ranked.into_iter().map(|((scene, name), _)| (scene, name.to_owned())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::CameraFromWorld;

    #[test]
    fn lost_queries_precede_wrong_and_wrong_precede_right() {
        let outcome = |method: usize, name: &str, error: Option<f64>| QueryOutcome {
            method,
            name: name.to_owned(),
            estimate: error.map(|_| CameraFromWorld::identity()),
            position_error: error,
            ..QueryOutcome::default()
        };
        let methods = [Method::default(), Method::default()];
        let outcomes = [
            outcome(0, "good", Some(0.01)),
            outcome(0, "lost", None),
            outcome(0, "wrong", Some(3.0)),
            outcome(0, "broken", Some(f64::NAN)),
            outcome(1, "good", Some(0.02)),
            outcome(1, "lost", Some(0.01)),
            outcome(1, "wrong", Some(0.01)),
            outcome(7, "of no method", None),
        ];
        let names: Vec<String> = worst_first(&methods, &outcomes).into_iter().map(|(_, name)| name).collect();
        assert_eq!(names, ["lost", "broken", "wrong", "good"]);
    }
}
