//! How outcomes of attacks are called, and which row of a document counts.

use crate::audit::{Attack, AttackDocument, AttackSummary};

/// Share of keypoints within 10 px from which on the positions count as given away.
pub(super) const GIVEN_AWAY: f64 = 0.5;
/// Bits a keypoint from which on the positions count as narrowed down: the error of the guess halved.
const NARROWED: f64 = 1.0;
/// Bits a keypoint from which on an attack counts as having learned anything.
pub(super) const LEARNED: f64 = 0.1;
/// Bending below which the arrangement counts as kept: an offset is then nearer to the truth than to nothing.
pub(super) const ARRANGED: f64 = 0.5;

/// How an attack's outcome is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Verdict {
    Nothing,
    Little,
    Narrowed,
    GivenAway,
}

impl Verdict {
    pub(super) fn of(row: &AttackSummary) -> Self {
        match row {
            r if r.under_10px >= GIVEN_AWAY => Self::GivenAway,
            r if r.bits_over_prior >= NARROWED => Self::Narrowed,
            r if r.bits_over_prior >= LEARNED => Self::Little,
            _ => Self::Nothing,
        }
    }

    pub(super) const fn words(self) -> &'static str {
        match self {
            Self::GivenAway => "most keypoint positions are given away",
            Self::Narrowed => "positions are narrowed down, most of them not to within 10 px",
            Self::Little => "an attacker learns a little beyond the guess",
            Self::Nothing => "no attack that was run learns more than the guess",
        }
    }
}

/// One scheme's rows at the smallest share of replaced neighbours.
pub(super) struct Found<'a> {
    pub(super) scheme: &'a str,
    pub(super) guess: &'a AttackSummary,
    /// Without the guess.
    pub(super) attacks: Vec<&'a AttackSummary>,
}

impl<'a> Found<'a> {
    /// The attack that tells most, `None` when only the guess was run.
    pub(super) fn strongest(&self) -> Option<&'a AttackSummary> {
        self.strongest_of(|_| true)
    }

    /// The same among some of them.
    pub(super) fn strongest_of(&self, chosen: impl Fn(&AttackSummary) -> bool) -> Option<&'a AttackSummary> {
        let tells = |row: &AttackSummary| {
            if row.bits_over_prior.is_nan() { f64::NEG_INFINITY } else { row.bits_over_prior }
        };
        self.attacks.iter().copied().filter(|row| chosen(row)).max_by(|a, b| tells(a).total_cmp(&tells(b)))
    }

    pub(super) fn paper(&self) -> Option<&'a AttackSummary> {
        self.attacks.iter().copied().find(|row| row.attack == Attack::CLOSED_FORM)
    }
}

/// Smallest share of replaced neighbours in the document, percent.
pub fn base_share(document: &AttackDocument) -> f64 {
    let uses = |row: &&AttackSummary| row.attack.needs.neighbours && row.corrupt.is_finite();
    let shares = document.attacks.iter().filter(uses).map(|row| row.corrupt);
    shares.fold(f64::INFINITY, f64::min)
}

/// Whether a row speaks of the least replaced neighbours, or of none.
pub(super) fn is_base(document: &AttackDocument, row: &AttackSummary) -> bool {
    let asks = row.attack.needs.neighbours;
    !asks || row.corrupt <= base_share(document)
}

pub(super) fn by_scheme(document: &AttackDocument) -> Vec<Found<'_>> {
    let mut found: Vec<Found<'_>> = Vec::new();
    for row in document.attacks.iter().filter(|row| is_base(document, row)) {
        if row.attack == Attack::PRIOR {
            found.push(Found { scheme: &row.scheme, guess: row, attacks: Vec::new() });
        } else if let Some(of) = found.iter_mut().find(|f| f.scheme == row.scheme) {
            of.attacks.push(row);
        }
    }
    found
}
