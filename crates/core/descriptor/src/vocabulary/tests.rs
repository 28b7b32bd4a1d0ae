//! Training, aggregation and the byte format.

use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::test_data::{clustered_descriptors, random_bytes, random_descriptors};

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// VLAD as documented for [`Vocabulary`], in f64 and with simple loops; `[K * dim]`, unit length.
fn reference(words: DescriptorView<'_>, rows: DescriptorView<'_>) -> Vec<f64> {
    let dim = words.kind().dim();
    let numbers = |of: DescriptorView<'_>, i| of.values(i).map(f64::from).collect::<Vec<f64>>();
    let distance = |word, row| {
        let pairs = numbers(words, word).into_iter().zip(numbers(rows, row));
        pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>()
    };
    let mut vlad = vec![0.0; words.len() * dim];
    for i in 0..rows.len() {
        let word = (0..words.len()).min_by(|&a, &b| distance(a, i).total_cmp(&distance(b, i))).unwrap();
        for d in 0..dim {
            vlad[word * dim + d] += numbers(rows, i)[d] - numbers(words, word)[d];
        }
    }
    for block in vlad.chunks_exact_mut(dim) {
        normalize(block);
    }
    normalize(&mut vlad);
    vlad
}

fn normalize(vector: &mut [f64]) {
    let length = vector.iter().map(|v| v * v).sum::<f64>().sqrt();
    if length > 0.0 {
        for v in vector {
            *v /= length;
        }
    }
}

fn cosine(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[test]
fn training_finds_clusters() {
    let samples = clustered_descriptors(4000, 16, 3, 7);
    let vocabulary = Vocabulary::train(samples.view(), 16, &mut rng(1)).unwrap();
    let nearest = crate::two_nearest(samples.view(), vocabulary.words());
    let worst = nearest.iter().map(|n| n.unwrap().nearest.distance).max().unwrap();
    assert!(worst < 128 * 16, "a sample is {worst} away from its word");
}

#[test]
fn training_is_independent_of_the_thread_count() {
    let samples = random_descriptors(9000, 3);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Vocabulary::train(samples.view(), 20, &mut rng(5)).unwrap())
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(3));
    assert_ne!(one, Vocabulary::train(samples.view(), 20, &mut rng(6)).unwrap());
}

#[test]
fn lloyd_improves_on_its_seeds() {
    let samples = random_descriptors(5000, 11);
    let total = |words: DescriptorView<'_>| -> u64 {
        let nearest = crate::two_nearest(samples.view(), words);
        nearest.iter().map(|n| u64::from(n.unwrap().nearest.distance)).sum()
    };
    let trained = Vocabulary::train(samples.view(), 32, &mut rng(2)).unwrap();
    let untrained = samples.select(0..32);
    assert!(total(trained.words()) < total(untrained.view()) * 7 / 10);
}

#[test]
fn as_many_words_as_different_samples() {
    // Each of 8 rows three times: each word must be one of them, and each must be a word.
    let rows = random_descriptors(8, 21);
    let samples = rows.select((0..24).map(|i| i % 8));
    let vocabulary = Vocabulary::train(samples.view(), 8, &mut rng(1)).unwrap();
    let nearest = crate::two_nearest(samples.view(), vocabulary.words());
    assert!(nearest.iter().all(|n| n.unwrap().nearest.distance == 0));
}

#[test]
fn a_word_without_samples_moves_to_the_farthest_sample() {
    let samples = clustered_descriptors(300, 3, 2, 5);
    // The second word is a copy of the first, so it has no samples (ties go to the lowest index).
    let words = samples.select([0, 0, 1]);
    let next = kmeans::lloyd_round(samples.view(), words.as_bytes());
    let before = crate::two_nearest(samples.view(), words.view());
    let farthest =
        (0..300).max_by_key(|&i| (before[i].unwrap().nearest.distance, std::cmp::Reverse(i))).unwrap();
    assert_eq!(&next[128..256], samples.row(farthest));
}

