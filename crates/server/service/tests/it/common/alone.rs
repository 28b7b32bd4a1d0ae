//! A test in a process of its own: the log is the process's, and other tests write to it too.
#![allow(dead_code, unreachable_pub)] // each user takes its own part

use std::process::Command;

/// Set in the process that is there for one test.
const CHILD: &str = "VEILOC_TEST_ALONE";

/// Runs `test` in a process of its own; `name` is that of the calling test, with its modules.
pub fn alone(name: &str, test: impl FnOnce()) {
    if std::env::var_os(CHILD).is_some() {
        return test();
    }
    let output = Command::new(std::env::current_exe().expect("this program"))
        .args(["--exact", name, "--nocapture"])
        .env(CHILD, "1")
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    assert!(output.status.success() && said.contains("1 passed"), "{said}");
}
