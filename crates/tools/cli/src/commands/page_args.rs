//! The page that `serve` and `demo` serve: where its files are, and what it is told.

use std::path::PathBuf;

use serde::Serialize;
use veiloc_service::web_page::Page;

use crate::exit::Failure;

/// Reads the page of a folder, or where it is found, and tells it what there is to show.
///
/// # Errors
/// [`Failure`] when there is no page, or its files cannot be read.
pub(crate) fn page(folder: Option<&PathBuf>, about: &About) -> Result<Page, Failure> {
    let found = match folder {
        Some(folder) => folder.clone(),
        None => Page::folder(&std::env::current_exe()?)?,
    };
    let mut page = Page::read(&found)?;
    page.add("page.json", serde_json::to_vec(about)?)?;
    Ok(page)
}

/// What a page is told: `page.json`, between one version of program and page.
#[derive(Debug, Serialize)]
pub(crate) struct About {
    /// Most points of a map that it is shown.
    pub points: usize,
    /// Images to pick from.
    pub views: Vec<View>,
}

/// An image to pick.
#[derive(Debug, Serialize)]
pub(crate) struct View {
    /// For people.
    pub name: String,
    /// Its file of the page.
    pub file: String,
    /// Its camera, as COLMAP writes it.
    pub camera: String,
}
