//! The example localizes images sealed in one session.

#[path = "../../examples/session.rs"]
#[expect(dead_code, reason = "its own main is not called")]
#[expect(clippy::duplicate_mod, reason = "each example has the module beside it")]
mod example;

#[test]
fn example_localizes_session_images() {
    let errors = example::run().expect("it runs");
    assert_eq!(errors.len(), 3);
    assert!(errors.iter().all(|metres| *metres < 0.05), "{errors:?}");
}
