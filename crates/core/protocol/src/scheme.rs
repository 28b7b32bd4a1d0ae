//! How the positions of keypoints are hidden before they are sent.

use std::fmt;
use std::str::FromStr;

use crate::{DclLayout, HalvesLayout, LayoutTurn, QueryError, SectorLayout};

/// An obfuscation scheme.
///
/// | scheme | what is sent per keypoint | source |
/// |---|---|---|
/// | `points` | its position: **no protection**, the baseline | |
/// | `random-lines` | a line through it in a random direction | Speciale et al., ICCV 2019 |
/// | `coordinate-permutation` | a position with one of its two coordinates exchanged with another keypoint's | Pan et al., 2023 |
/// | `dcl` | one of two anchors and the angle of the line to it | Dual Convergent Lines, CVPR 2026 |
///
/// As text: the names above; `dcl` alone has its default layout, or a colon and a layout follow. The layout is `paper`; or, separated by
/// colons or commas, `vertical`, `horizontal` or `angle=DEGREES` (dividing line), and `s=NUMBER` (anchor distance in
/// half image heights); or a [`SectorLayout`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Scheme {
    /// Positions as they are.
    Points,
    /// Random lines.
    RandomLines,
    /// Coordinate permutation.
    CoordinatePermutation,
    /// Dual Convergent Lines.
    Dcl(DclLayout),
}

impl Scheme {
    /// Every scheme once, `dcl` with its default layout.
    pub const ALL: [Self; 4] =
        [Self::Points, Self::RandomLines, Self::CoordinatePermutation, Self::Dcl(DclLayout::DEFAULT)];

    /// The name without layout.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Points => "points",
            Self::RandomLines => "random-lines",
            Self::CoordinatePermutation => "coordinate-permutation",
            Self::Dcl(_) => "dcl",
        }
    }

    /// The name for sentences and headings, without layout.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Points => "Points",
            Self::RandomLines => "Random lines",
            Self::CoordinatePermutation => "Coordinate permutation",
            Self::Dcl(_) => "Dual convergent lines",
        }
    }

    /// One sentence of explanation for people without prior knowledge.
    pub const fn explanation(self) -> &'static str {
        match self {
            Self::Points => "Keypoint positions sent openly: no protection.",
            Self::RandomLines => "Each keypoint replaced by a line through it in a random direction.",
            Self::CoordinatePermutation => "Keypoints swap one coordinate with a random partner.",
            Self::Dcl(_) => "Each keypoint replaced by the half-line that joins it to one of few anchors.",
        }
    }

    /// A scheme of tables of attacks: any, or `dcl:random`, which is no scheme of queries ([`DclLayout::Random`]).
    ///
    /// # Errors
    /// [`QueryError::SchemeSyntax`] and [`QueryError::Layout`], as [`Self::from_str`].
    pub fn of_tables(text: &str) -> Result<Self, QueryError> {
        if text == RANDOM { Ok(Self::Dcl(DclLayout::Random)) } else { text.parse() }
    }

    /// Whether positions are hidden: false for `points`.
    pub const fn hides_positions(self) -> bool {
        !matches!(self, Self::Points)
    }

    /// `(scheme, dividing_angle, anchor_distance)` as on the wire; the latter two are 0 for a layout of sectors.
    pub(crate) const fn codes(self) -> (u32, u32, u32) {
        match self {
            Self::Points => (1, 0, 0),
            Self::RandomLines => (2, 0, 0),
            Self::CoordinatePermutation => (3, 0, 0),
            Self::Dcl(DclLayout::Halves(halves)) => {
                let (angle, distance) = halves.codes();
                (4, angle, distance)
            }
            // No decoder accepts an anchor distance of 0 without sectors.
            Self::Dcl(DclLayout::Sectors(_) | DclLayout::Random) => (4, 0, 0),
        }
    }

    /// The bytes of a layout of sectors, empty for all others.
    pub(crate) fn layout_bytes(self) -> Vec<u8> {
        match self {
            Self::Dcl(DclLayout::Sectors(sectors)) => sectors.pack(),
            _ => Vec::new(),
        }
    }

    /// The inverse of [`Self::codes`]; `layout` are the bytes of a layout of sectors, empty where there is none.
    pub(crate) fn with_layout(
        scheme: u32,
        angle: u32,
        distance: u32,
        layout: &[u8],
    ) -> Result<Self, QueryError> {
        if layout.is_empty() {
            return Self::from_codes(scheme, angle, distance);
        }
        if scheme != 4 {
            return Err(QueryError::Length { field: "layout", expected: 0, actual: layout.len() });
        }
        for (field, value) in [("dividing_angle", angle), ("anchor_distance", distance)] {
            if value != 0 {
                return Err(QueryError::Field { field, value, allowed: "0, because the layout has sectors" });
            }
        }
        SectorLayout::unpack(layout).map(|sectors| Self::Dcl(DclLayout::Sectors(sectors)))
    }

    fn from_codes(scheme: u32, angle: u32, distance: u32) -> Result<Self, QueryError> {
        let found = match scheme {
            1 => Self::Points,
            2 => Self::RandomLines,
            3 => Self::CoordinatePermutation,
            4 => return HalvesLayout::from_codes(angle, distance).map(|h| Self::Dcl(DclLayout::Halves(h))),
            _ => {
                return Err(QueryError::Field {
                    field: "scheme",
                    value: scheme,
                    allowed: "1 (points), 2 (random-lines), 3 (coordinate-permutation) or 4 (dcl)",
                });
            }
        };
        for (field, value) in [("dividing_angle", angle), ("anchor_distance", distance)] {
            if value != 0 {
                return Err(QueryError::Field { field, value, allowed: "0, because only dcl has one" });
            }
        }
        Ok(found)
    }

    /// Refuses a turn of a layout under a scheme that has none: only `dcl` has one.
    pub(crate) fn check_turn(self, turn: LayoutTurn) -> Result<(), QueryError> {
        match (self, turn.codes().into_iter().find(|code| *code != 0)) {
            (Self::Dcl(_), _) | (_, None) => Ok(()),
            (Self::Points | Self::RandomLines | Self::CoordinatePermutation, Some(value)) => {
                Err(QueryError::Field { field: "turn", value, allowed: "0, because only dcl has one" })
            }
        }
    }
}

