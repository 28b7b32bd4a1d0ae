//! Plots in the colours of the page, light or dark.

/// From what width on a plot has a row of the page for itself, its own units.
const LONG: f64 = 500.0;

/// Whether a plot has a row of the page for itself.
pub(super) fn is_long(svg: &str) -> bool {
    let width = svg.split("width=\"").nth(1).and_then(|rest| rest.split('"').next());
    width.and_then(|width| width.parse().ok()).is_some_and(|width: f64| width > LONG)
}

/// A plot without its paper, its ink that of the page, named for those who do not see it.
pub(super) fn of_page(svg: &str, caption: &str) -> String {
    let body = svg.find("<svg").map_or("", |start| &svg[start..]);
    // Its size comes from the page, its shape from the drawing.
    let attribute = |name: &str| {
        let head = &body[..body.find('>').unwrap_or(0)];
        let at = head.find(&format!(" {name}=\""))? + name.len() + 3;
        head[at..].split('"').next().map(str::to_owned)
    };
    let (Some(width), Some(height)) = (attribute("width"), attribute("height")) else { return String::new() };
    let rest = body.find('>').map_or("", |end| &body[end + 1..]);
    let rest = rest
        .replace("fill=\"#FFFFFF\"", "fill=\"none\"")
        .replace("fill=\"#000000\"", "fill=\"currentColor\"")
        .replace("stroke=\"#000000\"", "stroke=\"currentColor\"");
    format!("<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{caption}\">{rest}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paper_and_ink_are_the_page_s() {
        let svg = "<?xml?><svg width=\"380\" height=\"320\" viewBox=\"0 0 380 320\"><rect fill=\"#FFFFFF\"/><text fill=\"#000000\">a</text></svg>";
        assert_eq!(
            of_page(svg, "c"),
            "<svg viewBox=\"0 0 380 320\" role=\"img\" aria-label=\"c\"><rect fill=\"none\"/><text fill=\"currentColor\">a</text></svg>"
        );
        assert_eq!(of_page("no drawing", "c"), "");
        assert!(!is_long(svg) && !is_long("") && is_long("<svg width=\"760\" height=\"90\">"));
    }
}
