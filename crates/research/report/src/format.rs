//! Words and numbers as they stand on the page.

use veiloc_protocol::Scheme;

/// Text made safe for HTML, in element content and in quoted attributes.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}

/// What is written where a query has no pose.
pub(super) const NOT_LOCALIZED: &str = "<span class=\"none\">not localized</span>";

/// A length in metres: millimetres, centimetres or metres, two or three digits.
pub(super) fn length(metres: Option<f64>) -> String {
    length_or(metres, NOT_LOCALIZED)
}

/// The same, with other words where there is none.
pub(super) fn length_or(metres: Option<f64>, none: &str) -> String {
    match metres {
        Some(m) if m.is_finite() && m.abs() < 0.01 => format!("{:.1} mm", 1e3 * m),
        Some(m) if m.is_finite() && m.abs() < 1.0 => format!("{:.1} cm", 1e2 * m),
        Some(m) if m.is_finite() => format!("{m:.2} m"),
        _ => none.to_owned(),
    }
}

/// An angle in degrees.
pub(super) fn degrees(value: Option<f64>) -> String {
    match value {
        Some(d) if d.is_finite() => format!("{d:.2}°"),
        _ => NOT_LOCALIZED.to_owned(),
    }
}

/// A distance in the image.
pub(super) fn pixels(value: f64) -> String {
    match value {
        v if !v.is_finite() => "–".to_owned(),
        v if v < 10.0 => format!("{v:.1} px"),
        v => format!("{v:.0} px"),
    }
}

/// A share of 1 in percent.
pub(super) fn percent(share: Option<f64>) -> String {
    match share {
        Some(s) if s.is_finite() && s > 0.0 && s < 0.0095 => format!("{:.1} %", 100.0 * s),
        Some(s) if s.is_finite() => format!("{:.0} %", 100.0 * s),
        _ => "–".to_owned(),
    }
}

/// Milliseconds.
pub(super) fn milliseconds(value: Option<f64>) -> String {
    match value {
        Some(v) if v.is_finite() && v < 10.0 => format!("{v:.1} ms"),
        Some(v) if v.is_finite() => format!("{v:.0} ms"),
        _ => "–".to_owned(),
    }
}

/// A scheme's name for people, escaped, and what it does in one sentence; nothing of what reads as no scheme.
pub(super) fn scheme_words(scheme: &str) -> (String, &'static str) {
    let what = scheme.parse::<Scheme>().map_or("", Scheme::explanation);
    (escape(&veiloc_evaluation::audit::scheme_words(scheme)), what)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_units_and_missing_ones_words() {
        assert_eq!(length(Some(0.0042)), "4.2 mm");
        assert_eq!(length(Some(0.042)), "4.2 cm");
        assert_eq!(length(Some(4.2)), "4.20 m");
        assert_eq!((length(None), degrees(Some(f64::NAN))), (NOT_LOCALIZED.into(), NOT_LOCALIZED.into()));
        assert_eq!(percent(Some(0.004)), "0.4 %");
        assert_eq!(
            (percent(None), pixels(f64::INFINITY), milliseconds(None)),
            ("–".into(), "–".into(), "–".into())
        );
        assert_eq!(escape("<a href='x'>&\""), "&lt;a href=&#39;x&#39;&gt;&amp;&quot;");
        assert_eq!(scheme_words("dcl:s=2").0, "Dual convergent lines (s=2)");
        assert_eq!(scheme_words("<x>").0, "&lt;x&gt;");
    }
}
