//! Tests of `web_page`.

mod folder;
