//! Layouts of sectors as small integers: two to four anchors at any position, and which stripe of the image belongs to
//! which.

use std::fmt;
use std::str::FromStr;

use veiloc_geometry::{Anchor, AnchorPosition, Layout, Sectors};

use crate::QueryError;

/// Sectors and anchors of Dual Convergent Lines.
///
/// Anchor positions are thousandths of the image's height from its centre, or, for an anchor at infinity, a direction
/// in hundredths of a degree; sectors have their axis in hundredths of a degree and begin at a hundredth of a sector.
///
/// As text: `axis=DEGREES:sectors=COUNT:anchors=X/Y+X/Y` (or with commas) with `X/Y` heights right and down of the
/// centre, or `@DEGREES` for an anchor at infinity; `shift=SHARE` moves the sectors, `across=DEGREES/COUNT/SHARE` adds
/// a second family.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct SectorLayout {
    anchors: [AnchorCode; Anchor::MAX_COUNT],
    count: u8,
    sectors: SectorCode,
    across: Option<SectorCode>,
}

/// Where an anchor is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum AnchorCode {
    /// Right and down, 1/1000 image height.
    At(i16, i16),
    /// At infinity, 1/100 degree.
    Toward(u16),
}

/// A family of sectors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct SectorCode {
    /// 1/100 degree.
    axis: u16,
    count: u8,
    /// 1/100 sector.
    shift: u8,
}

/// Codes of a half turn, of the image height, of a sector.
const HALF_TURN: u16 = 18_000;
const HEIGHT: f64 = 1_000.0;
const SECTOR: u8 = 100;
/// The largest distance of an anchor, in either direction.
const MAX_ANCHOR_DISTANCE: i16 = 20_000;
/// Stands for the first number of an anchor at infinity.
const AT_INFINITY: i16 = i16::MIN;
/// Most sectors in the whole circle: three degrees each.
const MAX_SECTORS: u8 = 120;

const FIELD: &str = "layout";

impl SectorLayout {
    /// The default of `dcl`: slanted strips 15° wide, anchors above right and below left of the image's centre, on the line
    /// through it along the strips. How it was chosen: `docs/decisions/0058-the-default-layout-by-absolute-errors.md`.
    pub const SLANTED: Self = Self {
        anchors: [
            AnchorCode::At(370, -590),
            AnchorCode::At(-530, 850),
            AnchorCode::At(0, 0),
            AnchorCode::At(0, 0),
        ],
        count: 2,
        sectors: SectorCode { axis: 12_200, count: 24, shift: 0 },
        across: None,
    };

    /// Bytes of a layout on the wire.
    pub(crate) const BYTES: usize = 2 + 4 * Anchor::MAX_COUNT + 2 * 4;

    /// Rounds a layout to what the wire can express.
    ///
    /// # Errors
    /// [`QueryError::SectorLayout`] when it cannot: anchors beyond 20 heights, more than 120 sectors, counts that are
    /// not a multiple of the number of anchors.
    pub fn new(layout: &Layout) -> Result<Self, QueryError> {
        let refuse = || QueryError::SectorLayout;
        let degrees = |radians: f64| {
            let code = (radians.to_degrees().rem_euclid(180.0) * 100.0).round();
            code as u16 % HALF_TURN
        };
        let anchor = |anchor: &AnchorPosition| match *anchor {
            AnchorPosition::At(at) => {
                let [x, y] = at.map(|x| (x * HEIGHT).round());
                let fits = |x: f64| x.abs() <= f64::from(MAX_ANCHOR_DISTANCE);
                (fits(x) && fits(y)).then_some(AnchorCode::At(x as i16, y as i16))
            }
            AnchorPosition::Toward(angle) => Some(AnchorCode::Toward(degrees(angle))),
        };
        let sectors = |s: &Sectors| {
            let count = u8::try_from(s.count).ok().filter(|c| *c <= MAX_SECTORS)?;
            let shift = (s.shift * f64::from(SECTOR)).round() as u8 % SECTOR;
            Some(SectorCode { axis: degrees(s.axis), count, shift })
        };
        let mut anchors = [AnchorCode::At(0, 0); Anchor::MAX_COUNT];
        for (to, from) in anchors.iter_mut().zip(layout.anchors()) {
            *to = anchor(from).ok_or_else(refuse)?;
        }
        let across = layout.across().map(|s| sectors(s).ok_or_else(refuse)).transpose()?;
        let count = layout.anchors().len() as u8;
        let own = sectors(layout.sectors()).ok_or_else(refuse)?;
        Ok(Self { anchors, count, sectors: own, across })
    }

    /// How many anchors there are.
    pub const fn anchors(&self) -> usize {
        self.count as usize
    }

