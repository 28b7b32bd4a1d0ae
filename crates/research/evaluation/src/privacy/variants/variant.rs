//! A variant of dcl: what a device might do differently before it sends, as text and as fields.

use std::fmt;
use std::str::FromStr;

use rand::Rng;
use veiloc_protocol::{AngleBits, DclLayout, Scheme};

/// What a device sends, told by how it differs from `dcl`.
///
/// As text: `dcl`, or any of these joined by `+`, each at most once, applied in the order of this table.
///
/// | text | what the device does |
/// |---|---|
/// | `known=R` | sends only keypoints that match the map with a distance ratio of at most `R`; it must hold the map's descriptors for that |
/// | `gap=PX` | leaves out keypoints nearer than this to the dividing line |
/// | `crop=C` | draws `λ` from `[C, 1]` for each side and leaves out keypoints beyond the share `λ` of their half-line in the image |
/// | `spacing=PX` | goes through the keypoints in the order of the file and leaves out those nearer than this to one that is kept |
/// | `cell=PX` | keeps the first keypoint in every square cell of this size |
/// | `first=N` | keeps the first `N` of the file: the strongest, where the file is in order of strength |
/// | `random=N` | keeps `N` drawn at random; `spacing` and `cell` then go through a shuffled list |
/// | `noise=PX` | moves every keypoint across its half-line by normal noise of this deviation |
/// | `decoys=P` | adds `P` percent more rows, decoys as a device invents them |
/// | `line=L` | dividing line `vertical`, `horizontal`, or `random`: a direction drawn for every query |
/// | `s=S` | anchors at `S` half image heights from the centre |
/// | `bits=B` | angles of `B` bits, 6 to 16 |
#[derive(Debug, Clone, PartialEq)]
#[expect(missing_docs, reason = "the table above says what each field does")]
pub struct Variant {
    pub known: Option<f64>,
    pub gap: f64,
    pub crop: f64,
    pub spacing: f64,
    pub cell: f64,
    pub keep: Keep,
    pub noise: f64,
    pub decoys: f64,
    pub line: DividingLine,
    pub s: f64,
    pub bits: AngleBits,
}

/// How many keypoints are kept, and which.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Keep {
    /// All of them.
    All,
    /// The first of the file.
    First(usize),
    /// Drawn at random.
    Random(usize),
}

/// Where the dividing line runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DividingLine {
    /// The paper's choice.
    Vertical,
    /// The other midline.
    Horizontal,
    /// A direction drawn for every query.
    Random,
}

/// `dcl` as it is.
impl Default for Variant {
    fn default() -> Self {
        Self {
            known: None,
            gap: 0.0,
            crop: 1.0,
            spacing: 0.0,
            cell: 0.0,
            keep: Keep::All,
            noise: 0.0,
            decoys: 0.0,
            line: DividingLine::Vertical,
            s: 1.0,
            bits: AngleBits::default(),
        }
    }
}

impl Variant {
    /// Dividing line and anchors of one query.
    pub(super) fn scheme(&self, rng: &mut impl Rng) -> Scheme {
        let degrees = match self.line {
            DividingLine::Vertical => 90.0,
            DividingLine::Horizontal => 0.0,
            DividingLine::Random => rng.random_range(0.0..180.0),
        };
        // `s` was checked when the variant was read, and every direction is allowed.
        Scheme::Dcl(DclLayout::halves(degrees, self.s).unwrap_or_default())
    }
}

/// A text that names no variant.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is no variant: {reason}")]
pub struct VariantError {
    text: String,
    reason: String,
}

impl FromStr for Variant {
    type Err = VariantError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let refuse = |reason: String| VariantError { text: text.chars().take(80).collect(), reason };
        let mut variant = Self::default();
        let mut seen: Vec<&str> = Vec::new();
        for part in text.split('+').map(str::trim).filter(|p| *p != "dcl") {
            let (name, value) =
                part.split_once('=').ok_or_else(|| refuse(format!("{part:?} has no value")))?;
            // `first` and `random` answer the same question.
            let slot = if name == "first" { "random" } else { name };
            if seen.contains(&slot) {
                return Err(refuse(format!("{name} is asked for twice")));
            }
            seen.push(slot);
            variant.set(name, value).map_err(&refuse)?;
        }
        Ok(variant)
    }
}

