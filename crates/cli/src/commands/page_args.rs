//! The web page of `serve` and `demo`: its files and its configuration.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;
use veiloc_service::web_page::Page;

use crate::output::exit::Failure;

/// Loads the page from the given or the default folder, and adds its configuration.
///
/// # Errors
/// [`Failure`] if there is no page, or its files cannot be read.
pub(crate) fn page(folder: Option<&PathBuf>, page_config: &PageConfig) -> Result<Page, Failure> {
    let found = match folder {
        Some(folder) => folder.clone(),
        None => Page::folder(&std::env::current_exe()?)?,
    };
    let mut page = Page::read(&found)?;
    let mut page_config = serde_json::to_value(page_config)?;
    // Whether the page can hide people: the operator put the network into the folder.
    page_config["people"] = page.file(Page::PEOPLE).is_some().into();
    page.add("page.json", serde_json::to_vec(&page_config)?)?;
    Ok(page)
}

/// Configuration of the page, `page.json`; program and page must have the same version.
#[derive(Debug, Default, Serialize)]
pub(crate) struct PageConfig {
    /// Maximum number of map points that the page shows.
    pub points: usize,
    /// Images that the page offers.
    pub views: Vec<PageView>,
    /// By map, where it is known: the direction of its x axis, degrees from east, counter-clockwise.
    pub north: BTreeMap<String, f64>,
}

/// An image that the page offers.
#[derive(Debug, Serialize)]
pub(crate) struct PageView {
    /// Displayed name.
    pub name: String,
    /// Path on the page's server.
    pub file: String,
    /// Its camera, in COLMAP's text form.
    pub camera: String,
}
