//! `--report FILE` of `eval inversion`: what was found, and the contact sheets, to the page.

use veiloc_evaluation::inversion::evaluation::{
    EvaluationDocument, NetworkRow, RebuiltRow, Sheet, SummaryRow, Tile,
};
use veiloc_report::{InversionReport, InversionRow, InversionSheet, SheetImage, SheetTile};

/// The page's data; `seed` and command stand in its details.
pub(super) fn report(
    document: &EvaluationDocument,
    [sheet, wide]: &[Sheet; 2],
    details: Vec<(String, String)>,
) -> InversionReport {
    let mut sheets = vec![
        InversionSheet {
            title: "Image by image".to_owned(),
            note: "The original on the network's grid, then what was made of it, with each image's own scores. Boxes are objects \
                   that a detector finds, where one was given."
                .to_owned(),
            images: images(document, sheet),
        },
        InversionSheet {
            title: "The same in a view twice as wide and high".to_owned(),
            note: "The image in the middle: what attacks put beyond it is drawn too.".to_owned(),
            images: images(document, wide),
        },
    ];
    sheets.retain(|sheet| !sheet.images.is_empty());
    InversionReport {
        images: document.images,
        networks: document.networks.iter().map(network).collect(),
        rows: document.summary.iter().map(row).collect(),
        sheets,
        details,
    }
}

fn network(of: &NetworkRow) -> String {
    let form = if of.form == "invsfm" { "Three U-Nets in a row (InvSfM)" } else { "A U-Net" };
    format!(
        "{form}, given {}: {} channels, {} levels, {} cells on the longer side, {} numbers.",
        of.sees, of.width, of.depth, of.side, of.parameters
    )
}

fn row(of: &SummaryRow) -> InversionRow {
    InversionRow {
        scheme: of.scheme.clone(),
        attack: of.attack.to_owned(),
        by: of.by.clone(),
        mean_px: of.mean_px,
        psnr: of.psnr,
        ssim: of.ssim,
        lpips: of.lpips,
        feature_distance: of.feature_distance,
        objects: of.objects_found.zip(of.objects).map(|(found, all)| [found, all]),
        told_apart: of.told_apart,
    }
}

/// The images of a sheet; of the wide one only some columns are there, told by their names.
fn images(document: &EvaluationDocument, sheet: &Sheet) -> Vec<SheetImage> {
    let column = |row: &SummaryRow| format!("{} {}", row.scheme, row.attack);
    // Rows stand by column, and within it in the order of the images.
    let own = |column: usize, image: usize| document.rows.get(column * document.images + image);
    let of_sheet = |(i, tiles): (usize, &Vec<Tile>)| {
        let name = own(0, i).map_or_else(String::new, |row| row.image.clone());
        let tile = |(tile, name): (&Tile, &String)| {
            let at = document.summary.iter().position(|row| column(row) == *name);
            let row = at.and_then(|at| own(at, i));
            let drawn = tile.drawn();
            SheetTile {
                size: [drawn.width(), drawn.height()],
                pixels: drawn.data().to_vec(),
                of: row.map(|row| [row.scheme.clone(), row.attack.to_owned()]),
                scores: row.map(scores).unwrap_or_default(),
            }
        };
        SheetImage { name, tiles: tiles.iter().zip(&sheet.columns).map(tile).collect() }
    };
    sheet.rows.iter().enumerate().map(of_sheet).collect()
}

fn scores(row: &RebuiltRow) -> String {
    let lpips = row.lpips.map_or_else(String::new, |lpips| format!(", LPIPS {lpips:.3}"));
    let objects = row.objects_found.zip(row.objects).filter(|(_, all)| *all > 0);
    let objects =
        objects.map_or_else(String::new, |(found, all)| format!(", {found} of {all} objects found again"));
    format!("{:.2} dB, SSIM {:.3}{lpips}{objects}.", row.psnr, row.ssim)
}