impl Variant {
    fn set(&mut self, name: &str, value: &str) -> Result<(), String> {
        let number = |low: f64, high: f64| match value.parse::<f64>() {
            Ok(x) if (low..=high).contains(&x) => Ok(x),
            _ => Err(format!("{name} takes a number from {low} to {high}")),
        };
        let count = || match value.parse::<usize>() {
            Ok(n) if n > 0 => Ok(n),
            _ => Err(format!("{name} takes a whole number above 0")),
        };
        match name {
            "known" => self.known = Some(number(0.0, 1.0)?),
            "gap" => self.gap = number(0.0, 1e4)?,
            "crop" => self.crop = number(0.01, 1.0)?,
            "spacing" => self.spacing = number(0.0, 1e4)?,
            "cell" => self.cell = number(0.0, 1e4)?,
            "first" => self.keep = Keep::First(count()?),
            "random" => self.keep = Keep::Random(count()?),
            "noise" => self.noise = number(0.0, 100.0)?,
            "decoys" => self.decoys = number(0.0, 1000.0)?,
            "s" => self.s = number(0.1, 20.0)?,
            "line" => {
                self.line = match value {
                    "vertical" => DividingLine::Vertical,
                    "horizontal" => DividingLine::Horizontal,
                    "random" => DividingLine::Random,
                    _ => return Err("line takes vertical, horizontal or lot".to_owned()),
                }
            }
            "bits" => {
                let bits = value.parse().ok().and_then(|b| AngleBits::new(b).ok());
                self.bits = bits.ok_or("bits takes a whole number from 6 to 16")?;
            }
            _ => return Err(format!("nothing is called {name:?}")),
        }
        Ok(())
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let plain = Self::default();
        let mut parts: Vec<String> = Vec::new();
        let mut push = |differs: bool, part: String| parts.extend(differs.then_some(part));
        push(self.known.is_some(), format!("known={}", self.known.unwrap_or(1.0)));
        push(self.gap != plain.gap, format!("gap={}", self.gap));
        push(self.crop != plain.crop, format!("crop={}", self.crop));
        push(self.spacing != plain.spacing, format!("spacing={}", self.spacing));
        push(self.cell != plain.cell, format!("cell={}", self.cell));
        match self.keep {
            Keep::All => {}
            Keep::First(n) => push(true, format!("first={n}")),
            Keep::Random(n) => push(true, format!("random={n}")),
        }
        push(self.noise != plain.noise, format!("noise={}", self.noise));
        push(self.decoys != plain.decoys, format!("decoys={}", self.decoys));
        match self.line {
            DividingLine::Vertical => {}
            DividingLine::Horizontal => push(true, "line=horizontal".to_owned()),
            DividingLine::Random => push(true, "line=random".to_owned()),
        }
        push(self.s != plain.s, format!("s={}", self.s));
        push(self.bits != plain.bits, format!("bits={}", self.bits.get()));
        f.pad(&if parts.is_empty() { "dcl".to_owned() } else { parts.join("+") })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variants_read_what_they_print() {
        for text in [
            "dcl",
            "known=0.8+gap=30+crop=0.5",
            "spacing=12+random=256+bits=9",
            "cell=16+first=128+noise=2+decoys=50+line=random+s=2+bits=6",
            "line=horizontal",
        ] {
            assert_eq!(text.parse::<Variant>().expect(text).to_string(), text);
        }
        assert_eq!(
            "bits=9+spacing=12".parse::<Variant>().expect("any order").to_string(),
            "spacing=12+bits=9"
        );
        assert_eq!("spacing=0+line=vertical".parse(), Ok(Variant::default()));
    }

    #[test]
    fn other_text_is_refused_with_the_reason() {
        for (text, says) in [
            ("", "no value"),
            ("spacing", "no value"),
            ("spacing=-1", "from 0"),
            ("spacing=NaN", "from 0"),
            ("bits=5", "6 to 16"),
            ("random=0", "above 0"),
            ("random=9+first=9", "twice"),
            ("line=diagonal", "vertical"),
            ("s=0", "from 0.1"),
            ("blur=3", "nothing is called"),
        ] {
            let error = text.parse::<Variant>().expect_err(text).to_string();
            assert!(error.contains(says), "{error}");
        }
    }

    #[test]
    fn a_random_line_differs_from_query_to_query_and_others_do_not() {
        use rand::SeedableRng;
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let mut drawn = |text: &str| {
            let variant: Variant = text.parse().expect("well written");
            [variant.scheme(&mut rng).to_string(), variant.scheme(&mut rng).to_string()]
        };
        assert_eq!(drawn("dcl"), ["dcl", "dcl"]);
        assert_eq!(drawn("line=horizontal+s=3"), ["dcl:horizontal,s=3"; 2]);
        let [a, b] = drawn("line=random+s=2");
        assert!(a != b && a.starts_with("dcl:angle=") && a.ends_with(",s=2"), "{a} {b}");
    }
}
