//! Layouts, queries, conditions and the attackers' training data.

use std::path::PathBuf;

use crate::EvalError;
use crate::stress::{StressCondition, StressEvaluation};
use veiloc_map::PosedImages;
use veiloc_protocol::{DclLayout, Scheme};

/// Inputs and options.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct LayoutsEvaluation {
    /// The scene, its queries, their conditions, and localization; its schemes are ignored.
    pub stress: StressEvaluation,
    /// Layouts, in the order of the table.
    pub layouts: Vec<DclLayout>,
    /// Keypoint files that train the predictor of neighbours; empty for the images of the map.
    pub train: Vec<PathBuf>,
    /// A trained network that predicts neighbours too.
    pub network: Option<PathBuf>,
    /// Networks that predict positions from all rows, at most one per layout.
    pub positions: Vec<PathBuf>,
    /// Number of attacked queries, spread evenly; `None` for all. Poses are estimated for all queries.
    pub attacked: Option<usize>,
    /// Neighbours per keypoint.
    pub k: usize,
    /// Number of seeds of the pose estimates, starting at that of [`Self::stress`], at least one. Each seed builds
    /// its own map.
    pub seeds: u64,
}

impl LayoutsEvaluation {
    /// Default layouts: the paper's, a diagonal with two corners, stripes, and the result of the search in
    /// `research/notes/layouts.md`.
    pub const DEFAULT: [&str; 6] = [
        "dcl:paper",
        "dcl:axis=143.13:sectors=2:anchors=0.667/-0.5+0.667/0.5",
        "dcl:axis=90:sectors=16:shift=0.5:anchors=@90+@0",
        "dcl:axis=67:sectors=20:anchors=-0.12/-0.49+1.5/0",
        "dcl:axis=115:sectors=20:anchors=0.23/-0.33+-0.88/-0.47",
        "dcl:axis=138:sectors=24:anchors=-0.62/-0.61+0.92/-1.16",
    ];

    /// [`Self::DEFAULT`] on unmodified and half-hidden queries and in a sparse map; four queries are attacked.
    pub fn new(posed: PosedImages, images: PathBuf, map_list: Vec<String>, query_list: Vec<String>) -> Self {
        let mut stress = StressEvaluation::new(posed, images, map_list, query_list);
        stress.stresses = vec![StressCondition::HalfHidden, StressCondition::SparseMap];
        Self {
            stress,
            layouts: Self::DEFAULT.iter().filter_map(|text| layout(text).ok()).collect(),
            train: Vec::new(),
            network: None,
            positions: Vec::new(),
            attacked: Some(4),
            k: 20,
            seeds: 1,
        }
    }

    pub(super) fn check(&self) -> Result<(), EvalError> {
        let selected = !self.layouts.is_empty()
            && !self.stress.query_list.is_empty()
            && self.seeds > 0
            && self.k > 0
            && self.attacked != Some(0);
        if !selected {
            return Err(EvalError::Options("no layout, query, seed or neighbour to evaluate".to_owned()));
        }
        let twice = self.layouts.iter().enumerate().find(|(i, own)| self.layouts[..*i].contains(own));
        twice.map_or(Ok(()), |(_, own)| {
            Err(EvalError::Options(format!("{} is given twice", super::name(*own))))
        })
    }

    pub(super) fn seeds(&self) -> impl Iterator<Item = u64> {
        let first = self.stress.seed;
        first..first.saturating_add(self.seeds)
    }
}

/// A layout from the text of its scheme.
fn layout(text: &str) -> Result<DclLayout, EvalError> {
    match text.parse() {
        Ok(Scheme::Dcl(layout)) => Ok(layout),
        Ok(other) => Err(EvalError::Options(format!("{other} has no layout"))),
        Err(error) => Err(EvalError::Options(format!("{text}: {error}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_layouts_parse_and_differ() {
        let evaluation = || {
            let lists = (vec!["a".to_owned()], vec!["b".to_owned()]);
            LayoutsEvaluation::new(PosedImages::default(), "images".into(), lists.0, lists.1)
        };
        let all = evaluation();
        assert_eq!(all.layouts.len(), LayoutsEvaluation::DEFAULT.len());
        assert_eq!(all.layouts[0], DclLayout::VERTICAL);
        let named: Vec<String> = all.layouts.iter().map(|l| super::super::name(*l)).collect();
        assert_eq!(named, LayoutsEvaluation::DEFAULT, "written as they print");
        assert!(all.check().is_ok());
        let refused = |change: &dyn Fn(&mut LayoutsEvaluation)| {
            let mut changed = evaluation();
            change(&mut changed);
            changed.check().expect_err("refused").to_string()
        };
        assert!(refused(&|e| e.layouts.push(DclLayout::VERTICAL)).contains("dcl:paper is given twice"));
        assert!(refused(&|e| e.layouts.clear()).contains("no layout"));
        assert!(refused(&|e| e.seeds = 0).contains("no layout, query, seed"));
        assert!(refused(&|e| e.stress.query_list.clear()).contains("query"));
        assert!(layout("points").is_err() && layout("dcl:axis=1").is_err());
    }
}
