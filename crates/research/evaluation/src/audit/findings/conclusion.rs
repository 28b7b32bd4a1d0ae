//! The conclusion in sentences. Every one of them is decided by the figures: other data, other sentences.

use super::data::AuditPart;
use super::verdict::{ARRANGED, Found, GIVEN_AWAY, Verdict, base_share, by_scheme};
use super::words::{Sentence, count, listed, needs, percent, px, scheme_words};
use crate::audit::{ATTACKS, Attack, AttackDocument, AttackSummary, Neighbours};

/// What was found, scheme by scheme, and how far it goes.
pub fn conclusion(part: &AuditPart) -> Vec<Sentence> {
    let mut out = findings(part);
    out.push(of_neighbours(&part.attacks));
    out.push(limits(part));
    out
}

/// What was found, scheme by scheme.
pub fn findings(part: &AuditPart) -> Vec<Sentence> {
    let found = by_scheme(&part.attacks);
    let mut out = Vec::new();
    out.extend(headline(&found, &part.attacks));
    out.extend(found.iter().map(|f| of_scheme(f, part)));
    out.extend(of_paper(&found));
    out.extend(judged_by_the_paper(&found));
    out.extend(found.iter().filter_map(|f| of_replaced(f, &part.attacks)));
    out
}

/// Who gives what away: to attackers who exist first, to one whom an oracle helps after them.
fn headline(found: &[Found<'_>], document: &AttackDocument) -> Option<Sentence> {
    let told = |row: &AttackSummary| document.is_told(row.attack);
    let text = if document.has_both() {
        format!(
            "{} {}",
            given_away(found, |row| !told(row), "the strongest attack that needs no oracle")?,
            given_away(
                found,
                told,
                "an attacker whom an oracle tells the true neighbours, which nobody has,"
            )?
        )
    } else {
        given_away(found, |_| true, "the strongest attack that was run")?
    };
    Some(Sentence::new("In short", text))
}

/// Under which schemes the strongest of some attacks gives positions away.
fn given_away(
    found: &[Found<'_>],
    chosen: impl Fn(&AttackSummary) -> bool,
    attacker: &str,
) -> Option<String> {
    let verdicts: Vec<(&Found<'_>, Verdict)> =
        found.iter().filter_map(|f| Some((f, Verdict::of(f.strongest_of(&chosen)?)))).collect();
    if verdicts.is_empty() {
        return None;
    }
    let named = |given: bool| {
        let of = verdicts.iter().filter(|(_, v)| (*v == Verdict::GivenAway) == given);
        listed(&of.map(|(f, _)| f.scheme).collect::<Vec<_>>())
    };
    let given = verdicts.iter().filter(|(_, v)| *v == Verdict::GivenAway).count();
    Some(match (given, verdicts.len() - given) {
        (0, _) => {
            format!(
                "Against {attacker} half of the keypoints or more stay farther off than 10 px under {}.",
                named(false)
            )
        }
        (_, 0) => format!("Against {attacker} most keypoint positions are given away under {}.", named(true)),
        _ => format!(
            "Against {attacker} most keypoint positions are given away under {}, but not under {}.",
            named(true),
            named(false)
        ),
    })
}

fn of_scheme(found: &Found<'_>, part: &AuditPart) -> Sentence {
    let (guess, document) = (found.guess, &part.attacks);
    let told = |row: &AttackSummary| document.is_told(row.attack);
    let text = match (found.strongest_of(|row| !told(row)), found.strongest_of(told)) {
        (None, None) => format!(
            "Only the guess was run: it puts {} of the keypoints within 5 px and half of them within {}.",
            percent(guess.under_5px),
            px(guess.median_px)
        ),
        (Some(best), None) | (None, Some(best)) => of_attack(best, guess, part),
        (Some(best), Some(told)) => format!(
            "{} Told by an oracle: {}. The strongest then, {} ({}), puts {} of the keypoints within 5 px and half of them within \
             {}.{}",
            of_attack(best, guess, part),
            Verdict::of(told).words(),
            told.attack.words,
            told.attack,
            percent(told.under_5px),
            px(told.median_px),
            kept(told, Verdict::of(told), part)
        ),
    };
    Sentence::new(format!("{} ({})", scheme_words(found.scheme), found.scheme), text)
}

/// What an attack makes of a scheme, and what it needs for it.
fn of_attack(best: &AttackSummary, guess: &AttackSummary, part: &AuditPart) -> String {
    let verdict = Verdict::of(best);
    let most = if verdict == Verdict::Nothing { "The best of them" } else { "The strongest" };
    format!(
        "{}. {most}, {} ({}), puts {} of the keypoints within 5 px and half of them within {}; guessing from the single line \
         puts {} within 5 px and half within {}. It needs {}.{}",
        verdict.words(),
        best.attack.words,
        best.attack,
        percent(best.under_5px),
        px(best.median_px),
        percent(guess.under_5px),
        px(guess.median_px),
        needs(best.attack, &part.attacks),
        kept(best, verdict, part)
    )
}

/// Whether the arrangement survives where the positions do not: then the pixels of error say too little.
fn kept(row: &AttackSummary, verdict: Verdict, part: &AuditPart) -> String {
    let at = part.attacks.attacks.iter().position(|r| std::ptr::eq(r, row));
    match at.and_then(|i| part.bending.get(i)) {
        Some(bent) if verdict != Verdict::GivenAway && *bent < ARRANGED => format!(
            " The arrangement is given away all the same: offsets between neighbouring keypoints are off by {} of their length \
             in the median, so what is recovered is bent or shifted, not lost.",
            percent(*bent)
        ),
        _ => String::new(),
    }
}

fn of_paper(found: &[Found<'_>]) -> Option<Sentence> {
    let compared: Vec<String> = found
        .iter()
        .filter_map(|f| Some((f, f.paper()?)))
        .map(|(f, paper)| {
            let (error, guessed) = (paper.mean_px, f.guess.mean_px);
            let meaning = match error / guessed {
                ratio if ratio > 1.1 => {
                    "worse than guessing: the large error shows that this attack fails, not that the scheme protects".to_owned()
                }
                ratio if ratio >= 1.0 / 1.1 => "as good as guessing".to_owned(),
                ratio if ratio.is_finite() => format!("{:.1} times nearer", 1.0 / ratio),
                _ => "which cannot be compared".to_owned(),
            };
            format!("{} on {}, where the guess has {} ({meaning})", px(error), f.scheme, px(guessed))
        })
        .collect();
    let text = format!("Its mean error is {}.", compared.join("; "));
    (!compared.is_empty()).then(|| Sentence::new("The paper's attack", text))
}

/// Whether the paper's measure, the error of its own attack, misleads about the scheme it praises most.
fn judged_by_the_paper(found: &[Found<'_>]) -> Option<Sentence> {
    if found.len() < 2 {
        return None;
    }
    let safest = largest(found, |f| f.paper().map(|r| r.mean_px))?;
    let best = safest.strongest()?;
    if best.attack == Attack::CLOSED_FORM {
        return None;
    }
    let least = largest(found, |f| f.strongest().map(|r| r.median_px))?;
    let then = if least.scheme == safest.scheme {
        format!("it is also the one with the largest median error, {}", px(best.median_px))
    } else {
        let other = least.strongest()?;
        format!(
            "its median error is {}, and {} has the largest, {}",
            px(best.median_px),
            least.scheme,
            px(other.median_px)
        )
    };
    let paper = safest.paper()?;
    Some(Sentence::new(
        "Judged by which attack",
        format!(
            "By the paper's attack alone {} looks safest, with a mean error of {}. By the strongest attack on each {then}.",
            safest.scheme,
            px(paper.mean_px)
        ),
    ))
}

fn largest<'a, 'b>(found: &'b [Found<'a>], of: impl Fn(&Found<'a>) -> Option<f64>) -> Option<&'b Found<'a>> {
    let all = found.iter().filter_map(|f| Some((f, of(f)?)));
    all.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(f, _)| f)
}

/// How many false neighbours the strongest attack with neighbours stands.
fn of_replaced(found: &Found<'_>, document: &AttackDocument) -> Option<Sentence> {
    let asks = |row: &&&AttackSummary| row.attack.needs.neighbours;
    let best =
        found.attacks.iter().filter(asks).max_by(|a, b| a.bits_over_prior.total_cmp(&b.bits_over_prior))?;
    let mut rows: Vec<&AttackSummary> =
        document.attacks.iter().filter(|r| r.scheme == best.scheme && r.attack == best.attack).collect();
    rows.sort_by(|a, b| a.corrupt.total_cmp(&b.corrupt));
    if rows.len() < 2 {
        return None;
    }
    let stands = rows.iter().take_while(|r| r.under_10px >= GIVEN_AWAY).count();
    let at = |row: &AttackSummary| match row.corrupt {
        0.0 => "With none of the neighbours replaced".to_owned(),
        share => format!("With {share:.0} % of the neighbours replaced at random"),
    };
    let says = |row: &AttackSummary| {
        format!(
            "puts {} of the keypoints within 10 px and half of them within {}",
            percent(row.under_10px),
            px(row.median_px)
        )
    };
    let one = |row: &AttackSummary| format!("{} it {}.", at(row), says(row));
    let text = match (stands.checked_sub(1).map(|i| rows[i]), rows.get(stands)) {
        (None, Some(first)) => one(first),
        (Some(last), None) => one(last),
        (Some(last), Some(next)) => format!("{} {}", one(last), one(next)),
        (None, None) => return None,
    };
    Some(Sentence::new(format!("False neighbours, {} on {}", best.attack.words, best.scheme), text))
}

fn of_neighbours(document: &AttackDocument) -> Sentence {
    let replaced = base_share(document);
    let replaced = if replaced > 0.0 && replaced.is_finite() {
        format!(" In this run at least {replaced:.0} % of them were replaced by keypoints drawn at random.")
    } else {
        String::new()
    };
    let text = match (document.neighbours, document.precision.zip(document.chance)) {
        (Neighbours::Oracle, _) => format!(
            "Attacks that ask who is near whom were told the true {} nearest keypoints of each. That is the worst case; whether \
             an attacker gets there from descriptors is not measured by this run.",
            document.k
        ),
        (source, Some((true_share, chance))) => format!(
            "Attacks that ask who is near whom were told {} neighbours of each keypoint from the source “{source}”: {} of them \
             true, where drawing at random has {}.",
            document.k,
            percent(true_share),
            percent(chance)
        ),
        (source, None) => format!("Neighbours came from the source “{source}”, {} a keypoint.", document.k),
    };
    Sentence::new("Neighbours", text + &replaced)
}

fn limits(part: &AuditPart) -> Sentence {
    let document = &part.attacks;
    let images = document.attacks.iter().map(|row| row.images).max().unwrap_or(0);
    let run = |attack: &Attack| document.attacks.iter().any(|row| row.attack == *attack);
    let left_out: Vec<&str> = ATTACKS.iter().filter(|a| !run(a)).map(|a| a.name).collect();
    let left_out =
        if left_out.is_empty() { String::new() } else { format!(" Not run here: {}.", left_out.join(", ")) };
    Sentence::new(
        "How far this goes",
        format!(
            "{} with {}; others may give other figures. An attack that fails says nothing of attacks that were not \
             run.{left_out} Positions are all that is attacked: descriptors travel with every scheme and tell things of their own.",
            count(images, "image"),
            count(part.keypoints, "keypoint")
        ),
    )
}