#[test]
fn too_few_samples_are_rejected() {
    let few = random_descriptors(5, 1);
    let refused = |samples: DescriptorView<'_>, k| Vocabulary::train(samples, k, &mut rng(1)).unwrap_err();
    assert_eq!(refused(few.view(), 6), DescriptorError::TooFewSamples { samples: 5, distinct: 5, words: 6 });
    let same = few.select([2; 100]);
    assert_eq!(
        refused(same.view(), 2),
        DescriptorError::TooFewSamples { samples: 100, distinct: 1, words: 2 }
    );
    let none = Descriptors::empty(DescriptorKind::ROOT_SIFT);
    assert_eq!(refused(none.view(), 1), DescriptorError::TooFewSamples { samples: 0, distinct: 0, words: 1 });
    let max = Vocabulary::MAX_LEN;
    assert_eq!(refused(few.view(), 0), DescriptorError::WordCount { words: 0, max });
    assert_eq!(refused(few.view(), max + 1), DescriptorError::WordCount { words: max + 1, max });
}

#[test]
fn cosines_of_codes_agree_with_exact_vectors() {
    let vocabulary = Vocabulary::train(random_descriptors(3000, 1).view(), 64, &mut rng(1)).unwrap();
    // Images that share some, all or none of their descriptors; with 1 to 2000 descriptors.
    let all = random_descriptors(4000, 2);
    let mut worst = 0.0_f64;
    for (a, b) in
        [(0..1, 0..1), (0..1, 0..2), (0..7, 3..20), (0..100, 50..150), (0..2000, 1000..3000), (0..9, 9..2000)]
    {
        let (a, b) = (all.view().rows(a), all.view().rows(b));
        let exact = cosine(&reference(vocabulary.words(), a), &reference(vocabulary.words(), b));
        let codes = vocabulary.aggregate(a).similarity(vocabulary.aggregate(b).as_codes());
        worst = worst.max((exact - f64::from(codes)).abs());
    }
    assert!(worst < 0.002, "cosine off by {worst}");
}

#[test]
fn signed_numbers_are_aggregated() {
    let kind = DescriptorKind::new("own", 64, crate::Encoding::Signed, 100).unwrap();
    let words = Vocabulary::train(random_bytes(kind, 300, 1).view(), 8, &mut rng(1)).unwrap();
    let (a, b) = (random_bytes(kind, 50, 2), random_bytes(kind, 60, 3));
    let exact = cosine(&reference(words.words(), a.view()), &reference(words.words(), b.view()));
    let codes = words.aggregate(a.view()).similarity(words.aggregate(b.view()).as_codes());
    assert!((exact - f64::from(codes)).abs() < 0.002, "{exact} {codes}");
}

#[test]
fn a_residual_in_one_component_does_not_saturate() {
    let mut word = [0; 128];
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, word.to_vec()).unwrap();
    word[5] = 255;
    let row = Descriptors::new(DescriptorKind::ROOT_SIFT, word.to_vec()).unwrap();
    let global = Vocabulary::new(words).unwrap().aggregate(row.view());
    assert!(global.as_codes().iter().enumerate().all(|(i, &code)| code == if i == 5 { 127 } else { 0 }));
}

#[test]
fn no_descriptors_give_zeros() {
    let vocabulary = Vocabulary::new(random_descriptors(4, 1)).unwrap();
    let global = vocabulary.aggregate(Descriptors::empty(DescriptorKind::ROOT_SIFT).view());
    assert_eq!(global.as_codes(), [0; 4 * 128]);
    assert_eq!(global.len(), vocabulary.global_len());
    // A descriptor that equals a word has no residual either.
    let global = vocabulary.aggregate(vocabulary.words());
    assert_eq!(global.as_codes(), [0; 4 * 128]);
}