    /// As real numbers.
    pub fn layout(&self) -> Layout {
        let radians = |code: u16| f64::from(code) * (std::f64::consts::PI / f64::from(HALF_TURN));
        let anchor = |anchor: &AnchorCode| match *anchor {
            AnchorCode::At(x, y) => AnchorPosition::At([f64::from(x) / HEIGHT, f64::from(y) / HEIGHT]),
            AnchorCode::Toward(angle) => AnchorPosition::Toward(radians(angle)),
        };
        let sectors = |s: &SectorCode| Sectors {
            axis: radians(s.axis),
            count: s.count.into(),
            shift: f64::from(s.shift) / f64::from(SECTOR),
        };
        let anchors: Vec<AnchorPosition> = self.anchors[..self.anchors()].iter().map(anchor).collect();
        Layout::new(&anchors, sectors(&self.sectors), self.across.as_ref().map(sectors))
            .expect("the constructors reject layouts that do not close")
    }

    /// As on the wire.
    pub(crate) fn pack(&self) -> Vec<u8> {
        let mut bytes = vec![self.count, u8::from(self.across.is_some())];
        for anchor in &self.anchors {
            let (x, y) = match *anchor {
                AnchorCode::At(x, y) => (x, y),
                AnchorCode::Toward(angle) => (AT_INFINITY, angle.cast_signed()),
            };
            bytes.extend(x.to_le_bytes());
            bytes.extend(y.to_le_bytes());
        }
        let none = SectorCode { axis: 0, count: 0, shift: 0 };
        for s in [self.sectors, self.across.unwrap_or(none)] {
            bytes.extend(s.axis.to_le_bytes());
            bytes.extend([s.count, s.shift]);
        }
        bytes
    }

    /// The inverse of [`Self::pack`]. Unused numbers of anchors and sectors are not checked here: encoding the layout
    /// again shows whether they were zero.
    ///
    /// # Errors
    /// [`QueryError::Length`] for another length, [`QueryError::SectorLayout`] for an invalid layout.
    pub(crate) fn unpack(bytes: &[u8]) -> Result<Self, QueryError> {
        let refuse = || QueryError::SectorLayout;
        let bytes: &[u8; Self::BYTES] = bytes.try_into().map_err(|_| QueryError::Length {
            field: FIELD,
            expected: Self::BYTES,
            actual: bytes.len(),
        })?;
        let word = |at: usize| [bytes[at], bytes[at + 1]];
        let [count, has_across] = [bytes[0], bytes[1]];
        let mut anchors = [AnchorCode::At(0, 0); Anchor::MAX_COUNT];
        for (k, anchor) in anchors.iter_mut().enumerate().take(usize::from(count)) {
            let (x, y) = (i16::from_le_bytes(word(2 + 4 * k)), i16::from_le_bytes(word(4 + 4 * k)));
            let within = |x: i16| x.unsigned_abs() <= MAX_ANCHOR_DISTANCE.unsigned_abs();
            *anchor = if x == AT_INFINITY {
                AnchorCode::Toward(u16::try_from(y).ok().filter(|a| *a < HALF_TURN).ok_or_else(refuse)?)
            } else if within(x) && within(y) {
                AnchorCode::At(x, y)
            } else {
                return Err(refuse());
            };
        }
        let sectors = |at: usize| {
            let code =
                SectorCode { axis: u16::from_le_bytes(word(at)), count: bytes[at + 2], shift: bytes[at + 3] };
            let closes = count > 0 && code.count.is_multiple_of(count);
            let fits =
                code.axis < HALF_TURN && code.shift < SECTOR && (1..=MAX_SECTORS).contains(&code.count);
            (fits && closes).then_some(code).ok_or_else(refuse)
        };
        if !(2..=Anchor::MAX_COUNT).contains(&usize::from(count)) || has_across > 1 {
            return Err(refuse());
        }
        let first = 2 + 4 * Anchor::MAX_COUNT;
        let across = (has_across == 1).then(|| sectors(first + 4)).transpose()?;
        Ok(Self { anchors, count, sectors: sectors(first)?, across })
    }
}

impl fmt::Display for SectorLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let degrees = |code: u16| f64::from(code) / 100.0;
        let share = |code: u8| f64::from(code) / f64::from(SECTOR);
        write!(f, "axis={}:sectors={}", degrees(self.sectors.axis), self.sectors.count)?;
        if self.sectors.shift > 0 {
            write!(f, ":shift={}", share(self.sectors.shift))?;
        }
        if let Some(across) = self.across {
            write!(f, ":across={}/{}/{}", degrees(across.axis), across.count, share(across.shift))?;
        }
        f.write_str(":anchors=")?;
        for (k, anchor) in self.anchors[..self.anchors()].iter().enumerate() {
            if k > 0 {
                f.write_str("+")?;
            }
            match *anchor {
                AnchorCode::At(x, y) => write!(f, "{}/{}", f64::from(x) / HEIGHT, f64::from(y) / HEIGHT)?,
                AnchorCode::Toward(angle) => write!(f, "@{}", degrees(angle))?,
            }
        }
        Ok(())
    }
}

