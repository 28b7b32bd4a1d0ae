//! The page says what the document says, and nothing is loaded or injected.

use veiloc_datasets::problem_files::synthetic_image;
use veiloc_evaluation::audit::{
    Attack, AttackEvaluation, AttackSummary, AuditOptions, ImageGroup, run_audit,
};
use veiloc_geometry::Pixel;
use veiloc_protocol::Scheme;

use super::audit_page;

/// The page of an audit with these options.
fn page_of(
    options: &AuditOptions,
    photograph: &dyn Fn(usize, usize) -> Option<std::path::PathBuf>,
) -> String {
    audit_page(&run_audit(options, photograph, &()).expect("it runs"), options)
}

fn options(groups: Vec<ImageGroup>, synthetic: usize) -> AuditOptions {
    AuditOptions {
        evaluation: AttackEvaluation {
            synthetic,
            schemes: vec![Scheme::RandomLines, Scheme::CoordinatePermutation, Scheme::default()],
            attacks: vec![Attack::CLOSED_FORM, "closed-form-in-image".parse().expect("an attack")],
            corrupt: vec![0.0, 30.0],
            seed: 5,
            ..AttackEvaluation::default()
        },
        groups,
        shown: 1,
        command: "veiloc audit <x>".to_owned(),
    }
}

fn nowhere(_: usize, _: usize) -> Option<std::path::PathBuf> {
    None
}

/// Text of each cell of the rows of the page's tables.
fn cells(page: &str) -> Vec<Vec<String>> {
    let bodies = page.split("<tbody>").skip(1).filter_map(|rest| rest.split("</tbody>").next());
    let text = |cell: &str| {
        let cell = cell.split("<small>").next().unwrap_or(cell);
        cell.split('<')
            .filter_map(|part| part.split_once('>').map_or(Some(part), |p| Some(p.1)))
            .collect::<String>()
    };
    let row = |row: &str| {
        row.split("</td>")
            .map(|cell| text(cell.rsplit_once("<td").map_or(cell, |c| c.1).trim_start_matches('>')))
            .collect()
    };
    bodies
        .flat_map(|body| body.split("</tr>").filter(|r| r.contains("<td")).map(row).collect::<Vec<_>>())
        .collect()
}

/// The first number in a cell.
fn number(cell: &str) -> f64 {
    let from = cell.rsplit('>').next().unwrap_or(cell);
    let digits: String = from.chars().take_while(|c| c.is_ascii_digit() || ".+-".contains(*c)).collect();
    digits.parse().unwrap_or_else(|_| panic!("{cell:?} holds no number"))
}

#[test]
fn page_and_document_agree() {
    let group = ImageGroup { name: "own".to_owned(), images: vec![synthetic_image(220, 8)] };
    let options = options(vec![group], 180);
    let audit = run_audit(&options, &nowhere, &()).expect("it runs");
    let page = audit_page(&audit, &options);
    let (told, rows): (Vec<_>, Vec<_>) =
        cells(&page).into_iter().partition(|cells| cells[0].starts_with("Told the true neighbours"));
    assert_eq!(told.len(), 2 * 3, "every scheme of both parts says which attacks an oracle helps");
    let parts = [audit.document.inputs.as_ref(), audit.document.synthetic.as_ref()];
    let summaries: Vec<(&AttackSummary, f64)> = parts
        .iter()
        .flatten()
        .flat_map(|p| p.attacks.attacks.iter().zip(p.bending.iter().copied()))
        .collect();
    // Two parts, three schemes; the guess once, two attacks at two shares.
    assert_eq!(summaries.len(), 2 * 3 * 5);
    assert_eq!(rows.len(), summaries.len(), "{rows:?}");
    for (cells, (row, bent)) in rows.iter().zip(summaries) {
        let close = |cell: usize, value: f64, scale: f64| {
            assert!((number(&cells[cell]) - scale * value).abs() <= 0.0501, "{cells:?} {row:?}");
        };
        close(2, row.mean_px, 1.0);
        close(3, row.median_px, 1.0);
        close(4, row.under_5px, 100.0);
        close(5, row.under_10px, 100.0);
        close(6, row.under_30px, 100.0);
        assert!((number(&cells[7]) - row.bits_over_prior).abs() <= 0.00501, "{cells:?} {row:?}");
        close(8, bent, 100.0);
    }
    assert_eq!(audit.document.inputs.as_ref().map(|p| p.keypoints), Some(220));
    for sentence in &audit.document.conclusion {
        let text = sentence.split_once(": ").expect("a subject").1;
        assert!(page.contains(&crate::format::escape(text)), "{text}");
    }
}

#[test]
fn the_page_loads_nothing_and_names_are_only_text() {
    let mut image = synthetic_image(60, 2);
    image.name = "<script>alert('x')</script>&\".jpg".to_owned();
    let group = ImageGroup { name: "<img src=x onerror=alert(1)>".to_owned(), images: vec![image] };
    let page = page_of(&options(vec![group], 60), &nowhere);
    for bad in ["<script", "<img src=x", "http:", "https:", "url(", "@import", "<link", "<iframe", "src=\"/"]
    {
        assert!(!page.contains(bad), "{bad}");
    }
    for target in page.split("href=\"").skip(1).chain(page.split("src=\"").skip(1)) {
        assert!(target.starts_with('#') || target.starts_with("data:image/"), "{}", &target[..40]);
    }
    assert!(page.contains("&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt;&amp;&quot;.jpg"));
    assert!(page.contains("veiloc audit &lt;x&gt;"), "the command");
    assert!(!page.contains("NaN") && !page.contains(">inf"));
}

#[test]
fn a_photograph_is_inside_and_stays_out_when_it_shall() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("a.png");
    image::RgbImage::from_fn(320, 240, |x, y| image::Rgb([x as u8, y as u8, 90]))
        .save(&file)
        .expect("written");
    let mut image = synthetic_image(80, 2);
    (image.width, image.height) = (640, 480);
    let group = ImageGroup { name: "a.png".to_owned(), images: vec![image] };
    let options = options(vec![group], 0);
    let with = page_of(&options, &|_, _| Some(file.clone()));
    assert!(
        with.contains("This file contains the photographs")
            && with.contains("in place of the paper's Fig. 6")
    );
    assert!(with.matches("data:image/jpeg").count() > 8 && !with.contains("synthetic scene"));
    let without = page_of(&options, &nowhere);
    assert!(!without.contains("data:image") && without.contains("true positions of keypoints"));
    let mut figures_only = options.clone();
    figures_only.shown = 0;
    let bare = page_of(&figures_only, &|_, _| Some(file.clone()));
    assert!(!bare.contains("This file contains") && !bare.contains("data:image"));
    let gone = run_audit(&options, &|_, _| Some("gone.png".into()), &()).expect_err("no such file");
    assert!(gone.to_string().contains("gone.png"), "{gone}");
}

#[test]
fn degenerate_images_make_a_page() {
    let mut one = synthetic_image(1, 1);
    one.keypoints = vec![Pixel::new(3.0, 4.0)];
    let group = ImageGroup { name: "one".to_owned(), images: vec![one] };
    let page = page_of(&options(vec![group], 0), &nowhere);
    assert!(page.contains("1 image with 1 keypoint ") && !page.contains("NaN"), "{}", &page[..0]);
    let nothing = run_audit(&options(Vec::new(), 0), &nowhere, &()).expect_err("nothing");
    assert!(nothing.to_string().contains("nothing to attack"), "{nothing}");
}
