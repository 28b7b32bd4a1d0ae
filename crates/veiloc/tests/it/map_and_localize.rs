//! The example builds a map and localizes its queries.

#[path = "../../examples/map_and_localize.rs"]
#[expect(dead_code, reason = "its own main is not called")]
#[expect(clippy::duplicate_mod, reason = "each example has the module beside it")]
mod example;

#[test]
fn example_localizes_its_queries() {
    let errors = example::run().expect("it runs");
    assert_eq!(errors.len(), 3);
    assert!(errors.iter().all(|metres| *metres < 0.02), "{errors:?}");
}