impl FromStr for SectorLayout {
    type Err = QueryError;

    fn from_str(text: &str) -> Result<Self, QueryError> {
        let refuse = || QueryError::SectorLayout;
        let number =
            |text: &str| text.trim().parse::<f64>().ok().filter(|x| x.is_finite()).ok_or_else(refuse);
        let whole = |text: &str| text.trim().parse::<u16>().map_err(|_| refuse());
        let (mut axis, mut count, mut shift, mut across, mut anchors) = (None, None, None, None, None);
        for part in text.split([':', ',']) {
            let (name, value) = part.split_once('=').ok_or_else(refuse)?;
            let again = match name.trim() {
                "axis" => axis.replace(number(value)?).is_some(),
                "sectors" => count.replace(whole(value)?).is_some(),
                "shift" => shift.replace(number(value)?).is_some(),
                "across" => {
                    let [axis, count, shift] = three(value).ok_or_else(refuse)?;
                    let axis = number(axis)?.to_radians();
                    across.replace(Sectors { axis, count: whole(count)?, shift: number(shift)? }).is_some()
                }
                "anchors" => {
                    let anchor = |text: &str| {
                        if let Some(angle) = text.strip_prefix('@') {
                            return Ok(AnchorPosition::Toward(number(angle)?.to_radians()));
                        }
                        let (x, y) = text.split_once('/').ok_or_else(refuse)?;
                        Ok(AnchorPosition::At([number(x)?, number(y)?]))
                    };
                    let positions: Result<Vec<AnchorPosition>, QueryError> =
                        value.split('+').map(anchor).collect();
                    anchors.replace(positions?).is_some()
                }
                _ => true,
            };
            if again {
                return Err(refuse());
            }
        }
        let (Some(axis), Some(count), Some(anchors)) = (axis, count, anchors) else { return Err(refuse()) };
        let sectors = Sectors { axis: f64::to_radians(axis), count, shift: shift.unwrap_or(0.0) };
        Self::new(&Layout::new(&anchors, sectors, across).ok_or_else(refuse)?)
    }
}

fn three(text: &str) -> Option<[&str; 3]> {
    let words: Vec<&str> = text.split('/').collect();
    words.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXTS: [&str; 4] = [
        "axis=67:sectors=20:anchors=-0.12/-0.49+1.5/0",
        "axis=115:sectors=22:shift=0.5:anchors=@90+@0",
        "axis=12.34:sectors=21:anchors=0/0+0.5/0.25+@45",
        "axis=90:sectors=16:shift=0.5:across=0/12/0.25:anchors=@90+@0+0/-20+20/0.001",
    ];

    #[test]
    fn text_and_bytes_round_trip() {
        for text in TEXTS {
            let layout: SectorLayout = text.parse().expect(text);
            assert_eq!(layout.to_string(), text);
            let bytes = layout.pack();
            assert_eq!(bytes.len(), SectorLayout::BYTES);
            assert_eq!(SectorLayout::unpack(&bytes).expect(text), layout);
            assert_eq!(text.replace(':', ",").parse(), Ok(layout));
            assert_eq!(SectorLayout::new(&layout.layout()).expect(text), layout);
        }
    }

    #[test]
    fn invalid_layouts_are_rejected() {
        for text in [
            "",
            "axis=67",
            "axis=67,sectors=20",
            "axis=67,sectors=21,anchors=0/0+1/1",
            "axis=67,sectors=0,anchors=0/0+1/1",
            "axis=67,sectors=122,anchors=0/0+1/1",
            "axis=67,sectors=20,anchors=0/0",
            "axis=67,sectors=20,anchors=0/0+1/1+1/2+2/3+3/4",
            "axis=67,sectors=20,anchors=0/0+21/1",
            "axis=67,sectors=20,anchors=0/0+nan/1",
            "axis=67,axis=67,sectors=20,anchors=0/0+1/1",
            "axis=67,sectors=20,shift=1,anchors=0/0+1/1",
            "axis=67,sectors=20,across=1/2,anchors=0/0+1/1",
            "axis=67,sectors=20,anchors=0/0+1/1,more=1",
        ] {
            assert_eq!(text.parse::<SectorLayout>(), Err(QueryError::SectorLayout), "{text}");
        }
        let bytes = TEXTS[3].parse::<SectorLayout>().expect("a layout").pack();
        assert!(matches!(SectorLayout::unpack(&bytes[1..]), Err(QueryError::Length { .. })));
        for (at, value) in [(0, 1), (0, 5), (0, 3), (1, 2), (19, 255), (20, 0), (20, 121), (21, 100)] {
            let mut bad = bytes.clone();
            bad[at] = value;
            assert_eq!(SectorLayout::unpack(&bad), Err(QueryError::SectorLayout), "{at} {value}");
        }
    }
}