/// [`DclLayout::Random`] as text.
const RANDOM: &str = "dcl:random";

/// `dcl` with its default layout.
impl Default for Scheme {
    fn default() -> Self {
        Self::Dcl(DclLayout::DEFAULT)
    }
}

impl FromStr for Scheme {
    type Err = QueryError;

    fn from_str(text: &str) -> Result<Self, QueryError> {
        let refuse = || QueryError::SchemeSyntax { text: text.chars().take(80).collect() };
        let (name, layout) = match text.split_once(':') {
            Some((name, layout)) => (name, Some(layout)),
            None => (text, None),
        };
        match (name, layout) {
            ("points", None) => Ok(Self::Points),
            ("random-lines", None) => Ok(Self::RandomLines),
            ("coordinate-permutation", None) => Ok(Self::CoordinatePermutation),
            ("dcl", None) => Ok(Self::default()),
            ("dcl", Some("paper")) => Ok(Self::Dcl(DclLayout::VERTICAL)),
            ("dcl", Some(layout)) if layout.contains("sectors=") => {
                layout.parse().map(|sectors| Self::Dcl(DclLayout::Sectors(sectors)))
            }
            ("dcl", Some(layout)) => {
                let (mut degrees, mut s) = (None, None);
                for part in layout.split([':', ',']).map(str::trim) {
                    let (slot, value) = match part.split_once('=') {
                        None if part == "vertical" => (&mut degrees, 90.0),
                        None if part == "horizontal" => (&mut degrees, 0.0),
                        Some(("angle", number)) => (&mut degrees, number.parse().map_err(|_| refuse())?),
                        Some(("s", number)) => (&mut s, number.parse().map_err(|_| refuse())?),
                        _ => return Err(refuse()),
                    };
                    if slot.replace(value).is_some() {
                        return Err(refuse());
                    }
                }
                DclLayout::halves(degrees.unwrap_or(90.0), s.unwrap_or(1.0)).map(Self::Dcl)
            }
            _ => Err(refuse()),
        }
    }
}

