//! Runs a test in a separate process, because the log is global and other tests write to it too.
#![allow(dead_code, unreachable_pub)] // each user takes its own part

use std::process::Command;

/// Set in the child process.
const CHILD: &str = "VEILOC_TEST_ALONE";

/// Runs `test` in a separate process; `name` is that of the calling test, with its modules.
pub fn run_in_own_process(name: &str, test: impl FnOnce()) {
    if std::env::var_os(CHILD).is_some() {
        return test();
    }
    let output = Command::new(std::env::current_exe().expect("this program"))
        .args(["--exact", name, "--nocapture"])
        .env(CHILD, "1")
        .output()
        .expect("it runs");
    let output_text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    assert!(output.status.success() && output_text.contains("1 passed"), "{output_text}");
}
