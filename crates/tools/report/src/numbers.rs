//! Formatting of numbers and names on pages.

use veiloc_protocol::Scheme;

/// The unit of lengths of a report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LengthUnit {
    /// Map units: structure from motion has no metric scale.
    #[default]
    Map,
    /// Metres.
    Metres,
}

impl LengthUnit {
    /// A length: three significant digits in map units, or metres with unit.
    pub fn length(self, value: f64) -> String {
        match self {
            _ if !value.is_finite() => "–".to_owned(),
            Self::Map => significant(value),
            Self::Metres if value.abs() < 0.01 => format!("{} mm", significant(1e3 * value)),
            Self::Metres if value.abs() < 1.0 => format!("{} cm", significant(1e2 * value)),
            Self::Metres => format!("{} m", significant(value)),
        }
    }

    /// The same with its unit, for text outside of tables.
    pub fn with_unit(self, value: f64) -> String {
        match self {
            Self::Map if value == 1.0 => "1 map unit".to_owned(),
            Self::Map => format!("{} map units", significant(value)),
            Self::Metres => self.length(value),
        }
    }

    /// Header of a column of lengths.
    pub fn head(self, name: &str) -> String {
        match self {
            Self::Map => format!("{name}\n(map units)"),
            Self::Metres => name.to_owned(),
        }
    }
}

/// Three significant digits without trailing zeros in the fraction: `0.0123`, `4.2`, `1230`, `1.2e-7`.
pub fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0".to_owned() } else { "–".to_owned() };
    }
    if value.abs() < 1e-5 {
        return format!("{value:.1e}");
    }
    let digits = (2 - value.abs().log10().floor() as i32).max(0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// An angle in degrees.
pub fn degrees(value: f64) -> String {
    if value.is_finite() { format!("{}°", significant(value)) } else { "–".to_owned() }
}

/// A distance in the image.
pub fn pixels(value: f64) -> String {
    match value {
        v if !v.is_finite() => "–".to_owned(),
        v if v < 100.0 => format!("{v:.1} px"),
        v => format!("{v:.0} px"),
    }
}

/// A share as percent.
pub fn percent(share: f64) -> String {
    match share {
        s if !s.is_finite() => "–".to_owned(),
        s if s > 0.0 && s < 0.1 => format!("{:.1} %", 100.0 * s),
        s => format!("{:.0} %", 100.0 * s),
    }
}

/// Milliseconds.
pub fn milliseconds(value: f64) -> String {
    if value.is_finite() { format!("{} ms", significant(value)) } else { "–".to_owned() }
}

/// Bytes in kilobytes.
pub fn kilobytes(bytes: f64) -> String {
    format!("{} kB", significant(bytes / 1e3))
}

/// A number with its noun: `1 image`, `2 images`; plural of query: `queries`.
pub fn count(n: usize, what: &str) -> String {
    match (n, what.strip_suffix('y')) {
        (1, _) => format!("1 {what}"),
        (_, Some(stem)) => format!("{n} {stem}ies"),
        (_, None) => format!("{n} {what}s"),
    }
}

/// The text with a capital first letter.
pub fn capital(text: &str) -> String {
    let mut chars = text.chars();
    chars.next().map_or_else(String::new, |c| c.to_uppercase().collect::<String>() + chars.as_str())
}

/// Display name of a scheme, with its layout. Other texts are returned unchanged.
pub fn scheme_name(scheme: &str) -> String {
    let setting = scheme.split_once(':').map(|(_, setting)| setting);
    match (scheme.parse::<Scheme>(), setting) {
        (Ok(known), None) => known.words().to_owned(),
        (Ok(known), Some(setting)) => format!("{} ({setting})", known.words()),
        (Err(_), _) => scheme.to_owned(),
    }
}

/// A sentence that explains a scheme; empty for other texts.
pub fn scheme_explanation(scheme: &str) -> &'static str {
    scheme.parse::<Scheme>().map_or("", Scheme::explanation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_have_significant_digits_and_units() {
        let digits = [
            (0.1 + 0.2, "0.3"),
            (0.000_043_21, "0.0000432"),
            (1.2e-7, "1.2e-7"),
            (-4.2, "-4.2"),
            (1234.5, "1234"),
            (20.0, "20"),
            (0.0, "0"),
            (f64::NAN, "–"),
        ];
        for (value, text) in digits {
            assert_eq!(significant(value), text);
        }
        assert_eq!(LengthUnit::Map.length(0.042), "0.042");
        assert_eq!(LengthUnit::Map.with_unit(1.2), "1.2 map units");
        assert_eq!([0.0042, 0.042, 4.2].map(|m| LengthUnit::Metres.length(m)), ["4.2 mm", "4.2 cm", "4.2 m"]);
    }

    #[test]
    fn numbers_have_units_and_schemes_display_names() {
        assert_eq!([0.004, 0.5, f64::NAN].map(percent), ["0.4 %", "50 %", "–"]);
        assert_eq!((pixels(f64::INFINITY), milliseconds(f64::NAN)), ("–".into(), "–".into()));
        assert_eq!(
            (count(1, "query"), count(2, "query"), count(0, "image")),
            ("1 query".into(), "2 queries".into(), "0 images".into())
        );
        assert_eq!(scheme_name("dcl:s=2"), "Dual convergent lines (s=2)");
        assert_eq!((scheme_name("<x>"), scheme_explanation("<x>")), ("<x>".into(), ""));
    }
}
