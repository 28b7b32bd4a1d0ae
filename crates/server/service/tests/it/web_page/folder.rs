//! Which files of a folder are read.

use std::fs;

use veiloc_service::ServerError;
use veiloc_service::web_page::Page;

#[test]
fn only_allowed_files_are_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str| fs::write(folder.path().join(name), name).expect("written");
    let missing = |page: Result<Page, ServerError>| match page {
        Err(ServerError::PageIncomplete { missing, .. }) => missing,
        other => panic!("{other:?}"),
    };
    assert_eq!(missing(Page::read(folder.path())), "index.html");
    write("index.html");
    assert_eq!(missing(Page::read(folder.path())), "veiloc.wasm");
    for name in ["veiloc.wasm", "a.js", "secret.pem", ".hidden.js", "b c.js", ".js"] {
        write(name);
    }
    fs::create_dir(folder.path().join("sub.js")).expect("made");
    let page = Page::read(folder.path()).expect("a page");
    let known = |name: &str| page.file(name).map(|file| file.content_type);
    assert_eq!(known("a.js"), Some("text/javascript; charset=utf-8"));
    for none in ["secret.pem", "b c.js", ".js", "sub.js", "../index.html", "", "."] {
        assert_eq!(known(none), None, "{none}");
    }
    assert!(matches!(Page::read(&folder.path().join("no")), Err(ServerError::Io { .. })));
}

#[test]
fn too_large_folder_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = fs::File::create(folder.path().join("index.html")).expect("made");
    file.set_len(1 << 40).expect("a hole");
    assert!(matches!(Page::read(folder.path()), Err(ServerError::PageTooLarge { .. })));
}

#[test]
fn default_folder_is_next_to_the_program_or_in_share() {
    let root = tempfile::tempdir().expect("a folder");
    let program = root.path().join("bin/veiloc");
    let message = Page::folder(&program).expect_err("nowhere").to_string();
    assert!(message.contains("bin/veiloc-page") && message.contains("--page-folder"), "{message}");
    for folder in ["share/veiloc/veiloc-page", "bin/veiloc-page"] {
        let folder = root.path().join(folder);
        fs::create_dir_all(&folder).expect("made");
        fs::write(folder.join("index.html"), "").expect("written");
        assert_eq!(Page::folder(&program).expect("found"), folder);
    }
}