impl fmt::Display for Scheme {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())?;
        let Self::Dcl(layout) = self else { return Ok(()) };
        let layout = match layout {
            own if *own == DclLayout::default() => return Ok(()),
            DclLayout::Sectors(sectors) => return write!(f, ":{sectors}"),
            DclLayout::Random => return f.write_str(RANDOM.trim_start_matches(self.name())),
            DclLayout::Halves(halves) => halves,
        };
        let (angle, distance) = layout.codes();
        let mut separator = ":";
        if angle == 0 {
            write!(f, "{separator}horizontal")?;
            separator = ",";
        } else if angle != 9_000 {
            write!(f, "{separator}angle={}", layout.degrees())?;
            separator = ",";
        }
        if distance != 100 {
            write!(f, "{separator}s={}", layout.s())?;
        } else if angle == 9_000 {
            f.write_str(":paper")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_round_trips() {
        for text in [
            "points",
            "random-lines",
            "coordinate-permutation",
            "dcl",
            "dcl:paper",
            "dcl:horizontal",
            "dcl:angle=30",
            "dcl:s=2",
            "dcl:horizontal,s=0.5",
            "dcl:angle=12.34,s=20",
            "dcl:axis=67:sectors=20:anchors=-0.12/-0.49+1.5/0",
        ] {
            assert_eq!(text.parse::<Scheme>().expect(text).to_string(), text);
        }
        for text in ["dcl:vertical", "dcl:paper"] {
            assert_eq!(text.parse::<Scheme>().expect("known"), Scheme::Dcl(DclLayout::VERTICAL));
        }
    }

    #[test]
    fn random_assignment_is_for_tables_only() {
        let random = Scheme::of_tables(RANDOM).expect("known");
        assert_eq!(random.to_string(), RANDOM);
        assert!(RANDOM.parse::<Scheme>().is_err(), "no device seals with it");
        let (scheme, angle, distance) = random.codes();
        assert!(Scheme::with_layout(scheme, angle, distance, &random.layout_bytes()).is_err());
        assert_eq!(Scheme::of_tables("dcl:s=2").expect("known"), "dcl:s=2".parse().expect("known"));
    }

    #[test]
    fn invalid_text_is_rejected() {
        for text in [
            "",
            "DCL",
            "lines",
            "points:s=2",
            "dcl:",
            "dcl:s",
            "dcl:s=",
            "dcl:s=-1",
            "dcl:s=nan",
            "dcl:angle=180",
            "dcl:angle=30,angle=40",
            "dcl:vertical,horizontal",
        ] {
            assert!(text.parse::<Scheme>().is_err(), "{text:?}");
        }
    }

    #[test]
    fn codes_round_trip_and_invalid_ones_are_rejected() {
        for scheme in Scheme::ALL {
            let ((a, b, c), bytes) = (scheme.codes(), scheme.layout_bytes());
            assert_eq!(Scheme::with_layout(a, b, c, &bytes).expect("own codes"), scheme);
        }
        for text in ["dcl:paper", "dcl:s=2", "dcl:axis=67,sectors=20,anchors=-0.12/-0.49+1.5/0"] {
            let scheme: Scheme = text.parse().expect("a layout");
            let ((a, b, c), bytes) = (scheme.codes(), scheme.layout_bytes());
            assert_eq!(Scheme::with_layout(a, b, c, &bytes).expect("own codes"), scheme);
            assert!(bytes.is_empty() || Scheme::with_layout(1, 0, 0, &bytes).is_err());
            assert!(bytes.is_empty() || Scheme::with_layout(a, 1, c, &bytes).is_err());
        }
        for (a, b, c) in [(0, 0, 0), (5, 0, 0), (1, 1, 0), (2, 0, 1), (4, 0, 0), (4, 18_000, 100)] {
            assert!(Scheme::from_codes(a, b, c).is_err(), "{a} {b} {c}");
        }
    }
}
