//! Numbers of map images and queries of the published scenes.
//!
//! 7Scenes: its `TrainSplit.txt` and `TestSplit.txt` (1000 or 500 frames a sequence); Cambridge Landmarks: its
//! `dataset_train.txt` and `dataset_test.txt`; Aachen: `3D-models` and `queries` of v1 and v1.1.

/// Data set, scene, map images, queries.
const COUNTS: &[(&str, &str, usize, usize)] = &[
    ("7scenes", "chess", 4000, 2000),
    ("7scenes", "fire", 2000, 2000),
    ("7scenes", "heads", 1000, 1000),
    ("7scenes", "office", 6000, 4000),
    ("7scenes", "pumpkin", 4000, 2000),
    ("7scenes", "redkitchen", 7000, 5000),
    ("7scenes", "stairs", 2000, 1000),
    ("cambridge", "GreatCourt", 1531, 760),
    ("cambridge", "KingsCollege", 1220, 343),
    ("cambridge", "OldHospital", 895, 182),
    ("cambridge", "ShopFacade", 231, 103),
    ("cambridge", "StMarysChurch", 1487, 530),
    ("aachen", "aachen", 4328, 922),
    ("aachen-v1.1", "aachen-v1.1", 6697, 1015),
];

/// Whether these numbers of map images and queries are those of the published scene.
pub(crate) fn is_whole(data_set: &str, scene: &str, mapped: usize, queries: usize) -> bool {
    COUNTS.contains(&(data_set, scene, mapped, queries))
}