#[test]
fn result_is_independent_of_the_order() {
    let vocabulary = Vocabulary::new(random_descriptors(16, 1)).unwrap();
    let rows = random_descriptors(500, 2);
    let reversed = rows.select((0..500).rev());
    assert_eq!(vocabulary.aggregate(rows.view()), vocabulary.aggregate(reversed.view()));
}

#[test]
fn bytes_are_pinned() {
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, (0..=255).collect()).unwrap();
    let bytes = Vocabulary::new(words).unwrap().to_bytes();
    assert_eq!(&bytes[..12], b"VLAD\x01\0\0\0\x02\0\0\0");
    assert_eq!(bytes[12..52], DescriptorKind::ROOT_SIFT.to_bytes());
    assert_eq!(&bytes[52..], (0..=255).collect::<Vec<u8>>());
}

#[test]
fn kind_of_the_words_round_trips() {
    let kind = DescriptorKind::new("own", 3, crate::Encoding::Signed, 100).unwrap();
    let vocabulary = Vocabulary::new(Descriptors::new(kind, vec![1, 2, 3, 4, 5, 6]).unwrap()).unwrap();
    let bytes = vocabulary.to_bytes();
    assert_eq!(bytes[12..52], kind.to_bytes());
    assert_eq!(bytes[52..], [1, 2, 3, 4, 5, 6]);
    assert_eq!(Vocabulary::from_bytes(&bytes).unwrap(), vocabulary);
    for cut in 0..bytes.len() {
        assert!(Vocabulary::from_bytes(&bytes[..cut]).is_err(), "{cut}");
    }
    assert!(Vocabulary::from_bytes(&[&bytes[..], &[0]].concat()).is_err());
}

#[test]
fn error_names_the_fault_of_damaged_bytes() {
    let good = Vocabulary::new(random_descriptors(3, 1)).unwrap().to_bytes();
    let refused = |at: usize, value: u8| {
        let mut bytes = good.clone();
        bytes[at] = value;
        Vocabulary::from_bytes(&bytes).unwrap_err()
    };
    assert_eq!(refused(0, b'X'), DescriptorError::NotAVocabulary);
    for found in [0, 2] {
        let error = refused(4, found);
        assert_eq!(error, DescriptorError::VocabularyVersion { found: found.into(), supported: 1 });
        assert!(error.to_string().contains("train it again"), "{error}");
    }
    assert_eq!(refused(12, 0), DescriptorError::Name);
    assert_eq!(refused(8, 0), DescriptorError::WordCount { words: 0, max: Vocabulary::MAX_LEN });
    assert_eq!(refused(8, 4), DescriptorError::VocabularyLength { expected: 564, found: 436 });
    assert_eq!(refused(11, 255), DescriptorError::WordCount { words: 0xff00_0003, max: Vocabulary::MAX_LEN });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn bytes_round_trip(words in 1_usize..20, seed: u64) {
        let vocabulary = Vocabulary::new(random_descriptors(words, seed)).unwrap();
        prop_assert_eq!(Vocabulary::from_bytes(&vocabulary.to_bytes()).unwrap(), vocabulary);
    }

    #[test]
    fn bytes_of_wrong_length_are_rejected(words in 1_usize..4, cut: prop::sample::Index, more in 1_usize..300) {
        let mut bytes = Vocabulary::new(random_descriptors(words, 1)).unwrap().to_bytes();
        prop_assert!(Vocabulary::from_bytes(&bytes[..cut.index(bytes.len())]).is_err());
        bytes.resize(bytes.len() + more, 0);
        prop_assert!(Vocabulary::from_bytes(&bytes).is_err());
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = Vocabulary::from_bytes(&bytes);
        let with_magic = [b"VLAD\x01\0\0\0\x01\0\0\0", &bytes[..]].concat();
        let _ = Vocabulary::from_bytes(&with_magic);
        let with_kind = [&with_magic[..12], &DescriptorKind::ROOT_SIFT.to_bytes(), &bytes].concat();
        let _ = Vocabulary::from_bytes(&with_kind);
    }
}
