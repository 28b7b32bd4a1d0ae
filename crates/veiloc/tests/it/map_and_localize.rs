//! The example does what it says: a place is mapped and its queries are found.

#[path = "../../examples/map_and_localize.rs"]
#[expect(dead_code, reason = "its own main is not called")]
mod map_and_localize;

#[test]
fn a_place_is_mapped_and_its_queries_are_found() {
    let errors = map_and_localize::run().expect("it runs");
    assert_eq!(errors.len(), 3);
    assert!(errors.iter().all(|metres| *metres < 0.02), "{errors:?}");
}
